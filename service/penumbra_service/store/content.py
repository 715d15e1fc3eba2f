"""Where an asset's bytes lie: the one rule by which uploads are filed and decoders find them."""

from __future__ import annotations

from pathlib import Path
from typing import Final

DIGEST_DIGITS: Final = 64


class NoSuchAssetError(LookupError):
    """No asset has this SHA-256."""


def asset_file(folder: Path, sha256: str) -> Path:
    """The file of an asset, whether it exists or not, in one of 256 folders. `sha256` is 64 hexadecimal
    digits.

    Raises NoSuchAssetError for what is no digest, so that no path can leave the folder.
    """
    if len(sha256) != DIGEST_DIGITS or any(c not in "0123456789abcdef" for c in sha256):
        raise NoSuchAssetError(sha256)
    return folder / sha256[:2] / sha256
