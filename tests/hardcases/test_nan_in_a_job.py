"""NaN never reaches the film: a job with a poisoned light, from device process to receipt and channels."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from penumbra_scene.job import JobState
from penumbra_scene.scene import Scene
from penumbra_service.engine.local import LocalEngine, list_devices
from penumbra_service.engine.runner import JobRunner, RenderTask
from penumbra_service.film import flags

COMMAND = (sys.executable, str(Path(__file__).with_name("poisoned_device.py")))
LIGHT = {"type": "point", "position": [0, 3, 0], "intensity": 9 * np.pi}
SCENE = {
    "version": 1,
    "camera": {
        "type": "orthographic",
        "height": 0.01,
        "transform": {"look_at": {"origin": [0, 2, 0], "target": [0, 0, 0], "up": [0, 0, 1]}},
    },
    "film": {"width": 16, "height": 16},
    "materials": {"gray": {"type": "diffuse", "base_color": 0.5}},
    "shapes": [{"type": "plane", "material": "gray"}],
    "lights": [LIGHT, LIGHT],
    "integrator": {"max_bounces": 0, "light_selection": "uniform"},
    "stop": {"samples": 64},
}


@pytest.mark.skipif(not list_devices(), reason="no OpenCL device")
def test_rejected_samples_are_counted_in_channels_and_receipt(tmp_path: Path) -> None:
    with LocalEngine([list_devices()[0].id], command=COMMAND) as engine:
        result = JobRunner(engine, RenderTask("poisoned", Scene.model_validate(SCENE), tmp_path)).run()
        assert result.state is JobState.FINISHING, result.failure
        bands = list(result.bands())
    channels = {
        name: np.concatenate([(b.floats | b.integers)[name] for b in bands])
        for name in ("R", "InvalidCount", "SampleCount", "Flags")
    }
    assert (channels["SampleCount"] + channels["InvalidCount"] == 64).all()
    counts = result.record.counts
    assert counts is not None
    assert counts.rejected == channels["InvalidCount"].sum() > 0
    assert counts.rejected_in["delta_light"] == np.count_nonzero(channels["InvalidCount"])
    assert (channels["Flags"][channels["InvalidCount"] > 0] & flags.REJECTED).all()
    # The good light is chosen half the time, and so counts twice.
    assert np.abs(channels["R"] - 1).max() < 1e-4
