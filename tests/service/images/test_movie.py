"""The movie: what ffmpeg is given, and that its absence or failure is no harm."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from penumbra_service.images import movie
from penumbra_service.images.movie import write_movie

PICTURES = [np.full((31, 41, 3), 20 * n, np.uint8) for n in range(5)]
STAND_IN = """#!{python}
import pathlib, sys, time
pathlib.Path(sys.argv[-1] + ".words").write_text("\\n".join(sys.argv[1:]))
{body}
"""


def stand_in(folder: Path, monkeypatch: pytest.MonkeyPatch, body: str) -> None:
    """A program that is found in the place of ffmpeg."""
    (folder / "bin").mkdir()
    program = folder / "bin" / "ffmpeg"
    program.write_text(STAND_IN.format(python=sys.executable, body=body))
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(folder / "bin"))


def test_raw_pixels_of_even_size_go_through_a_pipe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(tmp_path, monkeypatch, "pathlib.Path(sys.argv[-1]).write_bytes(sys.stdin.buffer.read())")
    path = tmp_path / "preview.mp4"
    assert write_movie(path, PICTURES, 23.976)
    sent = np.frombuffer(path.read_bytes(), np.uint8).reshape(5, 30, 40, 3)
    assert (sent == np.arange(0, 100, 20, dtype=np.uint8)[:, None, None, None]).all()
    words = (tmp_path / ".preview.mp4.part.words").read_text().split("\n")
    assert words[words.index("-s") + 1] == "40x30"
    assert float(words[words.index("-r") + 1]) == 23.976


@pytest.mark.parametrize("body", ["sys.exit('no such codec')", "sys.stdin.buffer.read(5); sys.exit(3)"])
def test_a_program_that_fails_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, body: str
) -> None:
    stand_in(tmp_path, monkeypatch, body)
    pictures = [np.zeros((512, 512, 3), np.uint8)] * 4
    assert not write_movie(tmp_path / "preview.mp4", pictures, 24.0)
    assert {file.name for file in tmp_path.iterdir()} <= {"bin", ".preview.mp4.part.words"}


def test_a_program_that_hangs_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(tmp_path, monkeypatch, "time.sleep(600)")
    monkeypatch.setattr(movie, "MAX_SECONDS", 0.5)
    assert not write_movie(tmp_path / "preview.mp4", PICTURES, 24.0)


def test_pictures_that_cannot_be_read_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(tmp_path, monkeypatch, "sys.stdin.buffer.read()")

    def pictures():  # type: ignore[no-untyped-def]
        yield PICTURES[0]
        raise OSError("a broken file")

    with pytest.raises(OSError, match="a broken file"):
        write_movie(tmp_path / "preview.mp4", pictures(), 24.0)


def test_without_the_program_there_is_no_movie(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert not write_movie(tmp_path / "preview.mp4", PICTURES, 24.0)
    assert list(tmp_path.iterdir()) == []


needs_ffmpeg = pytest.mark.skipif(
    shutil.which("ffmpeg") is None and os.environ.get("PENUMBRA_REQUIRE_TOOLS") != "1",
    reason="no ffmpeg (Debian: ffmpeg)",
)


def said(*words: str) -> bytes:
    return subprocess.run(words, capture_output=True, check=True).stdout


@needs_ffmpeg
def test_ffmpeg_makes_a_movie_of_all_frames(tmp_path: Path) -> None:
    path = tmp_path / "preview.mp4"
    assert write_movie(path, PICTURES, 25.0)
    entries = "stream=codec_name,width,height,pix_fmt,color_range,color_space,r_frame_rate,nb_read_frames"
    told = said(
        "ffprobe", "-v", "error", "-count_frames", "-show_entries", entries, "-of", "csv=p=0", str(path)
    )
    assert told.decode().strip() == "h264,40,30,yuv420p,tv,bt709,25/1,5"


@needs_ffmpeg
def test_a_movies_frames_have_the_pictures_colours_in_their_order(tmp_path: Path) -> None:
    colours = [(200, 40, 30), (30, 180, 60), (40, 50, 210), (128, 128, 128), (250, 240, 10), (0, 0, 0)]
    pictures = [np.full((48, 64, 3), colour, np.uint8) for colour in colours]
    path = tmp_path / "preview.mp4"
    assert write_movie(path, pictures, 24.0)
    raw = said("ffmpeg", "-v", "error", "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-")
    frames = np.frombuffer(raw, np.uint8).reshape(len(colours), 48, 64, 3).astype(int)
    # two roundings to 8 bits, in steps of up to 1 / 0.46 of a code value, and the coder's own at crf 18
    assert np.abs(frames.mean(axis=(1, 2)) - colours).max() <= 4
