"""What is removed, when, and what stays."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from penumbra_service.housekeeping import QUOTE_PREFIX, QUOTE_SECONDS, Housekeeper
from penumbra_service.settings import Settings
from penumbra_service.store.artifacts import Artifacts
from penumbra_service.store.assets import AssetStore, StoredAsset
from penumbra_service.store.content import NoSuchAssetError
from penumbra_service.store.contents import ContentStore, contents_url, digest_of
from penumbra_service.store.database import Database
from penumbra_service.store.jobs import NewJob, NoSuchJobError, SqlJobStore

NOW = datetime.now(UTC)


class House:
    """A service's stores."""

    def __init__(self, folder: Path, database_url: str) -> None:
        self.settings = Settings(
            data=folder,
            database_url=database_url,
            keep_days=10,
            keep_assets_days=20,
            keep_decoded_days=30,
            keep_contents_days=40,
        )
        self.database = Database(self.settings.database)
        self.database.migrate()
        self.jobs = SqlJobStore(self.database)
        self.artifacts = Artifacts(self.settings.artifacts)
        self.assets = AssetStore(self.database, self.settings.assets_folder, 1000)

    def keeper(self, **changes: float | str) -> Housekeeper:
        return Housekeeper(replace(self.settings, **changes), self.jobs, self.artifacts, self.assets)  # type: ignore[arg-type]

    def job(self, state: str, days: float, request: str = "{}") -> str:
        """A job that ended so long ago, with one file."""
        row, _ = self.jobs.create(NewJob(request, "d" * 64, "a"))
        self.jobs.move(row.id, ("queued",), state, finished=NOW - timedelta(days=days))
        source = self.settings.data / "source"
        source.write_bytes(b"x")
        self.artifacts.put(row.id, "frames/0001/result.exr", source)
        return row.id

    def asset(self, text: bytes, days: float) -> str:
        with self.assets.upload() as sink:
            sink.write(text)
            self.assets.place(sink)
            asset = StoredAsset(sink.sha256, len(text), "mesh", "obj", "", NOW - timedelta(days=days))
            self.assets.record(asset)
        return sink.sha256


@pytest.fixture
def house(tmp_path: Path, database_url: str) -> Iterator[House]:
    house = House(tmp_path, database_url)
    yield house
    house.database.close()


def test_ended_jobs_go_with_their_files_once_they_are_old(house: House) -> None:
    old = [house.job(state, 10.1) for state in ("done", "failed", "cancelled")]
    kept = [house.job("done", 9.9), house.job("rendering", 100), house.job("paused", 100)]
    assert house.keeper(keep_days=0.0).remove_jobs(NOW) == 0
    assert house.keeper().remove_jobs(NOW) == 3
    for job in old:
        with pytest.raises(NoSuchJobError):
            house.jobs.get(job)
        assert not house.artifacts.exists(job, "frames/0001/result.exr")
    for job in kept:
        assert house.artifacts.exists(job, "frames/0001/result.exr")


def test_assets_that_no_job_names_go_once_they_are_old(house: House) -> None:
    used, unused, young = house.asset(b"used", 21), house.asset(b"unused", 21), house.asset(b"young", 19)
    house.job("done", 1, f'{{"asset": "sha256:{used}"}}')
    assert house.keeper(keep_assets_days=0.0).remove_assets(NOW) == 0
    assert house.keeper().remove_assets(NOW) == 1
    house.assets.get(used)
    house.assets.get(young)
    with pytest.raises(NoSuchAssetError):
        house.assets.get(unused)


def test_decoded_copies_go_once_nobody_has_used_them_for_long(house: House) -> None:
    kind = house.settings.assets_folder / ".decoded" / "v1" / "mesh"
    for name, days in (("old", 31), ("new", 29)):
        (kind / name).mkdir(parents=True)
        (kind / name / "positions.npy").write_bytes(b"x")
        then = (NOW - timedelta(days=days)).timestamp()
        os.utime(kind / name, (then, then))
    assert house.keeper(keep_decoded_days=0.0).remove_decoded(NOW) == 0
    assert house.keeper().remove_decoded(NOW) == 1
    assert [path.name for path in kind.iterdir()] == ["new"]


def test_contents_that_no_worker_was_sent_for_go_and_results_stay(house: House) -> None:
    job = house.job("done", 0)
    contents = ContentStore(contents_url(house.settings.artifacts))
    source = house.settings.data / "source"
    contents.put(digest_of(source), source)
    (path,) = (Path(house.settings.artifacts) / "contents").rglob(digest_of(source))
    then = (NOW - timedelta(days=41)).timestamp()
    os.utime(path, (then, then))
    os.utime(Path(house.settings.artifacts) / job / "frames/0001/result.exr", (then, then))
    assert house.keeper(keep_contents_days=0.0).remove_contents(NOW) == 0
    assert house.keeper().remove_contents(NOW) == 1
    assert not path.exists()
    assert house.artifacts.exists(job, "frames/0001/result.exr")


def test_folders_of_jobs_that_ended_are_swept_and_those_of_open_ones_stay(house: House) -> None:
    done, paused = house.job("done", 0), house.job("paused", 0)
    for name in (done, paused, "nobody"):
        (house.settings.work_folder / name / "tiles").mkdir(parents=True)
    house.keeper().sweep_leftovers()
    assert [path.name for path in house.settings.work_folder.iterdir()] == [paused]


def test_a_quote_that_a_service_beside_this_one_makes_keeps_its_folder(house: House) -> None:
    """Services that share a database may share their folders; what one of them left long ago goes."""
    work = house.settings.work_folder
    old, new = work / f"{QUOTE_PREFIX}old", work / f"{QUOTE_PREFIX}new"
    for folder in (old, new):
        folder.mkdir(parents=True)
    then = time.time() - QUOTE_SECONDS - 1
    os.utime(old, (then, then))
    house.keeper(database_url="postgresql://elsewhere/penumbra").sweep_leftovers()
    assert [path.name for path in work.iterdir()] == [new.name]
    house.keeper(database_url="").sweep_leftovers()
    assert not list(work.iterdir())
