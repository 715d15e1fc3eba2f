"""Limits that keep bad input from harming the service. Every error that they cause names them."""

from typing import Final

MAX_MAGNITUDE: Final = 1e18
"""Largest absolute value of any number in a scene: its square is still a float32."""
MIN_DIRECTION: Final = 1e-18
MIN_SCALE: Final = 1e-12
MAX_PIXELS: Final = 64 * 1024 * 1024
MAX_RESOLUTION: Final = 32768
MAX_SAMPLES: Final = 1 << 30
MAX_PILOT_SAMPLES: Final = 4096
MAX_SECONDS: Final = 7 * 24 * 3600
MAX_BOUNCES: Final = 65535
MAX_SHADOW_RAYS: Final = 1024
MAX_SHAPES: Final = 1_000_000
MAX_LIGHTS: Final = 1_000_000
MAX_TRIANGLES: Final = 50_000_000
MAX_KEYFRAMES: Final = 4096
MAX_TEXTURES: Final = 1024
MAX_MATERIALS: Final = 65536
MAX_ALBEDO_TABLES: Final = 1024
"""Different (kind, roughness, anisotropy, index of refraction) of rough materials: each costs some time."""
MAX_PROTOTYPES: Final = 65536
MAX_FRAMES: Final = 10_000
"""Of one job."""
MAX_STEPS: Final = 64
MAX_ERRORS: Final = 50
"""Errors that one answer lists."""
MAX_TEXTURE_SIDE: Final = 16384
MAX_TEXELS: Final = 1 << 27
"""Pixels of all of a scene's textures together: 2 GiB on the device."""
MAX_BODY_BYTES: Final = 64 * 1024 * 1024
MAX_ASSET_BYTES: Final = 2 * 1024 * 1024 * 1024
