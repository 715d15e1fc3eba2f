"""The EXR: what is written is what other programs read."""

from __future__ import annotations

import errno
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest
from numpy.typing import NDArray
from penumbra_kernels.nodes import Tile
from penumbra_service.images.exr import COUNTS_PART, PICTURE_PART, ExrLayout, write_exr

OpenEXR = pytest.importorskip("OpenEXR")

FLOATS = ("R", "G", "B", "A", "Variance.R", "StdErr.R", "Albedo.R", "N.X", "Z")
INTEGERS = ("SampleCount", "InvalidCount", "Flags", "ID")
WINDOW = Tile(10, 20, 70, 45)


@dataclass(frozen=True)
class Piece:
    tile: Tile
    floats: dict[str, NDArray[np.float32]]
    integers: dict[str, NDArray[np.uint32]]


def layout(half: bool = False) -> ExrLayout:
    attributes = {"penumbra:seed": "18446744073709551615", "penumbra:seconds": 1.25, "penumbra:replicates": 8}
    return ExrLayout(WINDOW, 200, 100, FLOATS, INTEGERS, half, attributes)


@pytest.fixture
def whole() -> Piece:
    random = np.random.default_rng(1)
    shape = (WINDOW.height, WINDOW.width)
    floats = {name: random.lognormal(0, 4, shape).astype(np.float32) for name in FLOATS}
    floats["Variance.R"][3, 4] = np.nan
    integers = {name: random.integers(0, 2**32, shape, np.uint32) for name in INTEGERS}
    integers["SampleCount"][0, 0] = 2**24 + 1  # which no float32 holds
    return Piece(WINDOW, floats, integers)


def bands(whole: Piece, rows: int) -> Iterator[Piece]:
    for y in range(0, WINDOW.height, rows):
        n = min(rows, WINDOW.height - y)
        tile = Tile(WINDOW.x, WINDOW.y + y, WINDOW.width, n)
        yield Piece(
            tile,
            {k: v[y : y + n] for k, v in whole.floats.items()},
            {k: v[y : y + n] for k, v in whole.integers.items()},
        )


@pytest.mark.parametrize("rows", [7, 16, 45])
def test_another_reader_finds_every_bit(tmp_path: Path, whole: Piece, rows: int) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, layout(), bands(whole, rows))
    file = OpenEXR.File(str(path), separate_channels=True)
    picture, counts = file.parts
    assert (picture.name(), counts.name()) == (PICTURE_PART, COUNTS_PART)
    assert set(picture.channels) == set(FLOATS)
    for name in FLOATS:
        pixels = picture.channels[name].pixels
        assert pixels.dtype == np.float32
        np.testing.assert_array_equal(pixels.view(np.uint32), whole.floats[name].view(np.uint32))
    assert set(counts.channels) == set(INTEGERS)
    for name in INTEGERS:
        assert counts.channels[name].pixels.dtype == np.uint32
        np.testing.assert_array_equal(counts.channels[name].pixels, whole.integers[name])


def test_the_crop_is_the_data_window_in_the_full_frame(tmp_path: Path, whole: Piece) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, layout(), bands(whole, 16))
    for part in OpenEXR.File(str(path), separate_channels=True).parts:
        low, high = part.header["dataWindow"]
        assert (list(low), list(high)) == ([10, 20], [79, 64])
        low, high = part.header["displayWindow"]
        assert (list(low), list(high)) == ([0, 0], [199, 99])


def test_attributes_are_kept_with_their_types(tmp_path: Path, whole: Piece) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, layout(), bands(whole, 16))
    for part in OpenEXR.File(str(path), separate_channels=True).parts:
        assert part.header["penumbra:seed"] == "18446744073709551615"
        assert part.header["penumbra:seconds"] == 1.25
        assert part.header["penumbra:replicates"] == 8
    reader = oiio.ImageInput.open(str(path))
    assert reader.spec().getattribute("penumbra:seed") == "18446744073709551615"
    reader.close()


