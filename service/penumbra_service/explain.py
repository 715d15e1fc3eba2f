"""`penumbra explain`: which effects a scene calls for, and why. Needs no device."""

from __future__ import annotations

import json
from pathlib import Path

from penumbra_kernels.features import Features, analyse
from penumbra_kernels.limits import Limit, not_covered
from penumbra_scene.parse import parse_scene


def explain(scene: Path, time: float = 0.0, *, as_json: bool = False) -> str:
    """The verdict on every effect for the frame at `time` seconds, as lines or as JSON.

    Raises OSError where the file cannot be read, ProblemError where it is not a scene.
    """
    model = parse_scene(scene.read_bytes(), allow_files=True)
    features, limits = analyse(model, time), not_covered(model)
    return _json(features, limits) if as_json else "\n".join([_lines(features), *_limits(limits)])


def _limits(limits: tuple[Limit, ...]) -> list[str]:
    return [f"not covered: {limit.name}, because {limit.reason}" for limit in limits]


def _json(features: Features, limits: tuple[Limit, ...]) -> str:
    verdicts = [{"effect": v.name, "in": v.present, "reason": v.reason} for v in features.verdicts]
    left_out = [{"name": limit.name, "reason": limit.reason} for limit in limits]
    return json.dumps({"sampler": features.sampler, "effects": verdicts, "not_covered": left_out}, indent=2)


def _lines(features: Features) -> str:
    width = max(len(v.name) for v in features.verdicts)
    return "\n".join(
        f"{v.name:<{width}}  {'in,  because ' + v.reason if v.present else 'out'}" for v in features.verdicts
    )
