"""The farm: devices of many machines through Dask distributed. The only home of Dask.

Dask gives membership, transport, TLS, liveness and deployment. Which lease a device gets next is decided here, in the
service: tasks are leases, pinned to a worker, two in flight, so that the scheduler never has to choose.
"""
