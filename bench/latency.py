"""How long one waits for Penumbra: whole processes, from their start, in seconds; medians. Prints JSON.

    python bench/latency.py [--runs 5]

    help                `penumbra --help`
    render              `penumbra render` of a small scene, one sample a pixel, programs cached: start to end, files written
    render_cold         the same with empty caches
    render_cold_long    the same with 64 samples a pixel, for which the program with vector lanes is built (decision 20)
    serve_answer        `penumbra serve`: start to the first answer of /v1/health
    serve_picture       start to the first thumbnail of a job that is sent as soon as the service listens
    post_thumbnail      a warm service: POST of a small scene to its first thumbnail

Whoever waits for a thumbnail is told of it by the job's events, as the web pages are. No service has a job from before to
finish. Byte code is cached, as it is for users. bench/memory.py measures memory.
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
PATIENCE: Final = 120.0


class Place:
    """A folder with scenes, caches and whatever the runs leave."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.small = folder / "small.json"
        self.small.write_text(json.dumps(SMALL))
        self.long = folder / "long.json"
        self.long.write_text(json.dumps({**SMALL, "stop": {"samples": 64}}))
        self.environment = {**os.environ, "PENUMBRA_CACHE": str(folder / "cache")}
        for name in ("PYTHONDONTWRITEBYTECODE", "POCL_CACHE_DIR"):
            self.environment.pop(name, None)

    def command(self, *words: str) -> list[str]:
        return [sys.executable, "-m", "penumbra_client", *words]

    def run(self, *words: str) -> float:
        """Seconds of one command."""
        started = time.perf_counter()
        done = subprocess.run(self.command(*words), env=self.environment, capture_output=True, check=False)
        if done.returncode != 0:
            raise RuntimeError(
                f"penumbra {' '.join(words)} ended with {done.returncode}: {done.stderr[-2000:]!r}"
            )
        return time.perf_counter() - started

    def render(self, scene: Path) -> float:
        return self.run("render", str(scene), "--quiet", "--out", str(self.folder / "out"))

    def render_cold(self, scene: Path) -> float:
        """With a cache folder that is new each time; PoCL's own cache is not used (decision 16)."""
        with tempfile.TemporaryDirectory(dir=self.folder) as empty:
            before = self.environment["PENUMBRA_CACHE"]
            self.environment["PENUMBRA_CACHE"] = empty
            try:
                return self.render(scene)
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


def first_thumbnail(url: str, number: int) -> float:
    """Send the small scene, and fetch its first thumbnail: when that was there. Returns once the job has ended. `number`
    makes it a scene of its own."""
    scene = {**SMALL, "sampler": {"type": "sobol", "seed": number}, "stop": {"samples": 64}}
    with httpx.Client(base_url=url, timeout=PATIENCE) as client:
        answer = client.post("/v1/jobs", json={"scene": scene})
        answer.raise_for_status()
        job = f"/v1/jobs/{answer.json()['id']}"
        with client.stream("GET", f"{job}/events") as events:
            told = (json.loads(line[5:]) for line in events.iter_lines() if line.startswith("data:"))
            next(event for event in told if event["thumbnail_revision"])
            client.get(f"{job}/thumbnail.png").raise_for_status()
            there = time.perf_counter()
            for _ in told:
                pass
    return there


def serve_answer(place: Place) -> float:
    with place.serving() as (started, url):
        httpx.get(f"{url}/v1/health", timeout=PATIENCE)
        return time.perf_counter() - started


def serve_picture(place: Place, number: int) -> float:
    with place.serving() as (started, url):
        return first_thumbnail(url, number) - started


def post_thumbnail(place: Place, runs: int) -> list[float]:
    """The first of a service is not counted: it loads the program."""
    seconds = []
    with place.serving() as (_, url):
        for number in range(runs + 1):
            started = time.perf_counter()
            seconds.append(first_thumbnail(url, 1000 + number) - started)
    return seconds[1:]


def median(runs: int, measure: Callable[[int], float]) -> float:
    return round(statistics.median(measure(number) for number in range(runs)), 3)


def measure(place: Place, runs: int) -> dict[str, float]:
    """All of it; programs and byte code are cached by runs that are not counted."""
    place.render(place.small)
    serve_picture(place, 10_000)
    return {
        "help": median(runs, lambda _: place.run("--help")),
        "render": median(runs, lambda _: place.render(place.small)),
        "render_cold": median(min(runs, 3), lambda _: place.render_cold(place.small)),
        "render_cold_long": median(min(runs, 3), lambda _: place.render_cold(place.long)),
        "serve_answer": median(runs, lambda _: serve_answer(place)),
        "serve_picture": median(runs, lambda number: serve_picture(place, number)),
        "post_thumbnail": round(statistics.median(post_thumbnail(place, runs)), 3),
    }


def main() -> None:
    """Prints the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=5)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print(json.dumps(measure(Place(Path(folder)), options.runs)))


if __name__ == "__main__":
    main()
