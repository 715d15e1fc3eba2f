"""Where a scheduler may be, and how one talks to it: mutual TLS, or plain TCP on this machine alone.

Whoever reaches a Dask scheduler runs code on it and on its workers, and plain TCP asks nobody who he is.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, Literal
from urllib.parse import urlsplit

from distributed.security import Security

from penumbra_service.settings import SettingsError, is_loopback

Role = Literal["scheduler", "worker", "client"]
DEFAULT_PORT: Final = 8786
_FORMS: Final = "tls://HOST:PORT, or tcp://127.0.0.1:PORT on this machine alone"


def check_scheduler(url: str, tls: Path | None) -> str:
    """The scheduler's address, if it may be used. Raises SettingsError."""
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if parts.scheme not in ("tls", "tcp") or not host or port is None:
        raise SettingsError(f"scheduler: given {url!r}, accepted: {_FORMS}")
    if parts.scheme == "tcp" and not is_loopback(host):
        raise SettingsError(
            f"scheduler: given {url!r}: plain TCP lets whoever reaches the scheduler run code on every worker; "
            f"accepted: {_FORMS} (`penumbra certs` makes the certificates)"
        )
    if parts.scheme == "tls" and tls is None:
        raise SettingsError(
            f"tls: none given, and {url} needs it; accepted: the folder that `penumbra certs` made"
        )
    return url


def security(tls: Path | None, *roles: Role) -> Security | None:
    """TLS with the certificates of some roles from a folder of `penumbra certs`; both sides show one. None without
    TLS. Raises SettingsError where a file is missing."""
    if tls is None:
        return None
    files = {"tls_ca_file": tls / "ca.pem"}
    for role in roles:
        files |= {f"tls_{role}_cert": tls / f"{role}.pem", f"tls_{role}_key": tls / f"{role}-key.pem"}
    missing = [path.name for path in files.values() if not path.is_file()]
    if missing:
        raise SettingsError(
            f"tls: given {tls}, which lacks {', '.join(missing)}; accepted: a folder that `penumbra certs` made"
        )
    return Security(require_encryption=True, **{name: str(path) for name, path in files.items()})
