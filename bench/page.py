"""docs/performance.md and its plots, from the results of bench/run.py and the notes beside this file."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from block import table
from matplotlib.axes import Axes
from penumbra_service.accuracy.plots import label_seconds

plt.switch_backend("svg")
plt.rcParams |= {"svg.fonttype": "none", "svg.hashsalt": "penumbra"}

DOCS = Path(__file__).resolve().parents[1] / "docs"
FOLDER = DOCS / "performance"
NOTES = Path(__file__).with_name("notes.md")
LARGE = Path(__file__).with_name("results") / "large.json"
PEERS = Path(__file__).with_name("results") / "peers.json"
Row = Iterable[object]
STARTS = (
    ("render", "`penumbra render` with cached programs, from its start to its end, files written", 0.6),
    ("render_cold", "the same with empty caches", 2.5),
    ("render_cold_long", "the same with 64 samples a pixel, for which another program is built", 2.5),
    ("serve_answer", "`penumbra serve`, from its start to its first answer", 1.2),
    ("serve_picture", "from its start to the first thumbnail of a job that is sent at once", 1.2),
    ("post_thumbnail", "a warm service, from the POST to the first thumbnail", 0.15),
)
"""Results of bench/latency.py, what they are, and the seconds that they are to stay below."""
NOT_YET = "Not measured yet."
MEMORY_GOAL = 250
"""Megabytes above the loaded runtime, for a million triangles."""
LABELS = {
    "penumbra": "Penumbra, replicates",
    "penumbra_1": "Penumbra, 1 replicate",
    "mitsuba_scalar/independent": "Mitsuba scalar, independent",
    "mitsuba_scalar/multijitter": "Mitsuba scalar, multijitter",
    "mitsuba_llvm/independent": "Mitsuba llvm, independent",
    "mitsuba_llvm/multijitter": "Mitsuba llvm, multijitter",
    "cycles": "Cycles",
    "luxcore": "LuxCore",
}
COLORS = {
    "penumbra": "#0b6e99",
    "penumbra_1": "#5fb3d3",
    "mitsuba_scalar/independent": "#c9c2b0",
    "mitsuba_scalar/multijitter": "#9c927a",
    "mitsuba_llvm/independent": "#f0b27a",
    "mitsuba_llvm/multijitter": "#c0561a",
    "cycles": "#4f7f3a",
    "luxcore": "#a9c48f",
}
OURS = "penumbra_1"
LLVM = "mitsuba_llvm/multijitter"
IN_PATHS = ("penumbra", OURS, "mitsuba_scalar/multijitter", LLVM, "cycles", "luxcore")
KEPT = ("cycles", "luxcore")
"""Measured by a run of their own, beside Penumbra: ratios are of that run."""
SAMPLES = 64


def number(value: float | None) -> str:
    """Three digits."""
    return "-" if value is None else f"{value:.3g}"


def _save(figure: Any, name: str) -> None:
    FOLDER.mkdir(exist_ok=True)
    figure.tight_layout()
    figure.savefig(FOLDER / f"{name}.svg", metadata={"Date": None})
    plt.close(figure)


def _renderers(scene: dict[str, Any]) -> list[str]:
    return [name for name in LABELS if name in scene]


def plot_rays(rays: dict[str, Any]) -> None:
    figure, axis = plt.subplots(figsize=(7, 3))
    names, values, robust = [], [], []
    for scene in rays["scenes"]:
        for kind in ("primary", "diffuse", "shadow"):
            names.append(f"{scene['triangles']:,}\n{kind}")
            values.append(scene[kind].get("ratio_to_embree", 0.0))
            robust.append(scene[kind].get("ratio_to_embree_robust", 0.0))
    at = range(len(names))
    axis.bar([i - 0.2 for i in at], values, 0.4, label="to Embree", color=COLORS["penumbra"])
    axis.bar([i + 0.2 for i in at], robust, 0.4, label="to Embree, robust", color=COLORS["penumbra_1"])
    axis.axhline(1.0, color="black", linewidth=0.8)
    axis.set_xticks(list(at), names, fontsize=6)
    axis.set_ylabel("rays per second, ratio")
    axis.legend(fontsize=7)
    _save(figure, "rays")


def plot_errors(paths: dict[str, Any]) -> None:
    figure, axes = plt.subplots(2, 4, figsize=(11, 5))
    for axis, (name, scene) in zip(axes.flat, paths.items(), strict=False):
        for which in _renderers(scene):
            points = scene[which]["points"]
            axis.loglog(
                [p["seconds"] for p in points], [p["relmse"] for p in points],
                marker="o", markersize=2.5, linewidth=1, label=LABELS[which], color=COLORS[which],
            )  # fmt: skip
        axis.set_title(name, fontsize=9)
        axis.tick_params(labelsize=6, which="both")
        label_seconds(axis.xaxis)
    for axis in axes[1]:
        axis.set_xlabel("seconds", fontsize=7)
    for axis in axes[:, 0]:
        axis.set_ylabel("relMSE", fontsize=7)
    handles, labels = axes.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncol=3, fontsize=7)
    figure.subplots_adjust(bottom=0.2, hspace=0.35)
    FOLDER.mkdir(exist_ok=True)
    figure.savefig(FOLDER / "errors.svg", metadata={"Date": None}, bbox_inches="tight")
    plt.close(figure)


def _line(axis: Axes, data: dict[str, float], label: str) -> None:
    axis.plot(
        [float(x) for x in data], [1e3 * y for y in data.values()], marker="o", color=COLORS["penumbra"]
    )
    axis.set_xscale("log")
    axis.set_ylim(0, 1.1e3 * max(data.values()))
    axis.set_xlabel(label, fontsize=8)
    axis.tick_params(labelsize=7)


def plot_scaling(scaling: dict[str, Any]) -> None:
    figure, axes = plt.subplots(1, 3, figsize=(9, 2.6))
    for axis, name in zip(axes, ("samples", "triangles", "lights"), strict=True):
        _line(axis, scaling[name], name)
    axes[0].set_ylabel("ms for a sample\nof every pixel", fontsize=8)
    _save(figure, "scaling")


def rays_text(rays: dict[str, Any]) -> str:
    rows = []
    product, robust, count = 1.0, 1.0, 0
    for scene in rays["scenes"]:
        for kind in ("primary", "diffuse", "shadow"):
            one = scene[kind]
            a, b = one.get("ratio_to_embree"), one.get("ratio_to_embree_robust")
            rows.append(
                (f"{scene['triangles']:,}", kind, number(one["mrays_per_second"]), number(a), number(b))
            )
            if a is not None:
                product, robust, count = product * a, robust * b, count + 1
    text = table(("triangles", "rays", "M rays/s", "to Embree", "to Embree, robust"), rows)
    if count:
        text += (
            f"\n\nGeometric means: {product ** (1 / count):.2f} times default Embree,"
            f" {robust ** (1 / count):.2f} times robust Embree."
        )
    return text


def paths_text(paths: dict[str, Any], kept: dict[str, Any]) -> str:
    rates, seconds = [], []
    for name, scene in paths.items():
        beside = kept.get(name, {})
        rates.append((name, *_row(scene, beside, "mpaths_per_second")))
        seconds += [(name, t, *_row(scene, beside, f"seconds_to_{t}")) for t in ("0.01", "0.001")]
    head = (*(LABELS[which] for which in IN_PATHS), "1 replicate to llvm", "to the best peer")
    return (
        "Million camera paths a second:\n\n"
        + table(("scene", *head), rates)
        + "\n\nSeconds to a relMSE:\n\n"
        + table(("scene", "relMSE", *head), seconds)
    )


def _row(scene: dict[str, Any], beside: dict[str, Any], key: str) -> Row:
    """Every renderer's number, and the ratios of one replicate's to llvm's and to the best peer's, in the run of each."""
    numbers = {which: (beside if which in KEPT else scene).get(which, {}).get(key) for which in IN_PATHS}
    ratios = {
        which: (beside if which in KEPT else scene)[OURS][key] / numbers[which]
        for which in (LLVM, *KEPT)
        if numbers[which]
    }
    best = (min if key == "mpaths_per_second" else max)(ratios, key=lambda which: ratios[which], default=None)
    told = "-" if best is None else f"{number(ratios[best])} ({LABELS[best].partition(',')[0]})"
    return (*(number(x) for x in numbers.values()), number(ratios.get(LLVM)), told)


def kept_text(peers: dict[str, Any] | None) -> str:
    """When and where Cycles and LuxCore were measured, and how far their pictures are ours."""
    if peers is None:
        return "Cycles and LuxCore are not measured yet: `make bench-peers`."
    machine = peers["machine"]
    found = ", ".join(f"{LABELS[name]} {version}" for name, version in peers["peers"].items())
    rows = []
    for name, scene in peers["paths"].items():
        cells = [scene.get(which, {}) for which in KEPT]
        rows.append((name, *(c.get(k, "-") for c in cells for k in ("mean_ratio", "rms_z"))))
    head = [f"{LABELS[which]}, {what}" for which in KEPT for what in ("mean", "rms z")]
    reasons = sorted(
        {reason for scene in peers["paths"].values() for reason in scene.get("left_out", {}).values()}
    )
    return f"""{found}: columns kept from `make bench-peers` of {peers["date"]} ({_processor(machine)}),
