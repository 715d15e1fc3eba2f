"""The service's settings: environment variables PENUMBRA_* (or the files that PENUMBRA_*_FILE name), then whatever the
caller gives (command-line flags).

docs/configuration.md documents every one of them.
"""

from __future__ import annotations

import ipaddress
import os
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Final

from penumbra_scene import limits

ENVIRONMENT_PREFIX: Final = "PENUMBRA_"


MIN_KEY_LENGTH: Final = 32
"""Characters of an API key that somebody else has made."""
FILE_SUFFIX: Final = "_FILE"
"""PENUMBRA_X_FILE names a file that holds the setting X: for secrets."""
FARM_JOBS: Final = 8
"""Jobs that share a farm: small ones do not fill it."""


class SettingsError(ValueError):
    """A setting cannot be used; the message says which, what was given and what is accepted."""


def _default_data() -> Path:
    base = os.environ.get("XDG_DATA_HOME") or "~/.local/share"
    return Path(base).expanduser() / "penumbra"


@dataclass(frozen=True)
class Settings:
    """Each field is a setting; its environment variable is PENUMBRA_ and its name in capitals."""

    host: str = "127.0.0.1"
    """Address to listen on. Anything but loopback needs an API key."""
    port: int = 8484
    """TCP port; 0 takes a free one."""
    data: Path = field(default_factory=_default_data)
    """Folder of the database, assets, working files and results."""
    database_url: str = ""
    """SQLAlchemy URL; empty: SQLite in the data folder."""
    initial_key: str = ""
    """An API key that is let in from the start, beside those that `penumbra keys` makes: for containers."""
    artifacts_url: str = ""
    """Where results go, as fsspec takes it; empty: the data folder."""
    hosts: tuple[str, ...] = ()
    """Further names under which browsers may reach the service (commas between them); '*' for any."""
    devices: str = ""
    """Which OpenCL devices work: identifiers with commas, as `penumbra devices` lists them;
    empty: all."""
    scheduler: str = ""
    """Address of the Dask scheduler whose workers render; empty: this machine's devices do."""
    tls: str = ""
    """Folder of certificates for a tls:// scheduler, as `penumbra certs` makes it."""
    verify_share: float = 0.01
    """Share of leases that two devices do and whose sums are compared, beside each device's first; 0: none."""
    max_body_bytes: int = limits.MAX_BODY_BYTES
    """Largest JSON body."""
    max_asset_bytes: int = limits.MAX_ASSET_BYTES
    """Largest asset."""
    decode_memory_bytes: int = 8 << 30
    """Address space of the process that decodes an asset."""
    decode_seconds: float = 120.0
    """Time that decoding an asset may take."""
    heartbeat_seconds: float = 15.0
    """Time between signs of life in a stream of events."""
    shutdown_seconds: float = 30.0
    """How long a shutdown waits for the running job's snapshot."""
    log_level: str = "info"
    """debug, info, warning or error."""
    log_format: str = "text"
    """text or json."""
    jobs_at_once: int = 0
    """Jobs that share the devices; 0: one on this machine's devices, 8 on a farm."""
    max_queued_jobs: int = 10_000
    """Jobs that may wait."""
    max_job_samples: int = 0
    """Samples of all pixels and frames of a job that its stop rule may allow; 0: any number."""
    max_picture_seconds: float = 0.0
    """Seconds of tracing that a picture which stops at a time or an error may take; 0: any number."""
    keep_days: float = 0.0
    """Days after its end that a job with all its files is removed; 0: never."""
    keep_assets_days: float = 30.0
    """Days after its upload that an asset which no job names is removed; 0: never."""
    keep_decoded_days: float = 30.0
    """Days without use after which the decoded copy of an asset is removed; 0: never."""
    keep_contents_days: float = 30.0
    """Days without use after which what a farm's workers fetch is removed from the artifact store; 0: never, else at
    least 1."""

    def __post_init__(self) -> None:
        for name in ("max_body_bytes", "max_asset_bytes", "decode_memory_bytes"):
            _require(getattr(self, name) >= 1, name, getattr(self, name), "a whole number of at least 1")
        _require(0 <= self.verify_share <= 1, "verify_share", self.verify_share, "a number from 0 to 1")
        _require(
            self.max_queued_jobs >= 1, "max_queued_jobs", self.max_queued_jobs, "a whole number of at least 1"
        )
        _require(self.jobs_at_once >= 0, "jobs_at_once", self.jobs_at_once, "a whole number of at least 0")
        for name in ("max_job_samples", "max_picture_seconds"):
            _require(getattr(self, name) >= 0, name, getattr(self, name), "a number of at least 0")
        for name in ("keep_days", "keep_assets_days", "keep_decoded_days"):
            _require(getattr(self, name) >= 0, name, getattr(self, name), "a number of at least 0")
        # A service says every few hours what it uses.
        days = self.keep_contents_days
        _require(days == 0 or days >= 1, "keep_contents_days", days, "0, or a number of at least 1")
        formats = ("text", "json")
        _require(self.log_format in formats, "log_format", self.log_format, ", ".join(formats))
        for name in ("decode_seconds", "heartbeat_seconds"):
            _require(getattr(self, name) > 0, name, getattr(self, name), "a number above 0")
        _require(
            self.shutdown_seconds >= 0, "shutdown_seconds", self.shutdown_seconds, "a number of at least 0"
        )
        _require(0 <= self.port <= 65535, "port", self.port, "0 to 65535")
        _require(
            not self.initial_key or len(self.initial_key) >= MIN_KEY_LENGTH,
            "initial_key",
            "fewer characters",
            f"at least {MIN_KEY_LENGTH} characters, or none",
        )
        levels = ("debug", "info", "warning", "error")
        _require(self.log_level in levels, "log_level", self.log_level, ", ".join(levels))

    @property
    def database(self) -> str:
        """The SQLAlchemy URL in use."""
        return self.database_url or f"sqlite:///{self.data.absolute() / 'penumbra.sqlite3'}"

    @property
    def shared(self) -> bool:
        """Whether other services may use the same database: then jobs are taken over from those that died."""
        return not self.database.startswith("sqlite")

    @property
    def slots(self) -> int:
        """Jobs that share the devices."""
        return self.jobs_at_once or (FARM_JOBS if self.scheduler else 1)

    @property
    def artifacts(self) -> str:
        """The fsspec URL in use."""
        return self.artifacts_url or str(self.data.absolute() / "results")

    @property
    def tls_folder(self) -> Path | None:
        """The folder of certificates, if there is one."""
        return Path(self.tls).expanduser() if self.tls else None

    @property
    def assets_folder(self) -> Path:
        """Uploaded files, by content."""
        return self.data.absolute() / "assets"

    @property
    def work_folder(self) -> Path:
        """Snapshots and unfinished files of jobs, a folder for each."""
        return self.data.absolute() / "work"

    def keys_command(self, words: str) -> str:
        """`penumbra keys`, as it is to be typed for the service with these settings."""
        return f"penumbra keys {words} --data {shlex.quote(str(self.data))}"

    @property
    def public(self) -> bool:
        """Whether other machines may reach the service."""
        return not is_loopback(self.host)


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches a socket bound to `host`. A name other than localhost counts as
    public."""
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def _require(good: bool, name: str, given: Any, accepted: str) -> None:
    if not good:
        raise SettingsError(f"{name}: given {given!r}, accepted: {accepted}")


def load_settings(
    given: Mapping[str, Any] | None = None, environment: Mapping[str, str] | None = None
) -> Settings:
    """Settings from the environment, overridden by `given` values that are not None. Raises SettingsError."""
    environment = os.environ if environment is None else environment
    values: dict[str, Any] = {}
    for setting in fields(Settings):
        text = _given(environment, ENVIRONMENT_PREFIX + setting.name.upper())
        if text is not None:
            values[setting.name] = _converted(setting.name, str(setting.type), text)
    values |= {name: value for name, value in (given or {}).items() if value is not None}
    unknown = values.keys() - {setting.name for setting in fields(Settings)}
    if unknown:
        raise SettingsError(f"there is no setting {', '.join(sorted(unknown))}")
    return Settings(**values)


def _given(environment: Mapping[str, str], variable: str) -> str | None:
    """A variable's text, from the file that its twin names where it is not set itself. Raises SettingsError."""
    file = environment.get(variable + FILE_SUFFIX)
    if variable in environment or not file:
        return environment.get(variable)
    try:
        return Path(file).read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(
            f"{variable}{FILE_SUFFIX}: given {file!r}, which cannot be read ({error}); accepted: a text file"
        ) from error


def _converted(name: str, kind: str, text: str) -> Any:
    try:
        if kind == "int":
            return int(text)
        if kind == "float":
            return float(text)
    except ValueError:
        raise SettingsError(
            f"{ENVIRONMENT_PREFIX}{name.upper()}: given {text!r}, accepted: a number"
        ) from None
    if kind == "Path":
        return Path(text).expanduser()
    if kind.startswith("tuple"):
        return tuple(part.strip() for part in text.split(",") if part.strip())
    return text
