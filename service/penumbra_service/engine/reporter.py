"""Progress and previews of one run, no more often than whoever watches can use. One thread, the run's."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Final

from penumbra_scene.job import JobState, Progress

from penumbra_service.engine.course import Course
from penumbra_service.engine.progress import forecast, progress_of
from penumbra_service.film.preview import PreviewImage

PROGRESS_SECONDS: Final = 0.25
"""Least time between two progress reports."""
PREVIEW_SECONDS: Final = 2.0


class Reporter:
    """Tells how a run stands. What it has told never goes back, also where the run begins again from a snapshot."""

    def __init__(
        self,
        on_progress: Callable[[JobState, Progress], None],
        on_preview: Callable[[PreviewImage], None],
    ) -> None:
        self._on_progress = on_progress
        self._on_preview = on_preview
        self._told: tuple[JobState, Progress] | None = None
        self._last_progress = self._last_preview = -math.inf

    def tell(self, state: JobState, course: Course, *, force: bool = False, share: float = 0.0) -> None:
        """Progress and preview, if it is time: for the first preview it always is. `share`: 1 where the picture is
        there."""
        now = time.monotonic()
        preview = course.canvas.preview
        first = preview.changed and self._last_preview == -math.inf
        if not (force or first) and now < self._last_progress + PROGRESS_SECONDS:
            return
        self._last_progress = now
        self._tell_progress(state, course, share)
        if preview.changed and (share == 1.0 or now >= self._last_preview + PREVIEW_SECONDS):
            self._last_preview = now
            self._on_preview(preview.image())

    def _tell_progress(self, state: JobState, course: Course, share: float) -> None:
        standing = course.standing(done=share == 1.0)
        goal, record = course.stage.goal, course.record
        told = forecast(goal, record.points, standing)
        before = 0.0 if self._told is None else self._told[1].progress
        news = (state, progress_of(goal, record, told, standing, max(before, share)))
        if news != self._told:
            self._told = news
            self._on_progress(*news)
