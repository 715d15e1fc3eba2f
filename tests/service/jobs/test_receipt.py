"""The receipt tells what the run wrote down, and the record survives its file."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime, timedelta

import pytest
from penumbra_scene.job import StopReason
from penumbra_scene.receipt import Receipt
from penumbra_scene.scene import Scene
from penumbra_service.film.counts import PixelCounts
from penumbra_service.film.predict import Point
from penumbra_service.jobs.receipt import ReceiptContext, build_receipt
from penumbra_service.jobs.record import AdaptiveUse, DeviceUse, Effect, Foretold, RunRecord
from penumbra_service.results import attributes
from penumbra_service.web.pages import receipt_rows

START = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
CONTEXT = ReceiptContext("j1", "a name", START, START, START + timedelta(seconds=9), 1.0, 0.5)


def _record(**more):  # type: ignore[no-untyped-def]
    points = [Point(n, n / 10, n**-1.2, 1.1 * n**-1.2, 0.05, n**-1.2, 400.0) for n in (8, 16, 24, 32, 64)]
    record = RunRecord(
        replicates=8,
        seconds=6.4,
        points=points,
        ends=[1, 2, 3, 4, 8],
        compile_seconds=1.5,
        compile_warm=False,
        build_seconds=0.3,
        build_warm=False,
        trace_seconds=12.0,
        devices={
            "a x": DeviceUse("a", "A", "P", "1", "x", 3, 6.0),
            "b x": DeviceUse("b", "B", "P", "1", "x", 3, 6.0),
        },
        effects=[Effect("lens", False, "nothing uses it"), Effect("gloss", True, "materials/m is phong")],
        program_hash="p",
        kernel_hash="k",
        redone_leases=1,
        crashes=1,
        foretold=Foretold(16, 70.0, 7.0),
        counts=PixelCounts(640, 600, 2, {"gloss": 2, "lens": 0}, 10, 3, {"empty": 1}),
    )
    for name, value in more.items():
        setattr(record, name, value)
    return record


@pytest.fixture
def scene() -> Scene:
    return Scene.model_validate(
        {"version": 1, "camera": {"type": "perspective"}, "sampler": {"seed": str(2**64 - 1)}}
    )


@pytest.mark.parametrize("kept", [0, 2])
def test_a_receipt_tells_how_samples_were_spread(scene, kept):  # type: ignore[no-untyped-def]
    mode = "fast" if kept else "certified"
    use = AdaptiveUse("error", mode, kept, 16, 0.5, 1.1, {"0": 1, "10": 6, "2": 3}, kept)
    receipt = build_receipt(scene, _record(adaptive=use), StopReason.SAMPLES, CONTEXT)
    adaptive = receipt.adaptive
    assert adaptive is not None
    told = attributes(receipt)
    assert str(told["penumbra:biased"]).startswith("yes" if kept else "no")
    assert told["penumbra:adaptive"] == f"error, {mode}"
    rows = dict(dict(receipt_rows(receipt))["Adaptive sampling"])
    assert rows["Pilot"].endswith("kept" if kept else "dropped")
    assert rows["Biased"].startswith("yes" if kept else "no")
    assert adaptive.biased == (kept > 0)
    assert adaptive.shadow_rays == (kept or None)
    assert told.get("penumbra:shadowRays") == adaptive.shadow_rays
    assert rows.get("Shadow rays that pay") == (str(kept) if kept else None)
    # ends[-1] is 8 of each of 8 replicates: level 2 takes 0 and 4, level 10 takes 0
    most, middle, least = (64, 24, 16) if kept else (64, 16, 8)
    assert [(level.samples, level.share) for level in adaptive.levels] == [
        (most, 0.1),
        (middle, 0.3),
        (least, 0.6),
    ]
    assert RunRecord.from_json(json.loads(json.dumps(_record(adaptive=use).to_json()))).adaptive == use


def test_a_receipt_says_what_the_record_says(scene):  # type: ignore[no-untyped-def]
    receipt = build_receipt(scene, _record(), StopReason.RELATIVE_ERROR, CONTEXT)
    assert receipt.samples == 64
    assert receipt.seed == str(2**64 - 1)
    assert receipt.bit_class == "x"
    assert receipt.error.theta == pytest.approx(1.2)
    assert receipt.error.relative_error == pytest.approx(math.sqrt(64**-1.2))
    assert [p.samples for p in receipt.error.curve] == [8, 16, 24, 32, 64]
    assert receipt.forecast.predicted_samples == 70
    assert receipt.forecast.real_samples == 64
    assert [(s.first_sample, s.sample_count) for s in receipt.plan] == [
        (0, 1),
        (1, 1),
        (2, 1),
        (3, 1),
        (4, 4),
    ]
    assert [e.name for e in receipt.effects_in] == ["gloss"]
    assert [e.name for e in receipt.effects_out] == ["lens"]
    assert [e.name for e in receipt.not_covered] == ["light of long paths"]
    assert receipt.counts.rejected_in == {"gloss": 2}
    assert receipt.counts.flagged_share == 0.3
    assert receipt.counts.empty_pixels == 1
    assert receipt.stages.wall_seconds == 9
    assert receipt.stages.compile.warm is False
    assert Receipt.model_validate_json(receipt.model_dump_json()) == receipt


def test_classes_that_were_mixed_are_named_so(scene):  # type: ignore[no-untyped-def]
    record = _record()
    record.devices["c y"] = DeviceUse("c", "C", "P", "1", "y", 0, 0.0)
    assert record.bit_class == "x"
    record.devices["c y"].leases = 1
    assert build_receipt(scene, record, StopReason.SAMPLES, CONTEXT).bit_class == "mixed"


def test_no_variance_is_said_and_not_invented(scene):  # type: ignore[no-untyped-def]
    points = [Point(4, 1.0, math.nan, math.nan, math.nan, math.nan)]
    receipt = build_receipt(
        scene, _record(points=points, deterministic=True, foretold=None), StopReason.SAMPLES, CONTEXT
    )
    assert receipt.error.relmse is None
    assert "deterministic" in receipt.error.method
    assert "null" in receipt.model_dump_json()
    assert "NaN" not in receipt.model_dump_json().replace("variance is NaN", "")


def test_a_record_survives_its_json():
    record = _record()
    assert RunRecord.from_json(json.loads(json.dumps(record.to_json()))) == record
    with pytest.raises(ValueError, match="unknown"):
        RunRecord.from_json({**record.to_json(), "nonsense": 1})


def test_an_error_that_few_pixels_carry_is_told(scene):  # type: ignore[no-untyped-def]
    for of_few in (False, True):
        record = _record(points=[Point(64, 1.0, 1e-3, 2e-3, 0.5, 1e-3, 3.2, of_few)])
        told = build_receipt(scene, record, StopReason.SAMPLES, CONTEXT).warnings
        assert any("some 3 pixels carry" in warning for warning in told) == of_few


def test_a_black_picture_is_told(scene):  # type: ignore[no-untyped-def]
    """A camera inside of a ball sees nothing, with an error of 0."""
    for lit in (0, 1):
        record = _record(counts=PixelCounts(640, lit, pixels=10))
        told = build_receipt(scene, record, StopReason.SAMPLES, CONTEXT).warnings
        assert any("the picture is black" in warning for warning in told) == (lit == 0)


def test_a_dark_picture_is_told_that_the_floor_hides_its_error(scene):  # type: ignore[no-untyped-def]
    for floor, said in ((0.5, False), (0.96, True)):
        record = _record(points=[Point(64, 1.0, 1e-3, 2e-3, 0.5, 1e-3, 900.0, floor=floor)])
        told = build_receipt(scene, record, StopReason.SAMPLES, CONTEXT).warnings
        assert (
            any("dark" in warning and "96 %" in warning and "5 times" in warning for warning in told) == said
        )


def test_an_error_far_beyond_a_scenes_numbers_is_told(scene):  # type: ignore[no-untyped-def]
    """Radiance may be 1e18, and its variance is squared radiance."""
    record = _record(points=[Point(64, 1.0, 1e30, 1e30, 0.0, 1e76)])
    error = build_receipt(scene, record, StopReason.SAMPLES, CONTEXT).error
    assert (error.mse, error.relmse, error.relative_error) == (1e76, 1e30, 1e15)
    assert error.curve[0].relmse == 1e30
