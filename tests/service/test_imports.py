"""What a process waits for before it does its work: imports are counted, never timed."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

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
            {"scipy", "numba", "pyopencl", "trimesh", "fastapi", "sqlalchemy"},
        ),
    ],
    ids=[
        "help",
        "the first device's start",
        "a device process",
        "a simple scene",
        "the HTTP process",
        "a render without a service",
    ],
)
def test_nothing_is_imported_that_is_not_needed_yet(code: str, unwanted: set[str]) -> None:
    assert not imported(code) & unwanted
