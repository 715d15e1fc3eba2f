"""`python -m penumbra_client` is the command `penumbra`."""

import sys

from penumbra_client.cli import main

sys.exit(main())
