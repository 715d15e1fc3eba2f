"""The decoding process: one file in, arrays out, under limits that the operating system enforces.

Run as `python -m penumbra_service.images.decode` with a JSON document on standard input: {kind: image |
mesh, format, path, out, limits}. It writes .npy files into the folder `out` and ends with 0, or with
REFUSED and a message on standard output. Any other end means that the decoder died.
"""

from __future__ import annotations

import json
import resource
import sys
from pathlib import Path
from typing import Any, Final

REFUSED: Final = 3


def confine(memory_bytes: int, seconds: float) -> None:
    """Limits this process's address space and processor time, and turns core dumps off."""
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds) + 1, int(seconds) + 2))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _decode(task: dict[str, Any]) -> None:
    import numpy as np

    from penumbra_service.images.limits import DecodeLimits

    limits = DecodeLimits(**task["limits"])
    path, out = Path(task["path"]), Path(task["out"])
    if task["kind"] == "image":
        from penumbra_service.images.pictures import read_image

        image = read_image(path, limits)
        np.save(out / "pixels.npy", image.pixels)
        np.save(out / "eight_bit.npy", np.array(image.eight_bit))
        return
    from penumbra_service.images.meshes import read_mesh

    mesh = read_mesh(path.read_bytes(), task["format"], limits)
    for name in ("positions", "indices", "normals", "uvs"):
        array = getattr(mesh, name)
        if array is not None:
            np.save(out / f"{name}.npy", array)


def attempt(task: dict[str, Any]) -> str | None:
    """Does the task; why it could not be done, in words, if so.

    Any exception is an answer, since the file is what it comes from.
    """
    try:
        _decode(task)
    except MemoryError:
        return f"decoding it takes more than {task['limits']['memory_bytes'] >> 20} MiB of memory"
    except Exception as error:
        return _in_words(error)
    return None


def main() -> int:
    """The exit status. Only the refusal's text leaves this process."""
    task = json.loads(sys.stdin.read())
    confine(task["limits"]["memory_bytes"], task["limits"]["seconds"])
    refusal = attempt(task)
    if refusal is None:
        return 0
    print(refusal)
    return REFUSED


def _in_words(error: Exception) -> str:
    from penumbra_kernels.assets import AssetError

    text = str(error)
    if isinstance(error, AssetError):
        return text
    return f"it is not a valid file of its format ({text or type(error).__name__})"


if __name__ == "__main__":
    sys.exit(main())
