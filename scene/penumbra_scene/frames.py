"""Ranges of frames as people write them: "12", "1-240", "1-240x2" (every second one), and lists "1,5,10-20"."""

from __future__ import annotations

import re
from typing import Final

from penumbra_scene import limits

PATTERN: Final = r"^[0-9]{1,7}(-[0-9]{1,7}(x[0-9]{1,5})?)?(,[0-9]{1,7}(-[0-9]{1,7}(x[0-9]{1,5})?)?)*$"
ACCEPTED: Final = f'such as "12", "1-240", "1-240x2" or "1,5,10-20", at most {limits.MAX_FRAMES} frames'
_PART: Final = re.compile(r"(\d+)(?:-(\d+)(?:x(\d+))?)?")


class FramesError(ValueError):
    """The text means no frames; the message says which part of it, and why."""


def parse_frames(text: str) -> tuple[int, ...]:
    """The frames, in order and each once. Raises FramesError."""
    found: set[int] = set()
    for part in text.split(","):
        match = _PART.fullmatch(part)
        if match is None:
            raise FramesError(f"{part!r} is no frame and no range")
        found.update(_range(part, *match.groups()))
        if len(found) > limits.MAX_FRAMES:
            raise FramesError(f"more than {limits.MAX_FRAMES} frames")
    return tuple(sorted(found))


def is_range(text: str) -> bool:
    """Whether it stands for a sequence of pictures; a lone number stands for one."""
    return not text.isdecimal()


def _range(part: str, first_text: str, last_text: str | None, step_text: str | None) -> range:
    first = int(first_text)
    last = first if last_text is None else int(last_text)
    step = 1 if step_text is None else int(step_text)
    if last < first:
        raise FramesError(f"{part!r} ends before it begins")
    if step < 1:
        raise FramesError(f"{part!r} has no step of at least 1")
    if (last - first) // step >= limits.MAX_FRAMES:
        raise FramesError(f"{part!r} has more than {limits.MAX_FRAMES} frames")
    return range(first, last + 1, step)
