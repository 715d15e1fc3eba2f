"""A job of several frames, rendered on an engine: their pictures, and the contact sheet of all of them."""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from penumbra_scene.job import JobRequest

from penumbra_service.film.film import MEMORY_LIMIT
from penumbra_service.images.contact_sheet import cell_picture, chosen_frames, contact_sheet
from penumbra_service.images.movie import write_movie
from penumbra_service.images.png import read_png, write_png
from penumbra_service.picture import Picture, PictureRunner
from penumbra_service.results import CONTACT_SHEET, MOVIE, THUMBNAIL, frame_folder
from penumbra_service.running import FrameBook, Outcome
from penumbra_service.sequence import FrameSequence, FrameTask

log = logging.getLogger(__name__)

SHEET_SECONDS: Final = 2.0
"""Least time between two contact sheets of a job that runs."""
THUMBNAILS: Final = "thumbnails"
"""Folder in a job's own: the thumbnails of finished frames, until the job has ended."""


class ContactSheet:
    """The sheet of one job, in its folder. Frames of an earlier run come back from their thumbnails."""

    def __init__(self, folder: Path, frames: tuple[int, ...], size: tuple[int, int]) -> None:
        self._folder = folder
        self._frames = chosen_frames(frames)
        self._size = size
        self._lock = threading.Lock()
        self._pictures: dict[int, NDArray[np.uint8]] = {}
        self._written_at = -float("inf")
        (folder / THUMBNAILS).mkdir(parents=True, exist_ok=True)
        for frame in self._frames:
            if thumbnail_file(folder, frame).is_file():
                self._read(frame)

    def add(self, frame: int, thumbnail: Path) -> bool:
        """A frame is done; whether there is a new sheet. A sheet that cannot be written harms no frame."""
        try:
            write_png(thumbnail_file(self._folder, frame), read_png(thumbnail))
            with self._lock:
                self._read(frame)
                return time.monotonic() >= self._written_at + SHEET_SECONDS and self._write()
        except OSError:
            log.warning("no contact sheet can be written to %s", self._folder, exc_info=True)
            return False

    def finish(self) -> None:
        """Write it with all frames that there are."""
        try:
            with self._lock:
                self._write()
        except OSError:
            log.warning("no contact sheet can be written to %s", self._folder, exc_info=True)

    def _read(self, frame: int) -> None:
        if frame in self._frames:
            self._pictures[frame] = cell_picture(read_png(thumbnail_file(self._folder, frame)))

    def _write(self) -> bool:
        sheet = contact_sheet(self._frames, self._pictures, self._size)
        write_png(self._folder / CONTACT_SHEET, sheet, {"Description": "frames and their numbers"})
        self._written_at = time.monotonic()
        return True


def _make_movie(folder: Path, request: JobRequest) -> None:
    """Of the frames that are done. That there is none harms no frame."""
    files = [thumbnail_file(folder, frame) for frame in request.sequence]
    try:
        write_movie(folder / MOVIE, (read_png(file) for file in files if file.is_file()), request.fps)
    except OSError:
        log.warning("no movie can be written to %s", folder, exc_info=True)


def thumbnail_file(folder: Path, frame: int) -> Path:
    """Where a finished frame's thumbnail waits for sheet and movie."""
    return folder / THUMBNAILS / f"{frame:04d}.png"


def run_frames(
    pictures: PictureRunner,
    request: JobRequest,
    whole: Picture,
    book: FrameBook,
    at_once: int,
) -> Outcome:
    """Renders every frame of a request that the book does not know as ended. `whole`: the job as if it were one
    picture; frames get folders in its own."""
    window = whole.scene.film.window
    sheet = ContactSheet(whole.folder, request.sequence, (window.width, window.height))

    def folder_of(frame: int) -> Path:
        return whole.folder / frame_folder(frame)

    def render(task: FrameTask) -> Outcome:
        folder_of(task.number).mkdir(parents=True, exist_ok=True)
        return pictures.run(
            replace(
                whole,
                folder=folder_of(task.number),
                control=task.control,
                report=task.report,
                show=task.show,
                time=request.time_of(task.number),
                frame=task.number,
                memory_limit=MEMORY_LIMIT // at_once,
            )
        )

    def finished(frame: int) -> None:
        if sheet.add(frame, folder_of(frame) / THUMBNAIL) and whole.show is not None:
            whole.show()

    sequence = FrameSequence(request.sequence, book, whole.control, render, whole.report, at_once, finished)
    outcome = sequence.run()
    if outcome.final:
        sheet.finish()
        _make_movie(whole.folder, request)
    return outcome
