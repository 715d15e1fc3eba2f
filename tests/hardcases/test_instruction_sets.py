"""Programs for AVX2 give the bits of those for AVX-512: lanes of sixteen are pairs of 256-bit vectors there."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from penumbra_kernels.device import devices
from penumbra_kernels.pocl_cache import VARIABLE
from penumbra_kernels.pocl_target import TARGETS

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
WIDE, NARROW = TARGETS[0][0], TARGETS[1][0]

RENDER = """
import hashlib, json, sys
from pathlib import Path
from penumbra_kernels import pocl_target

pocl_target.TARGETS = tuple(pair for pair in pocl_target.TARGETS if pair[0] != sys.argv[2])

from penumbra_kernels.assets import NoAssets
from penumbra_kernels.compile.scene import compile_scene
from penumbra_kernels.device import Device
from penumbra_kernels.nodes import Tile
from penumbra_kernels.tracer import SamplePlan, Tracer
from penumbra_scene.scene import Scene

device = Device(sys.argv[1])
scene = Scene.model_validate_json(Path(sys.argv[3]).read_bytes())
tracer = Tracer(device, compile_scene(scene, NoAssets()), SamplePlan(2, 16))
sums = tracer.trace(Tile(96, 96, 32, 16), 0, 16).sums
print(json.dumps([device.info.target, int(sums["lit"].sum()), hashlib.sha256(sums.tobytes()).hexdigest()]))
"""
"""argv: device, a target that is not to be had, scene."""


def rendered(device: str, without: str) -> tuple[str, int, str]:
    """The target that was compiled for, samples that brought light, and the sums' SHA-256."""
    words = [sys.executable, "-c", RENDER, device, without, str(EXAMPLES / "cornell.json")]
    environment = {name: value for name, value in os.environ.items() if name != VARIABLE}
    done = subprocess.run(words, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    target, lit, digest = json.loads(done.stdout)
    return target, lit, digest


@pytest.mark.parametrize("name", [info.id for info in devices() if info.target == WIDE] or ["none"])
def test_without_avx512_the_bits_are_the_same(name: str) -> None:
    if name == "none":
        pytest.skip(f"no device is compiled for {WIDE} here")
    narrow = rendered(name, WIDE)
    if narrow[0] != NARROW:
        pytest.skip(f"{name}'s driver names the processor itself: it cannot be made to compile for {NARROW}")
    native = rendered(name, "none")
    assert native[0] == WIDE
    assert native[1] > 1000
    assert native[1:] == narrow[1:]
