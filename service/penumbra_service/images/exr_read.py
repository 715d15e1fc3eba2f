"""Reads back the EXR that exr.py writes, band by band: its two parts, their channels and attributes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its own documentation calls it so
from numpy.typing import NDArray
from penumbra_kernels.nodes import Tile

from penumbra_service.film.develop import Developed
from penumbra_service.images.exr import COUNTS_PART, PICTURE_PART

BAND_ROWS: Final = 64
"""Scanlines that are read at a time."""


class NotARenderError(ValueError):
    """The file is no EXR of a render; the message says what is missing."""


class ExrReader:
    """An open file. Use it in a `with` statement. Raises NotARenderError, OSError."""

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.is_file():
            raise FileNotFoundError(2, "there is no such file", str(path))
        self._image: Any = oiio.ImageInput.open(str(path))
        if self._image is None:
            raise NotARenderError(f"{path}: {oiio.geterror() or 'is no image'}")
        self._parts = {spec.get_string_attribute("oiio:subimagename"): i for i, spec in self._specs()}
        for part in (PICTURE_PART, COUNTS_PART):
            if part not in self._parts:
                self.close()
                raise NotARenderError(f"{path} has no part {part!r}: it is not a render's result.exr")
        picture = self._spec(PICTURE_PART)
        self.window = Tile(picture.x, picture.y, picture.width, picture.height)
        self.full_size: tuple[int, int] = (picture.full_width, picture.full_height)
        self.float_channels: tuple[str, ...] = tuple(picture.channelnames)
        self.integer_channels: tuple[str, ...] = tuple(self._spec(COUNTS_PART).channelnames)
        self.half = str(picture.channelformat(picture.channelindex("R"))) == "half"
        self.attributes: dict[str, Any] = {a.name: a.value for a in picture.extra_attribs}

    def __enter__(self) -> ExrReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give the file back."""
        self._image.close()

    def bands(self, rows: int = BAND_ROWS) -> Iterator[Developed]:
        """All pixels, from the top, so many scanlines at a time."""
        window = self.window
        for y in range(window.y, window.y + window.height, rows):
            count = min(rows, window.y + window.height - y)
            floats = self._read(PICTURE_PART, "float", y, count)
            integers = self._read(COUNTS_PART, "uint32", y, count)
            yield Developed(
                Tile(window.x, y, window.width, count),
                {name: floats[..., i] for i, name in enumerate(self.float_channels)},
                {name: integers[..., i] for i, name in enumerate(self.integer_channels)},
            )

    def _read(self, part: str, kind: str, y: int, rows: int) -> NDArray[Any]:
        index = self._parts[part]
        channels = len(self._spec(part).channelnames)
        pixels = self._image.read_scanlines(index, 0, y, y + rows, 0, 0, channels, kind)
        if pixels is None:
            raise OSError(f"{self.path}: {self._image.geterror() or 'its pixels cannot be read'}")
        shaped: NDArray[Any] = np.asarray(pixels).reshape(rows, self.window.width, channels)
        return shaped

    def _specs(self) -> Iterator[tuple[int, Any]]:
        index = 0
        while self._image.seek_subimage(index, 0):
            yield index, self._image.spec(index)
            index += 1

    def _spec(self, part: str) -> Any:
        return self._image.spec(self._parts[part])