def test_half_is_for_the_picture_alone(tmp_path: Path, whole: Piece) -> None:
    path = tmp_path / "a.exr"
    whole.floats["G"][1, 2] = 1e6
    write_exr(path, layout(half=True), bands(whole, 16))
    channels = OpenEXR.File(str(path), separate_channels=True).parts[0].channels
    for name in FLOATS:
        pixels = channels[name].pixels
        if name in "RGBA":
            assert pixels.dtype == np.float16
            expected = np.clip(whole.floats[name], -65504, 65504).astype(np.float16)
            np.testing.assert_array_equal(pixels, expected)
        else:
            assert pixels.dtype == np.float32
            np.testing.assert_array_equal(pixels, whole.floats[name])
    assert channels["G"].pixels[1, 2] == 65504


def test_missing_scanlines_leave_no_file(tmp_path: Path, whole: Piece) -> None:
    path = tmp_path / "a.exr"
    short = list(bands(whole, 16))[:-1]
    with pytest.raises(ValueError, match="end at row"):
        write_exr(path, layout(), short)
    with pytest.raises(ValueError, match="whole scanlines"):
        write_exr(path, layout(), short[1:])
    assert list(tmp_path.iterdir()) == []


def test_a_failed_attempt_leaves_the_old_file(tmp_path: Path, whole: Piece) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, layout(), bands(whole, 16))
    before = path.read_bytes()
    with pytest.raises(ValueError, match="end at row"):
        write_exr(path, layout(), [])
    assert path.read_bytes() == before


def test_a_full_disk_is_named_and_never_leaves_half_a_file(
    whole: Piece, mount_disk: Callable[[int], Path]
) -> None:
    """OpenImageIO drops what its last buffer holds, and calls the file written."""
    disk, page = mount_disk(1 << 20), 4096
    write_exr(disk / "whole.exr", layout(), bands(whole, 16))
    data = (disk / "whole.exr").read_bytes()
    (disk / "whole.exr").unlink()
    written = 0
    for pages in range(0, len(data) // page + 48):
        (disk / "ballast").write_bytes(bytes((1 << 20) - pages * page))
        failed = None
        try:
            write_exr(disk / "a.exr", layout(), bands(whole, 16))
        except OSError as error:
            failed = error.errno
        if failed is None:
            written += 1
            assert (disk / "a.exr").read_bytes()[-page:] == data[-page:]  # its head has the time
            (disk / "a.exr").unlink()
        assert failed in (None, errno.ENOSPC)
        assert not (disk / "a.exr").exists()
    assert written > 0


def test_integers_that_do_not_fit_are_refused(tmp_path: Path, whole: Piece) -> None:
    wrong = ExrLayout(WINDOW, 200, 100, FLOATS, INTEGERS, False, {"seed": 2**63})
    with pytest.raises(ValueError, match="string"):
        write_exr(tmp_path / "a.exr", wrong, bands(whole, 16))


FOUR_K = """
import resource, sys
import numpy as np
from pathlib import Path
from penumbra_kernels.nodes import Tile
from penumbra_service.images.exr import ExrLayout, write_exr
sys.path.insert(0, sys.argv[2])
from test_exr import FLOATS, INTEGERS, Piece

def bands():
    for y in range(0, 2160, 64):
        n = min(64, 2160 - y)
        yield Piece(Tile(0, y, 3840, n), {k: np.ones((n, 3840), np.float32) for k in FLOATS},
                    {k: np.ones((n, 3840), np.uint32) for k in INTEGERS})

before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
write_exr(Path(sys.argv[1]), ExrLayout(Tile(0, 0, 3840, 2160), 3840, 2160, FLOATS, INTEGERS), bands())
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) >> 10)
"""


def test_a_4k_frame_takes_little_memory(tmp_path: Path) -> None:
    """The channels alone would be 430 MB."""
    here = str(Path(__file__).parent)
    command = [sys.executable, "-c", FOUR_K, str(tmp_path / "a.exr"), here]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert int(done.stdout) < 200
