"""Claims about cl/geometry/motion.cl: it interpolates as the host's float64 does, and inverts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from penumbra_kernels.compile.placement import Motion, Shutter, shutter_parts
from penumbra_kernels.compile.placement import slide as slide_of
from penumbra_kernels.compile.transforms import Pose, keyframes_of, matrix_at
from penumbra_kernels.device import Device
from penumbra_kernels.hardcases.benches.camera import Motions, keyed
from penumbra_kernels.layout import CONSTANTS, KEYFRAME


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


@pytest.mark.parametrize(("first", "last"), [(0.0, 1.0), (-0.5, 0.25), (1000.0, 1000.001), (3.0, 3.0 + 1e-9)])
def test_every_instant_is_in_the_part_that_the_device_picks(first: float, last: float) -> None:
    """The rounding of times counts as much as the parts' length where the shutter is open shortly and late."""
    shutter = Shutter(1e5, first, last)
    span = last - first
    inner = (first + 0.1 * span, first + 0.9 * span)
    for begin, end in ((first, last), inner):
        keys = np.zeros(2, KEYFRAME)
        keys["time"] = begin, end
        starts, ends = shutter_parts(shutter, keys)
        exact = np.linspace(first, last, 5001)
        time = exact.astype(np.float32)
        parts = np.float32(CONSTANTS["MOTION_BOXES"])
        with np.errstate(divide="ignore", invalid="ignore"):
            part = (time - keys["time"][0]) * (parts / (keys["time"][1] - keys["time"][0]))
        picked = np.where(part > 0, np.minimum(part, parts - 1), 0).astype(int)
        assert (1e5 + exact >= starts[picked]).all()
        assert (1e5 + exact <= ends[picked]).all()
        assert set(picked) == set(range(8)) or span < 1e-6


def test_what_only_slides_says_so_whoever_carries_it() -> None:
    """By the matrices at each of its keyframes."""
    slide, turn = keyed((0, []), (1, [{"translate": [1, -2, 3]}])), keyed((0, []), (1, [spin(30)]))
    placed = keyed((0, [spin(20), {"scale": [1, 2, 3]}])).keyframes[0].transform
    shutter = Shutter(0.0, 0.25, 0.75)

    def motion(transform: Any) -> Motion:
        return Motion.of(transform, shutter)

    for outer, inner in ((slide, placed), (placed, slide)):
        keys = slide_of(motion(outer), motion(inner))
        assert keys is not None
        assert list(keys["time"]) == [0.25, 0.75]
        for key in keys:
            time = float(key["time"])
            expected = matrix_at(outer, time) @ matrix_at(inner, time)
            pose = Pose(time, key["translation"], key["rotation"], key["stretch"][:, :3])
            np.testing.assert_allclose(pose.matrix(), expected, atol=1e-6)
    for outer, inner in ((turn, placed), (placed, turn), (slide, slide), (slide, turn), (placed, placed)):
        assert slide_of(motion(outer), motion(inner)) is None
