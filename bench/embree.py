"""Embree by its C interface, from the library that the embreex package brings along: single rays, one after the other.

embreex's own `run` packs and unpacks its arguments in Python, and has no scene flags; so the library is called directly. The
loop over rays is compiled by numba, which calls rtcIntersect1 and rtcOccluded1 through their addresses.
"""

from __future__ import annotations

import ctypes
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

ROBUST = 1 << 2  # RTC_SCENE_FLAG_ROBUST
HIGH_QUALITY = 2  # RTC_BUILD_QUALITY_HIGH
TRIANGLES = 0  # RTC_GEOMETRY_TYPE_TRIANGLE
INDEX, VERTEX = 0, 1  # RTC_BUFFER_TYPE_*
UINT3, FLOAT3 = 0x5003, 0x9003  # RTC_FORMAT_*
RAY_HIT_WORDS = 32  # RTCRayHit is 80 or 96 bytes, by the features compiled in
PRIMITIVE = 17  # words: RTCRay has 12, then Ng (3), u, v, primID
MISS = 0xFFFFFFFF


def installed() -> str | None:
    """The package's version, or None."""
    return version("embreex") if find_spec("embreex") else None


def _library() -> ctypes.CDLL:
    import embreex

    folder = Path(embreex.__file__).parent.parent / "embreex.libs"
    for tbb in folder.glob("libtbb*"):
        ctypes.CDLL(str(tbb), mode=ctypes.RTLD_GLOBAL)
    library = ctypes.CDLL(str(next(folder.glob("libembree4*"))))
    for name in ("rtcNewDevice", "rtcNewScene", "rtcNewGeometry", "rtcSetSharedGeometryBuffer"):
        getattr(library, name).restype = ctypes.c_void_p
    return library


_QUERY = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)


@numba.njit
def _closest(query: Any, scene: int, rays: Any, ray: Any, at: int, t: Any, primitive: Any) -> None:
    for i in range(rays.shape[0]):
        ray[0:3] = rays[i, 0:3]
        ray[3] = np.float32(0)
        ray[4:7] = rays[i, 3:6]
        ray[7] = np.float32(0)
        ray[8] = rays[i, 6]
        words = ray.view(np.uint32)
        words[9] = 0xFFFFFFFF
        words[10] = words[11] = 0
        words[18] = 0xFFFFFFFF  # geomID
        words[19] = words[20] = 0xFFFFFFFF
        query(scene, at, 0)
        t[i] = ray[8]
        primitive[i] = words[PRIMITIVE] if words[18] != 0xFFFFFFFF else 0xFFFFFFFF


@numba.njit
def _any(query: Any, scene: int, rays: Any, ray: Any, at: int, hit: Any) -> None:
    for i in range(rays.shape[0]):
        ray[0:3] = rays[i, 0:3]
        ray[3] = np.float32(0)
        ray[4:7] = rays[i, 3:6]
        ray[7] = np.float32(0)
        ray[8] = rays[i, 6]
        words = ray.view(np.uint32)
        words[9] = 0xFFFFFFFF
        words[10] = words[11] = 0
        query(scene, at, 0)
        hit[i] = ray[8] < 0


class EmbreeScene:
    """One triangle mesh. robust: RTC_SCENE_FLAG_ROBUST, Embree's mode without most leaks; built at high quality."""

    def __init__(
        self,
        positions: NDArray[np.float32],
        indices: NDArray[np.uint32],
        robust: bool,
        config: str = "threads=1",
    ) -> None:
        self._library = library = _library()
        pointer = ctypes.c_void_p
        device = pointer(library.rtcNewDevice(config.encode()))
        # SSE reads 16 bytes at the last vertex
        self._positions = np.concatenate([positions, np.zeros((1, 3), np.float32)])
        self._indices = np.ascontiguousarray(indices)
        self._scene = pointer(library.rtcNewScene(device))
        library.rtcSetSceneFlags(self._scene, ROBUST if robust else 0)
        library.rtcSetSceneBuildQuality(self._scene, HIGH_QUALITY)
        geometry = pointer(library.rtcNewGeometry(device, TRIANGLES))
        for kind, form, data, count in (
            (VERTEX, FLOAT3, self._positions, len(positions)),
            (INDEX, UINT3, self._indices, len(indices)),
        ):
            library.rtcSetSharedGeometryBuffer(
                geometry, kind, 0, form, pointer(data.ctypes.data), ctypes.c_size_t(0), ctypes.c_size_t(12),
                ctypes.c_size_t(count),
            )  # fmt: skip
        library.rtcCommitGeometry(geometry)
        library.rtcAttachGeometry(self._scene, geometry)
        library.rtcCommitScene(self._scene)
        room = np.zeros(RAY_HIT_WORDS + 16, np.float32)
        first = -(room.ctypes.data % 64) % 64 // 4
        self._ray = room[first : first + RAY_HIT_WORDS]
        self._intersect = _QUERY(("rtcIntersect1", library))
        self._occluded = _QUERY(("rtcOccluded1", library))

    def closest(self, rays: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
        """(t, triangle or MISS) of rays (n, 8): origin, direction, tmax, unused."""
        t, primitive = np.empty(len(rays), np.float32), np.empty(len(rays), np.uint32)
        _closest(self._intersect, self._scene.value, rays, self._ray, self._ray.ctypes.data, t, primitive)
        return t, primitive

    def any(self, rays: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Whether each ray is stopped."""
        hit = np.empty(len(rays), np.bool_)
        _any(self._occluded, self._scene.value, rays, self._ray, self._ray.ctypes.data, hit)
        return hit
