"""Tracing single rays through compiled geometry, one program for all scenes. Metres, relative to the anchor."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_scene.scene import Scene

from penumbra_kernels.accel.compact import tree_arrays
from penumbra_kernels.assets import Assets, MeshData, NoAssets
from penumbra_kernels.compile.geometry import CompiledGeometry, compile_geometry
from penumbra_kernels.device import Device

NONE: Final = 0xFFFFFFFF
TRIANGLE, SPHERE, DISC, PLANE = range(4)

ANSWER = np.dtype(
    [
        ("t", "f4"), ("u", "f4"), ("v", "f4"), ("kind", "u4"), ("primitive", "u4"), ("instance", "u4"),
        ("shape", "u4"),
        ("occluded", "u4"), ("p", "f4", 3), ("p_error", "f4", 3), ("ng", "f4", 3), ("ns", "f4", 3),
        ("tangent", "f4", 3), ("uv", "f4", 2), ("origin", "f4", 3),
    ]
)  # fmt: skip

BUFFERS = (
    "nodes", "packets", "shapes", "triangles", "positions", "normals", "uvs", "spheres", "discs", "planes",
    "instances",
)  # fmt: skip
EFFECTS = ("ROUND", "INSTANCING", "MOTION", "DEFORMATION", "TEXTURES")


RAYS_PER_ITEM: Final = 64
"""On CPUs, as in probe.cl."""
PROBE: Final = Path(__file__).with_name("probe.cl")


class Meshes(Assets):
    """Assets held in memory, by name."""

    def __init__(self) -> None:
        self.held: dict[str, MeshData] = {}

    def mesh(self, ref: Any) -> MeshData:
        return self.held[ref.asset]

    def image(self, ref: Any) -> Any:
        return NoAssets().image(ref)

    def add(self, positions: Any, indices: Any, normals: Any = None, uvs: Any = None) -> dict[str, Any]:
        """Keep a mesh; returns its shape's JSON."""
        name = "sha256:" + hashlib.sha256(str(len(self.held)).encode()).hexdigest()
        self.held[name] = MeshData(
            np.asarray(positions, np.float64), np.asarray(indices, np.uint32), normals, uvs
        )
        return {"type": "mesh", "source": {"asset": name}}


class Probe:
    """The probe program with a set of effects, and scenes to run it on."""

    def __init__(
        self, device: Device, kind: Mapping[str, int] | None = None, text: str | None = None, **effects: int
    ) -> None:
        """kind: macros in place of the device's own; text: a program in place of probe.cl's."""
        self.device = device
        self.flags = {**device.flags, **(kind or {})}
        flags = {f"PENUMBRA_{name}": effects.get(name, 1) for name in EFFECTS}
        self.kernel = device.build("probe.cl", {**flags, **self.flags}, text or PROBE.read_text()).probe

    def trace(self, geometry: CompiledGeometry, rays: NDArray[Any], side: float = 1.0) -> NDArray[Any]:
        """Answers to rays (n, 8): origin, direction, tmax, time."""
        rays = np.ascontiguousarray(rays, np.float32)
        device = self.device
        arrays = tree_arrays(geometry.arrays, self.flags)
        buffers = [device.upload(arrays[name]) for name in BUFFERS]
        buffers += [device.upload(geometry.keyframes), device.upload(geometry.arrays["times"])]
        answers = np.zeros(len(rays), ANSWER)
        if not len(rays):
            return answers
        uploaded, out = device.upload(rays), device.allocate(answers.nbytes)
        scalars = (np.uint32(geometry.root), np.uint32(geometry.plane_count), np.float32(side))
        arguments = [*buffers, *scalars, uploaded, np.uint32(len(rays)), out]
        items = len(rays) if self.flags["PENUMBRA_DEVICE_GPU"] else -(-len(rays) // RAYS_PER_ITEM)
        local = 64 if device.info.kind == "gpu" else 1
        device.launch(self.kernel, arguments, -(-items // local) * local, local)
        device.download(out, answers)
        return answers


def compiled(
    shapes: list[dict[str, Any]],
    assets: Assets | None = None,
    anchor: Any = (0, 0, 0),
    time: float = 0.0,
    **scene: Any,
) -> CompiledGeometry:
    """Geometry of shapes in JSON."""
    camera = scene.pop("camera", {"type": "perspective"})
    model = Scene.model_validate({"version": 1, "camera": camera, "shapes": shapes, **scene})
    return compile_geometry(model, assets or NoAssets(), time, np.asarray(anchor, np.float64), {})


def compiled_mesh(vertices: Any, faces: Any, anchor: Any = (0, 0, 0)) -> CompiledGeometry:
    """Geometry of a single mesh."""
    held = Meshes()
    return compiled([held.add(vertices, faces)], held, anchor)


def rays(origins: Any, directions: Any, tmax: float = np.inf, time: Any = 0.0) -> NDArray[np.float32]:
    """(n, 8) rays."""
    origins, directions = np.broadcast_arrays(
        np.asarray(origins, np.float64), np.asarray(directions, np.float64)
    )
    out = np.empty((len(origins), 8), np.float32)
    out[:, :3], out[:, 3:6], out[:, 6], out[:, 7] = origins, directions, tmax, time
    return out


def unit(v: Any) -> NDArray[np.float64]:
    v = np.asarray(v, np.float64)
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def directions(rng: np.random.Generator, n: int) -> NDArray[np.float64]:
    return unit(rng.normal(size=(n, 3)))


def random_rays(rng: np.random.Generator, n: int) -> NDArray[np.float32]:
    """From three metres away to points of the cube [-1, 1]^3."""
    origins = directions(rng, n) * 3
    return rays(origins, rng.uniform(-1, 1, (n, 3)) - origins)
