"""Fixtures for every test: each device test runs on each OpenCL device that is present. A PostgreSQL for those that ask
for one: Debian's package in a temporary folder, on loopback, gone with the test run."""

from __future__ import annotations

import logging
import os
import pwd
import shutil
import socket
import subprocess
import tempfile
import time
import uuid
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest
from penumbra_kernels.device import Device, devices

ROOT = Path(__file__).resolve().parent.parent
REQUIRED = os.environ.get("PENUMBRA_REQUIRE_TOOLS") == "1"


@pytest.fixture(scope="session", autouse=True)
def _own_program_cache(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Tests neither read nor fill the user's program cache, unless PENUMBRA_CACHE names one. Small kernels by the hundred
    stay in PoCL's own cache, so that a second run need not compile them."""
    os.environ.setdefault("POCL_CACHE_DIR", str(Path.home() / ".cache" / "pocl" / "kcache"))
    if "PENUMBRA_CACHE" not in os.environ:
        os.environ["PENUMBRA_CACHE"] = str(tmp_path_factory.mktemp("cache"))


@pytest.fixture
def log_as_before() -> Iterator[None]:
    """For tests that set up the log: its stream ends with them, and later ones must not write to it."""
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield
    root.handlers[:] = handlers
    root.setLevel(level)


@lru_cache
def _open(device_id: str) -> Device:
    return Device(device_id)


@pytest.fixture(scope="session", params=[info.id for info in devices()] or ["none"])
def device(request: pytest.FixtureRequest) -> Device:
    """An opened OpenCL device."""
    return _open(request.param)


def _binaries() -> Path | None:
    """The folder of the newest server; Debian keeps it off the PATH."""
    for folder in sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True):
        if (folder / "initdb").is_file():
            return folder
    found = shutil.which("initdb")
    return None if found is None else Path(found).resolve().parent


def _unprivileged() -> dict[str, Any]:
    """How to start a server that refuses to run as root."""
    if os.geteuid() != 0:
        return {}
    names = {entry.pw_name for entry in pwd.getpwall()}
    name = "postgres" if "postgres" in names else "nobody"
    return {"user": name, "group": pwd.getpwnam(name).pw_gid, "extra_groups": []}


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(scope="session")
def postgres_server() -> Iterator[str]:
    """The URL of a server, without a database's name."""
    binaries = _binaries()
    missing = "no PostgreSQL (Debian: postgresql)" if binaries is None else None
    try:
        import psycopg  # noqa: F401
    except ImportError:
        missing = "no psycopg (the extra 'farm')"
    if missing is not None or binaries is None:
        if REQUIRED:
            pytest.fail(f"{missing}, but PENUMBRA_REQUIRE_TOOLS is set")
        pytest.skip(str(missing))
    who = _unprivileged()
    folder = Path(tempfile.mkdtemp(prefix="penumbra-postgres-"))
    if who:
        os.chown(folder, pwd.getpwnam(who["user"]).pw_uid, who["group"])
    port = _free_port()
    words = [
        binaries / "initdb",
        "-D",
        folder / "data",
        "-U",
        "penumbra",
        "-A",
        "trust",
        "-E",
        "UTF8",
        "--no-sync",
    ]
    made = subprocess.run(
        [str(word) for word in words], capture_output=True, text=True, check=False, cwd=folder, **who
    )
    assert made.returncode == 0, made.stderr
    settings = [
        f"port={port}",
        "listen_addresses=127.0.0.1",
        f"unix_socket_directories={folder}",
        "fsync=off",
    ]
    command = [str(binaries / "postgres"), "-D", str(folder / "data")]
    for setting in settings:
        command += ["-c", setting]
    with (folder / "log").open("wb") as log:
        server = subprocess.Popen(command, stdout=log, stderr=log, cwd=folder, **who)
    try:
        _wait(server, port, folder / "log")
        yield f"postgresql+psycopg://penumbra@127.0.0.1:{port}"
    finally:
        server.terminate()
        server.wait(30)
        shutil.rmtree(folder, ignore_errors=True)


def _wait(server: subprocess.Popen[bytes], port: int, log: Path) -> None:
    import psycopg

    deadline = time.monotonic() + 60
    while True:
        try:
            psycopg.connect(f"host=127.0.0.1 port={port} user=penumbra dbname=postgres").close()
            return
        except psycopg.OperationalError:
            assert server.poll() is None, log.read_text()
            assert time.monotonic() < deadline, log.read_text()
            time.sleep(0.05)


@pytest.fixture
def postgres_url(postgres_server: str) -> Iterator[str]:
    """A database of its own."""
    import psycopg

    name = f"test_{uuid.uuid4().hex}"
    admin = postgres_server.replace("+psycopg", "") + "/postgres"
    with psycopg.connect(admin, autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE {name}")
    yield f"{postgres_server}/{name}"
    with psycopg.connect(admin, autocommit=True) as connection:
        connection.execute(f"DROP DATABASE {name} WITH (FORCE)")


def _drop_connections(url: str) -> int:
    """End every other connection to the database, as a restart of the server or a firewall does."""
    from sqlalchemy import create_engine, text

    engine = create_engine(url)
    with engine.connect() as connection:
        query = (
            "SELECT pg_terminate_backend(pid) FROM pg_stat_activity "
            "WHERE datname = current_database() AND pid <> pg_backend_pid()"
        )
        dropped = len(connection.execute(text(query)).all())
    engine.dispose()
    return dropped


@pytest.fixture
def drop_connections() -> Callable[[str], int]:
    """drop_connections(url): how many there were."""
    return _drop_connections


@pytest.fixture
def mount_disk(tmp_path: Path) -> Iterator[Callable[[int], Path]]:
    """mount_disk(size): the folder of a file system of so many bytes."""
    mounted: list[Path] = []

    def mount(size: int) -> Path:
        folder = tmp_path / f"disk{len(mounted)}"
        folder.mkdir()
        command = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            pytest.skip(f"no file system can be mounted: {done.stderr.strip()}")
        mounted.append(folder)
        return folder

    yield mount
    for folder in mounted:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)
