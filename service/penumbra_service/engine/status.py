"""A device as the API shows it."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from penumbra_scene.job import DeviceState, DeviceStatus

from penumbra_service.engine.protocol import DeviceDescription


def device_status(device: DeviceDescription, state: DeviceState, **more: Any) -> DeviceStatus:
    """`more`: further fields of DeviceStatus."""
    return DeviceStatus(**asdict(device), state=state, **more)
