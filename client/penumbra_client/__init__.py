"""A Python client of Penumbra's HTTP API, and the command line `penumbra`. Needs no OpenCL and no numpy.

from penumbra_client import Client

with Client() as client:                                   # PENUMBRA_SERVER, or http://127.0.0.1:8484
    job = client.submit("scene.json", stop={"relative_error": 0.02})
    for event in client.watch(job.id):
        print(event.samples_done, event.relative_error)
    paths = client.fetch(job.id, "out")
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from penumbra_client.client import Client as Client
    from penumbra_client.errors import ClientError as ClientError
    from penumbra_client.errors import JobCancelledError as JobCancelledError
    from penumbra_client.errors import JobFailedError as JobFailedError
    from penumbra_client.errors import RefusedError as RefusedError
    from penumbra_client.errors import UnreachableError as UnreachableError

__all__ = ["Client", "ClientError", "JobCancelledError", "JobFailedError", "RefusedError", "UnreachableError"]


def __getattr__(name: str) -> Any:
    # Lazily, so that `penumbra --help` waits for no HTTP library.
    from importlib import import_module

    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{'client' if name == 'Client' else 'errors'}"), name)
