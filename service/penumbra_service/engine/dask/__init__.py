"""The farm: devices of many machines through Dask distributed. The only home of Dask.

Dask gives membership, transport, TLS, liveness and deployment. Which lease a device gets next is decided here, in the
service, which sends it to the device's worker directly, two at a time: Dask runs no tasks.
"""
