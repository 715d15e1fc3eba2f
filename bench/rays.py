"""Rays per second against Embree: the same primary, diffuse and shadow rays through the same triangles, in turns.

    python bench/rays.py [--rays 262144] [--turns 5] [--triangles 36 100000 1000000]

Prints JSON. Ratios are of medians; above 1 Penumbra is faster.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import embree
import numpy as np
from clock import clock
from meshes import room
from numpy.typing import NDArray
from penumbra_kernels.accel.build import STATIC, Items, build_tree
from penumbra_kernels.compile.bounds import padded
from penumbra_kernels.device import Device
from penumbra_kernels.features import EFFECTS
from penumbra_kernels.layout import PACKET8

Rays = NDArray[np.float32]
KINDS = ("primary", "diffuse", "shadow")


class OurScene:
    """The mesh in our tree, and the two queries on a device."""

    def __init__(self, device: Device, positions: NDArray[np.float32], indices: NDArray[np.uint32]) -> None:
        corners = positions[indices]
        lo, hi = padded(corners.min(axis=1), corners.max(axis=1))
        count = len(indices)
        started = clock()
        tree = build_tree(Items(lo, hi, np.full(count, STATIC, np.int32), np.arange(count, dtype=np.uint32)))
        self.build_seconds = clock() - started
        packets = np.empty(len(tree.packet_items), PACKET8)
        packets["primitive"] = tree.packet_items
        for i, name in enumerate(("v0", "v1", "v2")):
            packets[name] = positions[indices[tree.packet_items][..., i]].transpose(0, 2, 1)
        self.device, self.root = device, np.uint32(tree.root)
        self.nodes, self.packets = device.upload(tree.nodes), device.upload(packets)
        flags = {f"PENUMBRA_{name.upper()}": 0 for name in EFFECTS}
        program = device.build("rays.cl", flags, Path(__file__).with_name("rays.cl").read_text())
        self._closest, self._any = program.closest, program.any_hit

    def prepare(self, rays: Rays, any_hit: bool) -> Traced:
        """The rays, uploaded."""
        return Traced(self, self._any if any_hit else self._closest, rays, any_hit)


class Traced:
    """Rays on the device and where their answers go: (t, triangle) pairs, or whether each is stopped."""

    def __init__(self, scene: OurScene, kernel: Any, rays: Rays, any_hit: bool) -> None:
        self._scene, self._kernel, self._count = scene, kernel, len(rays)
        self.out = np.empty(len(rays), np.uint32) if any_hit else np.empty((len(rays), 2), np.float32)
        self._rays, self._result = scene.device.upload(rays), scene.device.allocate(self.out.nbytes)

    def run(self) -> None:
        """Trace them; the answers stay on the device."""
        scene = self._scene
        arguments = [
            scene.nodes,
            scene.packets,
            scene.root,
            self._rays,
            np.uint32(self._count),
            self._result,
        ]
        scene.device.launch(self._kernel, arguments, -(-self._count // 64), 1)

    def fetch(self) -> NDArray[Any]:
        """Trace them and read the answers."""
        self.run()
        self._scene.device.download(self._result, self.out)
        return self.out


def _pack(origins: NDArray[Any], directions: NDArray[Any], tmax: float) -> Rays:
    out = np.zeros((len(origins), 8), np.float32)
    out[:, :3], out[:, 3:6], out[:, 6] = origins, directions, tmax
    return out


def primary(count: int) -> Rays:
    """A camera in the room, pixels in rows of 8 x 8 blocks, as the tracer's tiles are walked."""
    side = int(count**0.5) // 8 * 8
    y, x = np.divmod(np.arange(side * side), side)
    film = np.stack([(x + 0.5) / side * 2 - 1, 1 - (y + 0.5) / side * 2, np.full(len(x), -1.0)], -1)
    film[:, :2] *= 0.8
    return _pack(np.broadcast_to([0.0, 0.1, 0.99], film.shape), film, np.inf)


def diffuse_and_shadow(
    rays: Rays, t: NDArray[Any], triangle: NDArray[np.uint32], mesh: tuple[NDArray[Any], NDArray[Any]]
) -> tuple[Rays, Rays]:
    """From the hits of `rays`: a cosine-distributed bounce each, and a ray to a random point of a light at the ceiling."""
    rng = np.random.default_rng(5)
    positions, indices = mesh
    corners = positions[indices[triangle]].astype(np.float64)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    d = rays[:, 3:6].astype(np.float64)
    normal *= -np.sign(np.einsum("ij,ij->i", d, normal))[:, None]
    p = rays[:, :3] + d * t[:, None] + normal * 1e-4
    v = rng.normal(size=p.shape)
    bounce = normal + v / np.linalg.norm(v, axis=1, keepdims=True)
    light = np.stack(
        [rng.uniform(-0.3, 0.3, len(p)), np.full(len(p), 0.98), rng.uniform(-0.3, 0.3, len(p))], -1
    )
    return _pack(p, bounce / np.linalg.norm(bounce, axis=1, keepdims=True), np.inf), _pack(
        p, light - p, 0.999
    )


def median_seconds(calls: list[Callable[[], Any]], turns: int) -> list[float]:
    """Median seconds of each call; they alternate, so that the machine's moods meet all of them alike."""
    times: list[list[float]] = [[] for _ in calls]
    for _ in range(turns):
        for call, taken in zip(calls, times, strict=True):
            started = clock()
            call()
            taken.append(clock() - started)
    return [float(np.median(t)) for t in times]


def compare(device: Device, triangles: int, rays: int, turns: int) -> dict[str, Any]:
    """One scene: rays per second of ours, and ratios to Embree where it is installed."""
    mesh = room(triangles)
    ours = OurScene(device, *mesh)
    peers = {}
    if embree.installed():
        peers = {"embree": embree.EmbreeScene(*mesh, False), "embree_robust": embree.EmbreeScene(*mesh, True)}
    first = primary(rays)
    found = ours.prepare(first, False).fetch()
    sets = dict(
        zip(
            KINDS,
            (first, *diffuse_and_shadow(first, found[:, 0], found[:, 1].copy().view(np.uint32), mesh)),
            strict=True,
        )
    )
    result: dict[str, Any] = {"triangles": len(mesh[1]), "build_seconds": round(ours.build_seconds, 4)}
    for kind in KINDS:
        chosen, any_hit = sets[kind], kind == "shadow"
        calls = [ours.prepare(chosen, any_hit).run]
        calls += [partial(peer.any if any_hit else peer.closest, chosen) for peer in peers.values()]
        for call in calls:
            call()
        seconds = median_seconds(calls, turns)
        result[kind] = {"mrays_per_second": round(len(chosen) / seconds[0] / 1e6, 3)}
        for name, taken in zip(peers, seconds[1:], strict=True):
            result[kind][f"ratio_to_{name}"] = round(taken / seconds[0], 3)
    return result


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rays", type=int, default=1 << 18)
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--triangles", type=int, nargs="+", default=[36, 100_000, 1_000_000])
    options = parser.parse_args()
    device = Device()
    scenes = [compare(device, n, options.rays, options.turns) for n in options.triangles]
    print(json.dumps({"embreex": embree.installed(), "scenes": scenes}, indent=1))


if __name__ == "__main__":
    main()
