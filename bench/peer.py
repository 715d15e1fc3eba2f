"""Renderers in an environment of their own (bench/peers, `make peers`), as child processes that answer in JSON."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from plain import plain_scene
from scenes import UnsupportedError, build

HERE = Path(__file__).parent
PEERS = ("cycles", "luxcore")
ENVIRONMENT = Path(os.environ.get("VENV_PEERS", HERE.parent / ".venv-peers"))
ONCE_TRIES = 3


def installed() -> bool:
    """Whether `make peers` has run."""
    return (ENVIRONMENT / "bin" / "python").exists()


class Peer:
    """A scene in a renderer of bench/peers, loaded; the child is pinned as this process is. What a picture takes whatever its
    samples (the peers load their scene anew for each) is measured with pictures of one sample, and left out of `seconds`."""

    def __init__(self, name: str, which: str) -> None:
        if not installed():
            raise ImportError(f"{which} is not installed (make peers)")
        self._folder = tempfile.TemporaryDirectory(prefix="penumbra-bench-")
        scene, held = build(name)
        plain = plain_scene(scene, held, Path(self._folder.name))
        self._log = Path(self._folder.name) / "log"
        with self._log.open("w") as log:
            self._child = subprocess.Popen(
                [ENVIRONMENT / "bin" / "python", "-W", "ignore", HERE / "peers" / "serve.py", which],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True,
            )  # fmt: skip
        answer = self._ask(scene=plain, folder=self._folder.name)
        if "unsupported" in answer:
            self.close()
            raise UnsupportedError(f"{which}: {answer['unsupported']}")
        self.version = str(answer["ready"])
        self._once: tuple[float, float] | None = None
        self._seconds = 0.0

    def _ask(self, **words: Any) -> dict[str, Any]:
        assert self._child.stdin is not None
        assert self._child.stdout is not None
        self._child.stdin.write(json.dumps(words) + "\n")
        self._child.stdin.flush()
        line = self._child.stdout.readline()
        if not line:
            raise RuntimeError(f"a peer ended:\n{self._log.read_text()[-2000:]}")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def prepare(self, samples: int) -> None:
        """Measures pictures of one sample: (samples that were taken, seconds), the fastest of some."""
        if self._once is None:
            tries = [self._ask(samples=1, seed=900 + i) for i in range(ONCE_TRIES)]
            self._once = min(((t["samples"], t["seconds"]) for t in tries), key=lambda t: t[1])

    def render(self, samples: int, seed: int) -> NDArray[np.float64]:
        """(height, width, 3), linear radiance."""
        assert self._once is not None
        answer = self._ask(samples=samples, seed=seed)
        file = Path(answer["file"])
        picture = np.load(file).astype(np.float64)
        file.unlink()
        taken, seconds = answer["samples"], answer["seconds"]
        share = samples / max(taken - self._once[0], 1.0)
        self._seconds += max(seconds - self._once[1], 0.0) * share
        return np.asarray(picture)

    def seconds(self) -> float:
        """Spent on samples so far."""
        return self._seconds

    def close(self) -> None:
        """Ends the child, which ends with its input."""
        self._child.communicate()
        self._folder.cleanup()


def versions() -> dict[str, str]:
    """Of the packages that are installed."""
    if not installed():
        return dict.fromkeys(PEERS, "not installed")
    ask = "import importlib.metadata as m; print(m.version('bpy'), m.version('pyluxcore'))"
    run = [ENVIRONMENT / "bin" / "python", "-c", ask]
    found = subprocess.run(run, capture_output=True, text=True, check=True).stdout.split()
    return dict(zip(PEERS, found, strict=True))
