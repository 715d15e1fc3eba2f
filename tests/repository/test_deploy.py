"""The files that start a farm elsewhere: they parse, and every command and flag that they name exists."""

from __future__ import annotations

import copy
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import yaml
from penumbra_client.cli import make_parser
from penumbra_service.engine.dask.certs import make_certs
from penumbra_service.settings import ENVIRONMENT_PREFIX, FILE_SUFFIX, load_settings

ROOT = Path(__file__).resolve().parents[2]
DEPLOY = ROOT / "docs" / "deploy"
COMPOSE: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
OBJECTS: list[dict[str, Any]] = list(yaml.safe_load_all((DEPLOY / "kubernetes.yaml").read_text()))
OURS = {name: s for name, s in COMPOSE["services"].items() if s["image"] == "penumbra-render"}


def _containers() -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    for deployment in OBJECTS:
        if deployment["kind"] == "Deployment":
            pod = deployment["spec"]["template"]["spec"]
            yield pod, pod["containers"][0]


def _accepted(words: list[str], environment: dict[str, str]) -> None:
    """The command line takes these words, with what the environment gives."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in environment.items():
            patch.setenv(name, value)
        make_parser(words[0]).parse_args(words)


def _known(variables: dict[str, str]) -> None:
    """Every variable of ours is a setting."""
    ours = {name for name in variables if name.startswith(ENVIRONMENT_PREFIX)}
    for name in ours:
        setting = name.removeprefix(ENVIRONMENT_PREFIX).removesuffix(FILE_SUFFIX).lower()
        assert hasattr(load_settings({}, {}), setting), name


def test_compose_runs_commands_that_exist() -> None:
    assert set(OURS) == {"service", "scheduler", "worker-1", "worker-2"}
    for service in OURS.values():
        environment = service.get("environment", {})
        _accepted(shlex.split(service["command"]), environment)
        _known(environment)


def test_compose_gives_nobody_rights_or_secrets_that_he_does_not_need() -> None:
    for name, service in COMPOSE["services"].items():
        assert service["read_only"], name
        assert service["cap_drop"] == ["ALL"], name
        assert service["user"] not in ("root", "0", "0:0"), name
        assert "healthcheck" in service or name == "service", name  # the image has the service's
    published = {name: s["ports"] for name, s in COMPOSE["services"].items() if "ports" in s}
    assert list(published) == ["service"]
    assert published["service"][0].startswith("127.0.0.1:")
    files = {entry["file"] for entry in COMPOSE["secrets"].values()}
    assert all(file.startswith("secrets/") for file in files)
    assert not any("ca-key" in file for file in files)
    assert "/secrets/" in (ROOT / ".gitignore").read_text().split()
    assert not re.search(r"PASSWORD: |pnb_|://penumbra:", (ROOT / "docker-compose.yml").read_text())


def test_compose_secrets_are_what_compose_names(tmp_path) -> None:  # type: ignore[no-untyped-def]
    for folder in ("scripts", ".venv/bin"):
        (tmp_path / folder).mkdir(parents=True)
    script = tmp_path / "scripts" / "compose-secrets.sh"
    script.write_text((ROOT / "scripts" / "compose-secrets.sh").read_text())
    penumbra = tmp_path / ".venv" / "bin" / "penumbra"
    penumbra.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m penumbra_client "$@"\n')
    penumbra.chmod(0o755)
    command = ["bash", str(script)]
    subprocess.run(command, check=True, env={"PATH": "/usr/bin:/bin", "VENV": str(tmp_path / ".venv")})
    assert all((tmp_path / entry["file"]).is_file() for entry in COMPOSE["secrets"].values())
    assert (tmp_path / "secrets").stat().st_mode & 0o077 == 0
    key = (tmp_path / "secrets" / "api-key").read_text().strip()
    assert load_settings({"initial_key": key}, {}).initial_key == key
    again = subprocess.run(
        command,
        check=False,
        capture_output=True,
        env={"PATH": "/usr/bin:/bin", "VENV": str(tmp_path / ".venv")},
    )
    assert again.returncode == 1


@pytest.mark.parametrize("version", ["1.25", "1.31", "1.37"])
def test_kubernetes_objects_are_what_its_api_takes(version: str) -> None:
    """Against the schemas that Kubernetes publishes, without unknown fields."""
    kubernetes = pytest.importorskip("kubernetes_validate")
    for found in OBJECTS:
        kubernetes.validate(found, version, strict=True)
    broken = copy.deepcopy(OBJECTS[-1])
    broken["spec"]["template"]["spec"]["containers"][0]["livenessprobe"] = {}
    with pytest.raises(kubernetes.ValidationError, match="livenessprobe"):
        kubernetes.validate(broken, version, strict=True)


def test_kubernetes_runs_commands_that_exist_as_users_without_rights() -> None:
    assert [c["args"][0] for _, c in _containers()] == ["scheduler", "serve", "worker"]
    for pod, container in _containers():
        environment = {e["name"]: e.get("value", "1") for e in container.get("env", ())}
        _accepted([word.replace("$(POD_NAME)", "pod") for word in container["args"]], environment)
        _known({name: value for name, value in environment.items() if name != "POD_NAME"})
        assert pod["securityContext"]["runAsNonRoot"]
        assert container["securityContext"]["readOnlyRootFilesystem"]
        mounted = {mount["name"] for mount in container["volumeMounts"]}
        assert mounted == {volume["name"] for volume in pod["volumes"]}


def test_kubernetes_names_secrets_and_claims_that_are_made() -> None:
    words = (DEPLOY / "README.md").read_text()
    claims = {o["metadata"]["name"] for o in OBJECTS if o["kind"] == "PersistentVolumeClaim"}
    for pod, _ in _containers():
        for volume in pod["volumes"]:
            if "persistentVolumeClaim" in volume:
                assert volume["persistentVolumeClaim"]["claimName"] in claims
            if "secret" in volume:
                name = volume["secret"]["secretName"]
                assert re.search(rf"generic {name.replace('tls-', 'tls-(?:.role|)')}", words) or name in (
                    "tls-scheduler",
                    "tls-worker",
                    "tls-client",
                )
    assert {o["metadata"]["name"] for o in OBJECTS if o["kind"] == "Service"} == {"scheduler", "service"}


def test_slurm_files_are_sound() -> None:
    script = DEPLOY / "worker.sbatch"
    subprocess.run(["bash", "-n", str(script)], check=True)
    line = next(line for line in script.read_text().splitlines() if line.startswith("exec penumbra "))
    words = ["x" if "$" in word else word for word in shlex.split(line)[2:]]
    _accepted(words, {"PENUMBRA_SCHEDULER": "tls://farm:8786"})
    program = (DEPLOY / "slurm.py").read_text()
    compile(program, "slurm.py", "exec")
    modules = re.findall(r"penumbra_service[.\w]+", program)
    of_dask = "penumbra_service.engine.dask."
    assert {of_dask + name for name in ("addresses", "config", "preload")} == set(modules)
    for module in modules:
        assert (ROOT / "service" / (module.replace(".", "/") + ".py")).is_file()


@pytest.mark.skipif(find_spec("dask_jobqueue") is None, reason="needs dask_jobqueue")
def test_dask_jobqueue_gets_a_job_that_starts_a_worker_of_the_farm(tmp_path) -> None:  # type: ignore[no-untyped-def]
    make_certs(tmp_path / "certs")
    words = ["--jobs", "1", "--tls", str(tmp_path / "certs"), "--port", "0", "--cpus", "8", "--script"]
    command = [sys.executable, str(DEPLOY / "slurm.py"), *words, "--queue", "gpu", "--walltime", "01:00:00"]
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=120)
    lines = done.stdout.splitlines()
    for option in ("-p gpu", "--cpus-per-task=8", "-t 01:00:00"):
        assert f"#SBATCH {option}" in lines
    assert "export POCL_MAX_PTHREAD_COUNT=8" in lines
    assert "export DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED=False" in lines
    (worker,) = (line for line in lines if "distributed.cli.dask_worker" in line)
    given = shlex.split(worker)
    assert given[given.index("--preload") + 1] == "penumbra_service.engine.dask.preload"
    assert given[given.index("--nthreads") + 1] == "1"
    assert "--no-nanny" in given
    assert any(word.startswith("tls://") for word in given)
    assert Path(given[given.index("--tls-key") + 1]).is_file()
