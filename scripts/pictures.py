"""`make pictures`: renders every example into docs/pictures, and writes docs/gallery.md around them.

The words are those of examples/README.md, the numbers those of each picture's receipt, and the pictures the
thumbnails that every render leaves.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_client.cli import main as penumbra
from penumbra_scene.receipt import Receipt
from penumbra_service.images.exr_read import ExrReader
from penumbra_service.images.samplemap import write_sample_map

ROOT: Final = Path(__file__).resolve().parent.parent
EXAMPLES: Final = ROOT / "examples"
PICTURES: Final = ROOT / "docs" / "pictures"
GALLERY: Final = ROOT / "docs" / "gallery.md"
SEQUENCES: Final = {"turntable": "0-23"}
"""Frames of the examples that move; their picture is the contact sheet, their numbers are the last frame's."""
_ROW: Final = re.compile(r"^\| \[`(\w+)`\]\(\w+\.json\) \| (.*) \| (.*) \|$", re.MULTILINE)
_HEAD: Final = """\
# Gallery

The [examples](../examples/README.md), rendered as they are. Relative errors are the pictures' own
([how wrong a picture is](estimator.md)); seconds are of tracing, on the device that each line names.
`make pictures` makes this page.
"""


def main() -> int:
    """Returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="only these examples (default: all)")
    arguments = parser.parse_args()
    PICTURES.mkdir(parents=True, exist_ok=True)
    for name, _, _ in rows():
        if not arguments.names or name in arguments.names:
            print(name, flush=True)
            if status := render(name):
                return status
    GALLERY.write_text(gallery())
    return 0


def rows() -> list[tuple[str, str, str]]:
    """Name, what it shows, what is sampled, for each example."""
    return _ROW.findall((EXAMPLES / "README.md").read_text())


def render(name: str) -> int:
    """One picture and its receipt; the command's exit status."""
    scene = EXAMPLES / f"{name}.json"
    frames = SEQUENCES.get(name)
    with tempfile.TemporaryDirectory() as out:
        status = penumbra(["render", str(scene), "--out", out, *(["--frames", frames] if frames else [])])
        if status == 0:
            picture = "contact_sheet.png" if frames else "thumbnail.png"
            receipt = max(Path(out).rglob("receipt.json"))
            shutil.copy(Path(out) / picture, PICTURES / f"{name}.png")
            shutil.copy(receipt, PICTURES / f"{name}.json")
            if json.loads(scene.read_bytes()).get("adaptive"):
                write_sample_map(PICTURES / f"{name}_samples.png", sample_counts(Path(out) / "result.exr"))
    return status


def sample_counts(picture: Path) -> NDArray[Any]:
    """Samples of each pixel, (height, width)."""
    with ExrReader(picture) as reader:
        return np.concatenate([band.integers["SampleCount"] for band in reader.bands()])


def gallery() -> str:
    """The page."""
    parts = [_HEAD]
    for name, shows, sampled in rows():
        receipt_path = PICTURES / f"{name}.json"
        if receipt_path.exists():
            receipt = Receipt.model_validate_json(receipt_path.read_bytes())
            parts.append(
                f"## {receipt.name}\n\n"
                f"![{name}](pictures/{name}.png){samples(receipt, name)}\n\n"
                f"{shows[0].upper()}{shows[1:]}. Sampled: {sampled}. [Scene](../examples/{name}.json).\n\n"
                f"{numbers(receipt)}\n"
            )
    return "\n".join(parts)


def samples(receipt: Receipt, name: str) -> str:
    """Beside an adaptive picture: where it took how many samples."""
    if receipt.adaptive is None:
        return ""
    return f" ![{name}: samples a pixel](pictures/{name}_samples.png)"


def numbers(receipt: Receipt) -> str:
    """What the picture cost and how wrong it is."""
    error = receipt.error.relative_error
    told = "its error is not known" if error is None else f"relative error {100 * error:.2g} %"
    effects = ", ".join(effect.name for effect in receipt.effects_in) or "none"
    spread = ""
    if receipt.adaptive is not None:
        levels = receipt.adaptive.levels
        spread = (
            f", {levels[-1].samples} in the darkest parts of the map to {levels[0].samples} in the lightest"
        )
    frame = "" if receipt.frame is None else f"Frame {receipt.frame}: "
    count = "1 sample" if receipt.samples == 1 else f"{receipt.samples:.0f} samples"
    return (
        f"{frame}{count} a pixel (`{receipt.sampler}`{spread}), {told}, "
        f"{receipt.forecast.real_seconds:.1f} s on {receipt.devices[0].name}. Effects: {effects}."
    )


if __name__ == "__main__":
    sys.exit(main())
