"""`make demo`: starts the service on loopback, has it render an example as any client would, and stops it.

Everything goes into out/demo: the service's data, its log, and the results.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from penumbra_client import Client, ClientError
from penumbra_client.cli.progress import ProgressView, duration
from penumbra_client.cli.report import error_text
from penumbra_scene.job import JobStatus

ROOT: Final = Path(__file__).resolve().parent.parent
SCENE: Final = ROOT / "examples" / "cornell.json"
OUT: Final = ROOT / "out" / "demo"
_START_SECONDS: Final = 60.0
_STOP_SECONDS: Final = 40.0
_ANNOUNCEMENT: Final = "Penumbra listens on "


class DemoError(Exception):
    """The demonstration cannot go on; its text says what to do."""


def main() -> int:
    """Returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "scene", nargs="?", type=Path, default=SCENE, help="scene file (default: %(default)s)"
    )
    parser.add_argument("--seconds", type=float, default=30.0, help="tracing time after which the demo ends")
    parser.add_argument("--out", type=Path, default=OUT, help="folder for everything (default: %(default)s)")
    arguments = parser.parse_args()
    out: Path = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    try:
        with running_service(out / "data", out / "service.log") as address, Client(address) as client:
            print(f"The service is up on {address}", flush=True)
            job, paths = render(client, arguments.scene, arguments.seconds, out)
            tell(job, paths, out / "data")
    except (DemoError, ClientError) as error:
        print(f"make demo: {error}\nThe service's log is {_short(out / 'service.log')}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("make demo: interrupted; the service is stopped", file=sys.stderr)
        return 130
    return 0


@contextlib.contextmanager
def running_service(data: Path, log: Path) -> Iterator[str]:
    """A service on a free port of this machine; its address. It ends with the `with` statement."""
    command = [sys.executable, "-m", "penumbra_client", "serve", "--port", "0", "--data", str(data)]
    environment = {k: v for k, v in os.environ.items() if k not in ("PENUMBRA_HOST", "PENUMBRA_API_KEY")}
    with log.open("wb") as errors:
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=errors, env=environment, start_new_session=True
        )
    try:
        yield _address(process, log)
    finally:
        _stop(process)


def _address(process: subprocess.Popen[bytes], log: Path) -> str:
    """What the service announces once it listens."""
    assert process.stdout is not None
    deadline = time.monotonic() + _START_SECONDS
    while time.monotonic() < deadline:
        ready, _, _ = select.select([process.stdout], [], [], 0.5)
        line = process.stdout.readline().decode() if ready else ""
        if line.startswith(_ANNOUNCEMENT):
            return line.removeprefix(_ANNOUNCEMENT).strip()
        if process.poll() is not None:
            break
    last = log.read_text(errors="replace").strip().splitlines()[-1:] or ["it said nothing"]
    raise DemoError(f"the service did not start: {last[0]}")


def _stop(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(_STOP_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def render(client: Client, scene: Path, seconds: float, out: Path) -> tuple[JobStatus, dict[str, Path]]:
    """Submit, watch, fetch: three calls of the client."""
    job = client.submit(scene, stop={"samples": _samples_of(scene), "seconds": seconds})
    print(f"Rendering {_short(scene)} as job {job.id}", flush=True)
    with ProgressView() as view:
        job = client.wait(job.id, view)
    return job, client.fetch(job.id, out)


def _samples_of(scene: Path) -> int | None:
    from penumbra_client.scenefile import read_scene

    document, _ = read_scene(str(scene))
    samples: int | None = document.get("stop", {}).get("samples")
    return samples


def tell(job: JobStatus, paths: dict[str, Path], data: Path) -> None:
    """What came out, and what to do next."""
    spent = f"{job.samples_done:.0f} samples a pixel in {duration(job.seconds)} of tracing"
    error = error_text(job.relative_error, job.relative_error_interval)
    print(f"\n{spent}; relative error {error}\n")
    for name, path in paths.items():
        print(f"  {name:10} {_short(path)}")
    print(
        f"\nLook at it in a browser: file://{paths['thumbnail'].resolve()}\n"
        f"or bring the service up again with `make serve DATA={_short(data)}` "
        f"and open http://127.0.0.1:8484{job.links.page}"
    )


def _short(path: Path) -> Path:
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


if __name__ == "__main__":
    sys.exit(main())
