"""What the service's package adds to the command `penumbra`, found by entry points.

Nothing heavy is imported before a command runs: `penumbra --help` imports this module.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from penumbra_scene.exits import Exit

if TYPE_CHECKING:
    from penumbra_scene.job import DevicePage, JobRequest, ProgressEvent
    from penumbra_scene.quote import Quote
    from penumbra_scene.receipt import Receipt

    from penumbra_service.engine.launch import Child
    from penumbra_service.settings import Settings
    from penumbra_service.store.keys import ApiKey


@dataclass(frozen=True)
class Command:
    """A command as the command line wants it."""

    SUMMARY: str
    DESCRIPTION: str
    configure: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]


class CommandError(Exception):
    """A command cannot do what it should; its text goes to standard error."""

    def __init__(self, message: str, exit_code: Exit = Exit.USAGE) -> None:
        super().__init__(message)
        self.exit_code = exit_code


def _settings(**given: Any) -> Settings:
    from penumbra_service.settings import SettingsError, load_settings

    try:
        return load_settings(given)
    except SettingsError as error:
        raise CommandError(str(error)) from None


_SERVE: Final = """\
Keep a render service up: the REST API, the web pages, and a process for every OpenCL device.

Jobs, assets and results live in the data folder and survive a restart. Every setting has an environment
variable; docs/configuration.md lists them all. Once it listens, the service prints its address.

  penumbra serve                                 on 127.0.0.1:8484
  penumbra serve --port 0 --data out/data        on a free port
  penumbra keys create laptop --data out/data    make a key of that service; then other machines may be let in:
  penumbra serve --host 0.0.0.0 --data out/data
"""


def _add_data(parser: argparse.ArgumentParser, default: Any = None) -> None:
    parser.add_argument(
        "--data",
        type=Path,
        metavar="FOLDER",
        default=default,
        help="where the service keeps everything (default: PENUMBRA_DATA, or ~/.local/share/penumbra)",
    )


def _configure_serve(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--host", help="address to listen on (default 127.0.0.1); any other needs an API key")
    parser.add_argument("--port", type=int, help="TCP port (default 8484); 0 takes a free one")
    _add_data(parser)
    parser.add_argument("--devices", metavar="IDS", help="OpenCL devices, commas between them (default: all)")
    parser.add_argument(
        "--scheduler",
        metavar="URL",
        help="render on the farm of this Dask scheduler: tls://HOST:PORT, or tcp://127.0.0.1:PORT",
    )
    parser.add_argument("--tls", metavar="FOLDER", help="certificates for it, as `penumbra certs` makes them")
    parser.add_argument("--log-level", choices=("debug", "info", "warning", "error"), help="default: info")


def _serve(arguments: argparse.Namespace) -> int:
    from penumbra_kernels import cache

    from penumbra_service.engine.launch import be_frugal, ids_of, start_first
    from penumbra_service.settings import SettingsError

    be_frugal()
    cache.check()
    settings = _settings(
        host=arguments.host,
        port=arguments.port,
        data=arguments.data,
        devices=arguments.devices,
        scheduler=arguments.scheduler,
        tls=arguments.tls,
        log_level=arguments.log_level,
    )
    first = None
    try:
        # The device comes up while the HTTP side is imported.
        first = None if settings.scheduler else start_first(ids_of(settings.devices))
        from penumbra_service.serving import serve

        return serve(settings, first)
    except SettingsError as error:
        raise CommandError(str(error)) from error
    except OSError as error:
        why = error.strerror or str(error)
        raise CommandError(
            f"cannot serve on {settings.host} port {settings.port} with data in {settings.data}: {why}"
        ) from error
    finally:
        if first is not None:
            first.end()


SERVE: Final = Command("keep a render service up", _SERVE, _configure_serve, _serve)

_KEYS: Final = """\
Make, list and revoke the API keys of a service whose data lie on this machine.

