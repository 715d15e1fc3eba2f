"""A preview movie of frames' thumbnails: H.264 in MP4, made by ffmpeg where it is installed.

Raw pixels go to ffmpeg through a pipe, and its command is a list of words of our own: no shell, nothing of a user's.
"""

from __future__ import annotations

import contextlib
import logging
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Iterable
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

log = logging.getLogger(__name__)

PROGRAM: Final = "ffmpeg"
MAX_SECONDS: Final = 300.0
"""After which ffmpeg is ended: a movie is no reason to hold a job."""


def movie_program() -> str | None:
    """Where ffmpeg is, if it is installed."""
    return shutil.which(PROGRAM)


def write_movie(path: Path, pictures: Iterable[NDArray[np.uint8]], fps: float) -> bool:
    """Pictures (height, width, 3) of sRGB code values, all of one size; whether there is a movie now. Where ffmpeg
    fails the log says why, and no file is left. Raises OSError for pictures that cannot be read."""
    program = movie_program()
    stream = iter(pictures)
    first = next(stream, None)
    if program is None or first is None:
        return False
    # Half as many samples of colour: both sides must be even.
    height, width = (max(side - side % 2, 2) for side in first.shape[:2])
    if min(first.shape[:2]) < 2:
        return False
    aside = path.with_name(f".{path.name}.part")
    with tempfile.TemporaryFile() as words:
        process = subprocess.Popen(
            _command(program, width, height, fps, aside), stdin=subprocess.PIPE, stdout=words, stderr=words
        )
        try:
            _feed(process, first, stream, (height, width))
        finally:
            code = process.wait()
        words.seek(0)
        said = words.read().decode(errors="replace").strip()
    if code != 0:
        aside.unlink(missing_ok=True)
        log.warning("no movie: ffmpeg ended with code %d: %s", code, said[-1000:])
        return False
    aside.replace(path)
    return True


def _command(program: str, width: int, height: int, fps: float, target: Path) -> list[str]:
    return [
        program, "-hide_banner", "-loglevel", "error", "-y",
        "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{fps:.6f}", "-i", "-",
        "-vf", "scale=out_color_matrix=bt709:out_range=tv", "-colorspace", "bt709", "-color_primaries", "bt709",
        "-color_trc", "iec61966-2-1", "-color_range", "tv",  # untagged, players guess the matrix by the size
        "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "18", "-movflags", "+faststart", "-f", "mp4", str(target),
    ]  # fmt: skip


def _feed(
    process: subprocess.Popen[bytes],
    first: NDArray[np.uint8],
    others: Iterable[NDArray[np.uint8]],
    size: tuple[int, int],
) -> None:
    """All pictures into the pipe; a program that takes none is ended after MAX_SECONDS, one that has ended is left."""
    assert process.stdin is not None
    timer = threading.Timer(MAX_SECONDS, process.kill)
    timer.start()
    height, width = size
    try:
        process.stdin.write(first[:height, :width].tobytes())
        for picture in others:
            process.stdin.write(picture[:height, :width].tobytes())
        process.stdin.close()
        process.wait()
    except BrokenPipeError:
        return
    except OSError:
        process.kill()
        raise
    finally:
        timer.cancel()
        with contextlib.suppress(OSError):
            process.stdin.close()
