"""Server-sent events are read as the WHATWG standard says."""

from __future__ import annotations

import pytest
from penumbra_client.sse import Parser, ServerEvent, lines, parse


def _events(text: str) -> list[ServerEvent]:
    return list(parse(text.splitlines()))


def test_blank_line_ends_an_event() -> None:
    assert _events("event: job\ndata: {}\nid: 7\n\n") == [ServerEvent("job", "{}", "7")]


def test_lines_of_data_are_joined_by_newlines() -> None:
    # The standard's own example.
    assert [e.data for e in _events("data: YHOO\ndata: +2\ndata: 10\n\n")] == ["YHOO\n+2\n10"]


def test_only_one_space_after_the_colon_is_dropped() -> None:
    assert [e.data for e in _events("data:test\n\ndata: test\n\ndata:  test\n\n")] == [
        "test",
        "test",
        " test",
    ]


def test_comments_and_unknown_fields_are_ignored() -> None:
    assert [e.data for e in _events(": keep-alive\nflavour: sweet\ndata: x\n\n")] == ["x"]


def test_an_event_without_data_is_not_dispatched_and_leaves_no_type_behind() -> None:
    assert [e.event for e in _events("event: lost\n\ndata: x\n\n")] == ["message"]


def test_an_event_that_the_stream_breaks_off_is_dropped() -> None:
    assert _events("data: whole\n\ndata: half\n") == [ServerEvent("message", "whole", "")]


def test_field_without_colon_has_an_empty_value() -> None:
    # The standard's example: 'data' twice gives one newline; the event before it is empty data.
    assert [e.data for e in _events("data\n\ndata\ndata\n\n")] == ["", "\n"]


def test_byte_order_mark_is_stripped_once() -> None:
    assert [e.data for e in parse(["\ufeffdata: x", ""])] == ["x"]


def test_last_id_survives_events_without_one_and_an_empty_id_resets_it() -> None:
    assert [e.id for e in _events("id: 1\ndata: a\n\ndata: b\n\nid\ndata: c\n\n")] == ["1", "1", ""]


def test_id_with_nul_is_ignored() -> None:
    assert [e.id for e in _events("id: 1\ndata: a\n\nid: 2\x003\ndata: b\n\n")] == ["1", "1"]


@pytest.mark.parametrize(("value", "seconds"), [("1500", 1.5), ("soon", None), ("-1", None), ("", None)])
def test_retry_takes_digits_only(value: str, seconds: float | None) -> None:
    assert [e.retry_seconds for e in _events(f"retry: {value}\ndata: x\n\n")] == [seconds]


def test_parser_keeps_the_id_to_reconnect_with() -> None:
    parser = Parser(last_id="3")
    parser.feed("id: 4")
    assert parser.last_id == "4"


@pytest.mark.parametrize("size", [1, 2, 3, 100])
def test_lines_end_as_the_standard_says_wherever_chunks_end(size: int) -> None:
    text = "a\r\nb\rc\n\n\r\r\nd e\u2028f\x85g\nlost"
    chunks = [text[i : i + size].encode() for i in range(0, len(text), size)]
    assert list(lines(chunks)) == ["a", "b", "c", "", "", "", "d e\u2028f\x85g"]


def test_characters_may_be_cut_by_chunks() -> None:
    data = "data: \u20ac\n".encode()
    assert list(lines([data[:7], data[7:8], data[8:]])) == ["data: \u20ac"]


def test_a_line_is_given_as_soon_as_its_end_is_there() -> None:
    # A carriage return ends a line at once: waiting for a newline behind it would hold back the last event.
    source = iter([b"data: x\r\r", b"\n"])
    stream = lines(source)
    assert [next(stream), next(stream)] == ["data: x", ""]
