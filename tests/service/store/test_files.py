"""Artifacts and assets: one body of tests for every file system."""

from __future__ import annotations

import hashlib
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from penumbra_service.store.artifacts import Artifacts, NoSuchArtifactError
from penumbra_service.store.assets import AssetDigestError, AssetStore, AssetTooLargeError, StoredAsset
from penumbra_service.store.content import NoSuchAssetError, asset_file
from penumbra_service.store.database import Database
from penumbra_service.store.ids import new_id


@pytest.fixture(params=["folder", "memory", "s3"])
def artifacts(request: pytest.FixtureRequest, tmp_path: Path) -> Artifacts:
    if request.param == "s3":
        return Artifacts(request.getfixturevalue("s3_url"))
    return Artifacts(str(tmp_path / "results") if request.param == "folder" else f"memory://{new_id()}")


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


@pytest.mark.parametrize("digest", ["", "0" * 63, "0" * 65, "../" + "0" * 61, "A" * 64, "g" * 64])
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
