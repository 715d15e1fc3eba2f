"""What a process waits for before it does its work: imports are counted, never timed."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest
from penumbra_service.engine.launch import be_frugal

HEAVY = (
    "numpy",
    "scipy",
    "pyopencl",
    "numba",
    "trimesh",
    "OpenImageIO",
    "fastapi",
    "uvicorn",
    "sqlalchemy",
    "alembic",
    "httpx",
)
TREE = "import sys, json; {}; print(json.dumps(sorted({{name.partition('.')[0] for name in sys.modules}})))"


def imported(code: str) -> set[str]:
    done = subprocess.run(
        [sys.executable, "-c", TREE.format(code)], capture_output=True, text=True, check=True
    )
    return set(json.loads(done.stdout.splitlines()[-1]))


SIMPLE = (
    "from penumbra_kernels.assets import NoAssets; from penumbra_kernels.compile.scene import compile_scene; "
    "from penumbra_scene.scene import Scene; scene = {'version': 1, 'camera': {'type': 'perspective', 'fov': 40}, "
    "'shapes': [{'type': 'sphere'}, {'type': 'quad', 'emission': {'radiance': 1}}], 'environment': {'type': 'constant'}}; "
    "compile_scene(Scene.model_validate(scene), NoAssets())"
)


@pytest.mark.parametrize(
    ("code", "unwanted"),
    [
        (
            "from penumbra_client.cli import make_parser; make_parser(None).format_help()",
            {*HEAVY, "pydantic"},
        ),
        ("import penumbra_service.engine.launch", {*HEAVY, "pydantic"}),
        (
            "import penumbra_service.engine.opencl",
            {"scipy", "numba", "trimesh", "OpenImageIO", "fastapi", "sqlalchemy"},
        ),
        (SIMPLE, {"scipy", "numba", "pyopencl"}),
        (
            "import penumbra_service.serving",
            {"scipy", "numba", "pyopencl", "trimesh", "alembic", "dask"},
        ),
        (
            "import penumbra_service.rendering",
            {"scipy", "numba", "pyopencl", "trimesh", "fastapi", "sqlalchemy", "rich", "asyncio"},
        ),
        (
            "from penumbra_client.cli.progress import ProgressView; ProgressView(quiet=True)",
            {*HEAVY, "rich"},
        ),
    ],
    ids=[
        "help",
        "the first device's start",
        "a device process",
        "a simple scene",
        "the HTTP process",
        "a render without a service",
        "progress that nobody sees",
    ],
)
def test_nothing_is_imported_that_is_not_needed_yet(code: str, unwanted: set[str]) -> None:
    assert not imported(code) & unwanted


def test_our_own_commands_are_found_without_reading_all_that_is_installed() -> None:
    code = (
        "from importlib import metadata; metadata.entry_points = None; "
        "from penumbra_client.cli import make_parser; make_parser('serve'); "
        "from penumbra_client.local import find_engine; assert find_engine('render').render"
    )
    imported(code)  # which fails where that is called


def test_a_devices_process_starts_no_threads_for_linear_algebra_and_looks_for_no_plugins() -> None:
    code = (
        "import os\nfrom penumbra_service.engine.launch import be_frugal\nbe_frugal()\n"
        "import numpy, penumbra_scene.scene\nfrom pydantic.plugin import _loader\n"
        "assert len(os.listdir('/proc/self/task')) == 1, os.listdir('/proc/self/task')\n"
        "assert list(_loader.get_plugins()) == []\n"
    )
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("OPENBLAS", "PYDANTIC", "OMP"))}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)


def test_what_the_environment_says_of_threads_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "3")
    monkeypatch.setenv("PYDANTIC_DISABLE_PLUGINS", "0")  # so that the test leaves nothing behind
    be_frugal()
    assert os.environ["OPENBLAS_NUM_THREADS"] == "3"