A key is shown once, when it is made; only a hash of it is kept. Clients take it from PENUMBRA_API_KEY. Once a
service has ever had a key, it answers nobody without one. Name the data folder that the service was started
with: each folder has its own keys.

  penumbra keys create laptop --data data    of the service that `make serve` keeps up
  penumbra keys create laptop                of one that was started without --data
  penumbra keys list --data data
  penumbra keys revoke laptop --data data
  penumbra keys create render-bot --quota 36000        ten device-hours, then its submissions are refused
  penumbra keys quota render-bot 72000                 raise it; `none` lifts it
"""


def _configure_keys(parser: argparse.ArgumentParser) -> None:
    _add_data(parser)
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    create = actions.add_parser("create", help="make a key, and print it")
    create.add_argument("name", help="what it is for; no two active keys have one name")
    create.add_argument(
        "--quota", type=_quota_seconds, metavar="S", help="device-seconds that its jobs may use"
    )
    listing = actions.add_parser("list", help="list the keys, without what is secret")
    revoke = actions.add_parser("revoke", help="end a key")
    revoke.add_argument("name", help="a key's name or id")
    quota = actions.add_parser("quota", help="limit the device-seconds of a key's jobs")
    quota.add_argument("name", help="a key's name or id")
    quota.add_argument(
        "seconds", type=_quota_seconds, help="in all, those used so far included; `none`: no limit"
    )
    for action in (create, listing, revoke, quota):
        # Without a default of its own, so that the folder may stand on either side of the action's word.
        _add_data(action, argparse.SUPPRESS)


def _keys(arguments: argparse.Namespace) -> int:
    from penumbra_service.store.keys import KeyNameError

    _settings(data=arguments.data)  # a complaint about settings should come before anything is made
    try:
        return _KEY_ACTIONS[arguments.action](arguments)
    except KeyNameError as error:
        raise CommandError(str(error)) from None


def _quota_seconds(text: str) -> float | None:
    if text == "none":
        return None
    try:
        seconds = float(text)
    except ValueError:
        seconds = -1.0
    if not 0 <= seconds < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} given, device-seconds from 0 or `none` accepted")
    return seconds


def _set_quota(arguments: argparse.Namespace) -> int:
    from penumbra_service.serve import set_quota

    if set_quota(arguments.name, arguments.seconds, arguments.data) == 0:
        raise _no_such_key(arguments)
    return Exit.OK


def _no_such_key(arguments: argparse.Namespace) -> CommandError:
    listing = _settings(data=arguments.data).keys_command("list")
    return CommandError(f"there is no active key {arguments.name!r}; `{listing}` shows them")


def _create_key(arguments: argparse.Namespace) -> int:
    from penumbra_service.serve import create_key

    token, _ = create_key(arguments.name, arguments.data, quota_seconds=arguments.quota)
    print(token)
    place = _settings(data=arguments.data)
    kept = "the database of PENUMBRA_DATABASE_URL" if place.database_url else str(place.data.absolute())
    print(f"kept in {kept}: it opens the service that keeps its data there, and no other", file=sys.stderr)
    return Exit.OK


def _list_keys(arguments: argparse.Namespace) -> int:
    from penumbra_service.serve import list_keys

    for key in list_keys(arguments.data):
        state = "active" if key.revoked is None else f"revoked {key.revoked:%Y-%m-%d}"
        print(f"{key.id}  {key.hint}...  {key.created:%Y-%m-%d}  {state}  {_spent(key)}  {key.name}")
    return Exit.OK


def _spent(key: ApiKey) -> str:
    """'1234.5 of 36000 device-seconds'."""
    of = "" if key.quota_seconds is None else f" of {key.quota_seconds:g}"
    return f"{key.used_seconds:.1f}{of} device-seconds"


def _revoke_key(arguments: argparse.Namespace) -> int:
    from penumbra_service.serve import revoke_key

    if revoke_key(arguments.name, arguments.data) == 0:
        raise _no_such_key(arguments)
    return Exit.OK


_KEY_ACTIONS: Final = {"create": _create_key, "list": _list_keys, "revoke": _revoke_key, "quota": _set_quota}
KEYS: Final = Command("make, list and revoke API keys", _KEYS, _configure_keys, _keys)


_EXPLAIN: Final = """\
Say for each effect whether a scene calls for it, and why: a program is compiled with just the effects that are in.

  penumbra explain scene.json
  penumbra explain scene.json --json
  penumbra explain scene.json --measure          what each effect costs on this machine, in seconds and in noise
