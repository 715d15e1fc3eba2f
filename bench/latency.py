"""How long one waits for Penumbra: whole processes, from their start, in seconds; medians. Prints JSON.

    python bench/latency.py [--runs 5] [--memory]

    help                `penumbra --help`
    render              `penumbra render` of a small scene, one sample a pixel, programs cached: start to end, files written
    render_cold         the same with empty caches
    serve_answer        `penumbra serve`: start to the first answer of /v1/health
    serve_picture       start to the first thumbnail of a job that is sent as soon as the service listens
    post_thumbnail      a warm service: POST of a small scene to its first thumbnail
    peak_megabytes      of the largest process that renders the small scene, and one of a million triangles (--memory)

Byte code is cached, as it is for users.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import httpx

SMALL: Final[dict[str, Any]] = {
    "version": 1,
    "camera": {
        "type": "perspective",
        "fov": 40,
        "transform": {"look_at": {"origin": [0, 1, 5], "target": [0, 0.8, 0]}},
    },
    "film": {"width": 256, "height": 256},
    "materials": {"gray": {"type": "diffuse", "base_color": 0.6}},
    "shapes": [
        {"type": "plane", "material": "gray"},
        {"type": "sphere", "center": [0, 0.8, 0], "radius": 0.8, "material": "gray"},
        {"type": "quad", "origin": [-1, 3, -1], "u": [2, 0, 0], "v": [0, 0, 2], "emission": {"radiance": 5}},
    ],
    "stop": {"samples": 1},
}
GRID: Final = (1000, 500)
"""Cells of the large mesh, two triangles each."""
POLL_SECONDS: Final = 0.002
PATIENCE: Final = 120.0


class Place:
    """A folder with scenes, caches and whatever the runs leave."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.small = folder / "small.json"
        self.small.write_text(json.dumps(SMALL))
        self.environment = {**os.environ, "PENUMBRA_CACHE": str(folder / "cache")}
        self.environment.pop("PYTHONDONTWRITEBYTECODE", None)

    def command(self, *words: str) -> list[str]:
        return [sys.executable, "-m", "penumbra_client", *words]

    def run(self, *words: str) -> tuple[float, float]:
        """One command: seconds, and megabytes of the largest of its processes."""
        started = time.perf_counter()
        process = subprocess.Popen(
            self.command(*words), env=self.environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode != 0:
            raise RuntimeError(f"penumbra {' '.join(words)} ended with {process.returncode}")
        return time.perf_counter() - started, usage.ru_maxrss / 1024.0

    def render(self, scene: Path) -> tuple[float, float]:
        return self.run("render", str(scene), "--quiet", "--out", str(self.folder / "out"))

    def render_cold(self) -> float:
        """With a cache folder that is new each time; PoCL's own cache is not used (decision 16)."""
        with tempfile.TemporaryDirectory(dir=self.folder) as empty:
            before = self.environment["PENUMBRA_CACHE"]
            self.environment["PENUMBRA_CACHE"] = empty
            try:
                return self.render(self.small)[0]
            finally:
                self.environment["PENUMBRA_CACHE"] = before

    @contextmanager
    def serving(self) -> Iterator[tuple[float, str]]:
        """A service: when it was started, and where it listens."""
        started = time.perf_counter()
        process = subprocess.Popen(
            self.command("serve", "--port", "0", "--data", str(self.folder / "data"), "--log-level", "error"),
            env=self.environment,
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            if not line:
                raise RuntimeError("the service ended before it listened")
            yield started, line.split()[-1]
        finally:
            process.terminate()
            process.wait(PATIENCE)


def first_thumbnail(url: str, number: int) -> None:
    """Send the small scene, and wait until a thumbnail of it can be fetched. `number` makes it a scene of its own."""
    scene = {**SMALL, "sampler": {"type": "sobol", "seed": number}, "stop": {"samples": 64}}
    with httpx.Client(base_url=url, timeout=PATIENCE) as client:
        answer = client.post("/v1/jobs", json={"scene": scene})
        answer.raise_for_status()
        thumbnail = f"/v1/jobs/{answer.json()['id']}/thumbnail.png"
        deadline = time.perf_counter() + PATIENCE
        while client.get(thumbnail).status_code != httpx.codes.OK:
            if time.perf_counter() > deadline:
                raise RuntimeError(f"no thumbnail of {url}{thumbnail} in {PATIENCE:g} s")
            time.sleep(POLL_SECONDS)


def serve_answer(place: Place) -> float:
    with place.serving() as (started, url):
        httpx.get(f"{url}/v1/health", timeout=PATIENCE)
        return time.perf_counter() - started


def serve_picture(place: Place, number: int) -> float:
    with place.serving() as (started, url):
        first_thumbnail(url, number)
        return time.perf_counter() - started


def post_thumbnail(place: Place, runs: int) -> list[float]:
    """The first of a service is not counted: it loads the program."""
    seconds = []
    with place.serving() as (_, url):
        for number in range(runs + 1):
            started = time.perf_counter()
            first_thumbnail(url, 1000 + number)
            seconds.append(time.perf_counter() - started)
            time.sleep(1.0)  # the job before has ended
    return seconds[1:]


def write_mesh(path: Path) -> None:
    """A wavy square, GRID cells, as a binary PLY file."""
    import numpy as np

    columns, rows = GRID
    x, z = np.meshgrid(np.linspace(-2, 2, columns + 1), np.linspace(-2, 2, rows + 1))
    vertices = np.stack([x, 0.8 + 0.1 * np.sin(9 * x) * np.cos(7 * z), z], -1).astype("<f4").reshape(-1, 3)
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    faces = np.zeros(2 * len(corner), [("n", "u1"), ("v", "<i4", 3)])
    faces["n"] = 3
    faces["v"][0::2] = np.stack([corner, corner + columns + 1, corner + 1], -1)
    faces["v"][1::2] = np.stack([corner + 1, corner + columns + 1, corner + columns + 2], -1)
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    path.write_bytes(header.encode() + vertices.tobytes() + faces.tobytes())


def peak_megabytes(place: Place) -> dict[str, float]:
    """The large scene twice: the first time its mesh is decoded and its tree built."""
    write_mesh(place.folder / "mesh.ply")
    mesh = {"type": "mesh", "source": {"file": "mesh.ply"}, "material": "gray"}
    large = place.folder / "large.json"
    large.write_text(json.dumps({**SMALL, "shapes": [*SMALL["shapes"], mesh], "stop": {"samples": 16}}))
    return {
        "small": place.render(place.small)[1],
        "million_triangles": place.render(large)[1],
        "million_triangles_again": place.render(large)[1],
    }


def median(runs: int, measure: Callable[[int], float]) -> float:
    return round(statistics.median(measure(number) for number in range(runs)), 3)


def measure(place: Place, runs: int, *, memory: bool) -> dict[str, Any]:
    """All of it; programs and byte code are cached by runs that are not counted."""
    place.render(place.small)
    serve_picture(place, 10_000)
    found: dict[str, Any] = {
        "help": median(runs, lambda _: place.run("--help")[0]),
        "render": median(runs, lambda _: place.render(place.small)[0]),
        "render_cold": median(min(runs, 3), lambda _: place.render_cold()),
        "serve_answer": median(runs, lambda _: serve_answer(place)),
        "serve_picture": median(runs, lambda number: serve_picture(place, number)),
        "post_thumbnail": round(statistics.median(post_thumbnail(place, runs)), 3),
    }
    if memory:
        found["peak_megabytes"] = {name: round(value) for name, value in peak_megabytes(place).items()}
    return found


def main() -> None:
    """Prints the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--memory", action="store_true", help="measure memory too, with a million triangles")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print(json.dumps(measure(Place(Path(folder)), options.runs, memory=options.memory), indent=1))


if __name__ == "__main__":
    main()
