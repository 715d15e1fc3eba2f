"""Identifiers that sort by time of creation: ULIDs (48 bits of milliseconds, 80 random, Crockford's base
32)."""

from __future__ import annotations

import re
import secrets
import threading
import time
from typing import Final

ALPHABET: Final = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"
RANDOM_BITS: Final = 80
LENGTH: Final = 26
_PATTERN: Final = re.compile(f"[0-7][{ALPHABET}]{{{LENGTH - 1}}}")


def encode(value: int) -> str:
    """128 bits as 26 characters, the most significant first, so that text sorts as numbers do."""
    digits = []
    for _ in range(LENGTH):
        value, digit = divmod(value, 32)
        digits.append(ALPHABET[digit])
    return "".join(reversed(digits))


def is_id(text: str) -> bool:
    """Whether the text could be an identifier made here."""
    return _PATTERN.fullmatch(text) is not None


class IdMaker:
    """Makes identifiers that rise strictly within one process, even when its clock goes back."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last = 0

    def __call__(self) -> str:
        fresh = (time.time_ns() // 1_000_000) << RANDOM_BITS | secrets.randbits(RANDOM_BITS)
        with self._lock:
            self._last = max(fresh, self._last + 1)
            return encode(self._last)


new_id: Final = IdMaker()
