"""The scene's camera as the device reads it: record, keyframes, and the table of its shutter's curve."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from penumbra_scene.camera import Camera, PerspectiveCamera, Shutter
from penumbra_scene.film import Film

from penumbra_kernels.compile.tables import density_table
from penumbra_kernels.compile.transforms import keyframes_of, matrix_at, polar, shifted
from penumbra_kernels.layout import CAMERA, KEYFRAME

Array = NDArray[np.float64]

PERSPECTIVE, ORTHOGRAPHIC = 0, 1


def compile_camera(
    camera: Camera, film: Film, time: float, anchor: Array
) -> tuple[NDArray[Any], NDArray[Any], NDArray[np.float32]]:
    """(one CAMERA record, (n,) of KEYFRAME, shutter table) for the frame at `time` seconds.

    The caller sets the record's `first_keyframe` to where it puts the keyframes; n is 0 where the camera
    stands still while the shutter is open. anchor: metres, subtracted from positions in float64.
    A camera's transform places and turns it; scale and shear in it count for nothing, a mirror mirrors the
    picture.
    """
    record = np.zeros((), CAMERA)
    shutter = camera.shutter
    placed = shifted(_without_stretch(matrix_at(camera.transform, time + shutter.open)), anchor)
    record["world_from_camera"] = placed[:3]
    record["scale_x"], record["scale_y"] = _scales(camera, film)
    record["kind"] = PERSPECTIVE if isinstance(camera, PerspectiveCamera) else ORTHOGRAPHIC
    record["aperture_radius"] = camera.lens.aperture_radius
    record["focus_distance"] = camera.lens.focus_distance
    record["blades"] = camera.lens.blades
    record["blade_rotation"] = math.radians(camera.lens.rotation % 360.0)
    record["shutter_open"], record["shutter_close"] = shutter.open, shutter.close
    keyframes = keyframes_of(camera.transform, time, shutter.open, shutter.close, anchor)
    if keyframes is None:
        keyframes = np.zeros(0, KEYFRAME)
    for keyframe in keyframes:
        mirrored = np.trace(keyframe["stretch"][:, :3]) < 0.0  # then the whole stretch is negative
        keyframe["stretch"][:, :3] = -np.eye(3) if mirrored else np.eye(3)
    record["keyframe_count"] = len(keyframes)
    return record, keyframes, shutter_table(shutter)


def _without_stretch(matrix: Array) -> Array:
    """The matrix with its linear part replaced by the nearest rotation (or rotation and mirror)."""
    out = matrix.copy()
    if not np.allclose(matrix[:3, :3].T @ matrix[:3, :3], np.eye(3), rtol=0.0, atol=1e-12):
        out[:3, :3] = polar(matrix[:3, :3])[0]
    return out


def _scales(camera: Camera, film: Film) -> tuple[float, float]:
    """Camera-space x of the picture's right edge and y of its top: at z = -1 (perspective), or anywhere."""
    aspect = film.width / film.height
    if not isinstance(camera, PerspectiveCamera):
        return 0.5 * camera.height * aspect, 0.5 * camera.height
    half = math.tan(math.radians(0.5 * camera.fov))
    wide = film.width >= film.height
    along_x = {"x": True, "y": False, "larger": wide, "smaller": not wide}[camera.fov_axis]
    return (half, half / aspect) if along_x else (half * aspect, half)


def shutter_table(shutter: Shutter) -> NDArray[np.float32]:
    """Table of the shutter's curve over [0, 1] (layout: `density_table`)."""
    curve = np.asarray(shutter.curve, np.float64)
    return density_table(np.linspace(0.0, 1.0, len(curve)), curve / curve.max())
