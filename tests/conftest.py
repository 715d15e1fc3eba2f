"""Fixtures for every test: each device test runs on each OpenCL device that is present."""

from __future__ import annotations

import os
from functools import lru_cache
from pathlib import Path

import pytest
from penumbra_kernels.device import Device, devices

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session", autouse=True)
def _own_program_cache(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Tests neither read nor fill the user's program cache, unless PENUMBRA_CACHE names one. Small kernels by the hundred
    stay in PoCL's own cache, so that a second run need not compile them."""
    os.environ.setdefault("POCL_CACHE_DIR", str(Path.home() / ".cache" / "pocl" / "kcache"))
    if "PENUMBRA_CACHE" not in os.environ:
        os.environ["PENUMBRA_CACHE"] = str(tmp_path_factory.mktemp("cache"))


@lru_cache
def _open(device_id: str) -> Device:
    return Device(device_id)


@pytest.fixture(scope="session", params=[info.id for info in devices()] or ["none"])
def device(request: pytest.FixtureRequest) -> Device:
    """An opened OpenCL device."""
    return _open(request.param)
