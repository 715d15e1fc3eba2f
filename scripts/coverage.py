"""`make test-statistics`: renders many seeds of scenes with known means, and writes docs/coverage.md from them.

The claims are those of tests/statistical; what they measured is written down whether they hold or not.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from penumbra_service.film.replicates import DEFAULT_REPLICATES

ROOT: Final = Path(__file__).resolve().parent.parent
PAGE: Final = ROOT / "docs" / "coverage.md"
NUMBERS: Final = ROOT / "docs" / "pictures" / "coverage.json"
SAMPLERS: Final = ("random", "independent", "stratified", "jittered", "sobol", "blue_noise")
SCENES: Final = ("edge", "lamp", "penumbra")
LEVELS: Final = (50, 80, 90, 95, 99)


def main() -> int:
    """The exit status of the tests."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1000, help="renders of each scene (default 1000)")
    parser.add_argument("--page-only", action="store_true", help="write the page from the last run's numbers")
    arguments = parser.parse_args()
    status = 0
    if not arguments.page_only:
        status = measure(arguments.seeds)
    PAGE.write_text("\n".join(page(json.loads(NUMBERS.read_text()))) + "\n")
    return status


def measure(seeds: int) -> int:
    """Run the tests; their numbers go to NUMBERS."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        found = Path(folder) / "found.json"
        environment = {
            **os.environ,
            "PENUMBRA_SEEDS": str(seeds),
            "PENUMBRA_STATISTICS": str(found),
            "PENUMBRA_STATISTICS_PROGRAM": "specialised",
        }
        command = [sys.executable, "-m", "pytest", "-q", "--timeout", "1200", "tests/statistical"]
        status = subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode
        numbers = json.loads(found.read_text())
    numbers["run"] = {
        "day": time.strftime("%Y-%m-%d"), "processor": _processor(), "seconds": time.monotonic() - began,
        "seeds": seeds, "replicates": DEFAULT_REPLICATES, "passed": status == 0,
    }  # fmt: skip
    NUMBERS.write_text(json.dumps(numbers, indent=1, sort_keys=True) + "\n")
    return status


def _processor() -> str:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return "an unnamed processor"


def page(numbers: dict[str, Any]) -> Iterator[str]:
    """Lines of Markdown."""
    run = numbers["run"]
    yield "# Do the error bars hold?"
    yield ""
    yield (
        f"Measured by `make test-statistics` on {run['day']} ({run['processor']}, {run['seconds']:.0f} s): {run['seeds']} "
        f"seeds of small scenes whose true pixels are known in closed form, 32 x 32 pixels, {run['replicates']} replicates. "
        + ("All claims hold." if run["passed"] else "**Some claims of the tests do not hold.**")
    )
    yield from _failing(numbers)
    yield from _coverage(numbers)
    yield from _ratios(numbers)
    yield from _stop(numbers)
    yield from _forecasts(numbers)
    yield from _scenes()


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    yield ""
    yield "| " + " | ".join(head) + " |"
    yield "|" + "---|" * len(head)
    for row in rows:
        yield "| " + " | ".join(row) + " |"
    yield ""


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def _failing(numbers: dict[str, Any]) -> Iterator[str]:
    yield ""
    yield "## Where they fail"
    yield ""
    yield (
        "`fireflies`: a spark that one sample in a thousand meets, a thousand times as bright as the rest. V is right **on "
        "average**, and wrong in nearly every pixel: without the spark it is far too small, with it the interval is one of "
        "few samples. Nearly all pixels are flagged; the few that are not have seen no spark, look calm, and are all wrong. "
        "Nothing can tell them from pixels without sparks."
    )
    yield (
        "`edge`: blocks at an edge have pixels of which the shape covers a sliver. They are flagged almost everywhere; what "
        "is left over are slivers too, and below the promise."
    )
    rows = []
    for scene, sampler in (("fireflies", "independent"), ("edge", "independent"), ("edge", "sobol")):
        for samples in (32, 128):
            found = numbers.get(f"{scene} {sampler} {samples}")
            if found is not None:
                rows.append(
                    [
                        f"`{scene}`", f"`{sampler}`", str(samples), f"{found['ratio']:.3f}",
                        _percent(found["flagged_share"]), _percent(found["coverage"][3]),
                        _percent(found["coverage_flagged"]),
                    ]
                )  # fmt: skip
    head = ["scene", "sampler", "samples", "estimated / real variance", "flagged", "95 % covers, unflagged"]
    yield from _table([*head, "95 % covers, flagged"], rows)


def _coverage(numbers: dict[str, Any]) -> Iterator[str]:
    yield "## Coverage and calibration"
    yield ""
    yield (
        "`penumbra`, a soft shadow, 128 samples: how many unflagged pixels an interval of each confidence covers. Promised: "
        "95 +- 2 % at 95 %. `stratified` is measured against its own mean, since its fixed positions make another picture."
    )
    rows = []
    for sampler in SAMPLERS:
        found = numbers.get(f"penumbra {sampler} 128")
        if found is not None:
            covered = [_percent(c) for c in found["coverage"]]
            rows.append(
                [
                    f"`{sampler}`",
                    *covered,
                    _percent(found["flagged_share"]),
                    _percent(found["coverage_flagged"]),
                ]
            )
    yield from _table(["sampler", *(f"{n} %" for n in LEVELS), "flagged", "95 % covers, flagged"], rows)


def _ratios(numbers: dict[str, Any]) -> Iterator[str]:
    yield "## Estimated over real variance"
    yield ""
    yield (
        "32 samples, pooled over pixels whose samples differ; 0.9 to 1.1 is the claim. In brackets: what 95 % covers, "
        "unflagged. `stratified` has no noise at an edge: its positions are fixed."
    )
    rows = []
    for sampler in SAMPLERS:
        cells = []
        for scene in SCENES:
            found = numbers.get(f"{scene} {sampler} 32")
            blank = "no noise" if (scene, sampler) == ("edge", "stratified") else ""
            cells.append(
                blank if found is None else f"{found['ratio']:.3f} ({_percent(found['coverage'][3])})"
            )
        rows.append([f"`{sampler}`", *cells])
    yield from _table(["sampler", *(f"`{scene}`" for scene in SCENES)], rows)


def _stop(numbers: dict[str, Any]) -> Iterator[str]:
    yield "## Stopping at an error"
    yield ""
    yield (
        "Renders that stop by themselves at a relative error. Bias: of the picture's mean against the closed form, 1 % is the "
        "claim. Claimed over real: the mean squared error that the stopped render claims over the real one."
    )
    rows = []
    for key, found in sorted(numbers.items()):
        if key.startswith("stop "):
            _, scene, sampler = key.split()
            low, middle, high = found["samples"]
            rows.append(
                [
                    f"`{scene}`", f"`{sampler}`", _percent(found["target"]),
                    f"{100 * found['bias']:+.3f} % +- {100 * found['bias_deviation']:.3f}",
                    f"{found['claimed_over_real']:.3f}", f"{low:.0f}, {middle:.0f}, {high:.0f}",
                ]
            )  # fmt: skip
    yield from _table(
        ["scene", "sampler", "target", "bias", "claimed / real", "samples: least, median, most"], rows
    )


def _forecasts(numbers: dict[str, Any]) -> Iterator[str]:
    found: dict[str, tuple[float, float]] = numbers.get("forecasts", {})
    ratios = {name: told / real if real else 0.0 for name, (told, real) in found.items()}
    held = [name for name, ratio in ratios.items() if 1 / 1.5 <= ratio <= 1.5]
    yield "## Forecasts, in samples"
    yield ""
    share = len(held) / max(len(found), 1)
    yield (
        f"What a render foretells at 128 samples for half of its error, over the example scenes: {_percent(share)} within "
        "x1.5 of what was needed; 80 % is the claim. [Accuracy](accuracy.md) has them in seconds. Those that miss come first."
    )
    order = sorted(found, key=lambda name: (name in held, abs(ratios[name] - 1)))
    rows = [
        [
            f"`{n}`",
            f"{found[n][0]:.0f}",
            _real(found[n][1]),
            f"{ratios[n]:.2f}" if n in held else f"**{ratios[n]:.2f}**",
        ]
        for n in order
    ]
    yield from _table(["scene", "foretold", "needed", "ratio"], rows)


def _real(samples: float) -> str:
    return "more than 2048" if samples == float("inf") else f"{samples:.0f}"


def _scenes() -> Iterator[str]:
    yield "## The scenes"
    yield ""
    yield "| scene | what it shows | its true pixels |"
    yield "|---|---|---|"
    yield "| `edge` | a glowing parallelogram before black | the share of the pixel that it covers, by clipping polygons |"
    yield "| `lamp` | a floor beside a rectangular lamp | Lambert's formula for polygons, 36 Gauss-Legendre points a pixel |"
    yield "| `penumbra` | the same floor behind a wall | the same with the lamp clipped by the plane through the wall's edge |"
    yield "| `fireflies` | a glowing ground with sparks of 1/1000 of each pixel | 0.999 + 1 |"
    yield ""
    yield "Pixels whose samples cannot differ (inside and outside of the parallelogram, in full shadow) are left out."


if __name__ == "__main__":
    sys.exit(main())