"""


def _configure_explain(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", type=Path, metavar="SCENE", help="scene file (JSON)")
    parser.add_argument(
        "--time", type=frame_time, default=0.0, metavar="S", help="of the frame, seconds (default 0)"
    )
    parser.add_argument("--json", action="store_true", help="for programs")
    parser.add_argument(
        "--measure", action="store_true", help="trace parts of the scene with and without each effect"
    )
    parser.add_argument("--device", metavar="ID", help="OpenCL device to measure on (default: the first)")
    parser.add_argument(
        "--budget", type=float, default=5.0, metavar="S", help="seconds of tracing to measure for (default 5)"
    )


def frame_time(text: str) -> float:
    """A frame's place in time, seconds, from the command line."""
    with suppress(ValueError):
        if math.isfinite(seconds := float(text)):
            return seconds
    raise argparse.ArgumentTypeError(f"{text!r} given, accepted: a finite number of seconds")


def _explain(arguments: argparse.Namespace) -> int:
    from penumbra_kernels import cache
    from penumbra_scene.errors import ProblemError

    from penumbra_service.explain import explain
    from penumbra_service.measuring import MeasureError, Request, measure_effects

    if not 0 < arguments.budget < math.inf:
        raise CommandError(f"--budget: {arguments.budget:g} given, a number of seconds above 0 accepted")
    try:
        measured = None
        explain(arguments.scene, arguments.time)  # what is no scene is told before a device is asked for
        if arguments.measure:
            cache.check()
            scene = arguments.scene.resolve()
            folders = (str(cache.folder() / "assets"), str(scene.parent))
            request = Request(str(scene), *folders, arguments.time, arguments.device, arguments.budget)
            measured = measure_effects(request)
        text = explain(arguments.scene, arguments.time, as_json=arguments.json, measured=measured)
    except MeasureError as error:
        raise CommandError(str(error), Exit.DEVICE) from error
    except OSError as error:
        raise CommandError(f"cannot read {arguments.scene}: {error.strerror}", Exit.INVALID) from error
    except ProblemError as error:
        raise CommandError(str(error), Exit.INVALID) from error
    print(text)
    return Exit.OK


EXPLAIN: Final = Command("say which effects a scene calls for", _EXPLAIN, _configure_explain, _explain)


class LocalEngine:
    """Renders on this machine's devices, without a service."""

    def __init__(self) -> None:
        self._first: Child | None = None

    @contextmanager
    def ahead(self, devices: str) -> Iterator[None]:
        """Start the first device's process, for a render on these devices that will be asked for."""
        from penumbra_service.engine.launch import be_frugal, ids_of, start_first

        be_frugal()
        with suppress(OSError):  # the render itself will tell
            self._first = start_first(ids_of(devices))
        try:
            yield
        finally:
            if self._first is not None:
                self._first.end()
                self._first = None

    def devices(self) -> DevicePage:
        """The OpenCL devices of this machine."""
        from penumbra_service.rendering import local_devices

        return local_devices()

    def render(
        self,
        request: JobRequest,
        folder: Path,
        out: Path,
        devices: str,
        report: Callable[[ProgressEvent], None],
        *,
        anew: bool = False,
    ) -> tuple[Receipt, ...]:
        """Render a job whose files lie under `folder` and leave its results in `out`; frames that are there already are
        kept, unless `anew`. Raises CommandError."""
        from penumbra_service.rendering import render

        first, self._first = self._first, None
        return render(request, folder, out, devices, report, first, anew=anew)

    def quote(self, request: JobRequest, folder: Path, devices: str) -> Quote:
        """What a job would cost; arguments as for `render`. Raises CommandError."""
        from penumbra_service.rendering import quote

        return quote(request, folder, devices)


ENGINE: Final = LocalEngine()
