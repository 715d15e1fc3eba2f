"""Every example scene: no sample is rejected, and scaled, moved and turned as a whole it is the same picture.

The fast setting takes one change a scene, all scenes by one program; `make test-hard` takes every change, each scene with its
own sampler and its own program.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from penumbra_kernels.device import Device
from penumbra_kernels.hardcases.benches.pictures import Picture, Renderer
from penumbra_kernels.hardcases.benches.transformed import transformed
from penumbra_kernels.hardcases.pictures import same_picture
from penumbra_scene.scene import Scene
from penumbra_service.images.assets import FolderAssets

FULL = os.environ.get("PENUMBRA_HARD_CASES", "fast") == "full"
EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*.json"))
SIDE, SAMPLES = (48, 256) if FULL else (16, 32)
CHANGES: dict[str, dict[str, Any]] = {
    "scaled by 1e-6": {"scale": 1e-6},
    "scaled by 1e6": {"scale": 1e6},
    "moved by 1e6": {"move": (1e6, -1e6, 1e6)},
    "turned": {"rotate": {"axis": [1, 2, 3], "angle": 67}},
}
RUNS = [
    (path, change)
    for number, path in enumerate(EXAMPLES)
    for k, change in enumerate(CHANGES)
    if FULL or k == number % len(CHANGES)
]

Render = Callable[[Path, dict[str, Any]], Picture]


def _small(path: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(path.read_text())
    film = {**document.get("film", {}), "width": SIDE, "height": SIDE}
    film.pop("crop", None)
    if FULL:
        return {**document, "film": film}
    film.pop("layers", None)
    integrator = {**document.get("integrator", {}), "light_sampling": "solid_angle"}
    return {**document, "film": film, "integrator": integrator, "sampler": {"type": "sobol", "seed": 5}}


@pytest.fixture(scope="module")
def render(device: Device, tmp_path_factory: pytest.TempPathFactory) -> Render:
    renderer, kept = Renderer(device), tmp_path_factory.mktemp("assets")
    made: dict[str, Picture] = {}

    def run(path: Path, change: dict[str, Any]) -> Picture:
        document = transformed(_small(path), **change) if change else _small(path)
        key = json.dumps([path.name, change])
        if key not in made:
            scene = Scene.model_validate(document)
            one = scene.sampler.type == "regular"
            made[key] = renderer(
                scene,
                samples=SAMPLES,
                replicates=1 if one else 8,
                program="specialised" if FULL else "generic",
                assets=FolderAssets(kept, path.parent),
            )
        return made[key]

    return run


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_no_sample_of_an_example_is_rejected(path: Path, render: Render) -> None:
    sums = render(path, {}).node.sums
    assert sums["taken"].sum() > 0
    assert sums["rejected"].sum() == 0


@pytest.mark.parametrize(("path", "change"), RUNS, ids=lambda value: getattr(value, "stem", value))
def test_an_example_is_the_same_picture(path: Path, change: str, render: Render) -> None:
    here = render(path, {})
    if not (here.variance == here.variance).all():
        pytest.skip("a deterministic sampler has no noise to compare by")
    if FULL and change == "turned" and _small(path).get("sampler", {}).get("type") == "stratified":
        pytest.skip("places fixed in the pixel: what it errs at edges, which turn, is not noise")
    beyond = [m for m in same_picture(change, here, render(path, CHANGES[change])) if not m.passed]
    assert not beyond
