"""Measured blocks of documents: what stands between two marks belongs to the target that wrote it."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Iterable
from pathlib import Path

DOCUMENT = Path(__file__).resolve().parents[1] / "docs" / "farm.md"


def write_block(target: str, text: str, document: Path = DOCUMENT) -> None:
    """Put `text` into the block of `make target`. Raises ValueError where the document has none."""
    begin, end = f"<!-- written by make {target} -->", f"<!-- end of make {target} -->"
    before = document.read_text()
    after, count = re.subn(
        f"{re.escape(begin)}.*?{re.escape(end)}", lambda _: f"{begin}\n{text}\n{end}", before, flags=re.DOTALL
    )
    if count != 1:
        raise ValueError(f"{document.name} has {count} blocks {begin}")
    document.write_text(after)


def table(head: Iterable[object], rows: Iterable[Iterable[object]]) -> str:
    """Markdown."""
    heads = [str(cell) for cell in head]
    lines = [heads, ["---"] * len(heads), *([str(cell) for cell in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def processor() -> str:
    """This machine's, with its cores."""
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return f"{line.split(':', 1)[1].strip()}, {os.cpu_count()} cores"
    return platform.processor()
