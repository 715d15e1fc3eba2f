"""What only a look at the whole scene shows."""

from __future__ import annotations

from typing import Any

import pytest
from penumbra_scene import limits
from penumbra_scene.check import asset_refs, check_scene, scene_hash
from penumbra_scene.errors import ProblemError
from penumbra_scene.parse import job_from_json, scene_from_json
from penumbra_scene.placement import compose
from penumbra_scene.scene import Scene


def errors(document: dict[str, Any], **how: bool) -> dict[str, str]:
    found = check_scene(Scene.model_validate(document), **how)
    return {e.pointer: e.message for e in found if not e.warning}


def warnings(document: dict[str, Any]) -> list[str]:
    return [e.message for e in check_scene(Scene.model_validate(document)) if e.warning]


CAMERA = {"version": 1, "camera": {"type": "perspective"}, "environment": {"type": "constant"}}


def shining(transform: Any) -> dict[str, Any]:
    return {**CAMERA, "shapes": [{"type": "sphere", "emission": {"radiance": 1}, "transform": transform}]}


@pytest.mark.parametrize(
    "transform",
    [
        [],
        {"scale": -2},
        [{"rotate": {"axis": [1, 2, 3], "angle": 77}}, {"scale": 3}, {"translate": [1, 2, 3]}],
        [{"scale": [2, 1, 1]}, {"scale": [0.5, 1, 1]}],
        {"keyframes": [{"time": 0, "transform": [{"scale": 1}]}, {"time": 1, "transform": [{"scale": 2}]}]},
    ],
)
def test_a_sphere_light_may_be_turned_moved_and_scaled_evenly(transform: Any) -> None:
    assert not errors(shining(transform))


