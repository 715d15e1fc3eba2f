"""`penumbra replay`: the picture of a receipt again, bit for bit, whatever ended it.

How many samples a job that the clock or an error stopped has taken depends on the machine's speed; its receipt's plan records
it, and of an adaptive job the map that says which pixel took which. With the same samples, laid out as the receipt's stop rule
had them laid out, a device of the same bit class gives the same picture. No pilot is rendered.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from penumbra_scene.exits import Exit

from penumbra_service.commands import Command, CommandError

if TYPE_CHECKING:
    from penumbra_scene.receipt import Receipt, SampleMap
    from penumbra_scene.scene import Scene

    from penumbra_service.engine.task import FixedPlan

_REPLAY: Final = """\
Render the picture of a receipt again, with exactly the samples that it took: on a device of the receipt's bit class every
channel has the same bits, also where the clock had stopped the job. SCENE is the scene as it was rendered; its stop rule is
taken from the receipt.

  penumbra replay out/receipt.json scene.json --out again
"""


def _configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("receipt", type=Path, metavar="RECEIPT", help="receipt.json of the picture")
    parser.add_argument("scene", type=Path, metavar="SCENE", help="scene file (JSON), as it was rendered")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="where the results go")
    parser.add_argument(
        "--devices", default="", metavar="IDS", help="OpenCL devices, commas between (default: all)"
    )


def _run(arguments: argparse.Namespace) -> int:
    from penumbra_scene.errors import ProblemError

    try:
        again, doubts = replay(arguments.receipt, arguments.scene, arguments.out, arguments.devices)
    except OSError as error:
        raise CommandError(
            f"cannot read or write {error.filename or arguments.out}: {error.strerror}"
        ) from error
    except ProblemError as error:
        raise CommandError(str(error), Exit.INVALID) from error
    for doubt in doubts:
        print(f"the bits may differ: {doubt}", file=sys.stderr)
    print(f"{again.samples:g} samples a pixel: {arguments.out / 'result.exr'}")
    return Exit.OK


REPLAY: Final = Command("render a receipt's picture again, bit for bit", _REPLAY, _configure, _run)


def replay(receipt: Path, scene: Path, out: Path, devices: str = "") -> tuple[Receipt, list[str]]:
    """Render again; the new receipt, and why its bits may differ all the same.

    Raises OSError, ProblemError where the scene is none, CommandError where the receipt is none, or not this scene's, or
    has no plan that could be replayed.
    """
    from penumbra_scene.parse import parse_scene

    from penumbra_service.film.replicates import choose_layout
    from penumbra_service.rendering import render_plan

    old = _receipt(receipt)
    model = parse_scene(scene.read_bytes(), allow_files=True).model_copy(update={"stop": old.stop})
    _demand(old, model)
    out.mkdir(parents=True, exist_ok=True)
    layout = replace(choose_layout(model.sampler, model.stop), replicates=old.replicates)
    new = render_plan(model, layout, _plan(old, model), old.time, scene.parent, out, devices)
    return new, list(_doubts(old, new))


def _plan(old: Receipt, scene: Scene) -> FixedPlan:
    """What the receipt says that every pixel has taken."""
    from penumbra_kernels.nodes import Tile

    from penumbra_service.engine.task import FixedPlan
    from penumbra_service.jobs.receipt import adaptive_use
    from penumbra_service.jobs.sample_map import levels_of

    end = old.plan[-1].first_sample + old.plan[-1].sample_count
    if old.adaptive is None or old.adaptive.map is None:
        return FixedPlan(end)
    window = scene.film.window
    try:
        levels = levels_of(old.adaptive.map, Tile(window.x, window.y, window.width, window.height))
    except ValueError as error:
        raise CommandError(f"the receipt's map of samples cannot be read: {error}", Exit.INVALID) from error
    _demand_rays(old.adaptive.map, scene.integrator.shadow_rays)
    return FixedPlan(end, levels, adaptive_use(old.adaptive, levels))


def _demand_rays(found: SampleMap, most: int) -> None:
    given = max(found.shadow_rays, *found.kept_shadow_rays)
    if given > most:
        raise CommandError(
            f"the receipt's map asks hits for {given} shadow rays: accepted are up to the scene's own {most}",
            Exit.INVALID,
        )


def _receipt(path: Path) -> Receipt:
    from penumbra_scene.receipt import Receipt
    from pydantic import ValidationError

    try:
        return Receipt.model_validate_json(path.read_bytes())
    except ValidationError as error:
        raise CommandError(f"{path} is no receipt: {error.errors()[0]['msg']}", Exit.INVALID) from error


def _demand(old: Receipt, scene: Scene) -> None:
    from penumbra_scene.check import scene_hash

    if scene_hash(scene) != old.scene_hash:
        raise CommandError(
            f"the receipt is of another scene ({old.scene_hash}, not {scene_hash(scene)}): give the file that was "
            "rendered, with the settings of the command line or the job in it; if it is that one, another version of "
            f"Penumbra knew other settings (the receipt's has kernels {old.kernel_hash})",
            Exit.INVALID,
        )
    if scene.adaptive is not None and (old.adaptive is None or old.adaptive.map is None):
        raise CommandError(
            "an adaptive render decides from its pilot where samples go; this receipt does not hold that map (older "
            "versions did not record it), so that it cannot be replayed",
            Exit.INVALID,
        )
    if not old.plan:
        raise CommandError("the receipt has no plan: nothing was rendered", Exit.INVALID)


def _doubts(old: Receipt, new: Receipt) -> Iterator[str]:
    if old.kernel_hash != new.kernel_hash:
        yield "the kernels are others than those of the receipt"
    if old.bit_class == "mixed":
        yield "devices of several bit classes made the picture of the receipt"
    elif old.bit_class != new.bit_class:
        yield f"the receipt is of bit class {old.bit_class}, this is {new.bit_class}"
