"""`penumbra explain`: which effects a scene calls for, and why; measured, what each costs. Itself it needs no device."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

from penumbra_kernels.features import Features, analyse
from penumbra_kernels.limits import Limit, not_covered
from penumbra_scene.measured import EffectsMeasured
from penumbra_scene.parse import parse_scene

PEAK: Final = 0.5
"""From which share of the noise in a hundredth of the blocks on a few bright pixels are said to carry it."""


def explain(
    scene: Path, time: float = 0.0, *, as_json: bool = False, measured: EffectsMeasured | None = None
) -> str:
    """The verdict on every effect for the frame at `time` seconds, as lines or as JSON, and what was measured.

    Raises OSError where the file cannot be read, ProblemError where it is not a scene.
    """
    model = parse_scene(scene.read_bytes(), allow_files=True)
    features, limits = analyse(model, time), not_covered(model)
    if as_json:
        return _json(features, limits, measured)
    lines = "\n".join([_lines(features), *_limits(limits)])
    return lines + ("" if measured is None else "\n\n" + table(measured))


def _limits(limits: tuple[Limit, ...]) -> list[str]:
    return [f"not covered: {limit.name}, because {limit.reason}" for limit in limits]


def _json(features: Features, limits: tuple[Limit, ...], measured: EffectsMeasured | None) -> str:
    verdicts = [
        {"effect": v.name, "in": v.present, "reason": v.reason, "pointer": v.pointer}
        for v in features.verdicts
    ]
    left_out = [{"name": limit.name, "reason": limit.reason} for limit in limits]
    told: dict[str, Any] = {"sampler": features.sampler, "effects": verdicts, "not_covered": left_out}
    if measured is not None:
        told["measured"] = measured.model_dump(mode="json")
    return json.dumps(told, indent=2)


def _lines(features: Features) -> str:
    width = max(len(v.name) for v in features.verdicts)
    return "\n".join(
        f"{v.name:<{width}}  {'in,  because ' + v.reason if v.present else 'out'}" for v in features.verdicts
    )


def table(measured: EffectsMeasured) -> str:
    """What each effect costs, as lines."""
    head = (
        f"measured in {measured.seconds:.1f} s on {measured.device}: {measured.blocks} blocks of 8 x 8 pixels,"
        f" {measured.samples} samples a pixel"
    )
    return "\n".join([head, "", *_cost_lines(measured), "", *_noise_lines(measured)])


def _cost_lines(measured: EffectsMeasured) -> list[str]:
    if not measured.costs:
        return ["time: no effect of this scene can be taken out of it"]
    rows = [
        f"{cost.effect:<13} {1e6 * cost.seconds:9.3f} {1e6 * cost.seconds_without:9.3f} {100 * cost.share:6.1f} %"
        for cost in measured.costs
    ]
    return [f"{'time (us)':<13} {'with':>9} {'without':>9} {'share':>8}", *rows]


def _noise_lines(measured: EffectsMeasured) -> list[str]:
    if not measured.noise:
        return ["noise: none"]
    rows = [
        f"{row.group:<13} {100 * row.alone:6.1f} +- {_per_cent(row.error)}"
        f" {100 * row.typical:8.1f} +- {_per_cent(row.typical_error)}"
        + ("" if row.together is None else f" {100 * row.together:12.1f} %")
        for row in measured.noise
    ]
    head = f"{'noise':<13} {'of the whole':>16} {'in a typical block':>18} {'with others':>14}"
    return [head, *rows, *_unknown_lines(measured), *_peak_lines(measured)]


def _per_cent(error: float | None) -> str:
    return "   ? %" if error is None else f"{100 * error:4.1f} %"


def _unknown_lines(measured: EffectsMeasured) -> list[str]:
    if all(row.error is not None and row.typical_error is not None for row in measured.noise):
        return []
    return [
        "?: an error that is unknown; errors come from the spread over blocks, and there is one with noise"
    ]


def _peak_lines(measured: EffectsMeasured) -> list[str]:
    peak = measured.noise_peak
    if peak is None or peak < PEAK or measured.blocks == 1:
        return []
    return [
        f"{100 * peak:.0f} % of the noise is in the noisiest hundredth of the blocks: shares of the whole are those of a few"
        " bright pixels, and uncertain; go by a typical block"
    ]
