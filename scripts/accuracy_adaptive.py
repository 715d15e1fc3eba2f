"""What the default sampler and adaptive sampling save: processor seconds of whole jobs to one relative error.

Jobs run as users' jobs do, with an error target as their stop rule, pilot and looking included. Seconds are those of all
processes, so that other work on the machine does not count. A job stops a little below its target, at a check point; its
seconds are told for the target itself by the exponent that its curve shows. `independent` is rendered to twice the least
target, and told for the others by its exact law: its variance falls as 1 / samples.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from penumbra_scene.adaptive import Adaptive
from penumbra_scene.scene import Scene
from penumbra_scene.settings import Stop
from penumbra_service.engine.protocol import Engine
from penumbra_service.engine.runner import JobRunner, RenderTask
from penumbra_service.engine.task import RunFailedError, RunResult
from penumbra_service.film.predict import fit_theta
from penumbra_service.rendering import assets_folder

VARIANTS: Final = {
    "sobol": ("sobol", None),
    "certified": ("sobol", Adaptive()),
    "fast": ("sobol", Adaptive(mode="fast")),
}
BASELINE: Final = "independent"
SEEDS: Final = (11,)
SETTLE_SECONDS: Final = 0.1
"""Devices that compute for less than half of it are idle."""


@dataclass(frozen=True)
class Job:
    """One render to an error."""

    seconds: float
    """Of all processes, at the target itself."""
    samples: float
    """A pixel, at the check point where it stopped."""
    pilot: int
    """Samples a pixel that only decided."""
    shadow_rays: int
    """Of the scene's, as many as paid; 0: nothing was decided."""


@dataclass(frozen=True)
class Saving:
    """Of one scene and target."""

    target: float
    independent: float
    """Processor seconds."""
    jobs: dict[str, Job]
    """By name of the variant; the mean over SEEDS."""
    shadow_rays: int
    """The scene's."""


def measure(engine: Engine, scene: Scene, beside: Path, targets: Sequence[float]) -> list[Saving]:
    """Raises RunFailedError, OSError."""
    loose = 2 * min(targets)
    for sampler, adaptive in ((BASELINE, None), *VARIANTS.values()):  # programs are built, devices are warm
        _run(engine, _asked(scene, sampler, adaptive, 0, Stop(samples=16)), beside)
    base = _mean([_job(engine, scene, beside, BASELINE, None, loose, seed, theta=1.0) for seed in SEEDS])
    found = []
    for target in targets:
        jobs = {
            name: _mean([_job(engine, scene, beside, *variant, target, seed) for seed in SEEDS])
            for name, variant in VARIANTS.items()
        }
        least = base.seconds * (loose / target) ** 2
        found.append(Saving(target, least, jobs, scene.integrator.shadow_rays))
    return found


def _asked(scene: Scene, sampler: str, adaptive: Adaptive | None, seed: int, stop: Stop) -> Scene:
    chosen = scene.sampler.model_copy(update={"type": sampler, "seed": seed, "replicates": None})
    return scene.model_copy(update={"sampler": chosen, "adaptive": adaptive, "stop": stop})


def _job(
    engine: Engine, scene: Scene, beside: Path, sampler: str, adaptive: Adaptive | None, target: float,
    seed: int, theta: float | None = None,
) -> Job:  # fmt: skip
    before = settled_seconds()
    asked = _asked(scene, sampler, adaptive, seed, Stop(relative_error=target))
    record = _run(engine, asked, beside).record
    spent = settled_seconds() - before
    last = record.points[-1]
    exponent = theta or fit_theta(record.points).theta
    use = record.adaptive
    decided = (use.pilot_samples, use.shadow_rays) if use else (0, 0)
    return Job(spent * (last.relmse / target**2) ** (1 / exponent), last.samples, *decided)


def _run(engine: Engine, scene: Scene, beside: Path) -> RunResult:
    with tempfile.TemporaryDirectory(prefix="penumbra-") as folder:
        task = RenderTask(
            "adaptive",
            scene,
            Path(folder),
            assets_folder=assets_folder(),
            scene_folder=beside,
            program="specialised",  # the first, short run builds what the others are timed with
        )
        result = JobRunner(engine, task).run()
    if result.failure is not None:
        raise RunFailedError(result.failure.kind, result.failure.message)
    return result


def _mean(jobs: Sequence[Job]) -> Job:
    n = len(jobs)
    means = (sum(j.seconds for j in jobs) / n, sum(j.samples for j in jobs) / n)
    return Job(*means, jobs[0].pilot, jobs[0].shadow_rays)


def settled_seconds() -> float:
    """processor_seconds once the devices have done what was asked of them: work that a job had begun, and dropped as it
    stopped, is the job's own."""
    before = processor_seconds()
    while True:
        time.sleep(SETTLE_SECONDS)
        now = processor_seconds()
        if now - before < SETTLE_SECONDS / 2:
            return now
        before = now


def processor_seconds() -> float:
    """Of this process and all below it, as Linux counts them in /proc."""
    tick = os.sysconf("SC_CLK_TCK")
    below, waiting = 0.0, _children(os.getpid())
    while waiting:
        pid = waiting.pop()
        waiting += _children(pid)
        try:
            words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        below += (int(words[11]) + int(words[12])) / tick
    return time.process_time() + below


def _children(pid: int) -> list[int]:
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            found += [int(word) for word in task.read_text().split()]
        except OSError:
            continue
    return found
