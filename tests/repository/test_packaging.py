"""What is generated is up to date, what is pinned is pinned, and who may import whom is kept."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version
from penumbra_kernels import layout

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = {
    "requirements.lock": ("service", "cpu", "plots", "farm", "dev"),
    "requirements-service.lock": ("service", "cpu", "plots", "farm"),
}


def _pins(name: str) -> dict[str, Version]:
    lines = re.findall(r"^([A-Za-z0-9._-]+)==([^ ;\\]+)", (ROOT / name).read_text(), re.MULTILINE)
    return {canonicalize_name(package): Version(version) for package, version in lines}


@pytest.mark.parametrize("name", EXTRAS)
def test_lock_files_name_no_host(name: str) -> None:
    text = (ROOT / name).read_text()
    assert not re.search(r"https?:|--(extra-)?index-url|--find-links|@ ", text)


@pytest.mark.parametrize("name", EXTRAS)
def test_every_pin_has_a_hash(name: str) -> None:
    entries = re.split(r"^(?=[A-Za-z0-9])", (ROOT / name).read_text(), flags=re.MULTILINE)[1:]
    assert {canonicalize_name(re.split("==", entry)[0]) for entry in entries} == _pins(name).keys()
    assert len(entries) > 20
    assert all("--hash=sha256:" in entry for entry in entries)


@pytest.mark.parametrize("name", EXTRAS)
def test_lock_files_hold_all_that_the_project_asks_for(name: str) -> None:
    asked = list(PROJECT["dependencies"])
    for extra in EXTRAS[name]:
        asked += PROJECT["optional-dependencies"][extra]
    pins = _pins(name)
    for requirement in map(Requirement, asked):
        pinned = pins.get(canonicalize_name(requirement.name))
        assert pinned is not None, f"{requirement} is not in {name}: run `make lock`"
        assert pinned in requirement.specifier, f"{name} has {requirement.name} {pinned}: run `make lock`"


def test_both_lock_files_pin_the_same_versions() -> None:
    everything, service = _pins("requirements.lock"), _pins("requirements-service.lock")
    assert service.items() <= everything.items()
    assert len(service) < len(everything)


def test_the_device_header_is_the_one_that_the_layout_writes() -> None:
    written = (ROOT / "kernels" / "penumbra_kernels" / "cl" / "layout.h").read_text()
    assert written == layout.header(), "run `make layout`"


def test_imports_keep_the_contracts() -> None:
    lint = Path(sys.executable).with_name("lint-imports")
    result = subprocess.run([lint, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout


def test_the_client_imports_without_the_services_packages() -> None:
    script = (
        "import importlib.abc, sys\n"
        "class Refuse(importlib.abc.MetaPathFinder):\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name.partition('.')[0] in sys.argv[2:]:\n"
        "            raise ImportError(name)\n"
        "sys.meta_path.insert(0, Refuse())\n"
        "import penumbra_client.client, penumbra_client.cli.submit, penumbra_client.cli.report\n"
        "from penumbra_client.cli import main\n"
        "sys.exit(main(['validate', sys.argv[1]]))\n"
    )
    scene = ROOT / "examples" / "cornell.json"
    result = subprocess.run(
        [sys.executable, "-c", script, scene], capture_output=True, text=True, check=False
    )
    assert (result.returncode, result.stderr) == (0, "")


@pytest.mark.parametrize("script", ["scripts/bootstrap.sh", "scripts/lock.sh", ".ci/run"])
def test_scripts_are_executable_and_parse(script: str) -> None:
    assert os.access(ROOT / script, os.X_OK)
    subprocess.run(["bash", "-n", ROOT / script], check=True)


def test_packages_for_tests_are_names_that_apt_takes() -> None:
    lines = (ROOT / "apt-test.txt").read_text().splitlines()
    names = [line for line in lines if not line.startswith("#")]
    assert names
    assert all(re.fullmatch(r"[a-z0-9][a-z0-9.+-]+", name) for name in names)
