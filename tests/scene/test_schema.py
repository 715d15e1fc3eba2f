"""The published JSON Schemas are current, valid, and agree with the models."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from penumbra_scene import schema
from penumbra_scene.check import scene_hash
from penumbra_scene.parse import job_from_json, parse_scene, scene_from_json
from penumbra_scene.receipt import Receipt
from penumbra_scene.scene import Scene

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.json"))
GUIDE = (ROOT / "docs" / "scene.md").read_text(encoding="utf-8")
VALIDATOR = Draft202012Validator(schema.published("scene"))


@pytest.mark.parametrize("name", schema.PUBLISHED)
def test_the_published_schema_is_what_the_models_say(name: str) -> None:
    path = ROOT / "docs" / "schema" / f"{name}.schema.json"
    assert path.read_text(encoding="utf-8") == schema.text(name), "run `python -m penumbra_scene.schema`"
    Draft202012Validator.check_schema(json.loads(schema.text(name)))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_every_example_is_valid_by_the_models_and_by_the_schema(path: Path) -> None:
    scene = parse_scene(path.read_bytes(), allow_files=True)
    VALIDATOR.validate(json.loads(path.read_bytes()))
    assert scene_hash(Scene.model_validate_json(scene.model_dump_json())) == scene_hash(scene)
    VALIDATOR.validate(scene.model_dump(mode="json"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_every_asset_of_an_example_is_there(path: Path) -> None:
    for file in re.findall(r'"file": "([^"]+)"', path.read_text(encoding="utf-8")):
        assert (path.parent / file).is_file()


def test_the_readme_of_the_examples_lists_each() -> None:
    text = (ROOT / "examples" / "README.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"\[`(\w+)`\]\(\1\.json\)", text)) == [path.stem for path in EXAMPLES]


REFUSED_BY_BOTH = [
    ("camera", {"type": "perspective", "fov": 180}),
    ("camera", {"type": "perspective", "fov": True}),
    ("film", {"width": 0}),
    ("film", {"width": 1.5}),
    ("film", {"crop": {"x": -1, "y": 0, "width": 1, "height": 1}}),
    ("sampler", {"replicates": 3}),
    ("sampler", {"seed": -1}),
    ("stop", {"samples": 0}),
    ("integrator", {"max_bounces": 65536}),
    ("integrator", {"shadow_rays": 0}),
    ("shapes", [{"type": "sphere", "radius": 0}]),
    ("shapes", [{"type": "sphere", "transform": {"turn": 1}}]),
    ("materials", {"m": {"type": "diffuse", "base_color": 1.1}}),
    ("bogus", 1),
]


@pytest.mark.parametrize(("key", "value"), REFUSED_BY_BOTH)
def test_the_schema_refuses_what_the_models_refuse(minimal: dict[str, Any], key: str, value: Any) -> None:
    assert not VALIDATOR.is_valid({**minimal, key: value})


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("sampler", {"seed": "18446744073709551615"}),
        ("environment", {"type": "constant", "radiance": 2}),
        ("camera", {"type": "orthographic", "transform": {"scale": 2}}),
        ("camera", {"type": "orthographic", "transform": [{"scale": [1, 2, 3]}]}),
    ],
)
def test_the_schema_takes_the_short_forms(minimal: dict[str, Any], key: str, value: Any) -> None:
    scene_from_json({**minimal, key: value})
    VALIDATOR.validate({**minimal, key: value})


# ---- docs/scene.md
BLOCKS = re.findall(r"```json(?: fragment=(\w+))?\n(.*?)```", GUIDE, flags=re.DOTALL)


@pytest.mark.parametrize(("kind", "text"), BLOCKS, ids=[kind or "scene" for kind, _ in BLOCKS])
def test_every_example_in_the_guide_is_valid(minimal: dict[str, Any], kind: str, text: str) -> None:
    body = json.loads(text)
    if kind == "job":
        job_from_json(body)
    elif kind == "problem":
        wrong = {**minimal, "shapes": [{"type": "sphere", "radius": -1}]}
        with pytest.raises(Exception, match="not valid") as caught:
            scene_from_json(wrong)
        assert json.loads(caught.value.problem.model_dump_json()) == body  # type: ignore[attr-defined]
    elif kind == "shape":
        scene_from_json({**minimal, "shapes": [body]}, allow_files=True)
    else:
        document = {**minimal, kind: body} if kind else body
        if kind in ("materials", "textures"):
            document["shapes"] = []
            document.setdefault("materials", {})
        if kind == "textures":
            document["materials"] = {}
        scene_from_json(document, allow_files=True)


def _properties(definitions: dict[str, Any]) -> set[str]:
    return {key for node in definitions.values() for key in node.get("properties", {})}


def test_the_guide_explains_every_key_and_every_word() -> None:
    published = schema.published("job")
    keys = _properties(published["$defs"]) | set(published["properties"])
    words = set(re.findall(r'"const": "(\w+)"', json.dumps(published)))
    missing = {key for key in keys | words if not re.search(rf"\b{key}\b", GUIDE)}
    assert not missing


def test_every_number_and_word_of_the_receipt_is_in_its_schema() -> None:
    described = schema.published("receipt")["properties"]
    assert set(described) == set(Receipt.model_fields)
