"""`make accuracy`: measures what accuracy costs on the example scenes, and writes docs/accuracy.md and its plots.

Everything on the page is of the run that wrote it. `--only` repeats a part and keeps the rest.
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import accuracy_adaptive
from accuracy_forecasts import HOLDS, LONGEST, QUOTES, Forecast, Told, cold_engine, forecast, holds, summary
from accuracy_splitting import BLOCKS, COUNTS, measure, upkeep
from penumbra_kernels.device import Device, devices
from penumbra_scene.parse import parse_scene
from penumbra_scene.scene import Scene
from penumbra_service.accuracy.compare import Setting, as_json
from penumbra_service.accuracy.comparing import Wanted, compare_on, resized
from penumbra_service.accuracy.plots import plot_all
from penumbra_service.images.assets import FolderAssets
from penumbra_service.rendering import assets_folder, local_engine

ROOT: Final = Path(__file__).resolve().parent.parent
EXAMPLES: Final = ROOT / "examples"
PICTURES: Final = ROOT / "docs" / "pictures"
PAGE: Final = ROOT / "docs" / "accuracy.md"
NUMBERS: Final = PICTURES / "accuracy.json"
SCENES: Final = ("depth_of_field", "soft_shadows", "glossy", "motion_blur", "cornell")
PROMISED: Final = SCENES[:4]
"""Of which the default sampler with adaptive sampling is to need a third of independent sampling's seconds."""
AIM: Final = 1 / 3
SPREAD: Final = (160, 120)
TARGETS: Final = (0.03,)
"""Relative errors; a smaller one would take most of the five minutes that the page may take."""
SETTINGS: Final = tuple(
    Setting(name, adaptive)
    for name, adaptive in (
        ("regular", False), ("random", False), ("independent", False),
        ("stratified", False), ("jittered", False), ("sobol", False), ("sobol", True),
    )
)  # fmt: skip
SAMPLES: Final = (16, 64, 256)
REFERENCE: Final = 2048
COMPARED: Final = (64, 48)
SPLIT: Final = (48, 36)
FORETOLD: Final = (96, 72)
UPKEEP: Final = ((96, 72), (192, 144))
PARTS: Final = ("compare", "adaptive", "splitting", "upkeep", "forecasts")


