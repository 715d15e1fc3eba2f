"""Claims about cl/geometry/motion.cl: it interpolates as the host's float64 does, and inverts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.compile.transforms import keyframes_of, matrix_at
from penumbra_scene.camera import PerspectiveCamera

KERNELS = """
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

Launch = Callable[..., None]


@pytest.fixture(scope="module")
def launch(compiled: Any) -> Launch:
    return compiled(KERNELS, {})  # type: ignore[no-any-return]


def keyed(*pairs: tuple[float, Any]) -> Any:
    frames = {"keyframes": [{"time": t, "transform": steps} for t, steps in pairs]}
    return PerspectiveCamera.model_validate({"type": "perspective", "transform": frames}).transform


def spin(angle: float, axis: tuple[float, float, float] = (0, 1, 0)) -> dict[str, Any]:
    return {"rotate": {"axis": axis, "angle": angle}}


def on_device(launch: Launch, motion: Any, close: float, times: NDArray[np.float32]) -> NDArray[np.float32]:
    keys = keyframes_of(motion, 0.0, 0.0, close)
    assert keys is not None
    out = np.empty((len(times), 3, 4), np.float32)
    launch("matrices", len(times), out, keys, np.uint32(len(keys)), times)
    return out


MOTIONS = {
    "half turn": keyed((0, []), (1, [spin(180)])),
    "half turn the other way": keyed((0, []), (1, [spin(-180, (1, 1, 0))])),
    "full turn in three": keyed((0, []), (0.25, [spin(120)]), (0.5, [spin(240)]), (1, [spin(360)])),
    "tiny turn": keyed((0, []), (1, [spin(1e-5)])),
    "translation alone": keyed((0, []), (1, [{"translate": [1, -2, 3]}])),
    "mirror and stretch": keyed(
        (0, [{"scale": [-1, 2, 3]}]), (1, [{"scale": [-2, 2, 1]}, spin(170, (1, 2, 3))])
    ),
    "sheared": keyed(
        (0, [{"matrix": [[1, 0.9, 0, 0], [0, 1, 0, 0], [0, 0.3, 1, 0], [0, 0, 0, 1]]}]), (1, [spin(90)])
    ),
    "many": keyed(*((k / 16, [spin(50 * k, (1, k, 2)), {"translate": [k % 3, 0, 0]}]) for k in range(17))),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_device_interpolates_as_the_host_does(launch: Launch, name: str) -> None:
    times = np.linspace(-0.1, 1.1, 121, dtype=np.float32)
    got = on_device(launch, MOTIONS[name], 1.0, times)
    expected = np.array([matrix_at(MOTIONS[name], float(t))[:3] for t in times])
    assert np.abs(got - expected).max() <= 1e-6 * np.abs(expected).max()


def test_half_turn_keeps_lengths(launch: Launch) -> None:
    times = np.linspace(0, 1, 1001, dtype=np.float32)
    linear = on_device(launch, MOTIONS["half turn"], 1.0, times)[:, :, :3].astype(np.float64)
    gram = np.einsum("nij,nik->njk", linear, linear)
    assert np.abs(gram - np.eye(3)).max() <= 1e-6


def test_one_keyframe_stands_still(launch: Launch) -> None:
    keys = keyframes_of(MOTIONS["many"], 0.0, 0.25, 1.0)
    assert keys is not None
    out = np.empty((2, 3, 4), np.float32)
    for record, time in ((0, 0.25), (len(keys) - 1, 1.0)):
        launch("matrices", 2, out, keys[record : record + 1].copy(), np.uint32(1), np.float32([-3, 9]))
        np.testing.assert_allclose(out[0], matrix_at(MOTIONS["many"], time)[:3], atol=1e-6)
        np.testing.assert_array_equal(out[0], out[1])


@pytest.mark.parametrize("scale", [1e-12, 1e-3, 1.0, 1e3, 1e12])
def test_inverse_is_good_to_the_condition_number(launch: Launch, scale: float) -> None:
    rng = np.random.default_rng(7)
    m = rng.normal(size=(500, 3, 4)).astype(np.float32) * np.float32(scale)
    out = np.empty_like(m)
    launch("inverses", len(m), out, m)
    exact = np.linalg.inv(m[:, :, :3].astype(np.float64))
    conditions = np.linalg.cond(m[:, :, :3].astype(np.float64))
    error = np.abs(out[:, :, :3] - exact).max(axis=(1, 2)) / np.abs(exact).max(axis=(1, 2))
    # The cofactors are good to 1.5 ulp after one rounding of the scaled inputs; the determinant loses the
    # condition number.
    assert (error <= 8 * 2**-24 * conditions).all()
    moved = np.einsum("nij,nj->ni", exact, m[:, :, 3].astype(np.float64))
    size = np.abs(exact).max(axis=(1, 2)) * np.abs(m[:, :, 3]).max(axis=1)
    assert (np.abs(out[:, :, 3] + moved).max(axis=1) <= 16 * 2**-24 * conditions * size).all()
