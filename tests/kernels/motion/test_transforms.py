"""Claims about transforms on the host: steps, keyframes, the way in which rotations go."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.linalg
from penumbra_kernels.compile.transforms import (
    keyframes_of,
    matrix_at,
    matrix_of,
    moves,
    polar,
    poses_of,
    quaternion_of,
    rotation_of,
    shifted,
)
from penumbra_scene.camera import PerspectiveCamera
from scipy.spatial.transform import Rotation


def transform(value: Any) -> Any:
    return PerspectiveCamera.model_validate({"type": "perspective", "transform": value}).transform


def keyed(*pairs: tuple[float, Any]) -> Any:
    return transform({"keyframes": [{"time": t, "transform": steps} for t, steps in pairs]})


def spin(angle: float, axis: tuple[float, float, float] = (0, 1, 0)) -> list[Any]:
    return [{"rotate": {"axis": axis, "angle": angle}}]


def test_steps_act_in_the_order_listed() -> None:
    steps = transform([{"translate": [1, 0, 0]}, *spin(90, (0, 0, 1)), {"scale": [1, 2, 1]}])
    point = matrix_of(steps) @ [0, 0, 0, 1]
    np.testing.assert_array_equal(point, [0, 2, 0, 1])


def test_look_at_sees_its_target_along_minus_z_with_up_above() -> None:
    m = matrix_of(transform({"look_at": {"origin": [1, 2, 3], "target": [4, -2, 5], "up": [0, 1, 0]}}))
    np.testing.assert_allclose(m[:3, :3].T @ m[:3, :3], np.eye(3), atol=1e-15)
    assert np.linalg.det(m[:3, :3]) == pytest.approx(1.0)
    target = np.linalg.inv(m) @ [4, -2, 5, 1]
    np.testing.assert_allclose(target[:3], [0, 0, -np.sqrt(9 + 16 + 4)], atol=1e-14)
    assert (np.linalg.inv(m)[:3, :3] @ [0, 1, 0])[1] > 0


@pytest.mark.parametrize("angle", [-450, -270, -180, -90, 0, 90, 180, 270, 360, 630])
def test_right_angles_are_exact(angle: float) -> None:
    m = matrix_of(transform(spin(angle)))
    assert set(np.abs(m).reshape(-1)) <= {0.0, 1.0}


def test_anchor_is_subtracted_before_rounding() -> None:
    motion = keyed((0, [{"translate": [1e9, 0, 0]}]), (1, [{"translate": [1e9 + 1.5, 0, 0]}]))
    keys = keyframes_of(motion, 0.0, 0.0, 1.0, np.array([1e9, 0.0, 0.0]))
    assert keys is not None
    np.testing.assert_array_equal(keys["translation"][:, 0], [0.0, 1.5])
    assert shifted(matrix_at(motion, 1.0), np.array([1e9, 0, 0]))[0, 3] == 1.5


def test_what_stands_still_while_the_shutter_is_open_has_no_keyframes() -> None:
    motion = keyed((0, spin(0)), (1, spin(90)), (2, spin(90)))
    assert keyframes_of(motion, 0.5, 0.0, 0.0) is None
    assert keyframes_of(motion, 1.0, 0.0, 0.9) is None
    assert keyframes_of(motion, 5.0, 0.0, 1.0) is None
    assert keyframes_of(motion, -5.0, 0.0, 1.0) is None
    assert keyframes_of(transform(spin(3)), 0.0, 0.0, 1.0) is None
    assert moves(motion, 0.9, 0.0, 0.5)


@pytest.mark.parametrize(
    ("axis", "sign"), [((0, 1, 0), 1), ((0, -1, 0), -1), ((0, 0, -1), 1), ((-1, 0, 0), 1)]
)
def test_half_turns_go_the_way_that_the_angles_grow(axis: tuple[float, float, float], sign: int) -> None:
    motion = keyed((0, spin(0, axis)), (1, spin(180, axis)), (2, spin(360, axis)))
    for t in np.linspace(0, 2, 17):
        expected = matrix_of(transform(spin(180 * t, axis)))
        np.testing.assert_allclose(matrix_at(motion, float(t)), expected, atol=1e-14)


def test_rotation_takes_the_shorter_arc() -> None:
    motion = keyed((0, spin(10)), (1, spin(350)))
    np.testing.assert_allclose(matrix_at(motion, 0.25), matrix_of(transform(spin(5))), atol=1e-14)


def test_cutting_at_the_shutter_changes_nothing() -> None:
    far = [{"scale": [1, 2, 3]}, *spin(170, (1, 2, 3)), {"translate": [3, 4, 5]}]
    motion = keyed((-1, [{"scale": [-1, 1, 1]}]), (0, spin(20)), (1, far), (4, spin(-30)))
    whole = {pose.time: pose.matrix() for pose in poses_of(motion, 0.0, 4.0)}
    assert list(whole) == [0.0, 1.0, 4.0]
    part = poses_of(motion, 0.3, 2.0)
    assert [p.time for p in part] == [0.3, 1.0, 2.0]
    for pose in part:
        np.testing.assert_allclose(pose.matrix(), matrix_at(motion, pose.time), atol=1e-14)


def test_mirrors_go_into_the_stretch() -> None:
    motion = keyed((0, [{"scale": [-2, 1, 1]}]), (1, [{"scale": [-2, 1, 1]}, *spin(90)]))
    for pose in poses_of(motion, 0.0, 1.0):
        assert np.linalg.det(pose.stretch) < 0
        np.testing.assert_allclose(pose.matrix(), matrix_at(motion, pose.time), atol=1e-15)
    middle = matrix_of(transform([{"scale": [-2, 1, 1]}, *spin(45)]))
    np.testing.assert_allclose(matrix_at(motion, 0.5), middle, atol=1e-14)


def test_times_are_stored_relative_to_the_frame() -> None:
    motion = keyed((99_999, []), (100_001, [{"translate": [2, 0, 0]}]))
    keys = keyframes_of(motion, 100_000.0, -0.25, 0.25)
    assert keys is not None
    np.testing.assert_array_equal(keys["time"], np.float32([-0.25, 0.25]))
    np.testing.assert_allclose(keys["translation"][:, 0], [0.75, 1.25], rtol=1e-6)


def test_rotations_and_their_factors_are_scipys() -> None:
    """Quaternions near every axis and at half turns; polar factors, mirrored ones too."""
    rng = np.random.default_rng(3)
    vectors = np.concatenate(
        [rng.normal(size=(200, 3)), np.pi * np.eye(3), (np.pi - 1e-9) * np.eye(3), np.zeros((1, 3))]
    )
    for rotation in Rotation.from_rotvec(vectors):
        matrix, expected = rotation.as_matrix(), rotation.as_quat()
        ours = quaternion_of(matrix)
        assert abs(abs(ours @ expected) - 1.0) < 1e-15 * 8
        assert rotation_of(ours) == pytest.approx(matrix, abs=1e-14)
    for _ in range(50):
        matrix = rng.normal(size=(3, 3))
        for a, b in zip(polar(matrix), scipy.linalg.polar(matrix), strict=True):
            assert a == pytest.approx(b, abs=1e-12)
