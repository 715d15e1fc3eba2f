"""Which leases are computed twice, by different devices, and who is wrong where they differ. Pure.

A broken device gives garbage silently. Devices of one bit class owe the same bits for the same lease, so that any two of
them can be compared; where they differ a third decides, and more if it must. The first lease of every device on a job is
checked, so that one that is always wrong is found at once, and a share of all others.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

from penumbra_kernels.nodes import SumNode

from penumbra_service.jobs.planning import WorkItem

Key = tuple[str, str]
"""A device: (id, bit class)."""


@dataclass
class Check:
    """One lease's work, and what devices have answered to it."""

    number: int
    items: tuple[WorkItem, ...]
    bit_class: str
    answers: dict[str, bytes] = field(default_factory=dict)
    """Digest of the nodes by device."""
    out: str | None = None
    """Who works on it."""

    @property
    def disputed(self) -> bool:
        """Whether answers differ."""
        return len(set(self.answers.values())) > 1

    def suits(self, device: Key) -> bool:
        """Whether this device's answer would tell something."""
        return device[1] == self.bit_class and device[0] not in self.answers


def digest_of(nodes: Iterable[SumNode]) -> bytes:
    """Equal for equal bits."""
    digest = hashlib.blake2b(digest_size=16)
    for node in nodes:
        digest.update(node.sums.tobytes())
        if node.layers is not None:
            digest.update(node.layers.tobytes())
    return digest.digest()


class DoubleChecks:
    """All checks of one run. Not thread-safe: its owner holds a lock."""

    def __init__(self, job: str, share: float) -> None:
        """`share` of leases to check, 0 to 1; with 0 nothing is."""
        self._job = job
        self._share = share
        self._seen: set[str] = set()
        self._open: dict[int, Check] = {}
        self._next = 1
        self.done = 0
        """Checks that were decided."""

    def wants(self, device: str, lease: int) -> bool:
        """Whether this lease of a device is to be checked."""
        if self._share <= 0:
            return False
        first = device not in self._seen
        self._seen.add(device)
        draw = hashlib.sha256(f"{self._job}/{lease}".encode()).digest()
        return first or int.from_bytes(draw[:8], "little") < self._share * 2**64

    def open(self, device: Key, items: tuple[WorkItem, ...], digest: bytes) -> None:
        """Have another device of this one's bit class do this work as well."""
        self._open[self._next] = Check(self._next, items, device[1], {device[0]: digest})
        self._next += 1

    def take(self, device: Key) -> Check | None:
        """Work for a device, if it can help; disputes go first."""
        fitting = [c for c in self._open.values() if c.out is None and c.suits(device)]
        if not fitting:
            return None
        check = max(fitting, key=lambda c: (c.disputed, -c.number))
        check.out = device[0]
        return check

    def lost(self, number: int) -> None:
        """Whoever worked on it will not answer."""
        if number in self._open:
            self._open[number].out = None

    def answered(self, number: int, device: str, digest: bytes) -> list[str]:
        """A device's answer; the devices that are proven wrong by it."""
        check = self._open.get(number)
        if check is None:
            return []
        check.out = None
        check.answers[device] = digest
        (right, votes), *_ = Counter(check.answers.values()).most_common()
        if votes < 2:
            return []
        del self._open[number]
        self.done += 1
        return [name for name, answer in check.answers.items() if answer != right]

    def drop(self) -> None:
        """What is open cannot be decided any more: its samples are void."""
        self._open.clear()

    def forget(self, device: str) -> None:
        """A device's answers count no more."""
        for number, check in list(self._open.items()):
            check.answers.pop(device, None)
            if check.out == device:
                check.out = None
            if not check.answers:
                del self._open[number]

    def pending(self, devices: Iterable[Key]) -> bool:
        """Whether some check can still be decided by one of these devices."""
        present = list(devices)
        names = {device[0] for device in present}
        return any(
            check.out in names or any(check.suits(device) for device in present)
            for check in self._open.values()
        )

    @property
    def disputes(self) -> list[tuple[str, ...]]:
        """Devices that contradict each other in checks that are not decided."""
        return [tuple(check.answers) for check in self._open.values() if check.disputed]
