"""docs/effects.md and its plot, from what effects.py measured."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from clock import cores
from penumbra_kernels.device import Device
from penumbra_scene.measured import EffectsMeasured

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PLOT: Final = Path(__file__).resolve().parent.parent / "docs" / "pictures" / "effects.png"
LARGE: Final = 1.1
"""Speed of a specialised program against the generic one that the page calls large, and `NOTHING` where it calls it none."""
NOTHING: Final = 1.02
PROMISED: Final = 0.98


@dataclass(frozen=True)
class Ratio:
    """A median, and its 95 % interval."""

    value: float
    low: float
    high: float

    def more(self) -> str:
        """As so many per cent more."""
        return (
            f"{100 * self.value - 100:+.1f} % ({100 * self.low - 100:+.1f} to {100 * self.high - 100:+.1f})"
        )


@dataclass(frozen=True)
class NoiseCheck:
    """The whole of a scene's noise by pick-freeze, and by the spread of replicates that a film sees, on the same blocks."""

    whole: float
    """Over the film's."""
    error: float
    """Its standard error, from differences by block."""
    lowest: float
    """The lowest share, in its own standard errors."""

    @property
    def deviations(self) -> float:
        return (self.whole - 1) / self.error if self.error > 0 else 0.0


@dataclass(frozen=True)
class Row:
    """One example, by its own program and by the generic one."""

    name: str
    effects: int
    microseconds: tuple[float, float]
    """Of a camera path, CPU."""
    speed: Ratio
    """Own over generic."""
    cold: tuple[float, float]
    """Seconds of compiling."""
    warm: float
    bytes: tuple[int, int]
    numbers: tuple[int, int]
    """At most, for the camera's ray and for a hit."""
    drawn: float
    rays: float
    """Of a camera path."""
    noise: NoiseCheck | None
    """None: the sampler has none."""

    @property
    def gain(self) -> float:
        return self.speed.value


def table(rows: Sequence[Row]) -> list[str]:
    lines = [
        "| scene | effects in | CPU us a path: own | generic | own is faster by (95 %) | compile cold, s: own | generic "
        "| warm, ms | scene data, KiB: own | generic | numbers at most | drawn a path | rays a path | noise whole / film's |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| `{row.name}` | {row.effects} | {row.microseconds[0]:.3f} | {row.microseconds[1]:.3f} "
        f"| {row.gain:.2f} ({row.speed.low:.2f}-{row.speed.high:.2f}) "
        f"| {row.cold[0]:.2f} | {row.cold[1]:.2f} | {1e3 * row.warm:.0f} | {row.bytes[0] / 1024:.1f} "
        f"| {row.bytes[1] / 1024:.1f} | {row.numbers[0]} + {row.numbers[1]} | {row.drawn:.1f} | {row.rays:.2f} "
        f"| {'' if row.noise is None else f'{row.noise.whole:.2f} +- {row.noise.error:.2f}'} |"
        for row in rows
    ]
    return lines


def _names(rows: Sequence[Row]) -> str:
    return ", ".join(f"`{row.name}` {row.gain:.2f}" for row in rows) or "none"


def findings(rows: Sequence[Row]) -> list[str]:
    """What is large and what is nothing, by the numbers of this run."""
    by_gain = sorted(rows, key=lambda row: -row.gain)
    large = [row for row in by_gain if row.gain >= LARGE]
    nothing = [row for row in by_gain if PROMISED <= row.gain < NOTHING]
    slower = [row for row in by_gain if row.gain < PROMISED]
    ratios = [row.cold[0] / row.cold[1] for row in rows]
    saved = [1 - row.bytes[0] / row.bytes[1] for row in rows]
    return [
        f"- **Time to trace.** Large (a tenth and more) in {len(large)} of {len(rows)} scenes: {_names(large)}.",
        f"- Next to nothing (less than 2 %) in {len(nothing)}: {_names(nothing)}.",
        f"- Slower than {PROMISED} of the generic program: {_names(slower)}.",
        f"- **Compiling.** A scene's own program takes {min(ratios):.2f} to {max(ratios):.2f} of the generic one's time.",
        f"- **Scene data.** {100 * min(saved):.1f} to {100 * max(saved):.1f} % less: nothing beside meshes and textures; what "
        "counts is that an effect that is out has no buffer at all.",
        "- **Random numbers.** A pinhole draws no lens, a still scene no time, a single light no choice, a mirror no lobe: the "
        "columns give them for the camera's ray and, at most, for a hit; and as they were counted, for a whole path.",
    ]


def _with_error(share: float, error: float | None) -> str:
    return f"{100 * share:.0f} +- {'?' if error is None else f'{100 * error:.0f}'}"


