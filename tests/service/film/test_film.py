"""The film: bits that do not depend on tiles, order, memory or restarts; broken files only cost their
tile."""

from __future__ import annotations

import numpy as np
import pytest
from penumbra_kernels.nodes import Tile, aligned_ranges
from penumbra_service.film.develop import develop, develop_bands, float_channels, integer_channels
from penumbra_service.film.error import image_error, summarize
from penumbra_service.film.film import Film
from penumbra_service.film.grid import TileGrid
from penumbra_service.film.tilefile import FolderTileStore, MemoryTileStore, tile_name

WINDOW = Tile(5, 3, 70, 50)
END = 6


def _film(tile_size=32, store=None, window=WINDOW, **more):  # type: ignore[no-untyped-def]
    return Film(TileGrid(window, tile_size), 4, store or MemoryTileStore(), "key", **more)


def _fill(film, made, seed=0, end=END):  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(seed)
    work = [(tile, r) for tile in film.tiles for r in aligned_ranges(0, end)]
    for i in rng.permutation(len(work)):
        tile, (first, count) = work[i]
        film.add(made.node(tile, first, count))


def _picture(film, end=END):  # type: ignore[no-untyped-def]
    window = film.grid.window
    names = [*float_channels(), *integer_channels()]
    picture = {n: np.zeros((window.height, window.width), np.float32) for n in names}
    for part in develop(film, end):
        t = part.tile
        for name, values in (part.floats | part.integers).items():
            at = np.s_[t.y - window.y : t.y - window.y + t.height, t.x - window.x : t.x - window.x + t.width]
            picture[name][at] = values
    return b"".join(picture[name].tobytes() for name in names)


def test_tiles_cover_the_window_once_and_align_with_the_frame():
    for size in (16, 32, 64):
        grid = TileGrid(WINDOW, size)
        seen = np.zeros((WINDOW.height, WINDOW.width), int)
        for tile in grid:
            x, y = tile.x - WINDOW.x, tile.y - WINDOW.y
            seen[y : y + tile.height, x : x + tile.width] += 1
            assert tile.x % size == 0 or tile.x == WINDOW.x
            assert tile.y % size == 0 or tile.y == WINDOW.y
        assert (seen == 1).all()
        assert len(list(grid)) == len(grid)


def test_every_channel_is_bit_equal_for_any_tile_size_and_order(samples):  # type: ignore[no-untyped-def]
    made = samples(replicates=4)
    pictures = set()
    errors = set()
    for size, seed in ((16, 0), (32, 1), (64, 2), (128, 3)):
        film = _film(size)
        _fill(film, made, seed)
        pictures.add(_picture(film))

        errors.add(image_error([summarize(film.pixels(t, END)) for t in film.tiles]))
    assert len(pictures) == 1
    assert len(errors) == 1


def test_looks_are_equal_whatever_was_looked_at_before(samples):  # type: ignore[no-untyped-def]
    """They share one room for their arrays. Of alpha they have no variance."""
    film = _film(32)
    _fill(film, samples(replicates=4), 0)
    for tile in (*film.tiles, *reversed(film.tiles)):
        pixels, summary = film.look(tile, END)
        alone = film.pixels(tile, END)
        for name in ("mean", "taken", "largest_share", "calm"):
            assert getattr(pixels, name).tobytes() == getattr(alone, name).tobytes()
        assert pixels.variance.tobytes() == alone.variance[..., :3].tobytes()
        assert image_error([summary]) == image_error([summarize(alone)])


def test_what_tiles_depend_on_is_written_before_each_of_them(samples):  # type: ignore[no-untyped-def]
    store, order = MemoryTileStore(), []
    film = Film(TileGrid(WINDOW, 32), 4, store, "key", before_write=lambda: order.append(len(store.files)))
    _fill(film, samples(replicates=4), 0)
    assert order == []
    film.flush()
    assert order == list(range(len(film.tiles)))


def test_a_crop_has_the_bits_of_the_full_frame(samples):  # type: ignore[no-untyped-def]
    made = samples(replicates=4)
    full, crop = _film(window=Tile(0, 0, 96, 64)), _film(window=Tile(32, 16, 32, 24))
    _fill(full, made)
    _fill(crop, made)
    big = np.concatenate([b.floats["Variance.G"] for b in develop_bands(full, END)])
    small = np.concatenate([b.floats["Variance.G"] for b in develop_bands(crop, END)])
    assert np.array_equal(big[16:40, 32:64], small)


def test_bands_are_the_tiles_put_together(samples):  # type: ignore[no-untyped-def]
    made = samples(replicates=4)
    film = _film()
    _fill(film, made)
    bands = list(develop_bands(film, END))
    assert [b.tile.y for b in bands] == [3, 32]
    assert sum(b.tile.height for b in bands) == WINDOW.height
    for part in develop(film, END):
        band = next(b for b in bands if b.tile.y == part.tile.y)
        x = part.tile.x - WINDOW.x
        assert np.array_equal(band.floats["R"][:, x : x + part.tile.width], part.floats["R"])