which ran Penumbra beside them; ratios are of that run. One thread; the start of a process and what a scene costs whatever
its samples are left out of the times. Not measured: {"; ".join(reasons)}.

The same pictures? Image means over Penumbra's, and the rms difference of 8 x 8 blocks over what noise
explains, 1 where both agree:

{table(("scene", *head), rows)}"""


def _processor(machine: dict[str, Any]) -> str:
    return f"{machine['processor']}, {machine['cores']} cores"


def samplers_text(samplers: dict[str, Any], paths: dict[str, Any]) -> str:
    """The section's own, and what stands in `paths` already."""
    merged = {
        scene: {"penumbra_1/sobol": paths[scene].get(OURS), LLVM: paths[scene].get(LLVM)} | measured
        for scene, measured in samplers.items()
    }
    names = [n for n in next(iter(merged.values())) if n != "left_out"]
    rows = [
        (f"`{n}`", *(number(_error_at(scene.get(n), SAMPLES)) for scene in merged.values())) for n in names
    ]
    return table(("sampler", *samplers), rows)


def _error_at(measured: dict[str, Any] | None, samples: int) -> float | None:
    points = measured["points"] if measured else []
    return next((p["relmse"] for p in points if p["samples"] == samples), None)


def trees_text(scaling: dict[str, Any]) -> str:
    rows = [
        (f"{int(n):,}", number(t["build_seconds"]), number(t["found_seconds"]), number(t["bytes_a_triangle"]))
        for n, t in scaling["trees"].items()
    ]
    return table(("triangles", "seconds to build", "seconds to find", "bytes a triangle"), rows)