def _noise_table(measured: dict[str, EffectsMeasured]) -> list[str]:
    groups = ("pixel", "lens", "time", "lights", "directions", "interactions")
    lines = [
        "| scene | share of | " + " | ".join(groups) + " | sum | in the noisiest hundredth |",
        "|---" * (len(groups) + 4) + "|",
    ]
    for name, found in measured.items():
        whole = {row.group: (row.alone, row.error) for row in found.noise}
        typical = {row.group: (row.typical, row.typical_error) for row in found.noise}
        peak = f"{100 * (found.noise_peak or 0.0):.0f}"
        for what, rows, last in (("the whole", whole, peak), ("a typical block", typical, "")):
            cells = [_with_error(*rows[g]) if g in rows else "" for g in groups]
            total = 100 * sum(share for share, _ in rows.values())
            lines.append(f"| `{name}` | {what} | " + " | ".join(cells) + f" | {total:.0f} | {last} |")
    return lines


def _cost_table(measured: dict[str, EffectsMeasured]) -> list[str]:
    lines = ["| scene | effect | us a path with | without | share of the time |", "|---|---|---|---|---|"]
    lines += [
        f"| `{name}` | {cost.effect} | {1e6 * cost.seconds:.3f} | {1e6 * cost.seconds_without:.3f} "
        f"| {100 * cost.share:.0f} % |"
        for name, found in measured.items()
        for cost in found.costs
    ]
    return lines


@dataclass(frozen=True)
class Bar:
    """A scene of the plot."""

    name: str
    gain: float
    cold: tuple[float, float]
    """Seconds of compiling: own, generic."""


def bars_of(text: str) -> list[Bar]:
    """The plot's scenes from the table of a written page, whose columns are `table`'s; the fastest last."""
    found = []
    for line in text.split("## Every example", 1)[1].split("\n## ", 1)[0].splitlines():
        if line.startswith("| `"):
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            found.append(
                Bar(cells[0].strip("`"), float(cells[4].split()[0]), (float(cells[5]), float(cells[6])))
            )
    return sorted(found, key=lambda bar: bar.gain)


def draw(bars: Sequence[Bar]) -> Figure:
    """Speed beside compile time, a scene a row; what the colours mean stands above the bars."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    y = np.arange(len(bars))
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 0.26 * len(bars) + 1.4), sharey=True)
    left.barh(y, [bar.gain for bar in bars], color="#4878a8")
    left.axvline(1.0, color="black", linewidth=0.8)
    left.set_yticks(y, [bar.name for bar in bars], fontsize=8)
    left.set_ylim(-0.7, len(bars) - 0.3)
    left.set_xlabel("samples a second, own program / generic")
    right.barh(y + 0.2, [bar.cold[1] for bar in bars], 0.4, color="#c8b090", label="generic")
    right.barh(y - 0.2, [bar.cold[0] for bar in bars], 0.4, color="#4878a8", label="own")
    right.set_xlabel("cold compile, s")
    right.legend(fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)
    figure.tight_layout()
    return figure


def plot(text: str) -> None:
    """The picture of a written page."""
    draw(bars_of(text)).savefig(PLOT, dpi=100)


def page(
    device: Device, rows: Sequence[Row], extra: Sequence[str], measured: dict[str, EffectsMeasured]
) -> str:
    info = device.info
    target = f", {info.target}" if info.target else ""
    machine = f"{info.name} ({cores()} cores{target})"
    return "\n".join(
        [
            "# What effects cost, measured",
            "",
            "A scene's own program has just the effects that it calls for; the generic one has all, and gives the same bits. "
            f"On {machine}, {info.platform_version}, {datetime.date.today().isoformat()}. `make effects` makes this page; "
            "`penumbra explain scene.json --measure` makes the last two tables for any scene.",
            "",
            "![Speed and compile time by scene](pictures/effects.png)",
            "",
            "## Large, and nothing",
            "",
            *findings(rows),
            "",
            "## What was expected",
            "",
            *extra,
            "",
            "## Every example",
            "",
            *table(rows),
            "",
            "## Shares of the noise, per cent",
            "",
            "Of the variance of a replicate's mean at 8 samples, by first-order sensitivity indices "
            "([decision 17](decisions/0017-what-effects-cost-is-asked-for.md)); a share of one group alone can come out below "
            "0 by its error. `interactions` is what several groups do together. Where most of the noise is in the noisiest "
            "hundredth of the blocks, a few bright pixels decide on the whole, and even its error is uncertain; a typical "
            "block's shares are the means of all blocks' own.",
            "",
            *_noise_table(measured),
            "",
            "## Seconds, with an effect and without",
            "",
            "Without means the plain thing in its place: a pinhole, a closed shutter, paint for metal or glass. It can cost "
            "more.",
            "",
            *_cost_table(measured),
            "",
        ]
    )
