"""What log records say of the work at hand: fields that are bound to the thread (or coroutine) that does it.

Apart from logs.py, so that whoever binds fields does not import what writes them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from types import MappingProxyType
from typing import Any, Final

_NOTHING: Final[Mapping[str, Any]] = MappingProxyType({})
_fields: ContextVar[Mapping[str, Any]] = ContextVar("penumbra_log_fields", default=_NOTHING)


def bound_fields() -> Mapping[str, Any]:
    """What is bound here."""
    return _fields.get()


@contextmanager
def bind(**fields: Any) -> Iterator[None]:
    """Have records that are made within carry these fields too."""
    token = _fields.set({**_fields.get(), **fields})
    try:
        yield
    finally:
        _fields.reset(token)
