"""The log of services, workers and schedulers: lines for people, or JSON objects for programs, one a line, on standard error.

Whatever is logged while a job is worked on names it under `job` (and `frame`), by log_context.bind; what concerns a lease
names it under `lease`, given as `extra`.
"""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, Final, TextIO

from penumbra_service.log_context import bound_fields
from penumbra_service.settings import ENVIRONMENT_PREFIX, load_settings

FIELDS: Final = ("job", "frame", "lease", "device")
"""What records may carry as `extra`, and what lines for people show."""


def configure(level: str, form: str, stream: TextIO | None = None) -> None:
    """Have every logger write to `stream` (standard error) from `level` on. `form`: text or json."""
    handler = logging.StreamHandler(stream or sys.stderr)
    handler.setFormatter(_Json() if form == "json" else _Text())
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(level.upper())


def configure_from(environment: Mapping[str, str]) -> None:
    """As PENUMBRA_LOG_LEVEL and PENUMBRA_LOG_FORMAT say. Raises SettingsError."""
    prefix = f"{ENVIRONMENT_PREFIX}LOG_"
    settings = load_settings(
        {}, {name: text for name, text in environment.items() if name.startswith(prefix)}
    )
    configure(settings.log_level, settings.log_format)


class _Json(logging.Formatter):
    """One object: event, level, logger, timestamp, what is bound or given, and `exception`."""

    def format(self, record: logging.LogRecord) -> str:
        return json.dumps(self._fields(record), sort_keys=True, default=repr)

    def _fields(self, record: logging.LogRecord) -> dict[str, Any]:
        found: dict[str, Any] = {
            **bound_fields(),
            **{name: record.__dict__[name] for name in FIELDS if name in record.__dict__},
            "event": record.getMessage(),
            "level": record.levelname.lower(),
            "logger": record.name,
            "timestamp": datetime.fromtimestamp(record.created, UTC).isoformat().replace("+00:00", "Z"),
        }
        if record.exc_info:
            found["exception"] = self.formatException(record.exc_info)
        return found


class _Text(_Json):
    """'2025-01-01T00:00:00Z INFO penumbra_service.job_queue: job J: begins [job=J]'."""

    def format(self, record: logging.LogRecord) -> str:
        found = self._fields(record)
        head = f"{found['timestamp']} {record.levelname} {found['logger']}: {found['event']}"
        known = " ".join(f"{name}={found[name]}" for name in FIELDS if name in found)
        trace = found.get("exception")
        return head + (f" [{known}]" if known else "") + (f"\n{trace}" if trace else "")
