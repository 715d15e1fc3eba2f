"""Server-sent events, parsed as the WHATWG HTML standard says (section 9.2.6): pure, lines in, events out."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

_LINE_END: Final = re.compile("\r\n|\n|\r")


@dataclass(frozen=True)
class ServerEvent:
    """One event of a stream."""

    event: str
    """Its type; 'message' where the server names none."""
    data: str
    id: str
    """The last id that the stream has named; "" before the first."""
    retry_seconds: float | None = None
    """How long the server asks clients to wait before they reconnect, where it has said so by now."""


class Parser:
    """Feeds on lines without their ends; keeps the last id and retry time for a reconnection."""

    def __init__(self, last_id: str = "") -> None:
        self.last_id = last_id
        self.retry_seconds: float | None = None
        self._type = ""
        self._data: list[str] = []

    def reset(self) -> None:
        """Forget half an event: the connection that brought it is gone."""
        self._type, self._data = "", []

    def feed(self, line: str) -> ServerEvent | None:
        """The event that this line ends, if it is a blank line after data."""
        if not line:
            return self._dispatch()
        if line.startswith(":"):
            return None
        field, _, value = line.partition(":")
        self._set(field, value.removeprefix(" "))
        return None

    def _set(self, field: str, value: str) -> None:
        if field == "data":
            self._data.append(value)
        elif field == "event":
            self._type = value
        elif field == "id" and "\0" not in value:
            self.last_id = value
        elif field == "retry" and value.isascii() and value.isdigit():
            self.retry_seconds = int(value) / 1000

    def _dispatch(self) -> ServerEvent | None:
        data, kind = self._data, self._type or "message"
        self._data, self._type = [], ""
        if not data:
            return None
        return ServerEvent(kind, "\n".join(data), self.last_id, self.retry_seconds)


def parse(lines: Iterable[str]) -> Iterator[ServerEvent]:
    """The events of a finished stream; one without its closing blank line is dropped, says the standard."""
    parser = Parser()
    for number, line in enumerate(lines):
        event = parser.feed(line.removeprefix("\ufeff") if number == 0 else line)
        if event is not None:
            yield event


def lines(chunks: Iterable[bytes]) -> Iterator[str]:
    """The whole lines of a stream of UTF-8 bytes.

    They end with CR LF, LF or CR only; `str.splitlines` would also cut at characters that may stand in JSON.
    """
    decode = codecs.getincrementaldecoder("utf-8")(errors="replace").decode
    rest = ""
    after_return = False
    for chunk in chunks:
        text = decode(chunk)
        if after_return and text:
            text = text.removeprefix("\n")  # the second half of a CR LF whose first half has ended a line
            after_return = False
        after_return = after_return or text.endswith("\r")
        *whole, rest = _LINE_END.split(rest + text)
        yield from whole
