"""Runs a renderer of this folder, `python serve.py cycles`, and answers one JSON object a line.

These programs run in an environment of their own (`make peers`) and know nothing of Penumbra.

Read: first {"scene": plain scene, "folder": where pictures go}, then any number of {"samples": n, "seed": s}.
Written: {"ready": version}, then {"samples": taken a pixel, "seconds": CPU seconds with all set-up, "file": picture}, a .npy of
(height, width, 3) in float32, linear radiance, first row on top. {"unsupported": reason} ends the program.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.float32]


def serve(
    load: Callable[[dict[str, Any]], Callable[[int, int], tuple[float, Picture]]],
    version: str,
    answers: TextIO,
) -> None:
    """load(scene) -> render(samples, seed) -> (samples that were taken, picture). Answers until its input ends."""

    def answer(**words: Any) -> None:
        print(json.dumps(words), file=answers, flush=True)

    first = json.loads(sys.stdin.readline())
    try:
        render = load(first["scene"])
    except NotImplementedError as error:
        answer(unsupported=str(error))
        return
    answer(ready=version)
    for count, line in enumerate(sys.stdin):
        asked = json.loads(line)
        started = time.process_time()
        taken, picture = render(asked["samples"], asked["seed"])
        seconds = time.process_time() - started
        file = Path(first["folder"]) / f"picture{count}.npy"
        np.save(file, np.asarray(picture, np.float32))
        answer(samples=taken, seconds=seconds, file=str(file))


def main() -> None:
    with os.fdopen(os.dup(1), "w") as answers:
        os.dup2(2, 1)  # what renderers print as they are imported goes to standard error
        renderer = importlib.import_module(f"{sys.argv[1]}_peer")
        serve(renderer.load, renderer.VERSION, answers)


if __name__ == "__main__":
    main()
