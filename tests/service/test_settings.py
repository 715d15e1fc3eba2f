"""Settings: where they come from, and that each is documented."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import pytest
from penumbra_service.settings import ENVIRONMENT_PREFIX, Settings, SettingsError, load_settings

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "configuration.md"


@pytest.mark.parametrize("name", [setting.name for setting in fields(Settings)])
def test_every_setting_is_documented_with_its_variable_and_default(name: str) -> None:
    begin = f"| `{ENVIRONMENT_PREFIX}{name.upper()}` |"
    rows = [line for line in DOCUMENT.read_text().splitlines() if line.startswith(begin)]
    assert len(rows) == 1, f"{name} must have one row in docs/configuration.md"
    default = getattr(Settings(), name)
    if isinstance(default, (int, float)):
        assert f"`{default:g}`" in rows[0] or f"`{default}`" in rows[0]


def test_arguments_go_before_the_environment_and_that_before_defaults() -> None:
    environment = {"PENUMBRA_PORT": "9000", "PENUMBRA_HOST": "::1", "PENUMBRA_HOSTS": "a.example, b.example"}
    settings = load_settings({"port": 9001, "host": None}, environment)
    assert (settings.port, settings.host, settings.log_level) == (9001, "::1", "info")
    assert settings.hosts == ("a.example", "b.example")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("PORT", "x"),
        ("PORT", "-1"),
        ("PORT", "65536"),
        ("MAX_BODY_BYTES", "0"),
        ("DECODE_SECONDS", "nan"),
        ("HEARTBEAT_SECONDS", "0"),
        ("LOG_LEVEL", "loud"),
    ],
)
def test_wrong_settings_are_told(name: str, text: str) -> None:
    with pytest.raises(SettingsError, match=f"(?i){name}"):
        load_settings({}, {f"PENUMBRA_{name}": text})


def test_unknown_settings_are_told() -> None:
    with pytest.raises(SettingsError, match="prot"):
        load_settings({"prot": 1}, {})


def test_places_follow_the_data_folder(tmp_path: Path) -> None:
    settings = Settings(data=tmp_path)
    assert settings.database == f"sqlite:///{tmp_path}/penumbra.sqlite3"
    assert settings.artifacts == f"{tmp_path}/results"
    assert Settings(database_url="sqlite:///x").database == "sqlite:///x"
    assert Settings(artifacts_url="memory://x").artifacts == "memory://x"


def test_a_setting_may_lie_in_a_file(tmp_path):  # type: ignore[no-untyped-def]
    file = tmp_path / "url"
    file.write_text("sqlite:///somewhere\n")
    name = "PENUMBRA_DATABASE_URL"
    assert load_settings({}, {f"{name}_FILE": str(file)}).database_url == "sqlite:///somewhere"
    assert (
        load_settings({}, {name: "sqlite:///here", f"{name}_FILE": str(file)}).database_url
        == "sqlite:///here"
    )
    with pytest.raises(SettingsError, match=f"{name}_FILE: given"):
        load_settings({}, {f"{name}_FILE": str(tmp_path / "none")})


def test_an_initial_key_that_can_be_guessed_is_refused_and_not_repeated():
    with pytest.raises(SettingsError, match="at least 32 characters") as caught:
        load_settings({"initial_key": "secret"}, {})
    assert "secret" not in str(caught.value)
