"""The service's book of a job's frames: rows in the database, files among the artifacts."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable, Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from penumbra_scene.job import JobState, StopReason

from penumbra_service import results
from penumbra_service.running import EndedFrame, Outcome
from penumbra_service.store.artifacts import Artifacts
from penumbra_service.store.database import gently
from penumbra_service.store.frames import FrameStore


class ServiceFrameBook:
    """Implements running.FrameBook for one job. `ring` is called whenever a frame has moved."""

    def __init__(
        self,
        job: str,
        folder: Path,
        store: FrameStore,
        artifacts: Artifacts,
        show_job: Callable[[], None],
    ) -> None:
        """`folder`: the job's own; `show_job`: called when the job has a new picture to show."""
        self._job = job
        self._folder = folder
        self._store = store
        self._artifacts = artifacts
        self._show_job = show_job
        self._lock = threading.Lock()
        self._shown: int | None = None
        """The frame whose picture stands for the job."""

    def ended(self) -> dict[int, EndedFrame]:
        return {
            row.number: EndedFrame(
                row.state == JobState.FAILED,
                row.progress.get("seconds", 0.0),
                row.progress.get("device_seconds", 0.0),
                row.progress.get("samples_done", 0.0),
            )
            for row in self._store.of_job(self._job)
            if JobState(row.state).ended
        }

    def report(self, frame: int, state: JobState, news: Mapping[str, Any]) -> None:
        gently(lambda: self._store.put(self._job, frame, state, news))

    def show(self, frame: int) -> None:
        gently(lambda: self._show(frame))

    def _show(self, frame: int) -> None:
        self._publish(frame, (results.THUMBNAIL, results.HEATMAP))
        self._store.note_picture(self._job, frame)
        with self._lock:
            if self._shown is None:
                self._shown = frame
            if self._shown == frame:
                self._stand_for_job(frame)

    def end(self, frame: int, outcome: Outcome) -> None:
        now = datetime.now(UTC)
        if outcome.problem is not None:
            news = {"problem": outcome.problem.model_dump(mode="json")}
            self._store.put(self._job, frame, JobState.FAILED, news, reason=StopReason.FAILED, finished=now)
        else:
            self._publish(frame, results.ALL)
            self._store.note_picture(self._job, frame)
            done = {"progress": 1.0, "predicted_seconds": None, "predicted_seconds_interval": None}
            self._store.put(self._job, frame, JobState.DONE, done, reason=outcome.stop_reason, finished=now)
            with self._lock:
                self._shown = None
                self._stand_for_job(frame)
        shutil.rmtree(self._folder / results.frame_folder(frame), ignore_errors=True)

    def _publish(self, frame: int, names: Iterable[str]) -> None:
        folder = results.frame_folder(frame)
        for name in names:
            path = self._folder / folder / name
            if path.is_file():
                self._artifacts.put(self._job, f"{folder}/{name}", path)

    def _stand_for_job(self, frame: int) -> None:
        """The frame's pictures become the job's."""
        for name in (results.THUMBNAIL, results.HEATMAP):
            path = self._folder / results.frame_folder(frame) / name
            if path.is_file():
                shutil.copyfile(path, self._folder / name)
        self._show_job()
