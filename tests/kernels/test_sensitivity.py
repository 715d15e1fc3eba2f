"""Shares of the noise: the estimator on integrands of known indices, the kernel's two streams, and a real picture's whole."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.features import analyse
from penumbra_kernels.layout import CONSTANTS, PARAMS
from penumbra_kernels.nodes import Tile
from penumbra_kernels.sensitivity import (
    GROUPS,
    INTERACTIONS,
    bit_of,
    groups_of,
    measure,
    peak,
    shares,
    values_of,
    variance_of,
)
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.scene import Scene

Array = NDArray[np.float64]


def of_function(
    f: Callable[[Array], Array], count: int, blocks: int = 400, inner: int = 64
) -> dict[str, Any]:
    """The table of f over [0, 1)^count."""
    rng = np.random.default_rng(7)
    a, b = rng.random((2, count, blocks, inner))
    mixed = {}
    for i in range(count):
        both = a.copy()
        both[i] = b[i]
        mixed[f"x{i}"] = f(both)
    return {row.group: row for row in shares(f(a), f(b), mixed)}


# Sobol's g-function (Saltelli and Sobol 1995): V_i = 1 / (3 (1 + a_i)^2), V = prod (1 + V_i) - 1.
G_PARAMETERS = (0.0, 1.0, 4.5)


def g_function(x: Array) -> Array:
    out = np.ones(x.shape[1:])
    for xi, ai in zip(x, G_PARAMETERS, strict=True):
        out = out * (np.abs(4 * xi - 2) + ai) / (1 + ai)
    return out


def test_shares_of_a_function_with_known_indices() -> None:
    table = of_function(g_function, len(G_PARAMETERS))
    alone = [1 / (3 * (1 + a) ** 2) for a in G_PARAMETERS]
    whole = float(np.prod([1 + v for v in alone]) - 1)
    for i, v in enumerate(alone):
        row = table[f"x{i}"]
        assert abs(row.alone - v / whole) < 5 * row.error
        assert abs(row.typical - v / whole) < 5 * row.typical_error + 0.01  # 64 replicates: a ratio's bias
        total = v * float(np.prod([1 + w for j, w in enumerate(alone) if j != i])) / whole
        assert row.together == pytest.approx(total, rel=0.05)
    assert abs(table[INTERACTIONS].alone - (1 - sum(alone) / whole)) < 5 * table[INTERACTIONS].error
    assert all(0 < row.error < 0.03 for row in table.values())


def test_a_product_is_interaction_alone() -> None:
    """Freezing one factor of a product of zero mean removes nothing: it can even raise the variance."""
    table = of_function(lambda x: (x[0] - 0.5) * (x[1] - 0.5), 2)
    assert abs(table["x0"].alone) < 5 * table["x0"].error
    assert abs(table["x1"].alone) < 5 * table["x1"].error
    assert abs(table[INTERACTIONS].alone - 1) < 5 * table[INTERACTIONS].error
    assert table["x0"].together == pytest.approx(1, abs=0.05)


def test_without_noise_there_are_no_shares() -> None:
    flat = np.ones((4, 8))
    rows = shares(flat, flat, {"pixel": flat})
    assert [(row.alone, row.typical) for row in rows] == [(0, 0), (0, 0)]
    assert peak(flat, flat) == 0


def test_errors_of_a_single_block_are_unknown() -> None:
    """They come from the spread over blocks: one has none to show."""
    first, second, mixed = np.random.default_rng(5).normal(size=(3, 1, 8, 4))
    rows = shares(first, second, {"pixel": mixed})
    assert [(row.error, row.typical_error) for row in rows] == [(None, None), (None, None)]
    assert variance_of(first, second)[1] is None


def test_a_few_bright_values_leave_the_table_of_a_typical_block() -> None:
    """One value in each draw some thousand times the others, as a caustic gives them."""
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(2, 2, 400, 16, 16))
    first, second = a[0] + 2 * a[1], b[0] + 2 * b[1]
    mixed = {"x0": b[0] + 2 * a[1], "x1": a[0] + 2 * b[1]}
    for block, values in enumerate((first, second, *mixed.values())):
        values[10 + block // 2, 3, 5] = 1e4
    table = {row.group: row for row in shares(first, second, mixed)}
    assert peak(first, second) > 0.9
    assert sum(row.alone for row in table.values()) == pytest.approx(1)
    assert sum(row.typical for row in table.values()) == pytest.approx(1)
    assert all(-1 <= row.alone <= 1 for row in table.values() if row.group != INTERACTIONS)
    for name, share in (("x0", 0.2), ("x1", 0.8), (INTERACTIONS, 0.0)):
        row = table[name]
        assert row.typical_error < 0.01
        assert abs(row.typical - share) < 5 * row.typical_error + 0.01
    assert abs(table["x1"].alone - 0.8) > 0.2


SAMPLERS = ["random", "independent", "stratified", "jittered", "sobol", "blue_noise"]

STREAMS = """
#include "sampling/sampler.cl"
__kernel void draws(__global float2 *out, const __global Params *params, const __global ulong *dims) {
  const uint i = get_global_id(0);
  Sampler s = sampler_start(params, 3, 5, 1);
  sampler_next(&s, i);
  for (uint k = 0; k < 9; k++) {
    out[18 * i + 2 * k] = sample_2d(&s, dims[k]);
    out[18 * i + 2 * k + 1] = (float2)(sample_1d(&s, dims[k]), sample_1d_of(&s, dims[k], 1, 2));
  }
}
"""
BOUNCE = [(bounce + 1) * 16 for bounce in range(2)]
DIMENSIONS = [0, 1, 2, *(BOUNCE[0] + slot for slot in range(1, 6)), (BOUNCE[1] + 1) | (3 << 32)]
GROUP_OF = [
    "pixel",
    "lens",
    "time",
    "lights",
    "directions",
    "directions",
    "directions",
    "lights",
    "lights",
]


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_only_the_named_group_draws_from_the_second_stream(
    compiled: Callable[[str, Mapping[str, int]], Any], sampler: str
) -> None:
    flags = {"PENUMBRA_SAMPLER": CONSTANTS[f"SAMPLER_{sampler.upper()}"], "PENUMBRA_PICK_FREEZE": 1}
    launch = compiled(STREAMS, flags)
    plain = compiled(STREAMS, {**flags, "PENUMBRA_PICK_FREEZE": 0})

    def draws(run: Any, groups: int) -> NDArray[np.float32]:
        params = np.zeros((), PARAMS)
        params["seed"], params["strata"], params["replicate_count"] = 11, 16, 4
        params["film_width"] = params["film_height"] = 16
        params["log2_samples"] = 4
        params["options"] = groups << CONSTANTS["OPTION_OTHER_SHIFT"]
        out = np.zeros((16, len(DIMENSIONS), 4), np.float32)
        run("draws", 16, out, params, np.array(DIMENSIONS, np.uint64))
        return out

    first = draws(launch, 0)
    assert first.tobytes() == draws(plain, 0).tobytes()
    for group in GROUPS:
        changed = (draws(launch, bit_of(group)) != first).any(axis=(0, 2))
        assert [name for name, new in zip(GROUP_OF, changed, strict=True) if new] == [
            name for name in GROUP_OF if name == group
        ]


SCENE: dict[str, Any] = {
    "version": 1,
    "camera": {
        "type": "perspective",
        "transform": [{"translate": [0, 0.6, 4]}],
        "lens": {"aperture_radius": 0.1, "focus_distance": 3},
    },
    "film": {"width": 48, "height": 48},
    "sampler": {"type": "independent", "seed": 3},
    "integrator": {"max_bounces": 2},
    "shapes": [
        {"type": "plane"},
        {"type": "sphere", "center": [0, 0.6, 0], "radius": 0.6},
        {
            "type": "quad",
            "origin": [-0.5, 2.5, -0.5],
            "u": [1, 0, 0],
            "v": [0, 0, 1],
            "emission": {"radiance": 6},
        },
    ],
}
TILES = [Tile(8 * x, 8 * y, 8, 8) for y in range(6) for x in range(6)]


def tracer_of(device: Device, **sections: Any) -> Tracer:
    scene = Scene.model_validate({**SCENE, **sections})
    return Tracer(device, compile_scene(scene, NoAssets()), SamplePlan(8, 4), measuring=True)


def test_a_pictures_table_adds_up_to_the_variance_of_its_replicates(device: Device) -> None:
    """The whole as the film knows it: the spread of independent replicates, from another seed."""
    tracer = tracer_of(device)
    everything = sum(bit_of(group) for group in GROUPS)
    first, second = values_of(tracer, TILES, 4, 0), values_of(tracer, TILES, 4, everything)
    whole, error = variance_of(first, second)
    other = values_of(tracer_of(device, sampler={"type": "independent", "seed": 4}), TILES, 4, 0)
    spread = other.var(axis=1, ddof=1).mean(axis=1)
    assert abs(whole - spread.mean()) < 5 * np.hypot(error, spread.std(ddof=1) / np.sqrt(len(spread)))
    table = {row.group: row for row in measure(tracer, TILES, 4).rows}
    assert list(table) == ["pixel", "lens", "lights", "directions", INTERACTIONS]
    assert sum(row.alone for row in table.values()) == pytest.approx(1, abs=1e-9)
    for row in table.values():
        assert row.together is None or row.together > row.alone - 5 * row.error


def test_what_cannot_matter_has_no_share(device: Device) -> None:
    """A lens that shows the same everywhere: a plain wall that is lit evenly. All noise is the directions'."""
    wall = [{"type": "quad", "origin": [-50, -50, -2], "u": [100, 0, 0], "v": [0, 100, 0]}]
    sky = {"type": "constant", "radiance": 1}
    tracer = tracer_of(device, shapes=wall, environment=sky, integrator={"max_bounces": 1})
    table = {row.group: row for row in measure(tracer, TILES[:12], 4).rows}
    assert abs(table["lens"].alone) < 0.02
    assert abs(table["pixel"].alone) < 0.02
    assert table["lights"].alone + table["directions"].alone + table[INTERACTIONS].alone > 0.95


def test_groups_are_those_that_the_scenes_program_draws() -> None:
    lit = {
        **SCENE,
        "lights": [{"type": "point"}],
        "shapes": SCENE["shapes"][:2],
        "integrator": {"max_bounces": 0},
    }
    assert groups_of(analyse(Scene.model_validate(lit))) == ("pixel", "lens")
