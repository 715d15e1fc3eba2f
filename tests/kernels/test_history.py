"""What programs cost on a device: kept for the next process, the newest numbers only, and a broken file is an empty one."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from penumbra_kernels.choice import GAIN, build_seconds
from penumbra_kernels.device import DeviceInfo
from penumbra_kernels.history import KEPT, History, Past

INFO = DeviceInfo("fake:0", "Fake", "Fake", "1.0", "driver 1", "cpu", 2, 1, 1)


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache."""
    monkeypatch.setenv("PENUMBRA_CACHE", str(tmp_path))
    return tmp_path


def test_the_next_process_knows_what_this_one_has_seen(own: Path) -> None:
    history = History(INFO)
    assert history.read() == Past()
    assert (history.read().gain, history.read().rate) == (GAIN, None)
    history.add_build(2500, 4.0)
    for gain in (1.1, 3.0, 1.2):
        history.add_gain(gain)
    history.add_rate(2e6)
    past = History(INFO).read()
    assert (past.gain, past.rate) == (1.2, 2e6)
    for program, seconds in (("a", 1.0), ("b", 2.0), ("a", 3.0)):
        history.add_spent(program, seconds)
    assert [History(INFO).read().spent_for(program) for program in "abc"] == [4.0, 2.0, 0.0]
    assert past.build_seconds(2500, "cpu") == pytest.approx(4.0) != build_seconds(2500, "cpu", ())


def test_another_driver_is_another_device(own: Path) -> None:
    History(INFO).add_build(2500, 4.0)
    assert History(replace(INFO, driver="driver 2")).read() == Past()


def test_only_the_newest_are_kept(own: Path) -> None:
    history = History(INFO)
    for number in range(KEPT + 3):
        history.add_build(100 + number, 1.0)
        history.add_spent(str(number), 1.0)
    history.add_spent("3", 1.0)
    assert [lines for lines, _ in history.read().builds] == list(range(103, 103 + KEPT))
    assert [name for name, _ in history.read().spent] == [*map(str, range(4, 3 + KEPT)), "3"]


def test_a_folder_in_the_files_place_is_replaced(own: Path) -> None:
    history = History(INFO)
    history.add_rate(1.0)
    (file,) = (own / "history").iterdir()
    file.unlink()
    (file / "more").mkdir(parents=True)
    assert history.read() == Past()
    history.add_gain(1.5)
    assert history.read().gains == (1.5,)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "{}",
        '{"builds": 3, "gains": [], "rates": [], "spent": []}',
        '{"builds": [[1]], "gains": [], "rates": [], "spent": []}',
        '{"builds": [], "gains": [NaN], "rates": [], "spent": []}',
        '{"builds": [[9, 0]], "gains": [], "rates": [], "spent": []}',
        '{"builds": [], "gains": ["fast"], "rates": [], "spent": []}',
    ],
)
def test_a_broken_file_is_an_empty_one(own: Path, text: str) -> None:
    history = History(INFO)
    history.add_rate(1.0)
    (file,) = (own / "history").iterdir()
    file.write_text(text)
    assert history.read() == Past()
    history.add_gain(1.5)
    assert json.loads(file.read_text())["gains"] == [1.5]


def test_a_folder_that_cannot_be_written_costs_memory_of_the_past_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("PENUMBRA_CACHE", str(tmp_path / "file"))
    history = History(INFO)
    history.add_gain(1.5)
    assert history.read() == Past()
