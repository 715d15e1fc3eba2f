"""Artifacts and assets: one body of tests for every file system."""

from __future__ import annotations

import hashlib
import os
import time
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from penumbra_service.store import contents as module
from penumbra_service.store.artifacts import Artifacts, NoSuchArtifactError
from penumbra_service.store.assets import AssetDigestError, AssetStore, AssetTooLargeError, StoredAsset
from penumbra_service.store.content import NoSuchAssetError, asset_file
from penumbra_service.store.contents import ContentStore
from penumbra_service.store.database import Database


def after_all() -> datetime:
    """When all that there is now is old."""
    return datetime.now(UTC) + timedelta(days=1)


@pytest.fixture
def artifacts(files_url: str) -> Artifacts:
    return Artifacts(files_url)


def test_artifacts_are_stored_replaced_and_removed(artifacts: Artifacts, tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.write_bytes(b"one" * 1_000_000)
    with pytest.raises(NoSuchArtifactError):
        artifacts.info("job", "result.exr")
    artifacts.put("job", "result.exr", source)
    info = artifacts.info("job", "result.exr")
    assert info.size == 3_000_000
    assert b"".join(artifacts.read("job", "result.exr")) == source.read_bytes()
    local = artifacts.local_path("job", "result.exr")
    assert local is None or local.read_bytes() == source.read_bytes()
    source.write_bytes(b"two")
    artifacts.put("job", "result.exr", source)
    assert artifacts.info("job", "result.exr").etag != info.etag
    assert b"".join(artifacts.read("job", "result.exr")) == b"two"
    assert source.is_file()
    artifacts.remove("job")
    artifacts.remove("job")
    with pytest.raises(NoSuchArtifactError):
        b"".join(artifacts.read("job", "result.exr"))
    assert not artifacts.exists("job", "result.exr")


def test_artifacts_may_lie_in_folders_of_their_job(artifacts: Artifacts, tmp_path: Path) -> None:
    source = tmp_path / "source"
    for frame in ("0001", "0002"):
        source.write_text(frame)
        artifacts.put("job", f"frames/{frame}/result.exr", source)
    assert b"".join(artifacts.read("job", "frames/0001/result.exr")) == b"0001"
    with pytest.raises(NoSuchArtifactError):
        artifacts.put("a/b", "result.exr", source)
    artifacts.remove("job")
    assert not artifacts.exists("job", "frames/0002/result.exr")


def test_what_another_process_stores_is_seen_at_once(s3_url: str, tmp_path: Path) -> None:
    source = tmp_path / "source"
    one, other = Artifacts(s3_url), Artifacts(s3_url)
    for text in (b"first", b"second"):
        assert not other.exists("job", f"{text.decode()}.png")
        source.write_bytes(text)
        one.put("job", f"{text.decode()}.png", source)
        assert b"".join(other.read("job", f"{text.decode()}.png")) == text
    assert other.local_path("job", "first.png") is None


@pytest.mark.parametrize(
    "name", ["", ".", "..", "../x", "a//b", "a/../b", "a/", "/etc/passwd", ".hidden", "a\0b", "x" * 101]
)
def test_names_cannot_leave_the_folder(artifacts: Artifacts, name: str, tmp_path: Path) -> None:
    (tmp_path / "source").write_bytes(b"x")
    for job_id, artifact in (("job", name), (name, "result.exr")):
        with pytest.raises(NoSuchArtifactError):
            artifacts.put(job_id, artifact, tmp_path / "source")
        with pytest.raises(NoSuchArtifactError):
            artifacts.info(job_id, artifact)


@pytest.fixture
def contents(files_url: str) -> ContentStore:
    return ContentStore(files_url)


def put(contents: ContentStore, folder: Path, data: bytes) -> str:
    source = folder / "source"
    source.write_bytes(data)
    digest = hashlib.sha256(data).hexdigest()
    contents.put(digest, source)
    return digest


def has(contents: ContentStore, digest: str, folder: Path) -> bool:
    try:
        contents.fetch(digest, folder)
    except FileNotFoundError:
        return False
    return True


def test_contents_go_once_nobody_has_put_them_for_long(
    contents: ContentStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert contents.remove_unused(after_all()) == 0  # there is nothing yet
    used, unused = put(contents, tmp_path, b"used"), put(contents, tmp_path, b"unused")
    assert contents.remove_unused(datetime.now(UTC) - timedelta(seconds=5)) == 0
    time.sleep(1.1)  # a store of objects tells times in whole seconds
    between = datetime.now(UTC)
    put(contents, tmp_path, b"used")  # used a moment ago anyway
    with monkeypatch.context() as patch:
        patch.setattr(module, "RENEW", timedelta(0))
        time.sleep(1.1)
        put(contents, tmp_path, b"used")
    assert contents.remove_unused(between) == 1
    assert has(contents, used, tmp_path / "one")
    assert not has(contents, unused, tmp_path / "one")
    assert put(contents, tmp_path, b"unused") == unused
    assert has(contents, unused, tmp_path / "two")


def test_a_folder_in_the_place_of_what_is_fetched_is_replaced(contents: ContentStore, tmp_path: Path) -> None:
    digest = put(contents, tmp_path, b"data")
    (asset_file(tmp_path / "fetched", digest) / "more").mkdir(parents=True)
    assert contents.fetch(digest, tmp_path / "fetched").read_bytes() == b"data"


def test_what_is_put_while_others_are_removed_stays(
    contents: ContentStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    digest = put(contents, tmp_path, b"data")
    listed = [(path, datetime.now(UTC) - timedelta(days=40)) for path, _ in contents._files.find()]
    monkeypatch.setattr(contents._files, "find", lambda: iter(listed))  # as it was before the put
    assert contents.remove_unused(datetime.now(UTC) - timedelta(days=30)) == 0
    assert has(contents, digest, tmp_path / "copy")


def test_services_that_put_and_remove_at_once_harm_nobody(contents: ContentStore, tmp_path: Path) -> None:
    data = [bytes([n]) * 100_000 for n in range(8)]

    def use(n: int) -> None:
        folder = tmp_path / str(n)
        folder.mkdir()
        for _ in range(6):
            put(contents, folder, data[n % 8])

    def clean() -> None:
        for _ in range(6):
            contents.remove_unused(after_all())

    with ThreadPoolExecutor(12) as pool:
        done = [pool.submit(use, n) for n in range(10)] + [pool.submit(clean) for _ in range(2)]
    assert [future.result() for future in done] == [None] * 12  # nobody met an error
    digests = [put(contents, tmp_path, part) for part in data]
    assert all(has(contents, digest, tmp_path / "copies") for digest in digests)  # whole: digests are checked


def test_an_upload_that_is_under_way_stays_and_one_that_died_goes(tmp_path: Path) -> None:
    contents = ContentStore(str(tmp_path / "store"))
    put(contents, tmp_path, b"data")
    dead, alive = tmp_path / "store" / "ab" / "x.part", tmp_path / "store" / "ab" / "y.part"
    dead.parent.mkdir()
    dead.write_bytes(b"")
    alive.write_bytes(b"")
    days = 86400.0
    os.utime(dead, (time.time() - 31 * days,) * 2)
    assert contents.remove_unused(datetime.now(UTC) - timedelta(days=30)) == 1
    assert not dead.exists()
    assert alive.exists()


def test_a_source_that_fails_leaves_nothing_half_written(artifacts: Artifacts, tmp_path: Path) -> None:
    with pytest.raises(IsADirectoryError):
        artifacts.put("job", "result.exr", tmp_path)
    assert not artifacts.exists("job", "result.exr")
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


@pytest.fixture
def assets(database: Database, tmp_path: Path) -> AssetStore:
    return AssetStore(database, tmp_path / "assets", 100)


def upload(assets: AssetStore, *chunks: bytes, expected: str | None = None) -> tuple[StoredAsset, bool]:
    with assets.upload() as sink:
        for chunk in chunks:
            sink.write(chunk)
        assets.place(sink, expected)
        return assets.record(StoredAsset(sink.sha256, sink.size, "mesh", "obj", "1 triangle"))


def leftovers(assets: AssetStore) -> list[str]:
    return [path.name for path in assets.folder.iterdir() if path.is_file()]


def test_an_asset_is_named_by_its_content_and_kept_once(assets: AssetStore) -> None:
    digest = hashlib.sha256(b"hello world").hexdigest()
    stored, new = upload(assets, b"hello ", b"world", expected=digest)
    assert (stored.sha256, stored.bytes, new) == (digest, 11, True)
    again, repeated = upload(assets, b"hello world")
    assert (again, repeated) == (stored, False)
    assert assets.get(digest) == stored
    assert assets.path(digest).read_bytes() == b"hello world"
    assert leftovers(assets) == []


def test_too_much_and_wrong_bytes_leave_nothing(assets: AssetStore) -> None:
    with assets.upload() as sink:
        sink.write(b"x" * 60)
        with pytest.raises(AssetTooLargeError):
            sink.write(b"x" * 60)
    with pytest.raises(AssetDigestError):
        upload(assets, b"abc", expected="0" * 64)
    assert leftovers(assets) == []
    with pytest.raises(NoSuchAssetError):
        assets.get(hashlib.sha256(b"abc").hexdigest())


def test_a_broken_asset_is_discarded_but_a_recorded_one_stays(assets: AssetStore) -> None:
    with assets.upload() as sink:
        sink.write(b"broken")
        assert assets.place(sink)
    assets.discard(sink.sha256)
    assert not asset_file(assets.folder, sink.sha256).exists()
    stored, _ = upload(assets, b"good")
    assets.discard(stored.sha256)
    assert assets.get(stored.sha256) == stored


@pytest.mark.parametrize("digest", ["", "\0" * 64, "0" * 63, "0" * 65, "../" + "0" * 61, "A" * 64, "g" * 64])
def test_what_is_no_digest_names_no_file(assets: AssetStore, digest: str) -> None:
    with pytest.raises(NoSuchAssetError):
        assets.path(digest)
    with pytest.raises(NoSuchAssetError):
        asset_file(assets.folder, digest)


def test_assets_are_removed_and_uploads_that_stopped_are_swept(assets: AssetStore) -> None:
    stored, _ = upload(assets, b"abc")
    assert [asset.sha256 for asset in assets.before(datetime.now(UTC) + timedelta(seconds=1))] == [
        stored.sha256
    ]
    assert assets.before(stored.created) == []
    assets.remove(stored.sha256)
    with pytest.raises(NoSuchAssetError):
        assets.get(stored.sha256)
    assert not asset_file(assets.folder, stored.sha256).exists()
    (assets.folder / ".upload-x").write_bytes(b"")
    assets.sweep(3600)
    assert leftovers(assets) == [".upload-x"]
    assets.sweep()
    assert leftovers(assets) == []
