"""`python -m penumbra_service` serves with the settings of the environment; `penumbra serve` has flags for them."""

from __future__ import annotations

import sys

from penumbra_service.serve import run
from penumbra_service.settings import SettingsError


def main() -> int:
    """The exit code: 0 after a regular end, 2 for settings that cannot be used."""
    try:
        run()
    except SettingsError as error:
        print(f"penumbra_service: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
