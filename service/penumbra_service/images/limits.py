"""How much decoding one asset may take. Whatever passes these is refused with a message that names the
limit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from penumbra_scene import limits


@dataclass(frozen=True)
class DecodeLimits:
    """Limits on one file and on the process that decodes it."""

    file_bytes: int = limits.MAX_ASSET_BYTES
    pixels: int = limits.MAX_PIXELS
    side: int = limits.MAX_TEXTURE_SIDE
    """Pixels of an image's longer side."""
    triangles: int = limits.MAX_TRIANGLES
    vertices: int = 3 * limits.MAX_TRIANGLES
    memory_bytes: int = 8 << 30
    """Address space of the decoding process."""
    seconds: float = 120.0
    """Wall-clock time of the decoding process."""


DEFAULTS: Final = DecodeLimits()
