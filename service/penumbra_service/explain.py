"""`penumbra explain`: which effects a scene calls for, and why. Needs no device."""

from __future__ import annotations

import json
from pathlib import Path

from penumbra_kernels.features import Features, analyse
from penumbra_scene.parse import parse_scene


def explain(scene: Path, time: float = 0.0, *, as_json: bool = False) -> str:
    """The verdict on every effect for the frame at `time` seconds, as lines or as JSON.

    Raises OSError where the file cannot be read, ProblemError where it is not a scene.
    """
    features = analyse(parse_scene(scene.read_bytes(), allow_files=True), time)
    return _json(features) if as_json else _lines(features)


def _json(features: Features) -> str:
    verdicts = [{"effect": v.name, "in": v.present, "reason": v.reason} for v in features.verdicts]
    return json.dumps({"sampler": features.sampler, "effects": verdicts}, indent=2)


def _lines(features: Features) -> str:
    width = max(len(v.name) for v in features.verdicts)
    return "\n".join(
        f"{v.name:<{width}}  {'in,  because ' + v.reason if v.present else 'out'}" for v in features.verdicts
    )
