"""Frames in the folder of `penumbra render`: those that are there already, from a render that was ended early, are kept."""

from __future__ import annotations

import fcntl
import shutil
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

from penumbra_scene.check import asset_refs, scene_hash
from penumbra_scene.job import JobRequest, JobState
from penumbra_scene.receipt import Receipt
from pydantic import ValidationError

from penumbra_service.engine.snapshot import kernel_hash
from penumbra_service.frames import thumbnail_file
from penumbra_service.results import ALL, RECEIPT, THUMBNAIL, frame_folder
from penumbra_service.running import EndedFrame, Outcome

PREFIX: Final = ".penumbra-"
LOCK: Final = "lock"
YOUNG_SECONDS: Final = 60.0
"""A folder that is no older may be one whose lock is just being taken."""


class OutBook:
    """Implements running.FrameBook: files of frames go where the user wants them. `kept`: receipts of those that lie
    there."""

    def __init__(self, work: Path, out: Path, kept: Mapping[int, Receipt]) -> None:
        self._work = work
        self._out = out
        self._kept = kept
        self.receipts = dict(kept)
        for frame in kept:  # for the contact sheet and the movie
            target = thumbnail_file(work, frame)
            target.parent.mkdir(exist_ok=True)
            shutil.copyfile(out / frame_folder(frame) / THUMBNAIL, target)

    def ended(self) -> dict[int, EndedFrame]:
        return {
            frame: EndedFrame(
                failed=False,
                seconds=receipt.forecast.real_seconds,
                device_seconds=sum(device.seconds for device in receipt.devices),
                samples=receipt.samples,
            )
            for frame, receipt in self._kept.items()
        }

    def report(self, frame: int, state: JobState, news: Mapping[str, Any]) -> None:
        pass

    def show(self, frame: int) -> None:
        pass

    def end(self, frame: int, outcome: Outcome) -> None:
        here = frame_folder(frame)
        if outcome.receipt is not None:
            self.receipts[frame] = outcome.receipt
            (self._out / here).mkdir(parents=True, exist_ok=True)
            # An old receipt must not stand beside a new picture, not even if this process is killed in between.
            (self._out / here / RECEIPT).unlink(missing_ok=True)
            move_files(self._work / here, self._out / here, ALL)
        shutil.rmtree(self._work / here, ignore_errors=True)


@contextmanager
def work_folder(out: Path) -> Iterator[Path]:
    """A folder within `out` for what is not finished, gone at the end; and with it those that killed renders have left."""
    remove_left(out)
    with tempfile.TemporaryDirectory(prefix=PREFIX, dir=out) as name:
        work = Path(name)
        with (work / LOCK).open("w") as lock:
            with suppress(OSError):  # a file system without locks: nobody will take it for left
                fcntl.flock(lock, fcntl.LOCK_EX)
            yield work


def remove_left(out: Path) -> None:
    """Work folders whose process has ended without removing them."""
    for lock in out.glob(f"{PREFIX}*/{LOCK}"):
        with suppress(OSError), lock.open("r+") as file:  # OSError: another process is at work there
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if time.time() - lock.stat().st_mtime > YOUNG_SECONDS:
                shutil.rmtree(lock.parent, ignore_errors=True)


def move_files(source: Path, target: Path, names: Iterable[str]) -> None:
    """Those that are there, in their order."""
    for name in names:
        if (source / name).exists():
            shutil.move(source / name, target / name)


def finished_frames(request: JobRequest, folder: Path, out: Path) -> dict[int, Receipt]:
    """Receipts of the frames in `out` that a render of this request would only make again: the same scene with the same
    sampler, seed and stop rule at the same time, by the same kernels, from files under `folder` that have not changed."""
    scene = request.resolved_scene()
    files = [folder / ref.file for _, ref in asset_refs(scene) if ref.file is not None]
    changed = max(map(_changed, files), default=0.0)
    wanted = scene_hash(scene), kernel_hash()
    found = {}
    for frame in request.sequence:
        receipt = _receipt(out / frame_folder(frame))
        if (
            receipt is not None
            and (receipt.scene_hash, receipt.kernel_hash) == wanted
            and receipt.time == request.time_of(frame)
            and receipt.created.timestamp() > changed
            and not (request.strict and receipt.bit_class == "mixed")
            and not (request.measure_effects and receipt.effects_measured is None)
        ):
            found[frame] = receipt
    return found


def _receipt(folder: Path) -> Receipt | None:
    """That of a frame whose files are all there; the receipt is the last one written."""
    if not all((folder / name).is_file() for name in ALL):
        return None
    try:
        return Receipt.model_validate_json((folder / RECEIPT).read_bytes())
    except (ValidationError, OSError):
        return None


def _changed(path: Path) -> float:
    """When a file was last written or put in its place; an infinitely late moment where it cannot be told."""
    try:
        return path.stat().st_ctime
    except OSError:
        return float("inf")
