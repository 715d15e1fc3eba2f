"""What a farm stands on: certificates, addresses that may be used, files by content."""

from __future__ import annotations

import asyncio
import hashlib
import os
import socket
import ssl
import stat
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import dask
import pytest
from penumbra_kernels.cache import CacheError
from penumbra_service.engine.dask import publisher as publishing
from penumbra_service.engine.dask.addresses import check_scheduler, security
from penumbra_service.engine.dask.certs import ROLES, CertsExistError, make_certs
from penumbra_service.engine.dask.config import QUIET, environment
from penumbra_service.engine.dask.publisher import Publisher
from penumbra_service.engine.dask.remote import PINGS, QUIET_SECONDS, RemoteDevice
from penumbra_service.engine.dask.scheduler import SchedulerOptions, serve_scheduler
from penumbra_service.engine.dask.supervisor import WorkerOptions, supervise
from penumbra_service.engine.dask.wire import NotPortableError, publish
from penumbra_service.engine.local import NoDeviceError
from penumbra_service.engine.protocol import DeviceDescription, RenderSpec
from penumbra_service.settings import SettingsError
from penumbra_service.store.content import NoSuchAssetError, asset_file
from penumbra_service.store.contents import BrokenContentError, ContentStore, trim


@pytest.fixture(scope="module")
def certs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("farm") / "certs"
    make_certs(folder)
    return folder


def test_certificates_are_readable_by_their_owner_only(certs):  # type: ignore[no-untyped-def]
    names = {"ca.pem", "ca-key.pem", *(f"{role}{end}.pem" for role in ROLES for end in ("", "-key"))}
    assert {path.name for path in certs.iterdir()} == names
    assert all(stat.S_IMODE(path.stat().st_mode) == 0o600 for path in certs.iterdir())
    with pytest.raises(CertsExistError, match="has certificates already"):
        make_certs(certs)


def _handshake(server: ssl.SSLContext, client: ssl.SSLContext) -> bytes:
    """What the client reads after a TLS handshake over a socket pair."""
    left, right = socket.socketpair()

    def serve() -> None:
        try:
            with server.wrap_socket(left, server_side=True) as tls:
                tls.sendall(b"let in")
        except (OSError, ssl.SSLError):
            left.close()

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        with client.wrap_socket(right) as tls:
            return tls.recv(6)
    finally:
        right.close()
        thread.join()


def test_whoever_shows_a_certificate_of_the_farm_is_let_in_and_nobody_else(certs, tmp_path):  # type: ignore[no-untyped-def]
    make_certs(tmp_path / "others")
    server = security(certs, "scheduler").get_listen_args("scheduler")["ssl_context"]
    assert (
        _handshake(server, security(certs, "worker").get_connection_args("worker")["ssl_context"])
        == b"let in"
    )
    strangers = security(tmp_path / "others", "client").get_connection_args("client")["ssl_context"]
    with pytest.raises((ssl.SSLError, OSError)):
        _handshake(server, strangers)
    bare = ssl.create_default_context(cafile=str(certs / "ca.pem"))
    bare.check_hostname = False
    with pytest.raises((ssl.SSLError, OSError)):
        assert _handshake(server, bare) == b"let in"


@pytest.mark.parametrize("url", ["tcp://127.0.0.1:8786", "tcp://localhost:1", "tcp://[::1]:8786"])
def test_plain_tcp_is_accepted_on_this_machine(url):  # type: ignore[no-untyped-def]
    assert check_scheduler(url, None) == url


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("tcp://farm:8786", "plain TCP lets whoever reaches the scheduler run code"),
        ("tcp://0.0.0.0:8786", "plain TCP lets"),
        ("farm:8786", "accepted: tls://HOST:PORT"),
        ("tls://farm", "accepted: tls://HOST:PORT"),
        ("tls://farm:99999", "accepted: tls://HOST:PORT"),
        ("http://farm:8786", "accepted: tls://HOST:PORT"),
        ("tls://farm:8786", "tls: none given"),
    ],
)
def test_other_addresses_are_refused_with_words(url, words):  # type: ignore[no-untyped-def]
    with pytest.raises(SettingsError, match=words):
        check_scheduler(url, None)


def test_a_scheduler_without_tls_listens_on_loopback_only():
    with pytest.raises(SettingsError, match=r"can reach the host '0\.0\.0\.0'"):
        serve_scheduler(SchedulerOptions(host="0.0.0.0"))


def test_a_folder_that_lacks_certificates_says_which(tmp_path):  # type: ignore[no-untyped-def]
    with pytest.raises(SettingsError, match=r"lacks ca\.pem, worker\.pem, worker-key\.pem"):
        security(tmp_path, "worker")


def _file(path: Path, data: bytes) -> tuple[str, Path]:
    path.write_bytes(data)
    return hashlib.sha256(data).hexdigest(), path


@pytest.fixture
def store(files_url: str) -> ContentStore:
    return ContentStore(files_url)


def test_contents_come_back_as_they_were_and_are_fetched_once(store, tmp_path):  # type: ignore[no-untyped-def]
    digest, source = _file(tmp_path / "a", b"some bytes")
    store.put(digest, source)
    store.put(digest, source)
    copy = store.fetch(digest, tmp_path / "cache")
    assert copy.read_bytes() == b"some bytes"
    copy.write_bytes(b"kept")
    assert store.fetch(digest, tmp_path / "cache").read_bytes() == b"kept"


