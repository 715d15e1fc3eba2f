"""Pictures of comparisons. The one home of matplotlib, which is an extra: `penumbra-render[plots]`."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from penumbra_service.accuracy.compare import Comparison, Curve

NEEDED: Final = (
    "plots need matplotlib, which is not installed: pip install 'penumbra-render[plots]', or give --no-plots"
)
COLOURS: Final = {
    "regular": "#7f7f7f",
    "random": "#8c564b",
    "independent": "#d62728",
    "stratified": "#9467bd",
    "jittered": "#ff7f0e",
    "sobol": "#1f77b4",
    "blue_noise": "#2ca02c",
}
_DPI: Final = 110


class NoPlotsError(ImportError):
    """matplotlib is missing."""


def demand_matplotlib() -> None:
    """Before anything is rendered. Raises NoPlotsError."""
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise NoPlotsError(NEEDED) from error


def _pyplot() -> Any:
    demand_matplotlib()
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt


def plot_curves(found: Comparison, path: Path) -> None:
    """Error against seconds, both logarithmic, with fitted slopes. Raises OSError."""
    plt = _pyplot()
    figure, axes = plt.subplots(figsize=(7.2, 4.8))
    for curve in found.curves:
        _draw(axes, curve)
    axes.set_xscale("log")
    axes.set_yscale("log")
    label_seconds(axes.xaxis)
    axes.set_xlabel("seconds of tracing")
    axes.set_ylabel("relMSE against the reference")
    axes.set_title(f"{found.scene}, {found.width} x {found.height}, {found.device}", fontsize=10)
    axes.grid(True, which="both", alpha=0.25)
    axes.legend(fontsize=8, title="slope", title_fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=_DPI)
    plt.close(figure)


def label_seconds(axis: Any) -> None:
    """At 1, 2 and 5 in each decade, as plain numbers: matplotlib's own labels overlap within one decade."""
    from matplotlib.ticker import LogLocator, NullFormatter, NullLocator

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_locator(NullLocator())
    axis.set_minor_formatter(NullFormatter())


def _draw(axes: Any, curve: Curve) -> None:
    """What the reference can tell as a line; what it cannot as open triangles at the bound, pointing down."""
    if not curve.points:
        return
    slope = "" if curve.slope is None else f"{curve.slope:.2f}"
    line = axes.plot(
        [seconds for seconds, _ in curve.told],
        [error for _, error in curve.told],
        marker="s" if curve.setting.adaptive else "o",
        markersize=4,
        linestyle="--" if curve.setting.adaptive else "-",
        color=COLOURS.get(curve.setting.sampler),
        label=f"{curve.setting.name}  {slope}",
    )[0]
    below = [(p.seconds, p.relmse_ref_below) for p in curve.points if p.relmse_ref_below]
    if below:
        axes.plot(
            *zip(*below, strict=True), marker="v", linestyle="", fillstyle="none", color=line.get_color()
        )


def plot_pictures(found: Comparison, path: Path, columns: int = 5) -> None:
    """The pictures side by side, each with its error there. Raises OSError."""
    plt = _pyplot()
    names = list(found.pictures)
    rows = -(-len(names) // columns)
    wide = min(columns, len(names))
    tall = found.height / found.width
    figure, grid = plt.subplots(rows, wide, figsize=(2.6 * wide, (2.6 * tall + 0.4) * rows), squeeze=False)
    for axes, name in zip(grid.flat, [*names, *[""] * (rows * wide - len(names))], strict=True):
        axes.axis("off")
        if name:
            axes.imshow(plt.imread(found.pictures[name]), interpolation="nearest")
            axes.set_title(name, fontsize=9)
    figure.suptitle(
        textwrap.shorten(f"{found.scene}: {found.equal_seconds:.2g} s of tracing each", 80), fontsize=10
    )
    figure.tight_layout()
    figure.savefig(path, dpi=_DPI)
    plt.close(figure)


def plot_all(found: Comparison, paths: Mapping[str, Path]) -> None:
    """`curves` and `pictures`, as far as paths name them."""
    if "curves" in paths:
        plot_curves(found, paths["curves"])
    if "pictures" in paths and found.pictures:
        plot_pictures(found, paths["pictures"])
