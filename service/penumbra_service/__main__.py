"""`python -m penumbra_service` serves with the settings of the environment; `penumbra serve` has flags."""

from __future__ import annotations

import sys

from penumbra_service.serve import run
from penumbra_service.settings import SettingsError


def main() -> int:
    """The exit status: 0 after a regular end, 2 for settings that cannot be used."""
    try:
        return run()
    except (SettingsError, OSError) as error:
        print(f"penumbra_service: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
