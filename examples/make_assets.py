"""Makes what the example scenes need under examples/assets: a dusk sky, tiles, a mesh of 131,072 triangles.

`python examples/make_assets.py [sky] [tiles] [shell]` makes all, or those named. Needs numpy and, for
the pictures, OpenImageIO. What it made is in the repository, so that the examples work as they are.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FOLDER = Path(__file__).resolve().parent / "assets"
RINGS, SIDES = 256, 256
"""Of the shell: 2 * RINGS * SIDES triangles."""


def sky(width: int = 512, height: int = 256) -> NDArray[np.float32]:
    """An equirectangular dusk, W / (m^2 sr): row 0 is straight up, the middle column is -Z."""
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    up = np.cos(np.pi * v)[..., None]
    azimuth = 2 * np.pi * (u - 0.5)[..., None]
    zenith, horizon, ground = (
        np.array(c) for c in ((0.08, 0.16, 0.4), (0.95, 0.55, 0.32), (0.1, 0.09, 0.09))
    )
    glow = np.exp(-np.abs(up) * 4.0)
    colour = np.where(up > 0, zenith + (horizon - zenith) * glow, ground + 0.5 * (horizon - ground) * glow**4)
    towards = np.cos(azimuth - 0.9) * np.sqrt(1 - up**2) * np.cos(0.12) + up * np.sin(0.12)
    colour = colour + np.array([1.0, 0.6, 0.3]) * 1.5 * np.exp((towards - 1) * 30)
    colour = np.where(towards > np.cos(0.06), np.array([180.0, 130.0, 80.0]), colour)
    return colour.astype(np.float32)


def tiles(side: int = 128) -> NDArray[np.uint8]:
    """A picture of sixteen tiles, each with its own hue and a round inlay: 8-bit sRGB, row 0 at the top."""
    y, x = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    cell = side // 4
    number = (y // cell) * 4 + x // cell
    hue = 2 * np.pi * ((number * 7) % 16) / 16
    wave = np.stack([np.cos(hue - shift) for shift in (0.0, 2.1, 4.2)], axis=-1)
    colour = 0.55 + 0.3 * wave
    dx, dy = (x % cell) / cell - 0.5, (y % cell) / cell - 0.5
    inlay = (dx**2 + dy**2 < 0.09)[..., None]
    grout = (np.maximum(abs(dx), abs(dy)) > 0.46)[..., None]
    colour = np.where(inlay, 1.0 - 0.6 * colour, colour)
    return np.where(grout, 235, 255 * colour).astype(np.uint8)


def shell() -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """A fluted torus about the origin: positions (n, 3) in metres, triangles (m, 3) facing outwards."""
    i, j = np.meshgrid(np.arange(RINGS), np.arange(SIDES), indexing="ij")
    a, b = 2 * np.pi * i / RINGS, 2 * np.pi * j / SIDES
    tube = 0.42 * (1 + 0.09 * np.cos(12 * a + 3 * b) + 0.025 * np.cos(9 * b - 24 * a))
    ring = 0.95 + tube * np.cos(b)
    positions = np.stack([ring * np.cos(a), tube * np.sin(b), ring * np.sin(a)], axis=-1)
    corner = i * SIDES + j
    right, up = ((i + 1) % RINGS) * SIDES + j, i * SIDES + (j + 1) % SIDES
    across = ((i + 1) % RINGS) * SIDES + (j + 1) % SIDES
    triangles = np.stack([corner, up, across, corner, across, right], axis=-1).reshape(-1, 3)
    return positions.reshape(-1, 3).astype(np.float32), triangles.astype(np.int32)


def write_picture(path: Path, pixels: NDArray[np.float32] | NDArray[np.uint8]) -> None:
    """Write (height, width, 3) pixels: EXR as half floats, PNG as they are."""
    import OpenImageIO as oiio  # noqa: N813  (its own documentation calls it so)

    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, "half" if path.suffix == ".exr" else "uint8")
    out = oiio.ImageOutput.create(str(path))
    if out is None or not out.open(str(path), spec) or not out.write_image(pixels):
        raise OSError(f"cannot write {path}: {oiio.geterror()}")
    out.close()


def write_ply(path: Path, positions: NDArray[np.float32], triangles: NDArray[np.int32]) -> None:
    """Write binary little-endian PLY."""
    head = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(positions)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"] = 3
    faces["corners"] = triangles
    path.write_bytes(head.encode("ascii") + positions.astype("<f4").tobytes() + faces.tobytes())


def main(names: list[str]) -> None:
    """Make the named assets, or all."""
    FOLDER.mkdir(exist_ok=True)
    wanted = names or ["sky", "tiles", "shell"]
    if "sky" in wanted:
        write_picture(FOLDER / "dusk.exr", sky())
    if "tiles" in wanted:
        write_picture(FOLDER / "tiles.png", tiles())
    if "shell" in wanted:
        write_ply(FOLDER / "shell.ply", *shell())


if __name__ == "__main__":
    main(sys.argv[1:])
