"""Camera rays, and interpolated transforms, computed on a device."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_scene.camera import Camera
from penumbra_scene.film import Film
from penumbra_scene.transforms import Transform
from pydantic import TypeAdapter

from penumbra_kernels.compile.camera import compile_camera
from penumbra_kernels.compile.transforms import keyframes_of
from penumbra_kernels.device import Device
from penumbra_kernels.hardcases.benches.launch import Kernels

Array = NDArray[np.float64]
Rays = tuple[Array, Array, Array]

CAMERA_TEXT: Final = """
#include "camera/camera.cl"
// u: film x, y; lens u, v; shutter, for each ray.
__kernel void rays(__global float *out, const __global Camera *camera, const __global Keyframe *keys,
                   const __global float *shutter, const __global float *u) {
  const uint i = get_global_id(0);
  const __global float *v = u + 5 * i;
  const float time = camera_time(camera, shutter, v[4]);
  const Ray ray = camera_ray(camera, keys, (float2)(v[0], v[1]), (float2)(v[2], v[3]), time);
  const float values[7] = {ray.o.x, ray.o.y, ray.o.z, ray.d.x, ray.d.y, ray.d.z, ray.time};
  for (int k = 0; k < 7; ++k) out[7 * i + k] = values[k];
}
"""

MOTION_TEXT: Final = """
#include "geometry/motion.cl"
__kernel void matrices(__global float *out, const __global Keyframe *keys, const uint count,
                       const __global float *times) {
  const uint i = get_global_id(0);
  float m[3][4];
  keyframe_matrix(keys, 0, count, times[i], m);
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 4; ++c) out[i * 12 + r * 4 + c] = m[r][c];
}
__kernel void inverses(__global float *out, const __global float *in) {
  const uint i = get_global_id(0);
  float m[3][4], inverse[3][4];
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 4; ++c) m[r][c] = in[i * 12 + r * 4 + c];
  invert_affine(m, inverse);
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 4; ++c) out[i * 12 + r * 4 + c] = inverse[r][c];
}
"""


def camera_of(**keys: Any) -> Camera:
    """A camera from JSON's keys; perspective unless told."""
    adapter: TypeAdapter[Camera] = TypeAdapter(Camera)
    return adapter.validate_python({"type": "perspective", **keys})


def keyed(*pairs: tuple[float, Any]) -> Transform:
    """A transform of (time, steps) keyframes."""
    frames = {"keyframes": [{"time": t, "transform": steps} for t, steps in pairs]}
    return camera_of(transform=frames).transform


def random_u(count: int = 4096) -> NDArray[np.float32]:
    """(count, 5) numbers of 24 bits in [0, 1)."""
    return (np.random.default_rng(1).integers(0, 1 << 24, (count, 5)) * 2.0**-24).astype(np.float32)


class Cameras:
    """cameras(camera, u (n, 5)) -> origins (n, 3), directions (n, 3), times (n,)."""

    def __init__(self, device: Device) -> None:
        self._programs = {
            (lens, motion): Kernels(
                device, "cameras", CAMERA_TEXT, {"PENUMBRA_LENS": lens, "PENUMBRA_CAMERA_MOTION": motion}
            )
            for lens in (0, 1)
            for motion in (0, 1)
        }

    def __call__(
        self,
        camera: Camera,
        u: NDArray[Any],
        film: Film | None = None,
        time: float = 0.0,
        anchor: tuple[float, float, float] = (0.0, 0.0, 0.0),
        lens: int = 1,
        motion: int = 1,
    ) -> Rays:
        record, keys, table = compile_camera(camera, film or Film(), time, np.array(anchor))
        out = np.empty((len(u), 7), np.float32)
        self._programs[lens, motion]("rays", len(u), out, record, keys, table, u.astype(np.float32))
        wide = out.astype(np.float64)
        return wide[:, :3], wide[:, 3:6], wide[:, 6]


class Motions(Kernels):
    """Matrices between keyframes, and inverses."""

    def __init__(self, device: Device) -> None:
        super().__init__(device, "motions", MOTION_TEXT)

    def matrices(self, motion: Transform, close: float, times: NDArray[np.float32]) -> NDArray[np.float32]:
        """(n, 3, 4) at these times, the shutter open from 0 to `close`."""
        keys = keyframes_of(motion, 0.0, 0.0, close)
        if keys is None:
            raise ValueError("nothing moves")
        out = np.empty((len(times), 3, 4), np.float32)
        self("matrices", len(times), out, keys, np.uint32(len(keys)), times)
        return out
