"""`python -m penumbra_client` is the command `penumbra`."""

from penumbra_client.cli import program

program()
