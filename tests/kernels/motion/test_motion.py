"""Claims about cl/geometry/motion.cl: it interpolates as the host's float64 does, and inverts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from penumbra_kernels.compile.transforms import keyframes_of, matrix_at
from penumbra_kernels.device import Device
from penumbra_kernels.hardcases.benches.camera import Motions, keyed


@pytest.fixture(scope="module")
def motions(device: Device) -> Motions:
    return Motions(device)


def spin(angle: float, axis: tuple[float, float, float] = (0, 1, 0)) -> dict[str, Any]:
    return {"rotate": {"axis": axis, "angle": angle}}


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
def test_device_interpolates_as_the_host_does(motions: Motions, name: str) -> None:
    times = np.linspace(-0.1, 1.1, 121, dtype=np.float32)
    got = motions.matrices(MOTIONS[name], 1.0, times)
    expected = np.array([matrix_at(MOTIONS[name], float(t))[:3] for t in times])
    assert np.abs(got - expected).max() <= 1e-6 * np.abs(expected).max()


def test_one_keyframe_stands_still(motions: Motions) -> None:
    keys = keyframes_of(MOTIONS["many"], 0.0, 0.25, 1.0)
    assert keys is not None
    out = np.empty((2, 3, 4), np.float32)
    for record, time in ((0, 0.25), (len(keys) - 1, 1.0)):
        motions("matrices", 2, out, keys[record : record + 1].copy(), np.uint32(1), np.float32([-3, 9]))
        np.testing.assert_allclose(out[0], matrix_at(MOTIONS["many"], time)[:3], atol=1e-6)
        np.testing.assert_array_equal(out[0], out[1])


@pytest.mark.parametrize("scale", [1e-12, 1e-3, 1.0, 1e3, 1e12])
def test_inverse_is_good_to_the_condition_number(motions: Motions, scale: float) -> None:
    rng = np.random.default_rng(7)
    m = rng.normal(size=(500, 3, 4)).astype(np.float32) * np.float32(scale)
    out = np.empty_like(m)
    motions("inverses", len(m), out, m)
    exact = np.linalg.inv(m[:, :, :3].astype(np.float64))
    conditions = np.linalg.cond(m[:, :, :3].astype(np.float64))
    error = np.abs(out[:, :, :3] - exact).max(axis=(1, 2)) / np.abs(exact).max(axis=(1, 2))
    # The cofactors are good to 1.5 ulp after one rounding of the scaled inputs; the determinant loses the
    # condition number.
    assert (error <= 8 * 2**-24 * conditions).all()
    moved = np.einsum("nij,nj->ni", exact, m[:, :, 3].astype(np.float64))
    size = np.abs(exact).max(axis=(1, 2)) * np.abs(m[:, :, 3]).max(axis=1)
    assert (np.abs(out[:, :, 3] + moved).max(axis=1) <= 16 * 2**-24 * conditions * size).all()
