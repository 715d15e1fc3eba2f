"""Every wrong document is answered with the place, what stands there, and what may."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from penumbra_scene.errors import Problem, ProblemError, pointer
from penumbra_scene.parse import job_from_json, parse_scene, scene_from_json


class _Missing:
    """Stands for a key that is taken away; its name is the same in every process."""

    def __repr__(self) -> str:
        return "missing"


MISSING = _Missing()
FLAT = [[0, 0, 0, 0]] * 3 + [[0, 0, 0, 1]]


def problem_of(document: Any) -> Problem:
    with pytest.raises(ProblemError) as caught:
        scene_from_json(document)
    return caught.value.problem


def put(document: Any, path: str, value: Any) -> Any:
    """A copy with `value` at the JSON pointer `path`; MISSING takes away what stands there."""
    changed = copy.deepcopy(document)
    *parents, last = [step.replace("~1", "/").replace("~0", "~") for step in path.split("/")[1:]]
    at = changed
    for step in parents:
        at = at[int(step)] if isinstance(at, list) else at[step]
    key = int(last) if isinstance(at, list) else last
    if value is MISSING:
        del at[key]
    else:
        at[key] = value
    return changed


# what is put where; where the error is seen; words that the accepted part must hold
WRONG = [
    ("/version", 2, "/version", "1"),
    ("/version", True, "/version", "1"),
    ("/version", MISSING, "/version", "1"),
    ("/camera", MISSING, "/camera", "perspective"),
    ("/camera", 7, "/camera", "orthographic"),
    ("/camera/type", "fisheye", "/camera/type", '"perspective" | "orthographic"'),
    ("/camera/type", MISSING, "/camera/type", '"perspective" | "orthographic"'),
    ("/camera/fov", 180, "/camera/fov", "below 180"),
    ("/camera/fov", math.nan, "/camera/fov", "a number above 0"),
    ("/camera/fov", math.inf, "/camera/fov", "a number above 0"),
    ("/camera/fov", "45", "/camera/fov", "a number above 0"),
    ("/camera/fov", True, "/camera/fov", "a number above 0"),
    ("/camera/fov", None, "/camera/fov", "a number above 0"),
    ("/camera/lens", {"blades": 2}, "/camera/lens/blades", "3 to 64"),
    ("/camera/lens", {"aperture": 2}, "/camera/lens/aperture", "aperture_radius (did you mean this?)"),
    ("/camera/shutter", {"open": 1, "close": 0}, "/camera/shutter/close", "at least 1"),
    ("/camera/shutter", {"curve": [0, 0]}, "/camera/shutter/curve", "above 0"),
    ("/camera/transform", "up", "/camera/transform", "keyframes"),
    ("/camera/transform", {"turn": 1}, "/camera/transform", "rotate"),
    ("/camera/transform", {"translate": [1, 2]}, "/camera/transform/translate", "an array of 3"),
    (
        "/camera/transform",
        {"scale": 2, "translate": [1, 2, 3]},
        "/camera/transform",
        '[{"scale": ...}, {"translate": ...}]',
    ),
    ("/camera/fov", 180, "/camera/fov", "below 180"),
    (
        "/materials/wall/base_color",
        {"texture": ""},
        "/materials/wall/base_color/texture",
        "1 to 200 characters",
    ),
    ("/shapes/2", {"type": "mesh", "source": {"file": "http://x/y"}}, "/shapes/2/source/file", "/v1/assets"),
    ("/camera/transform", [{"scale": [1, 0, 1]}], "/camera/transform/0/scale", "1e-12"),
    ("/camera/transform", {"keyframes": []}, "/camera/transform/keyframes", "at least 1"),
    (
        "/camera/transform",
        {"matrix": [[0, 0, 0, 0]] * 3 + [[0, 0, 0, 1]]},
        "/camera/transform/matrix",
        "inverse",
    ),
    ("/camera/transform", [{"scale": 1e12}, {"scale": 1e12}], "/camera/transform", "factors"),
    ("/film", {"width": 0}, "/film/width", "at least 1, at most 32768"),
    ("/film", {"width": 1.5}, "/film/width", "a whole number"),
    ("/film", {"width": math.inf}, "/film/width", "a whole number"),
    ("/film", {"width": 10**400}, "/film/width", "a whole number"),
    ("/film", {"width": 32768, "height": 32768}, "/film", "at most 67108864"),
    ("/film", {"crop": {"x": 500, "y": 0, "width": 100, "height": 1}}, "/film/crop", "512 x 512"),
    ("/film", {"filter": {"type": "lanczos"}}, "/film/filter/type", '"blackman_harris"'),
    ("/film", {"half": 1}, "/film/half", "true | false"),
    ("/film", {"layers": ["depth", "depth"]}, "/film/layers", "once"),
    ("/film", {"layers": ["uv"]}, "/film/layers/0", '"albedo" | "normal" | "depth"'),
    ("/sampler", {"type": "halton"}, "/sampler/type", '"sobol"'),
    ("/sampler", {"seed": -1}, "/sampler/seed", "at least 0"),
    ("/sampler", {"seed": 2**64}, "/sampler/seed", "18446744073709551616"),
    ("/sampler", {"seed": "1e3"}, "/sampler/seed", "a string matching"),
    ("/sampler", {"replicates": 3}, "/sampler/replicates", "1 | 2 | 4 | 8 | 16"),
    ("/sampler", {"replicates": True}, "/sampler/replicates", "1 | 2 | 4 | 8 | 16"),
    ("/sampler", {"type": "regular", "replicates": 2}, "/sampler/replicates", "1, or null"),
    ("/stop", {"samples": 0}, "/stop/samples", "at least 1"),
    ("/stop", {"seconds": 0}, "/stop/seconds", "above 0"),
    ("/stop", {"relative_error": 2}, "/stop/relative_error", "at most 1"),
    ("/textures/board/color0", [0.1, 0.2], "/textures/board/color0", "an array of 3"),
    ("/materials/wall/base_color", 1.5, "/materials/wall/base_color", "at most 1"),
    ("/materials/wall/base_color", [0.5, -0.1, 0.5], "/materials/wall/base_color/1", "at least 0"),
    ("/materials/wall/base_color", {"texture": "bored"}, "/materials/wall/base_color/texture", '"board"'),
    ("/materials/wall/base_color", {"texure": "board"}, "/materials/wall/base_color/texture", "a string"),
    ("/materials/wall/base_color", {"texture": "board", "uv": 1}, "/materials/wall/base_color/uv", "texture"),
    ("/materials/a~1b~0c/type", "miror", "/materials/a~1b~0c/type", '"mirror"'),
    ("/materials/a~1b~0c/colour", 1, "/materials/a~1b~0c/colour", "color (did you mean this?)"),
    ("/materials/diffuse", {"type": "phong", "exponent": -1}, "/materials/diffuse/exponent", "at least 0"),
    ("/prototypes/ball", [], "/prototypes/ball", "at least 1"),
    ("/prototypes/ball/0/emission", {"radiance": 1}, "/prototypes/ball/0/emission", "shapes"),
    ("/prototypes/ball/0/type", "plane", "/prototypes/ball/0/type", '"sphere"'),
    ("/shapes", {}, "/shapes", "an array"),
    ("/shapes/0", None, "/shapes/0", '{"type": "sphere", ...}'),
    ("/shapes/0/type", "cube", "/shapes/0/type", '"instance"'),
    ("/shapes/0/radius", -1, "/shapes/0/radius", "above 0"),
    ("/shapes/0/radius", 1e19, "/shapes/0/radius", "at most 1e+18"),
    ("/shapes/0/material", "wal", "/shapes/0/material", '"wall"'),
    ("/shapes/0/center", [0, 0, 0, 0], "/shapes/0/center", "an array of 3"),
    ("/shapes/0/emission", {"radiance": -1}, "/shapes/0/emission/radiance", "at least 0"),
    ("/shapes/1/prototype", "bell", "/shapes/1/prototype", '"ball"'),
    ("/shapes/1/transform/0/scale", 0, "/shapes/1/transform/0/scale", "1e-12"),
    ("/shapes/2/positions", [], "/shapes/2/positions", "at least 3"),
    ("/shapes/2/positions/1", [0, math.nan, 0], "/shapes/2/positions/1/1", "a number"),
    ("/shapes/2/indices/0", [0, 1, 3], "/shapes/2/indices/0", "0 to 2"),
    ("/shapes/2/indices/0/0", -1, "/shapes/2/indices/0/0", "at least 0"),
    ("/shapes/2/indices", MISSING, "/shapes/2", "positions with indices"),
    ("/shapes/2/normals", [[0, 0, 0]] * 3, "/shapes/2/normals/0", "an array of 3"),
    ("/shapes/2/uvs", [[0, 0]], "/shapes/2/uvs", "3 entries"),
    ("/shapes/2/source", {"asset": "sha256:12"}, "/shapes/2/source/asset", "sha256"),
    ("/shapes/3/u", [0, 0, 0], "/shapes/3/u", "an array of 3"),
    ("/shapes/3/v", [1, 0, 0], "/shapes/3/v", "not parallel"),
    ("/lights/0/intensity", [1, 2], "/lights/0/intensity", "an array of 3"),
    ("/lights/0", {"type": "spot", "inner_cone_angle": 60}, "/lights/0/inner_cone_angle", "at most 45"),
    ("/environment", {"type": "image", "image": {"file": "x.exr"}}, "/environment/image/file", "sha256"),
    ("/environment", {"type": "image", "image": {"file": "../x"}}, "/environment/image/file", "relative"),
    ("/environment", {"type": "image", "image": {}}, "/environment/image", "asset"),
    ("/environment", {"type": "image", "image": {"url": "http://x"}}, "/environment/image/url", "asset"),
    ("/shape", [], "/shape", "shapes (did you mean this?)"),
]


@pytest.mark.parametrize(
    ("where", "value", "seen", "accepted"), WRONG, ids=[f"{w[0]}={w[1]!r:.40}" for w in WRONG]
)
def test_the_error_names_the_place_the_value_and_what_is_accepted(
    minimal: dict[str, Any], where: str, value: Any, seen: str, accepted: str
) -> None:
    problem = problem_of(put(minimal, where, value))
    found = {item.pointer: item for item in problem.errors}
    assert seen in found, problem
    assert accepted in found[seen].accepted
    assert found[seen].given
    assert found[seen].message
    assert problem.status == 422


def test_the_starting_document_of_these_tests_is_valid(minimal: dict[str, Any]) -> None:
    scene_from_json(minimal)


def test_one_wrong_number_in_a_large_array_is_one_error(minimal: dict[str, Any]) -> None:
    positions = [[0.0, 0.0, "x"]] * 100_000
    problem = problem_of(put(minimal, "/shapes/2/positions", positions))
    assert [item.pointer for item in problem.errors] == ["/shapes/2/positions/0/2"]


def test_no_more_than_fifty_errors_are_listed_and_the_rest_are_counted(minimal: dict[str, Any]) -> None:
    problem = problem_of(put(minimal, "/shapes", [{"type": "sphere", "radius": -i} for i in range(200)]))
    assert len(problem.errors) == 50
    assert "200 errors" in problem.detail


def test_a_job_blames_its_own_sections_and_the_scene_inside(minimal: dict[str, Any]) -> None:
    scene = put(minimal, "/shapes/0/material", "walls")
    body = {"scene": scene, "sampler": {"type": "regular"}, "stop": {"relative_error": 0.1}}
    with pytest.raises(ProblemError) as caught:
        job_from_json(body)
    assert {e.pointer for e in caught.value.problem.errors} == {
        "/scene/shapes/0/material",
        "/stop/relative_error",
    }


@pytest.mark.parametrize("frames", ["a", "", "-1", 12, "5-1", "1-5x0", "1-", "1,,2", "0-10000", "1-5 "])
def test_frames_that_mean_none_are_refused(minimal: dict[str, Any], frames: Any) -> None:
    with pytest.raises(ProblemError) as caught:
        job_from_json({"scene": minimal, "frames": frames})
    assert [e.pointer for e in caught.value.problem.errors] == ["/frames"]


def test_a_frame_is_looked_at_after_frame_over_fps_seconds(minimal: dict[str, Any]) -> None:
    assert job_from_json({"scene": minimal, "frames": "12", "fps": 48}).time == 0.25


def _places(document: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    if path:
        yield path
    items = document.items() if isinstance(document, dict) else enumerate(document)
    for key, value in items if isinstance(document, (dict, list)) else ():
        yield from _places(value, (*path, key)) if isinstance(value, (dict, list)) else [(*path, key)]


NUMBERS = [0, -1, 1, 10**400, 1e300, -0.0, 1e-300, math.nan, math.inf]
WORDS = ["", "wall", "\x00", "\ud800", "ü" * 300]
ARRAYS = [[], [[]], [1, 2, 3], [None] * 3]
OBJECTS = [{}, {"type": "sphere"}, {"type": None}, {"texture": "board"}, {"keyframes": [1]}, {"": 1}]
NASTY = st.sampled_from([None, True, False, *NUMBERS, *WORDS, *ARRAYS, *OBJECTS, {"translate": [0, 0, 0]}])


@settings(
    max_examples=400,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(data=st.data())
def test_any_change_is_accepted_or_blamed(minimal: dict[str, Any], data: st.DataObject) -> None:
    document = copy.deepcopy(minimal)
    for _ in range(data.draw(st.integers(1, 3))):
        path = data.draw(st.sampled_from(list(_places(document))))
        document = put(document, pointer(path), copy.deepcopy(data.draw(NASTY)))
    try:
        scene_from_json(document)
    except ProblemError as error:
        json.loads(error.problem.model_dump_json())
        for item in error.problem.errors:
            assert_exists_but_for_the_last_step(document, item.pointer)


def assert_exists_but_for_the_last_step(document: Any, at: str) -> None:
    steps = [step.replace("~1", "/").replace("~0", "~") for step in at.split("/")[1:]]
    for i, step in enumerate(steps):
        if isinstance(document, list):
            assert int(step) < len(document), at
            document = document[int(step)]
        else:
            assert isinstance(document, dict), at
            assert step in document or i == len(steps) - 1, at
            document = document.get(step)


BYTES = [
    (b"", 422, "JSON"),
    (b"{", 422, "line 1"),
    (b"\xef\xbb\xbf{}", 422, "byte-order mark"),
    (b'{"a": "\xff"}', 422, "not UTF-8"),
    (b'{"version": 1, "version": 1}', 422, "twice"),
    (b'{"\\ud800": 1}', 422, "surrogate"),
    (b"[" * 200_000, 422, "nested"),
    (b'{"a":' * 200_000, 422, "nested"),
    (b"[1e400]", 422, "must be an object"),
    (b'{"version": 1, "camera": {"type": "perspective", "fov": NaN}}', 422, "finite"),
    (b'{"version": 1, "camera": {"type": "perspective", "fov": -Infinity}}', 422, "finite"),
    (b'{"version": 1, "camera": {"type": "perspective", "fov": ' + b"9" * 100_000 + b"}}", 422, "finite"),
    (b" " * (64 * 1024 * 1024 + 1), 413, "too long"),
]


@pytest.mark.parametrize(("data", "status", "words"), BYTES, ids=[repr(b[0][:20]) for b in BYTES])
def test_bytes_that_are_no_json_are_refused(data: bytes, status: int, words: str) -> None:
    with pytest.raises(ProblemError) as caught:
        parse_scene(data)
    assert caught.value.problem.status == status
    assert words in str(caught.value)


def test_a_key_given_twice_is_blamed_on_its_object(minimal: dict[str, Any]) -> None:
    text = json.dumps(minimal).replace('"type": "point"', '"type": "point", "type": "point"')
    with pytest.raises(ProblemError) as caught:
        parse_scene(text.encode())
    assert [e.pointer for e in caught.value.problem.errors] == ["/lights/0"]


def test_a_bound_that_another_makes_idle_is_not_told(minimal: dict[str, Any]) -> None:
    (item,) = problem_of(put(minimal, "/camera/fov", 180)).errors
    assert item.accepted == "a number above 0, below 180"


def test_an_emission_in_a_prototype_is_shown(minimal: dict[str, Any]) -> None:
    (item,) = problem_of(put(minimal, "/prototypes/ball/0/emission", {"radiance": 1})).errors
    assert item.given.startswith('{"radiance": [1.0')