def starts_text(start: dict[str, float] | None) -> str:
    if start is None:
        return NOT_YET
    rows = [
        (words, f"{start[name]:.2f}", f"{goal:g}", f"{start[name] / goal:.2f}")
        for name, words, goal in STARTS
    ]
    return table(("from ... to", "seconds", "at most", "share"), rows)


def memory_text(found: dict[str, Any] | None) -> str:
    """Two rows: with the tree built, and with it found."""
    if found is None:
        return NOT_YET
    rows = []
    for name in ("built", "found"):
        one = found[name]
        holder, builder = (one[who] - one["runtime"] if one[who] else 0.0 for who in ("holder", "builder"))
        grown = one["after_1024_samples"] - one["after_64_samples"]
        cells = (holder, builder) if builder else (holder, None)
        more = ("-" if cell is None else f"{cell:.0f}" for cell in cells)
        rows.append(
            (f"{found['triangles']:,}", name, f"{one['runtime']:.0f}", *more, f"{grown:.1f}",
             number(one["bytes_a_triangle"]), number(one["seconds"]))
        )  # fmt: skip
    head = ("triangles", "tree", "runtime", "holder", "builder", "64 to 1,024 samples", "bytes a triangle")
    return table((*head, "seconds"), rows)


def large_text() -> str:
    """The largest mesh, whenever it was measured last."""
    if not LARGE.exists():
        return ""
    found = json.loads(LARGE.read_text())
    when = f"{found['date']}, {found['machine']['processor']}, {found['machine']['cores']} cores"
    return (
        f"\nTen million triangles, by `make bench ARGS=--full` ({when}):\n\n{memory_text(found['memory'])}\n"
    )


