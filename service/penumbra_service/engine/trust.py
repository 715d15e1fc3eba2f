"""Which devices a run works with, what it has from each, and what follows when one fails or gives wrong sums.

One thread, the run's. The rules are jobs/blame.py's and jobs/doublecheck.py's; the record keeps what a restart must know.
"""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable
from typing import Literal

from penumbra_kernels.nodes import Tile

from penumbra_service.engine.desk import LeaseDesk
from penumbra_service.engine.protocol import DeviceDescription, LeaseResult
from penumbra_service.engine.standing import Standing
from penumbra_service.engine.task import RunFailedError
from penumbra_service.jobs.blame import Blame, Verdict
from penumbra_service.jobs.record import DeviceUse, RunRecord

log = logging.getLogger(__name__)

Why = Literal["build", "failures", "wrong"]


class Trust:
    """Of one run. `usable`: the engine's devices; `standing`: what the job's runs share, of which this is `run`."""

    def __init__(
        self,
        record: RunRecord,
        desk: LeaseDesk,
        usable: Callable[[], Iterable[DeviceDescription]],
        standing: Standing,
        run: str,
    ) -> None:
        self._record = record
        self._desk = desk
        self._usable = usable
        self._standing = standing
        self._run = run
        self._blame = Blame()
        self._touched: dict[str, set[Tile]] = defaultdict(set)
        uses = record.devices.values()
        self._earlier = {use.id for use in uses if use.leases}
        """Devices whose tiles an earlier run did not write down."""
        self._wrong = {use.id for use in uses if use.blocked == "wrong"}
        for use in uses:
            standing.failed(run, use.id, use.failures)
            if use.blocked:
                desk.exclude(use.id)
                standing.block(use.id)

    def believes(self, device: DeviceDescription) -> bool:
        """Whether its answers count."""
        return device.id not in self._wrong

    def use_of(self, device: DeviceDescription) -> DeviceUse:
        """Its account in the record."""
        key = f"{device.id} {device.bit_class}"
        if key not in self._record.devices:
            self._record.devices[key] = DeviceUse(
                device.id, device.name, device.platform, device.driver, device.bit_class
            )
        return self._record.devices[key]

    def spent(self, device: DeviceDescription, result: LeaseResult) -> None:
        """It has worked on a lease, or on a check of one."""
        self.use_of(device).seconds += result.seconds
        self._record.trace_seconds += result.seconds
        self._blame.delivered()

    def delivered(self, device: DeviceDescription, result: LeaseResult) -> None:
        """Its lease goes into the picture."""
        self.spent(device, result)
        self.use_of(device).leases += 1
        self._touched[device.id].update(node.tile for node in result.nodes)

    def refused_to_build(self, device: DeviceDescription, message: str) -> None:
        """Its compiler takes no part in this job. Raises RunFailedError where no device is left."""
        first = self._desk.exclude(device.id)
        if not self._desk.allowed(self._usable()):
            raise RunFailedError("build", message)
        if first:
            self._block(
                self.use_of(device), "build", f"device {device.id} was left out: {_first_line(message)}"
            )

    def failed(self, device: DeviceDescription, reason: str, tried: Collection[str]) -> None:
        """It died, hung or refused; its lease's work has failed on `tried`. Raises RunFailedError where the job is
        to blame, or no device is left."""
        use = self.use_of(device)
        if use.blocked:  # its other lease, under way when it was blocked
            return
        use.failures += 1
        failures = self._standing.failed(self._run, device.id, use.failures)
        verdict = self._blame.failed(device.id, failures, tried)
        if verdict is Verdict.BLOCK:
            self._desk.exclude(device.id)
            told = f"device {device.id} was left out after {failures} failures: {_first_line(reason)}"
            self._block(use, "failures", told)
        if verdict is Verdict.FAIL or (verdict is Verdict.BLOCK and not self._desk.allowed(self._usable())):
            told = f"{self._record.crashes} device processes ended under this job; the last: {reason}"
            if verdict is Verdict.BLOCK:
                self._standing.over = told
            raise RunFailedError("crash", told)

    def disbelieve(self, device: str) -> set[Tile] | None:
        """It gave other sums than two others: whatever it has done is void. The tiles that hold some of it; None: any
        may."""
        self._wrong.add(device)
        self._desk.disbelieve(device)
        for use in self._record.devices.values():
            if use.id == device:
                self._record.redone_leases += use.leases
                told = f"device {device} gave other sums than two others for the same samples: its work was done again"
                self._block(use, "wrong", told)
        return None if device in self._earlier else self._touched.pop(device, set())

    def demand_device(self) -> None:
        """Raises RunFailedError where another frame has blocked the last device."""
        if self._standing.over is not None:
            raise RunFailedError("crash", self._standing.over)

    def settle(self) -> None:
        """The picture is about to be finished. Raises RunFailedError where devices contradict each other and nobody
        can tell which is right."""
        for devices in self._desk.disputes:
            raise RunFailedError(
                "device",
                f"devices {' and '.join(devices)} give different sums for the same samples, and no other of their bit "
                "class is here to tell which is right: check them, or leave one out",
            )

    def _block(self, use: DeviceUse, why: Why, told: str) -> None:
        use.blocked = why
        self._standing.block(use.id)
        self._record.warnings.append(told)
        log.warning("%s", told)


def _first_line(text: str) -> str:
    return text.splitlines()[0] if text else ""
