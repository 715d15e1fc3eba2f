"""A device process as the service starts it, whose scenes have one light with a radiance of NaN (which no scene can say)."""

from __future__ import annotations

from typing import Any

import numpy as np
from penumbra_service.engine import device_process, opencl

_compile = opencl.compile_scene


def _poisoned(*arguments: Any, **keys: Any) -> Any:
    compiled = _compile(*arguments, **keys)
    compiled.arrays["lights"]["radiance"][1] = np.nan
    return compiled


if __name__ == "__main__":
    opencl.compile_scene = _poisoned  # type: ignore[assignment]
    device_process.main(opencl.OpenCLBackend())
