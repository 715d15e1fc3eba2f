"""The set-up script on machines that lack something, played with stand-ins on the path."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
_TOOLS = ("bash", "env", "dirname", "cat", "sha256sum", "cut", "uname", "mktemp", "rm", "tr", "ls")


class Machine:
    """A checkout and a path that holds what a test puts there, and nothing else."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "bin"
        self.path.mkdir()
        for tool in _TOOLS:
            found = shutil.which(tool)
            assert found is not None
            (self.path / tool).symlink_to(found)
        self.checkout = folder / "checkout"
        (self.checkout / "scripts").mkdir(parents=True)
        for name in ("scripts/bootstrap.sh", "requirements.lock", "pyproject.toml"):
            shutil.copy(ROOT / name, self.checkout / name)
        self.log = folder / "log"

    def put(self, tool: str, script: str) -> None:
        """A stand-in for a program."""
        path = self.path / tool
        path.unlink(missing_ok=True)
        path.write_text(f"#!/bin/bash\n{script}\n")
        path.chmod(0o755)

    def run(self) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [self.checkout / "scripts" / "bootstrap.sh"],
            env={"PATH": str(self.path), "TMPDIR": str(self.path.parent)},
            capture_output=True,
            text=True,
            check=False,
        )

    @property
    def called(self) -> list[str]:
        return self.log.read_text().splitlines() if self.log.exists() else []


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    """A machine that has everything, for a user who is not root."""
    made = Machine(tmp_path)
    made.put("id", "echo 1000")
    made.put("ld", "exit 0")
    made.put("python3", _PYTHON.format(log=made.log))
    return made


# Answers what the script asks Python: its version, whether it has venv. `-m venv` makes a folder with a like Python.
_PYTHON = """\
echo "python $*" >>{log}
case "$*" in
  *"-m venv"*)
    for folder in "$@"; do :; done
    mkdir -p "$folder/bin" 2>/dev/null || /bin/mkdir -p "$folder/bin"
    /bin/cp "$0" "$folder/bin/python"
    printf '#!/bin/bash\\n' >"$folder/bin/penumbra"
    /bin/chmod +x "$folder/bin/penumbra" ;;
esac
exit 0"""


def test_pinned_packages_are_installed_with_their_hashes(machine: Machine) -> None:
    result = machine.run()
    assert (result.returncode, result.stderr) == (0, "")
    installs = [line for line in machine.called if "install" in line]
    assert "--require-hashes --requirement requirements.lock" in installs[0]
    assert "--no-deps --no-build-isolation --editable ." in installs[1]


def test_a_second_run_does_nothing(machine: Machine) -> None:
    machine.run()
    before = len(machine.called)
    result = machine.run()
    assert (result.returncode, result.stdout) == (0, "")
    assert [line for line in machine.called[before:] if "pip" in line or "venv" in line] == []


@pytest.mark.parametrize("name", ["requirements.lock", "pyproject.toml"])
def test_a_changed_pin_is_installed(machine: Machine, name: str) -> None:
    machine.run()
    with (machine.checkout / name).open("a") as file:
        file.write("# changed\n")
    before = len(machine.called)
    machine.run()
    assert any("--require-hashes" in line for line in machine.called[before:])
    assert not any("-m venv" in line for line in machine.called[before:])


def test_a_failed_installation_is_tried_again(machine: Machine) -> None:
    good = (machine.path / "python3").read_text()
    machine.put(
        "python3", good.replace("exit 0", '[[ "$*" != *--require-hashes* ]]').removeprefix("#!/bin/bash\n")
    )
    assert machine.run().returncode == 1
    (machine.checkout / ".venv" / "bin" / "python").write_text(good)
    before = len(machine.called)
    assert machine.run().returncode == 0
    assert any("--require-hashes" in line for line in machine.called[before:])


def test_without_a_linker_the_line_that_brings_it_is_printed(machine: Machine) -> None:
    (machine.path / "ld").unlink()
    result = machine.run()
    assert result.returncode == 1
    assert "    sudo apt-get install -y binutils gcc libc6-dev\n" in result.stderr
    assert not any("venv" in line and "-m" in line for line in machine.called)


def test_a_linker_without_libc_counts_as_none(machine: Machine) -> None:
    machine.put("ld", "exit 1")
    assert "sudo apt-get install -y binutils gcc libc6-dev" in machine.run().stderr


def test_python_without_venv_names_its_package(machine: Machine) -> None:
    python = (machine.path / "python3").read_text().removeprefix("#!/bin/bash\n")
    machine.put("python3", python.replace("exit 0", '[[ "$*" != *ensurepip* ]]'))
    assert "sudo apt-get install -y python3-venv\n" in machine.run().stderr


def test_root_on_debian_gets_what_is_missing(machine: Machine) -> None:
    (machine.path / "ld").unlink()
    machine.put("id", "echo 0")
    ld = machine.path / "ld"
    install = f'[ "$1" = update ] || {{ printf "#!/bin/bash\\n" >{ld}; /bin/chmod +x {ld}; }}'
    machine.put("apt-get", f'echo "apt-get $*" >>{machine.log}\n{install}')
    result = machine.run()
    assert (result.returncode, result.stderr) == (0, "")
    assert [line for line in machine.called if line.startswith("apt-get")] == [
        "apt-get update",
        "apt-get install -y --no-install-recommends binutils gcc libc6-dev",
    ]


def test_an_old_python_is_named(machine: Machine) -> None:
    python = (machine.path / "python3").read_text().removeprefix("#!/bin/bash\n")
    machine.put("python3", python.replace("exit 0", 'echo "Python 3.9.2"; [[ "$*" != *version_info* ]]'))
    result = machine.run()
    assert result.returncode == 1
    assert "needs Python 3.11 or newer, but python3 is Python 3.9.2" in result.stderr


def test_another_system_is_told_at_once(machine: Machine) -> None:
    machine.put("uname", "echo Darwin")
    result = machine.run()
    assert result.returncode == 1
    assert "Linux" in result.stderr
