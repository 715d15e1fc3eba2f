"""The files of docs/deploy at work: dask-jobqueue's program with an sbatch that starts jobs on this machine."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
from penumbra_scene.job import JobState
from penumbra_service.engine.dask.certs import make_certs
from penumbra_service.engine.dask.engine import DaskEngine
from penumbra_service.engine.runner import JobRunner

# Its import would take SIGINT over, in this process.
without = pytest.mark.skipif(find_spec("dask_jobqueue") is None, reason="needs dask_jobqueue")
pytestmark = [without, pytest.mark.thorough, pytest.mark.timeout(600)]
PROGRAM = Path(__file__).parents[2] / "docs" / "deploy" / "slurm.py"
_SBATCH = """#!/bin/bash
grep -q '^#SBATCH' "$1" || exit 1
cp "$1" "$0.job"
setsid bash "$0.job" >"$0.log" 2>&1 &
echo $! >"$0.pid"
echo "Submitted batch job $!"
"""
_SCANCEL = """#!/bin/bash
kill -- "-${@: -1}"
"""


@pytest.fixture
def slurm(tmp_path: Path, free_port: int) -> Iterator[subprocess.Popen[str]]:
    """slurm.py at work, with one job."""
    for name, text in (("sbatch", _SBATCH), ("scancel", _SCANCEL)):
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    make_certs(tmp_path / "certs")
    words = [sys.executable, str(PROGRAM), "--jobs", "1", "--tls", str(tmp_path / "certs"), "--cpus", "1"]
    environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"}
    process = subprocess.Popen(
        [*words, "--port", str(free_port)], env=environment, stdout=subprocess.PIPE, text=True
    )
    yield process
    process.send_signal(signal.SIGTERM)
    try:
        assert process.wait(60) == 0
    finally:  # as Slurm does with whatever of a job does not end by itself
        with contextlib.suppress(ProcessLookupError):
            os.killpg(int((tmp_path / "sbatch.pid").read_text()), signal.SIGKILL)


def test_dask_jobqueues_jobs_render_over_tls(slurm, make_task, tmp_path):  # type: ignore[no-untyped-def]
    assert slurm.stdout is not None
    words = slurm.stdout.readline().split()
    assert words[:3] == ["penumbra", "serve", "--scheduler"]
    assert words[3].startswith("tls://")
    with DaskEngine(words[3], str(tmp_path / "contents"), tmp_path / "certs") as engine:
        end = time.monotonic() + 300
        while not engine.usable():
            assert time.monotonic() < end, (tmp_path / "sbatch.log").read_text()
            time.sleep(0.1)
        result = JobRunner(engine, make_task("plain", film={"width": 16, "height": 16})).run()
    assert result.state is JobState.FINISHING
    assert [use.id.partition("@")[0] for use in result.record.devices.values()] == ["pocl:0"]
    script = (tmp_path / "sbatch.job").read_text()
    assert "#SBATCH --cpus-per-task=1\n" in script
