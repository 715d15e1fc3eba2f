"""The log, for people and for programs."""

from __future__ import annotations

import io
import json
import logging

import pytest
from penumbra_service import logs
from penumbra_service.log_context import bind
from penumbra_service.settings import SettingsError

pytestmark = pytest.mark.usefixtures("log_as_before")


def lines(form: str) -> list[str]:
    stream = io.StringIO()
    logs.configure("info", form, stream)
    log = logging.getLogger("penumbra_service.x")
    with bind(job="J1", frame=7):
        log.info("a %s", "message")
        log.warning("lost", extra={"lease": "J1/7/3", "device": "pocl:0"})
        try:
            raise ValueError("inner\nlines")
        except ValueError:
            log.exception("failed")
    log.info("alone")
    log.debug("unseen")
    return stream.getvalue().splitlines()


def test_workers_and_schedulers_log_as_the_environment_says(capsys: pytest.CaptureFixture[str]) -> None:
    logs.configure_from(
        {"PENUMBRA_LOG_FORMAT": "json", "PENUMBRA_LOG_LEVEL": "warning", "PENUMBRA_DATA": "/x"}
    )
    logging.getLogger("penumbra_service.x").info("unseen")
    logging.getLogger("penumbra_service.x").warning("lost", extra={"job": "J1", "lease": "J1/3"})
    (line,) = capsys.readouterr().err.splitlines()
    assert json.loads(line).items() >= {"event": "lost", "job": "J1", "lease": "J1/3"}.items()
    with pytest.raises(SettingsError, match="log_format: given 'xml'"):
        logs.configure_from({"PENUMBRA_LOG_FORMAT": "xml"})


def test_json_is_one_object_a_line_with_job_and_lease() -> None:
    first, lost, failed, alone = (json.loads(line) for line in lines("json"))
    assert first["timestamp"].endswith("Z")
    del first["timestamp"]
    assert first == {
        "event": "a message", "frame": 7, "job": "J1", "level": "info", "logger": "penumbra_service.x",
    }  # fmt: skip
    assert (lost["lease"], lost["device"], lost["level"]) == ("J1/7/3", "pocl:0", "warning")
    assert "ValueError: inner\nlines" in failed["exception"]
    assert "job" not in alone


def test_text_says_the_same() -> None:
    found = lines("text")
    assert found[0].endswith("INFO penumbra_service.x: a message [job=J1 frame=7]")
    assert found[1].endswith("WARNING penumbra_service.x: lost [job=J1 frame=7 lease=J1/7/3 device=pocl:0]")
    assert any(line.startswith("ValueError: inner") for line in found)
    assert found[-1].endswith("INFO penumbra_service.x: alone")
