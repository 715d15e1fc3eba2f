"""The commands of a farm: `penumbra worker`, `penumbra scheduler`, `penumbra certs`.

Nothing heavy is imported before a command runs: `penumbra --help` imports this module.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any, Final

from penumbra_scene.exits import Exit

from penumbra_service.commands import Command, CommandError

_MISSING: Final = "this command needs the extra 'farm' ({}): pip install 'penumbra-render[service,cpu,farm]'"

_WORKER: Final = """\
Lend this machine's OpenCL devices to a farm: a process for each, which takes leases from the services that use the
same scheduler. Scenes and assets are fetched from the services' artifact store, so that this machine has to reach it.

Processes that end are started again, and look for their scheduler until it is there.

  penumbra worker --scheduler tcp://127.0.0.1:8786                on the scheduler's own machine
  penumbra worker --scheduler tls://farm:8786 --tls certs         on any other (`penumbra certs`)
  penumbra worker --scheduler tls://farm:8786 --tls certs --devices pocl:0 --artifacts s3://renders
"""


def _configure_worker(parser: argparse.ArgumentParser) -> None:
    _add_scheduler(parser)
    _add_tls(parser)
    parser.add_argument(
        "--devices", metavar="IDS", default="", help="OpenCL devices, commas between (default: all)"
    )
    parser.add_argument(
        "--name", default="", help="what the devices' names end with (default: host and process)"
    )
    parser.add_argument(
        "--selftest",
        action="store_true",
        help="run the hard cases on each device first; one that fails does not join",
    )
    parser.add_argument("--host", help="address at which others reach this machine (default: found out)")
    parser.add_argument(
        "--port",
        type=int,
        default=0,
        help="port of the first device's process, the next for the next (default: free)",
    )
    parser.add_argument(
        "--status-port",
        type=int,
        default=0,
        help="port of /health and metrics of the first device's process, on loopback; the next for the next",
    )
    parser.add_argument(
        "--artifacts",
        metavar="URL",
        default=os.environ.get("PENUMBRA_ARTIFACTS_URL"),
        help="the services' artifact store, as it is reached from here (default: PENUMBRA_ARTIFACTS_URL, or as they say)",
    )
    parser.add_argument(
        "--cache", type=Path, metavar="FOLDER", help="for scenes and assets (default: the user's cache)"
    )
    parser.add_argument(
        "--cache-gigabytes", type=float, default=20.0, metavar="G", help="most that it may hold (20)"
    )


def _add_scheduler(parser: argparse.ArgumentParser) -> None:
    given = os.environ.get("PENUMBRA_SCHEDULER")
    parser.add_argument(
        "--scheduler",
        metavar="URL",
        default=given,
        required=not given,
        help="tls://HOST:PORT, or tcp://127.0.0.1:PORT (default: PENUMBRA_SCHEDULER)",
    )


def _add_tls(parser: argparse.ArgumentParser) -> None:
    given = os.environ.get("PENUMBRA_TLS")
    parser.add_argument(
        "--tls",
        type=Path,
        metavar="FOLDER",
        default=Path(given) if given else None,
        help="certificates, as `penumbra certs` makes them (default: PENUMBRA_TLS)",
    )


def _worker(arguments: argparse.Namespace) -> int:
    try:
        from penumbra_service.engine.dask.supervisor import SELFTEST, WorkerOptions, supervise
    except ImportError as error:
        raise CommandError(_MISSING.format(error)) from error
    from penumbra_service import logs
    from penumbra_service.engine.local import NoDeviceError
    from penumbra_service.settings import SettingsError
    from penumbra_service.store.contents import contents_url

    more: dict[str, Any] = {} if arguments.cache is None else {"cache": arguments.cache.absolute()}
    options = WorkerOptions(
        arguments.scheduler,
        arguments.tls,
        tuple(part.strip() for part in arguments.devices.split(",") if part.strip()),
        arguments.name,
        arguments.host,
        arguments.port,
        arguments.status_port,
        contents_url(arguments.artifacts) if arguments.artifacts else None,
        cache_bytes=int(arguments.cache_gigabytes * 1e9),
        selftest=SELFTEST if arguments.selftest else (),
        **more,
    )
    try:
        logs.configure_from(os.environ)
        supervise(options)
    except SettingsError as error:
        raise CommandError(str(error)) from error
    except NoDeviceError as error:
        raise CommandError(str(error), Exit.DEVICE) from error
    return Exit.OK


WORKER: Final = Command("lend this machine's devices to a farm", _WORKER, _configure_worker, _worker)

_SCHEDULER: Final = """\
Keep up the scheduler of a farm: where services and workers meet. It decides nothing, and keeps nothing that would be
missed: when it is killed and started again, workers and services come back by themselves.

Whoever reaches a scheduler runs code on every worker. So it listens on loopback, or asks everybody for a certificate.

  penumbra scheduler                               tcp://127.0.0.1:8786, for this machine
  penumbra certs certs                             once; then
  penumbra scheduler --host 0.0.0.0 --tls certs    tls://, for other machines
"""


def _configure_scheduler(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--host", default="127.0.0.1", help="address to listen on (127.0.0.1); any other needs --tls"
    )
    parser.add_argument("--port", type=int, default=8786, help="TCP port (8786)")
    _add_tls(parser)
    parser.add_argument(
        "--status-port", type=int, default=8787, help="port of /health and metrics, on loopback only (8787)"
    )
    parser.add_argument(
        "--worker-ttl",
        type=float,
        default=20.0,
        metavar="S",
        help="silence after which a worker is given up (20 s)",
    )


def _scheduler(arguments: argparse.Namespace) -> int:
    try:
        from penumbra_service.engine.dask.scheduler import SchedulerOptions, serve_scheduler
    except ImportError as error:
        raise CommandError(_MISSING.format(error)) from error
    from penumbra_service.settings import SettingsError

    options = SchedulerOptions(
        arguments.host, arguments.port, arguments.tls, arguments.status_port, arguments.worker_ttl
    )
    try:
        serve_scheduler(options)
    except SettingsError as error:
        raise CommandError(str(error)) from error
    except OSError as error:
        raise CommandError(f"cannot listen on {options.host} port {options.port}: {error}") from error
    return Exit.OK


SCHEDULER: Final = Command("keep up the scheduler of a farm", _SCHEDULER, _configure_scheduler, _scheduler)

_CERTS: Final = """\
Make the certificates of a farm: an authority of its own, and one certificate each for the scheduler, the workers and
the services. Every file is readable by its owner only. Give each machine ca.pem and the two files of its role, in a
folder that --tls or PENUMBRA_TLS names; keep ca-key.pem off all of them.

  penumbra certs certs
"""


def _configure_certs(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="where the files go; made if need be")
    parser.add_argument("--days", type=int, default=365, help="for which they are valid (365)")


def _certs(arguments: argparse.Namespace) -> int:
    try:
        from penumbra_service.engine.dask.certs import make_certs
    except ImportError as error:
        raise CommandError(_MISSING.format(error)) from error
    if arguments.days < 1:
        raise CommandError(f"--days: given {arguments.days}, accepted: a whole number of at least 1")
    try:
        for path in make_certs(arguments.folder, arguments.days):
            print(path)
    except OSError as error:
        raise CommandError(str(error)) from error
    return Exit.OK


CERTS: Final = Command("make the certificates of a farm", _CERTS, _configure_certs, _certs)