def cores_text(results: dict[str, Any]) -> str:
    rows = []
    for name, scene in results["all_cores"].items():
        for which in ("penumbra", LLVM):
            if which in scene and which in results["paths"][name]:
                one, every = (x[which]["mpaths_per_second"] for x in (results["paths"][name], scene))
                rows.append((name, LABELS[which], number(one), number(every), number(every / one)))
    return table(("scene", "renderer", "one core", f"{results['machine']['cores']} cores", "ratio"), rows)


def write_page(results: dict[str, Any]) -> None:
    """Everything, from whatever sections there are, and what is kept of Cycles and LuxCore."""
    peers = json.loads(PEERS.read_text()) if PEERS.exists() else None
    machine = results["machine"]
    plot_rays(results["rays"])
    plot_errors(results["paths"])
    plot_scaling(results["scaling"])
    devices = "; ".join(
        f"{d['name']}, {d['platform']}, code for {d['instructions'] or 'its own instruction set'}"
        for d in machine["devices"]
    )
    packages = ", ".join(f"{name} {found}" for name, found in machine["peers"].items())
    left_out = sorted(
        {reason for scene in results["paths"].values() for reason in scene.get("left_out", {}).values()}
    )
    text = f"""# Performance

Written by `make bench` (`bench/run.py`); do not edit. The numbers are in `bench/results`, what they are made of in `bench/`.

Machine: {machine["processor"]}, {machine["cores"]} cores. {devices}. Peers: {packages}. One core unless said: CPU seconds of
processes that are pinned to it. Ratios are of one run, medians of alternating turns for rays.

## Rays

The same rays, one after the other through each library's interface for single rays: through pixels, a cosine-distributed bounce
from where they hit, and from there to a light. Above 1 Penumbra is faster. Its rays are watertight; Embree's default mode is
not, its robust mode nearly is.

![Ratios to Embree](performance/rays.svg)

{rays_text(results["rays"])}

## Paths

The scenes of `bench/scenes.py`, 128 x 128, roulette off, all renderers with multiple importance sampling. Penumbra splits
samples into {results.get("replicates", 8)} replicates, whose spread is its error bar; the peers give no error bar, so
one replicate is the like comparison.
{"Left out: " + "; ".join(left_out) + "." if left_out else ""}

![relMSE over seconds](performance/errors.svg)

{paths_text(results["paths"], peers["paths"] if peers else {})}

{kept_text(peers)}

## Samplers

relMSE at 64 samples a pixel, one replicate, on the same scenes:

{samplers_text(results["samplers"], results["paths"])}

## Scaling

![Milliseconds a sample](performance/scaling.svg)

Time grows linearly with samples, and with the logarithm of triangles and of lights.

{cores_text(results)}

## Trees

Seconds of one core, numba's code loaded; found: the same mesh again, from the cache folder. Bytes: tree, packets, vertices and
records on the device.

{trees_text(results["scaling"])}

## Start

Whole processes on all cores, a scene of a plane, a sphere and a lamp, 256 x 256 pixels; medians (`bench/latency.py`).

{starts_text(results.get("start"))}

## Memory

Megabytes at the peak (`bench/memory.py`): of a process that has loaded and traced a small scene, as a device's process has, and
what a mesh adds to that in it; and, above the same, the peak of the process that builds the tree, which goes some seconds after
(its numba and LLVM are 135 of them). At most {MEMORY_GOAL} for a million triangles in either. Bytes: all on the device.
Seconds: of all cores, from the decoded mesh to its first samples, the builder's start and numba's loading in them.

{memory_text(results.get("memory"))}
{large_text()}
{NOTES.read_text().strip()}
"""
    (DOCS / "performance.md").write_text(text)


if __name__ == "__main__":
    write_page(json.loads((Path(__file__).parent / "results" / "quick.json").read_text()))
