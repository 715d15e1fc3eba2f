"""8-bit sRGB PNG files: written aside first and then renamed, so that a reader never meets half a picture, and read back."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from penumbra_service.images.room import writes_into

_LEVEL: Final = 3
"""Of deflate: its usual 6 takes a third more time for 2 % less."""


def write_png(path: Path, pixels: NDArray[np.uint8], texts: Mapping[str, str] | None = None) -> None:
    """(height, width, 3) of sRGB code values. Raises OSError."""
    import OpenImageIO as oiio  # noqa: N813 - its own documentation calls it so

    height, width, channels = pixels.shape
    # Nothing is said of the colour space, which is sRGB without it too: to name it loads a colour configuration, for .05 s.
    spec = oiio.ImageSpec(width, height, channels, oiio.UINT8)
    spec.attribute("png:compressionLevel", _LEVEL)
    for name, text in (texts or {}).items():
        spec.attribute(name, text)
    handle, name = tempfile.mkstemp(prefix=f".{path.name}-", suffix=".png", dir=path.parent)
    os.close(handle)
    try:
        with writes_into(path.parent):
            writer = oiio.ImageOutput.create(name)
            if writer is None:
                raise OSError(oiio.geterror())
            _write(writer, name, spec, pixels)
        Path(name).chmod(0o644)
        Path(name).replace(path)
    finally:
        Path(name).unlink(missing_ok=True)


def _write(writer: Any, name: str, spec: Any, pixels: NDArray[np.uint8]) -> None:
    if not (writer.open(name, spec) and writer.write_image(np.ascontiguousarray(pixels)) and writer.close()):
        raise OSError(writer.geterror())


def read_png(path: Path) -> NDArray[np.uint8]:
    """(height, width, 3) of sRGB code values, from a file that write_png made. Raises OSError."""
    import OpenImageIO as oiio  # noqa: N813 - its own documentation calls it so

    reader = oiio.ImageInput.open(str(path))
    if reader is None:
        raise OSError(f"{path.name}: {oiio.geterror() or 'it cannot be read'}")
    try:
        pixels = reader.read_image(0, 0, 0, 3, oiio.UINT8)
        if pixels is None:
            raise OSError(f"{path.name}: {reader.geterror() or 'it cannot be read'}")
        return np.asarray(pixels, np.uint8)
    finally:
        reader.close()
