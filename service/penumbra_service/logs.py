"""The log of services, workers and schedulers: lines for people, or JSON objects for programs, one a line, on standard error.

Whatever is logged while a job is worked on names it under `job` (and `frame`), by structlog's context variables; what
concerns a lease names it under `lease`, given as `extra`.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Mapping
from typing import Any, Final, TextIO

import structlog
from structlog.typing import EventDict, Processor, WrappedLogger

from penumbra_service.settings import ENVIRONMENT_PREFIX, load_settings

FIELDS: Final = ("job", "frame", "lease", "device")
"""What records may carry as `extra`."""


def configure(level: str, form: str, stream: TextIO | None = None) -> None:
    """Have every logger write to `stream` (standard error) from `level` on. `form`: text or json."""
    handler = logging.StreamHandler(stream or sys.stderr)
    handler.setFormatter(_formatter(form))
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


def _formatter(form: str) -> logging.Formatter:
    shared: list[Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.stdlib.add_log_level,
        structlog.stdlib.add_logger_name,
        structlog.stdlib.ExtraAdder(FIELDS),
        structlog.processors.TimeStamper(fmt="iso", utc=True),
    ]
    last: list[Processor] = [structlog.stdlib.ProcessorFormatter.remove_processors_meta]
    if form == "json":
        last += [structlog.processors.format_exc_info, structlog.processors.JSONRenderer(sort_keys=True)]
    else:
        last += [_line]
    return structlog.stdlib.ProcessorFormatter(foreign_pre_chain=shared, processors=last)


def _line(_logger: WrappedLogger, _name: str, event: EventDict) -> str:
    """'2025-01-01T00:00:00Z INFO penumbra_service.job_queue: job J: begins [job=J]'."""
    found: dict[str, Any] = dict(structlog.processors.format_exc_info(_logger, _name, event))
    head = f"{found['timestamp']} {found['level'].upper()} {found['logger']}: {found['event']}"
    known = " ".join(f"{name}={found[name]}" for name in FIELDS if name in found)
    trace = found.get("exception")
    return head + (f" [{known}]" if known else "") + (f"\n{trace}" if trace else "")