@pytest.mark.parametrize(
    "transform",
    [
        {"scale": [1, 1, 1.01]},
        {"matrix": [[1, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]},
        {"keyframes": [{"time": 0, "transform": []}, {"time": 1, "transform": [{"scale": [1, 2, 1]}]}]},
    ],
)
def test_a_sphere_light_may_not_be_stretched(transform: Any) -> None:
    assert list(errors(shining(transform))) == ["/shapes/0/transform"]


@pytest.mark.parametrize(
    "kind", ["regular", "random", "independent", "stratified", "jittered", "sobol", "blue_noise"]
)
def test_only_the_regular_sampler_refuses_an_error_target(kind: str) -> None:
    found = errors({**CAMERA, "sampler": {"type": kind}, "stop": {"relative_error": 0.05}})
    assert list(found) == (["/stop/relative_error"] if kind == "regular" else [])


@pytest.mark.parametrize(
    ("sampler", "stop"),
    [({"replicates": 1}, {"relative_error": 0.1}), ({}, {"relative_error": 0.1, "samples": 1})],
)
def test_one_replicate_or_sample_refuses_an_error_target(sampler: Any, stop: Any) -> None:
    assert "/stop/relative_error" in errors({**CAMERA, "sampler": sampler, "stop": stop})


@pytest.mark.parametrize(
    ("sections", "at"),
    [
        ({"adaptive": {}, "sampler": {"type": "random"}}, "/adaptive/strategy"),
        ({"adaptive": {"strategy": "contrast"}, "sampler": {"type": "random"}}, "/adaptive/strategy"),
        ({"adaptive": {}, "sampler": {"type": "regular"}}, "/adaptive/strategy"),
        ({"adaptive": {}, "sampler": {"replicates": 1}}, "/adaptive/strategy"),
        ({"adaptive": {}, "stop": {"samples": 1}}, "/adaptive/strategy"),
        (
            {"adaptive": {"mode": "fast", "pilot_samples": 32}, "stop": {"samples": 16}},
            "/adaptive/pilot_samples",
        ),
    ],
)
def test_adaptive_sampling_is_refused_where_nothing_can_be_decided(sections: Any, at: str) -> None:
    assert list(errors({**CAMERA, **sections})) == [at]


@pytest.mark.parametrize(
    "sections",
    [
        {"adaptive": {}},
        {"adaptive": {"strategy": "contrast"}, "sampler": {"type": "regular"}},
        {"adaptive": {"strategy": "off"}, "sampler": {"type": "random"}},
        {"adaptive": {"pilot_samples": 32}, "stop": {"samples": 16}},
    ],
)
def test_adaptive_sampling_is_taken_where_something_can(sections: Any) -> None:
    assert not errors({**CAMERA, **sections})


@pytest.mark.parametrize(
    ("section", "at"),
    [({"strategy": "contrast", "mode": "fast"}, "/mode"), ({"threshold": 0.5}, "/threshold")],
)
def test_keys_of_the_other_strategy_are_refused(section: Any, at: str) -> None:
    with pytest.raises(ProblemError) as caught:
        scene_from_json({**CAMERA, "adaptive": section})
    assert [item.pointer for item in caught.value.problem.errors] == ["/adaptive" + at]


def test_a_job_can_turn_the_scenes_adaptive_sampling_off() -> None:
    scene = {**CAMERA, "adaptive": {"strategy": "error"}}
    assert job_from_json({"scene": scene}).resolved_scene().adaptive is not None
    assert job_from_json({"scene": scene, "adaptive": {"strategy": "off"}}).resolved_scene().adaptive is None


def test_there_are_never_more_replicates_than_samples() -> None:
    assert "/sampler/replicates" in errors({**CAMERA, "sampler": {"replicates": 8}, "stop": {"samples": 7}})
    assert not errors({**CAMERA, "sampler": {"replicates": 8}, "stop": {"samples": 8}})


@pytest.mark.parametrize(
    ("chosen", "refused"),
    [({"type": "box"}, False), ({"type": "box", "radius": 1}, True), ({"type": "tent"}, True)],
)
def test_the_plane_wide_sampler_needs_the_box_filter(chosen: Any, refused: bool) -> None:
    found = errors({**CAMERA, "sampler": {"type": "random"}, "film": {"filter": chosen}})
    assert ("/film/filter" in found) == refused


@pytest.mark.parametrize("sampler", ["regular", "stratified", "jittered", "sobol"])
@pytest.mark.parametrize("c", [0, 0.5])
def test_fixed_places_in_the_pixel_weigh_no_negative_lobes(sampler: str, c: float) -> None:
    """Nine places of 3 x 3 hold other shares of the lobes than their integral does."""
    film = {"filter": {"type": "mitchell", "b": 0.2, "c": c}}
    found = errors({**CAMERA, "sampler": {"type": sampler}, "film": film})
    assert ("/film/filter" in found) == (sampler in ("regular", "stratified") and c > 0)


def test_files_are_refused_unless_allowed_and_every_one_is_named() -> None:
    ref = {"file": "a.ply"}
    document = {
        **CAMERA,
        "shapes": [{"type": "mesh", "source": ref}],
        "prototypes": {"p/q": [{"type": "mesh", "source": ref}]},
        "textures": {"t": {"type": "image", "image": ref}},
        "environment": {"type": "image", "image": ref},
    }
    places = ["/textures/t/image", "/shapes/0/source", "/prototypes/p~1q/0/source", "/environment/image"]
    assert [at for at, _ in asset_refs(Scene.model_validate(document))] == places
    assert list(errors(document)) == [at + "/file" for at in places]
    assert not errors(document, allow_files=True)


def test_no_light_and_nothing_to_see_are_warnings_not_errors() -> None:
    dark = {"version": 1, "camera": {"type": "perspective"}}
    assert not errors(dark)
    assert len(warnings(dark)) == 2
    assert not warnings({**dark, "shapes": [{"type": "quad", "emission": {"radiance": 1}}]})


def test_a_phong_material_that_makes_light_is_warned_of() -> None:
    lavish = {"type": "phong", "base_color": 0.6, "specular_color": 0.6}
    assert any("more light" in w for w in warnings({**CAMERA, "materials": {"m": lavish}}))


def test_triangles_are_counted_over_the_whole_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("penumbra_scene.limits.MAX_TRIANGLES", 3)
    mesh = {"type": "mesh", "positions": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "indices": [[0, 1, 2]] * 2}
    assert "/shapes" not in errors({**CAMERA, "shapes": [mesh]})
    assert "/shapes" in errors({**CAMERA, "shapes": [mesh, mesh]})


def test_a_transform_is_bounded_as_a_whole() -> None:
    far = [{"translate": [1e18, 0, 0]}] * 2
    assert "/shapes/0/transform" in errors({**CAMERA, "shapes": [{"type": "sphere", "transform": far}]})
    assert "/camera/transform" in errors({**CAMERA, "camera": {"type": "perspective", "transform": far}})


def test_steps_act_in_the_order_listed() -> None:
    shape = {"type": "sphere", "transform": [{"scale": 2}, {"translate": [1, 0, 0]}]}
    scene = Scene.model_validate({**CAMERA, "shapes": [shape]})
    transform = scene.shapes[0].transform
    assert isinstance(transform, tuple)
    assert compose(transform)[0] == (2.0, 0.0, 0.0, 1.0)


def test_look_at_points_minus_z_at_the_target() -> None:
    frame = {"origin": [1, 2, 3], "target": [4, -2, 3]}
    scene = Scene.model_validate(
        {**CAMERA, "camera": {"type": "perspective", "transform": {"look_at": frame}}}
    )
    assert isinstance(scene.camera.transform, tuple)
    m = compose(scene.camera.transform)
    assert [-row[2] for row in m] == pytest.approx([0.6, -0.8, 0.0])
    assert [row[3] for row in m] == [1, 2, 3]
    x, y, z = (tuple(row[j] for row in m) for j in range(3))
    cross = (x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0])
    assert cross == pytest.approx(z)


