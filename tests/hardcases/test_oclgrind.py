"""The kernels run clean under oclgrind: no invalid access, no race, no value that was never set.

oclgrind has a compiler of its own, and so sees only the portable branch of the kernels: neither compiler builtins nor
x86's instructions. `make test-oclgrind` renders every example with both kinds of tree; the suite takes a few.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
EXAMPLES = sorted((HERE.parents[1] / "examples").glob("*.json"))
ICD = Path("/usr/lib/oclgrind/liboclgrind-rt-icd.so")
FEW = {("all_effects", "compact"), ("instances", "wide"), ("deformation", "wide"), ("light_tree", "wide")}
ALL = os.environ.get("PENUMBRA_OCLGRIND", "few") == "all"
RUNS = [(path, tree) for path in EXAMPLES for tree in ("wide", "compact") if ALL or (path.stem, tree) in FEW]

pytestmark = pytest.mark.timeout(900)


@pytest.fixture
def oclgrind(tmp_path: Path) -> dict[str, str]:
    """The environment in which oclgrind is an OpenCL device that watches; what it finds goes to oclgrind.log."""
    if not (ICD.exists() and shutil.which("oclgrind")):
        if os.environ.get("PENUMBRA_REQUIRE_TOOLS") == "1":
            pytest.fail("oclgrind is missing: apt-get install oclgrind")
        pytest.skip("needs oclgrind (apt-get install oclgrind)")
    vendors = tmp_path / "vendors"
    vendors.mkdir()
    (vendors / "oclgrind.icd").write_text(f"{ICD}\n")
    return {
        **os.environ,
        "OCL_ICD_VENDORS": str(vendors),
        "OCLGRIND_LOG": str(tmp_path / "oclgrind.log"),
        "OCLGRIND_UNINITIALIZED": "1",
        "OCLGRIND_DATA_RACES": "1",
        "OCLGRIND_MAX_ERRORS": "20",
        # It does not know the intrinsics that its LLVM's optimiser makes.
        "OCLGRIND_BUILD_OPTIONS": "-cl-opt-disable",
        "PENUMBRA_PORTABLE": "1",
        "PENUMBRA_CACHE": str(tmp_path / "cache"),
        "PYOPENCL_NO_CACHE": "1",
    }


def _found(tmp_path: Path) -> str:
    log = tmp_path / "oclgrind.log"
    return log.read_text() if log.exists() else ""


@pytest.mark.parametrize(("path", "tree"), RUNS, ids=lambda value: getattr(value, "stem", value))
def test_an_example_renders_clean(path: Path, tree: str, oclgrind: dict[str, str], tmp_path: Path) -> None:
    command = [sys.executable, str(HERE / "oclgrind_render.py"), str(path), tree]
    result = subprocess.run(command, env=oclgrind, capture_output=True, text=True, timeout=800, check=False)
    assert result.returncode == 0, result.stderr[-2000:]
    assert not _found(tmp_path)
    answer = json.loads(result.stdout)
    assert answer["rejected"] == 0
    assert answer["taken"] > 0


BROKEN = """
import numpy as np
from penumbra_kernels.device import Device
from penumbra_kernels.hardcases.benches.launch import Kernels
text = "__kernel void broken(__global float *out, const __global float *in) {{ {body} }}"
Kernels(Device("oclgrind:0"), "broken", text)("broken", 4, np.zeros(4, np.float32), np.ones(4, np.float32))
"""

MISTAKES = {
    "Invalid read": "out[get_global_id(0)] = in[get_global_id(0) + 100];",
    "Invalid write": "out[get_global_id(0) + 100] = in[0];",
    "Uninitialized": "float x[2]; x[0] = in[0]; out[get_global_id(0)] = x[get_global_id(0) % 2];",
    "data race": "out[0] = in[0] + (float)get_global_id(0);",
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_would_be_found(mistake: str, oclgrind: dict[str, str], tmp_path: Path) -> None:
    code = BROKEN.format(body=MISTAKES[mistake])
    subprocess.run([sys.executable, "-c", code], env=oclgrind, capture_output=True, timeout=200, check=False)
    assert mistake in _found(tmp_path)