def test_broken_and_missing_contents_leave_nothing_behind(store, tmp_path):  # type: ignore[no-untyped-def]
    digest = hashlib.sha256(b"other").hexdigest()
    store.put(digest, _file(tmp_path / "a", b"some bytes")[1])
    with pytest.raises(BrokenContentError):
        store.fetch(digest, tmp_path / "cache")
    with pytest.raises(FileNotFoundError):
        store.fetch("0" * 64, tmp_path / "cache")
    with pytest.raises(NoSuchAssetError):
        store.fetch("../../etc/passwd", tmp_path / "cache")
    assert not [path for path in (tmp_path / "cache").rglob("*") if path.is_file()]


def test_the_cache_loses_what_was_used_the_longest_ago(tmp_path):  # type: ignore[no-untyped-def]
    now = time.time()
    files = []
    for age in range(4):
        digest = hashlib.sha256(bytes([age])).hexdigest()
        path = asset_file(tmp_path, digest)
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(bytes(100))
        os.utime(path, (now - age, now - age))
        files.append(path)
    trim(tmp_path, 250, keep=files[3:])
    assert [path.exists() for path in files] == [True, False, False, True]


def _spec(tmp_path: Path, scene: bytes, scene_folder: str | None = None) -> RenderSpec:
    path = tmp_path / "scene.json"
    path.write_bytes(scene)
    return RenderSpec(str(path), "h", str(tmp_path / "assets"), scene_folder, 0.0, 8, 0)


def test_a_scene_is_published_with_the_assets_that_it_names(store, tmp_path):  # type: ignore[no-untyped-def]
    digest, source = _file(tmp_path / "mesh", b"o")
    file = asset_file(tmp_path / "assets", digest)
    file.parent.mkdir(parents=True)
    source.rename(file)
    contents = publish(_spec(tmp_path, b'{"asset": "sha256:%s"}' % digest.encode()), store, "url")
    assert contents.assets == (digest,)
    assert store.fetch(digest, tmp_path / "cache").read_bytes() == b"o"
    assert store.fetch(contents.scene, tmp_path / "cache").read_bytes().startswith(b'{"asset"')


def test_a_scene_that_has_gone_from_the_store_is_published_again(files_url, tmp_path, monkeypatch):  # type: ignore[no-untyped-def]
    store = ContentStore(files_url)
    spec = _spec(tmp_path, b"{}")

    async def publish_twice(between: Callable[[Publisher], None]) -> bool:
        publisher = Publisher(files_url)
        contents = await publisher.contents_of(spec)
        store.remove_unused(datetime.now(UTC) + timedelta(days=1))
        between(publisher)
        assert await publisher.contents_of(spec) == contents
        try:
            store.fetch(contents.scene, Path(tempfile.mkdtemp(dir=tmp_path)))
        except FileNotFoundError:
            return False
        return True

    assert not asyncio.run(publish_twice(lambda publisher: None))  # it is not asked about for every lease
    assert asyncio.run(publish_twice(lambda publisher: publisher.forget(spec)))  # a worker could not fetch it
    monkeypatch.setattr(publishing, "AGAIN_SECONDS", -1.0)
    assert asyncio.run(publish_twice(lambda publisher: None))  # long ago


def test_scenes_with_files_beside_them_stay_on_their_machine(store, tmp_path):  # type: ignore[no-untyped-def]
    with pytest.raises(NotPortableError, match="this machine only"):
        publish(_spec(tmp_path, b"{}", str(tmp_path)), store, "url")


def test_a_device_that_fails_the_self_test_does_not_join(tmp_path, caplog):  # type: ignore[no-untyped-def]
    script = tmp_path / "selftest.py"
    script.write_text("import sys; print('case 12 failed'); sys.exit(1)")
    fake = (sys.executable, str(Path(__file__).with_name("fake_device.py")))
    options = WorkerOptions(
        "tcp://127.0.0.1:1", device_command=fake, selftest=(sys.executable, str(script)), cache=tmp_path
    )
    with pytest.raises(NoDeviceError, match="no device of this machine has passed the self-test"):
        supervise(options)
    assert "device fake:0 does not join" in caplog.text
    assert "case 12 failed" in caplog.text


@pytest.mark.parametrize("named", ["--cache", "PENUMBRA_CACHE"])
def test_a_worker_whose_cache_is_no_folder_does_not_start(tmp_path, monkeypatch, named):  # type: ignore[no-untyped-def]
    (tmp_path / "file").write_text("")
    if named == "PENUMBRA_CACHE":
        monkeypatch.setenv("PENUMBRA_CACHE", str(tmp_path / "file"))
    options = WorkerOptions("tcp://127.0.0.1:1", cache=tmp_path / ("file" if named == "--cache" else "farm"))
    with pytest.raises(
        (SettingsError, CacheError), match=rf"^{named}: given '.*file', but .*; accepted: a folder"
    ):
        supervise(options)


def test_dask_reads_from_variables_what_our_own_processes_tell_it():
    assert {
        name: dask.config.get(name, config=dask.config.collect_env(environment())) for name in QUIET
    } == QUIET


def test_large_farms_are_asked_whether_they_live_at_a_bounded_rate():
    description = DeviceDescription("d", "", "", "", "", "cpu", 1, 1, "")
    device = RemoteDevice("tcp://w", description, channel=None, heard=0.0)  # type: ignore[arg-type]
    assert not device.wants_ping(100.0), "it has no lease"
    device.unanswered = PINGS
    for devices, quiet in ((1, QUIET_SECONDS), (250, QUIET_SECONDS), (10_000, 200.0)):
        assert not device.wants_ping(quiet, devices)
        assert device.wants_ping(1.01 * quiet, devices)