def hash_of(document: dict[str, Any]) -> str:
    return scene_hash(Scene.model_validate(document))


def test_documents_that_mean_the_same_have_one_hash(minimal: dict[str, Any]) -> None:
    spelled = {**minimal, "film": {"width": 512.0}, "stop": {"samples": 64}, "sampler": {"seed": "0"}}
    spelled["materials"] = dict(reversed(minimal["materials"].items()))
    spelled["shapes"] = [{**minimal["shapes"][0], "center": [-0.0, 0, 0]}, *minimal["shapes"][1:]]
    assert hash_of(spelled) == hash_of(minimal)


def test_documents_that_differ_have_different_hashes(minimal: dict[str, Any]) -> None:
    others = [
        {**minimal, "sampler": {"seed": 1}},
        {**minimal, "sampler": {"seed": 2**63}},
        {**minimal, "sampler": {"seed": 2**63 + 1}},
        {**minimal, "shapes": minimal["shapes"][::-1]},
        {**minimal, "film": {"width": 513}},
    ]
    assert len({hash_of(d) for d in [minimal, *others]}) == 6


def test_rough_materials_are_counted_by_what_they_differ_in() -> None:
    def scene(count: int, **keys: Any) -> dict[str, Any]:
        material = {"type": "conductor", **keys}
        return {
            **CAMERA,
            "materials": {
                f"m{i}": {**material, "roughness": 0.2 + (i // 2) * 1e-4} for i in range(2 * count)
            },
        }

    assert not errors(scene(limits.MAX_ALBEDO_TABLES))
    assert "/materials" in errors(scene(limits.MAX_ALBEDO_TABLES + 1))
    assert not errors(scene(limits.MAX_ALBEDO_TABLES + 1, energy_compensation=False))


def _triangle(third: list[float], **more: Any) -> dict[str, Any]:
    positions = [[0, 0, 0], [0.1, 0.1, 0.1], third]
    return {"type": "mesh", "positions": positions, "indices": [[0, 1, 2]], **more}


def test_a_light_without_an_area_is_told_of_and_is_no_light() -> None:
    dark = {**CAMERA, "environment": None, "shapes": [_triangle([0.3, 0.3, 0.3], emission={"radiance": 1})]}
    told = warnings(dark)
    assert any("all triangles have no area: they are never seen and give no light" in m for m in told)
    assert any("the scene has no light" in m for m in told)
    dark["shapes"] = [_triangle([0.3, 0.3, 0.300001], emission={"radiance": 1})]  # thin, and no line
    assert warnings(dark) == []


@pytest.mark.parametrize(
    "shape",
    [
        {"type": "sphere", "radius": 1e-25},
        {"type": "disc", "radius": 1e-25},
        {"type": "quad", "u": [1e-18, 0, 0], "v": [0, 1e-18, 0], "transform": {"scale": 0.01}},
    ],
    ids=lambda shape: shape["type"],
)
def test_what_is_nothing_in_float32_is_told_of(shape: dict[str, Any]) -> None:
    dark = {**CAMERA, "environment": None, "shapes": [{**shape, "emission": {"radiance": 1}}]}
    seen, light = warnings(dark)
    assert seen.startswith("its area is below 1.2e-38 m^2")
    assert seen.endswith("it is never seen and gives no light")
    assert "the scene has no light" in light


def test_flat_triangles_are_counted_and_moving_ones_are_not() -> None:
    mesh = _triangle([1, 0, 0])
    mesh["indices"] = [[0, 1, 2], [0, 0, 1], [2, 2, 2]]
    (told,) = warnings({**CAMERA, "shapes": [mesh]})
    assert told.startswith("2 of 3 triangles have no area")
    flat, open_ = [[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    frames = [{"time": 0, "positions": flat}, {"time": 1, "positions": open_}]
    assert warnings({**CAMERA, "shapes": [_triangle([0.3, 0.3, 0.3], deformation=frames)]}) == []


def test_one_step_alone_is_a_list_in_keyframes_too() -> None:
    step = {"translate": [1, 0, 0]}
    scenes = [
        Scene.model_validate(shining({"keyframes": [{"time": 0, "transform": t}]})) for t in (step, [step])
    ]
    assert scenes[0] == scenes[1]
