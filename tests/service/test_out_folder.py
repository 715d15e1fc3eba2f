"""Work folders go with their process, however it ends."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
import time
from pathlib import Path

from penumbra_scene.exits import Exit
from penumbra_service.out_folder import LOCK, PREFIX, YOUNG_SECONDS, work_folder

_TERMINATED = """
import os, signal, sys
from pathlib import Path
import penumbra_client.cli as cli
from penumbra_service.out_folder import work_folder

def main():
    with work_folder(Path(sys.argv[1])) as work:
        (work / "some.exr").touch()
        os.kill(os.getpid(), signal.SIGTERM)
        signal.pause()

cli.main = main
cli.program()
"""


def _left(out: Path, name: str, age: float) -> Path:
    folder = out / f"{PREFIX}{name}"
    folder.mkdir()
    (folder / "tiles").mkdir()
    (folder / LOCK).touch()
    os.utime(folder / LOCK, (time.time() - age, time.time() - age))
    return folder


def test_what_killed_renders_left_is_removed_and_nothing_else(tmp_path: Path) -> None:
    dead, young, busy = (
        _left(tmp_path, name, age)
        for name, age in (("dead", 2 * YOUNG_SECONDS), ("young", 0.0), ("busy", 2 * YOUNG_SECONDS))
    )
    foreign = tmp_path / f"{PREFIX}foreign"
    foreign.mkdir()
    with (busy / LOCK).open("r+") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with work_folder(tmp_path) as work:
            assert set(tmp_path.iterdir()) == {work, young, busy, foreign}
            with work_folder(tmp_path):  # another render of the same folder
                assert work.is_dir()
        assert set(tmp_path.iterdir()) == {young, busy, foreign}
    assert not dead.exists()


def test_a_terminated_command_leaves_no_work_folder(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", _TERMINATED, str(tmp_path)], timeout=60, check=False)
    assert done.returncode == Exit.TERMINATED
    assert not list(tmp_path.iterdir())