def main() -> int:
    """Returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=PARTS, action="append", help="measure this part alone")
    parts = parser.parse_args().only or PARTS
    numbers: dict[str, Any] = json.loads(NUMBERS.read_text()) if NUMBERS.exists() else {}
    began = time.monotonic()
    with local_engine("") as engine:
        numbers["machine"] = {
            "processor": _processor(),
            "devices": [d.name for d in engine.usable()],
            "day": time.strftime("%Y-%m-%d"),
        }
        if "compare" in parts:
            numbers["compare"] = {name: _compare(engine, name) for name in SCENES}
            _write(numbers)
        if "adaptive" in parts:
            numbers["adaptive"] = {name: _adaptive(engine, name) for name in PROMISED}
            _write(numbers)
    if "forecasts" in parts:
        with cold_engine() as engine:
            numbers["forecasts"] = [asdict(f) for f in _forecasts(engine)]
        _write(numbers)
    if "splitting" in parts:
        numbers["splitting"] = _splitting()
        _write(numbers)
    if "upkeep" in parts:
        numbers["upkeep"] = _upkeep()
    _write(numbers)
    print(f"{PAGE.relative_to(ROOT)} in {time.monotonic() - began:.0f} s", file=sys.stderr)
    return 0


def _write(numbers: dict[str, Any]) -> None:
    """After every part: a run that is broken off keeps what it has measured."""
    NUMBERS.write_text(json.dumps(numbers, indent=1) + "\n")
    PAGE.write_text("\n".join(page(numbers)) + "\n")


def _processor() -> str:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _scene(name: str, size: tuple[int, int]) -> Scene:
    return resized(parse_scene((EXAMPLES / f"{name}.json").read_bytes(), allow_files=True), size)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _compare(engine: Any, name: str) -> dict[str, Any]:
    wanted = Wanted((), samples=SAMPLES, reference=REFERENCE, settings=SETTINGS)
    with tempfile.TemporaryDirectory() as folder:
        found = compare_on(engine, _scene(name, COMPARED), EXAMPLES, wanted, Path(folder), _say)
        paths = {
            "curves": PICTURES / f"accuracy_{name}.png",
            "pictures": PICTURES / f"accuracy_{name}_pictures.png",
        }
        plot_all(found, paths)
    return as_json(found)


def _adaptive(engine: Any, name: str) -> list[dict[str, Any]]:
    _say(f"adaptive: {name}")
    return [asdict(s) for s in accuracy_adaptive.measure(engine, _scene(name, SPREAD), EXAMPLES, TARGETS)]


def _forecasts(engine: Any) -> Iterator[Any]:
    for path in sorted(EXAMPLES.glob("*.json")):
        _say(f"forecast: {path.stem}")
        found = forecast(engine, _scene(path.stem, FORETOLD), EXAMPLES)
        if found is not None:
            yield found


def _splitting() -> dict[str, Any]:
    device = Device(devices()[0].id)
    assets = FolderAssets(assets_folder(), EXAMPLES)
    found = {}
    for name in SCENES:
        _say(f"splitting: {name}")
        found[name] = asdict(measure(device, _scene(name, SPLIT), assets))
    return found


def _upkeep() -> dict[str, Any]:
    device = Device(devices()[0].id)
    assets = FolderAssets(assets_folder(), EXAMPLES)
    _say("upkeep")
    return {f"{w} x {h}": asdict(upkeep(device, _scene("cornell", (w, h)), assets)) for w, h in UPKEEP}


# ---- the page
def page(numbers: dict[str, Any]) -> Iterator[str]:
    """Lines of Markdown."""
    machine = numbers["machine"]
    yield "# What accuracy costs in time"
    yield ""
    yield (
        f"Measured by `make accuracy` on {machine['day']}: {machine['processor']}, "
        f"{' and '.join(machine['devices'])}. Every number and picture here is of that run. Whether error bars hold is "
        "on a page of its own: [coverage](coverage.md)."
    )
    if "adaptive" in numbers:
        yield from _adaptive_page(numbers["adaptive"])
    if "compare" in numbers:
        yield from _samplers(numbers["compare"])
    if "splitting" in numbers and "upkeep" in numbers:
        yield from _split_page(numbers["splitting"], numbers["upkeep"])
    if "forecasts" in numbers:
        yield from _forecast_page(numbers["forecasts"])


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    yield ""
    yield "| " + " | ".join(head) + " |"
    yield "|" + "---|" * len(head)
    for row in rows:
        yield "| " + " | ".join(row) + " |"
    yield ""


def _share(value: float | None) -> str:
    return "never" if value is None else f"{value:.2f}"


def _adaptive_page(found: dict[str, list[dict[str, Any]]]) -> Iterator[str]:
    yield ""
    yield "## Samples where they are needed"
    yield ""
    yield (
        f"Whole jobs on pictures of {SPREAD[0]} x {SPREAD[1]}, each to the stated relative error: processor seconds over those "
        "of `independent`, pilot and looking included. `independent` is rendered to twice the least "
        "error, and told for the others by its exact law. In brackets: the pilot's samples a pixel, the picture's, and how "
        "many of the scene's shadow rays it took where the pilot decided. The aim is a third for `sobol` with adaptive "
        "sampling."
    )
    rows = [_saving_row(name, saving) for name, targets in found.items() for saving in targets]
    head = ["scene", "error", "`independent`", "`sobol`", "certified", "fast"]
    yield from _table(head, rows)
    met = sum(_ratio_of(saving, "certified") <= AIM for targets in found.values() for saving in targets)
    yield f"Certified renders meet the aim in {met} of {len(rows)} rows."


def _ratio_of(saving: dict[str, Any], variant: str) -> float:
    return float(saving["jobs"][variant]["seconds"] / saving["independent"])


def _saving_row(name: str, saving: dict[str, Any]) -> list[str]:
    cells = []
    for variant, job in saving["jobs"].items():
        ratio = _ratio_of(saving, variant)
        text = f"{ratio:.2f}" if variant == "sobol" or ratio <= AIM else f"**{ratio:.2f}**"
        told = [f"{job['pilot']}"] * bool(job["pilot"]) + [f"{job['samples']:.0f}"]
        if job["shadow_rays"]:
            told.append(f"{job['shadow_rays']} of {saving['shadow_rays']}")
        cells.append(f"{text} ({', '.join(told)})")
    return [f"`{name}`", f"{100 * saving['target']:.2g} %", f"{saving['independent']:.1f} s", *cells]


def _samplers(compared: dict[str, Any]) -> Iterator[str]:
    first = next(iter(compared.values()))
    width, height = first["width"], first["height"]
    yield ""
    yield "## Samplers"
    yield ""
    yield (
        f"`penumbra compare` on pictures of {width} x {height}. relMSE is against a reference of "
        f"{REFERENCE} samples; the last column is the share of the seconds that `independent` needs for the error "
        f"of its {max(SAMPLES)} samples. `regular` has no error bar, and its error here is aliasing. "
        "Adaptive renders take no more shadow rays than pay: on soft shadows each sample is cheaper, and noisier."
    )
    for name, found in compared.items():
        yield from _scene_section(name, found)


def _scene_section(name: str, found: dict[str, Any]) -> Iterator[str]:
    yield f"### {found['scene']}"
    rows = []
    for c in found["curves"]:
        title = f"`{c['sampler']}`" + (" adaptive" if c["adaptive"] else "")
        if not c["points"]:
            rows.append([title, c["left_out"], "", "", ""])
            continue
        last = c["points"][-1]
        slope = "" if c["slope"] is None else f"{c['slope']:.2f}"
        rows.append(
            [
                title,
                f"{last['relmse_ref']:.2e}"
                if last["relmse_ref"] is not None
                else f"< {last['relmse_ref_below']:.0e}",
                f"{last['seconds']:.2f}",
                slope,
                _share(c["seconds_over_baseline"]),
            ]
        )
    head = ["sampler", f"relMSE at {max(SAMPLES)} samples", "seconds", "slope", "of the seconds"]
    yield from _table(head, rows)
    yield f"![relMSE against seconds](pictures/accuracy_{name}.png)"
    yield ""
    yield f"In {found['equal_seconds']:.2g} s of tracing each:"
    yield ""
    yield f"![pictures at equal time](pictures/accuracy_{name}_pictures.png)"
    yield ""


def _split_page(splitting: dict[str, Any], kept: dict[str, Any]) -> Iterator[str]:
    yield "## What error bars cost"
    yield ""
    yield (
        "Splitting samples into R replicates makes their sequences shorter. Samples to the error of 128 samples in R "
        "replicates, over those of one sequence (`sobol`; theta is that of one sequence between 16 and 128 samples):"
    )
    rows = [
        [f"`{name}`", f"{s['theta']:.2f}", *(f"{_of(s['price'], r):.2f}" for r in COUNTS)]
        for name, s in splitting.items()
    ]
    yield from _table(["scene", "theta", *(f"R = {r}" for r in COUNTS)], rows)
    four, eight = (max(_of(s["price"], r) for s in splitting.values()) for r in (4, 8))
    yield (
        f"Four replicates cost {four:.2f} at most here, eight {eight:.2f}; the aim is 1.3. Eight give an interval 7 degrees of "
        "freedom where four give 3: 2.36 standard errors in place of 3.18. So jobs take 4, and a quote advises 8 where the "
        "pilot's theta says that they cost at most 1.3 ([decision 19](decisions/0019-four-replicates.md))."
    )
    yield ""
    yield (
        "V of one pixel is uncertain by 82 % at R = 4. The relative deviation of V pooled over a block, after 128 samples, "
        "of the median block:"
    )
    rows = [
        [f"`{name}`", *(f"{_of(s['deviation'], b):.2f}" for b in BLOCKS)] for name, s in splitting.items()
    ]
    yield from _table(["scene", *(f"{b} x {b}" for b in BLOCKS)], rows)
    yield "The error of a picture is pooled over 16 x 16: larger blocks gain little, and mix light with dark."
    yield ""
    checks = next(iter(kept.values()))["checks"]
    yield (
        "Keeping error bars costs, in CPU time on `cornell`, over tracing 256 samples in one replicate (a look is what a job "
        "does with all tiles at a check point: it adds up their sums, takes means, variances and the error, and brings the "
        "preview up to date; a job without an error target looks less often):"
    )
    rows = []
    for size, found in kept.items():
        tracing, looking = 100 * (found["replicates"] - 1), 100 * found["looking"]
        rows.append([size, f"{tracing:+.1f} %", f"{looking:.1f} %", f"{tracing + looking:.1f} %"])
    head = [
        "picture",
        "tracing in 4 replicates",
        f"looks at the {checks} check points of a job that ends there",
        "together",
    ]
    yield from _table(head, rows)
    yield "The aim is 3 %."
    yield ""


def _of(table: dict[Any, float], key: int) -> float:
    """JSON makes strings of keys."""
    return table[key] if key in table else table[str(key)]


def _forecast_page(found: list[dict[str, Any]]) -> Iterator[str]:
    told = [Forecast.read(f) for f in found]
    width, height = FORETOLD
    yield "## Do quotes hold?"
    yield ""
    yield (
        f"Every example with a random sampler at {width} x {height}, quoted for an error that takes about two seconds, then "
        "rendered to it. The first quote begins with an empty cache of programs (scenes that share a program build it once), "
        f"the second comes after the render. Within x{HOLDS:g}, where the aim is 80 %, and of the seconds in the quoted "
        "95 % interval:"
    )
    rows = []
    for when in QUOTES:
        shares = summary(told, when)
        of_pilots = sorted(f.told(when).pilot_seconds for f in told)
        compiling = sorted(f.told(when).compile_seconds for f in told)
        rows.append(
            [
                when, *(f"{100 * shares[name]:.0f} %" for name in ("samples", "seconds", "within")),
                f"{of_pilots[len(told) // 2]:.1f} s", f"{compiling[len(told) // 2]:.1f} s",
            ]
        )  # fmt: skip
    yield from _table(
        ["programs", "samples", "seconds", "in the interval", "pilot", "compiling, on top"], rows
    )
    yield (
        "Pilot and compiling are those of the median scene. "
        "`At least` stands where fewer than 25 pixels carry the error that the pilot saw: rare bright samples make it, and the "
        "quote says that it knows no upper bound. A render that has not met its error after "
        f"{LONGEST:.0f} s is ended, and what it took stands behind a `>`. Samples are the second quote's."
    )
    rows = [
        [
            f.scene, f"{100 * f.target:.2g} %", f"{f.warm.pilot_samples:.0f}",
            f"{_least(f.warm)}{f.warm.samples:.0f}", f"{_more(f)}{f.samples:.0f}", _ratio(f.samples_ratio("warm")),
            f"{_least(f.cold)}{f.cold.seconds:.2f}", f"{_least(f.warm)}{f.warm.seconds:.2f}", f"{_more(f)}{f.seconds:.2f}",
            *(_ratio(f.seconds_ratio(when)) for when in QUOTES),
        ]
        for f in sorted(told, key=lambda f: abs(f.seconds_ratio("warm") - 1), reverse=True)
    ]  # fmt: skip
    head = [
        "scene", "error", "the pilot's samples", "samples quoted", "real", "ratio",
        "seconds quoted cold", "warm", "real", "ratio cold", "warm",
    ]  # fmt: skip
    yield from _table(head, rows)


def _least(told: Told) -> str:
    """As the quote says it where few pixels carry the error."""
    return "" if told.bounded else "at least "


def _more(found: Forecast) -> str:
    """Before what a render took that was ended short of its error."""
    return "" if found.met else "> "


def _ratio(ratio: float) -> str:
    return f"{ratio:.2f}" if holds(ratio) else f"**{ratio:.2f}**"


if __name__ == "__main__":
    sys.exit(main())