def test_memory_stays_within_its_limit_and_bits_do_not_change(samples, tmp_path):  # type: ignore[no-untyped-def]
    made = samples(replicates=4)
    plain = _film()
    _fill(plain, made)
    limit = 4 * 32 * 32 * 32 * 3
    small = _film(store=FolderTileStore(tmp_path), memory_limit=limit)
    rng = np.random.default_rng(5)
    work = [(tile, r) for tile in small.tiles for r in aligned_ranges(0, END)]
    for i in rng.permutation(len(work)):
        tile, (first, count) = work[i]
        small.add(made.node(tile, first, count))
        assert small.resident_bytes <= limit
        assert small.resident_bytes == sum(a.nbytes for a in small._resident.values())
    assert _picture(small) == _picture(plain)


def test_a_restart_from_a_snapshot_goes_on_with_the_same_bits(samples, tmp_path):  # type: ignore[no-untyped-def]
    made = samples(replicates=4)
    plain = _film()
    _fill(plain, made)
    film = _film(store=FolderTileStore(tmp_path))
    for tile in film.tiles[::2]:
        film.add(made.node(tile, 0, 4))
    assert film.flush() == len(film.tiles[::2])
    assert film.flush() == 0
    film.add(made.node(film.tiles[1], 0, 4))  # lost: it came after the snapshot
    again = _film(store=FolderTileStore(tmp_path))
    again.restore(())
    assert again.missing(again.tiles[0], 0, END) == [(4, 2)]
    assert again.missing(again.tiles[1], 0, END) == [(0, 4), (4, 2)]
    for tile in again.tiles:
        for first, count in again.missing(tile, 0, END):
            again.add(made.node(tile, first, count))
    assert _picture(again) == _picture(plain)


@pytest.mark.parametrize("damage", ["cut", "flip", "empty", "other key", "garbage"])
def test_a_broken_file_only_restarts_its_tile(samples, tmp_path, damage):  # type: ignore[no-untyped-def]
    made = samples(replicates=4)
    film = _film(store=FolderTileStore(tmp_path))
    _fill(film, made)
    film.flush()
    path = tmp_path / tile_name(film.tiles[0])
    data = path.read_bytes()
    path.write_bytes(
        {
            "cut": data[: len(data) // 2],
            "flip": data[:900] + bytes([data[900] ^ 1]) + data[901:],
            "empty": b"",
            "other key": data.replace(b'"key": "key"', b'"key": "kex"'),
            "garbage": b"\x00" * 100,
        }[damage]
    )
    again = _film(store=FolderTileStore(tmp_path))
    again.restore(())
    assert again.missing(again.tiles[0], 0, END) == [(0, 4), (4, 2)]
    assert all(again.complete(tile, END) for tile in again.tiles[1:])


def test_a_file_that_breaks_while_evicted_is_reported_as_lost(samples, tmp_path):  # type: ignore[no-untyped-def]
    made = samples(replicates=4)
    film = _film(store=FolderTileStore(tmp_path), memory_limit=1)
    first, second = film.tiles[:2]
    film.add(made.node(first, 0, 4))
    film.add(made.node(second, 0, 4))
    (tmp_path / tile_name(first)).write_bytes(b"broken")
    film.add(made.node(first, 4, 2))
    assert film.take_lost() == {first: "its file is broken"}
    assert film.take_lost() == {}
    assert film.missing(first, 0, END) == [(0, 4)]


def test_a_file_that_somebody_removed_is_called_gone(samples, tmp_path):  # type: ignore[no-untyped-def]
    made = samples(replicates=4)
    film = _film(store=FolderTileStore(tmp_path), memory_limit=1)
    first, second = film.tiles[:2]
    film.add(made.node(first, 0, 4))
    film.add(made.node(second, 0, 4))
    (tmp_path / tile_name(first)).unlink()
    film.add(made.node(first, 4, 2))
    assert film.take_lost() == {first: "its file is gone"}


def test_a_snapshot_that_reaches_across_an_undecided_check_is_not_used(samples, tmp_path):  # type: ignore[no-untyped-def]
    made = samples(replicates=4)
    film = _film(store=FolderTileStore(tmp_path))
    film.set_barriers((6,))
    for index in range(8):
        film.add(made.node(film.tiles[0], index, 1))
    film.set_barriers((8,))
    film.accumulator(film.tiles[0])
    film.flush()
    again = _film(store=FolderTileStore(tmp_path))
    again.restore((6,))
    assert again.missing(again.tiles[0], 0, 8) == [(0, 8)]


def test_missing_names_the_gaps():
    film = _film()
    film._ranges[film.tiles[0]] = [(2, 2), (8, 4)]
    assert film.missing(film.tiles[0], 0, 14) == [(0, 2), (4, 4), (12, 2)]
    assert film.missing(film.tiles[0], 2, 4) == []


def test_a_film_takes_the_same_memory_however_many_samples_it_has(samples):  # type: ignore[no-untyped-def]
    """Its nodes merge: beyond the float32 sums of 256 samples nothing grows."""
    made = samples(replicates=4)
    sizes = []
    for end in (1024, 4096, 65536):
        film = _film(32, window=Tile(0, 0, 32, 32))
        film.set_barriers((end,))
        for first in range(0, end, end // 16):
            film.add(made.node(film.tiles[0], first, end // 16))
        sizes.append(film.resident_bytes)
    assert len(set(sizes)) == 1
