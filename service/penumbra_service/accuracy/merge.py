"""`penumbra merge`: renders of one picture with different seeds, taken together into one EXR."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, Final

from penumbra_service.film.develop import Developed
from penumbra_service.film.merge import merge_bands, picture_error
from penumbra_service.film.replicates import DETERMINISTIC_SAMPLERS
from penumbra_service.images.exr import ExrLayout, write_exr
from penumbra_service.images.exr_read import ExrReader
from penumbra_service.results import ATTRIBUTE

Value = str | int | float
NEEDED: Final = ("seed", "sampler", "replicates", "samples", "pictureHash", "seconds", "biased")
"""Attributes without which nobody can tell whether renders may be merged, or what came of it."""
FIXED_POSITIONS: Final = "stratified"
"""The sampler whose positions in the pixel are fixed, so that it converges to another picture than the rest."""

_OF_ONE_RUN: Final = (
    "relmse", "relativeError", "flaggedShare", "theta", "predictedSamples", "predictedSeconds",
)  # fmt: skip


class MergeError(ValueError):
    """These files cannot be merged; the message says why, and what to do."""


@dataclass(frozen=True)
class Merged:
    """What came of a merge."""

    path: Path
    renders: int
    """Renders that it is made of, those in merged files counted apart."""
    seeds: tuple[str, ...]
    samples: float
    """A pixel, on average."""
    relative_error: float | None
    flagged_share: float


def merge_files(paths: Sequence[Path], out: Path) -> Merged:
    """Merge result.exr files into `out`. Raises MergeError, images.exr_read.NotARenderError, OSError."""
    if len(paths) < 2:
        raise MergeError("there must be at least two files to merge")
    with ExitStack() as stack:
        readers = [stack.enter_context(ExrReader(path)) for path in paths]
        for reader in readers:
            _demand_attributes(reader)
        _demand_one_picture(readers)
        _demand_independence(readers)
        error, flagged = picture_error(_merged(readers))
        told = attributes([_ours(reader) for reader in readers])
        told["flaggedShare"] = flagged
        if error.known:
            told |= {"relmse": error.relmse, "relativeError": error.relative_error}
        write_exr(out, _layout(readers, told), _merged(readers))
    return Merged(
        path=out,
        renders=int(told["mergedRenders"]),
        seeds=tuple(str(told["seed"]).split()),
        samples=float(told["samples"]),
        relative_error=error.relative_error if error.known else None,
        flagged_share=flagged,
    )


def _merged(readers: Sequence[ExrReader]) -> Iterator[Developed]:
    return (merge_bands(parts) for parts in zip(*(reader.bands() for reader in readers), strict=True))


def _layout(readers: Sequence[ExrReader], told: Mapping[str, Value]) -> ExrLayout:
    first = readers[0]
    general: dict[str, Value] = {"Software": str(first.attributes.get("Software", "Penumbra"))}
    if "ImageDescription" in first.attributes:
        general["comments"] = str(first.attributes["ImageDescription"])
    return ExrLayout(
        first.window,
        *first.full_size,
        float_channels=first.float_channels,
        integer_channels=first.integer_channels,
        half=all(reader.half for reader in readers),
        attributes=general | {ATTRIBUTE + name: value for name, value in told.items()},
    )


def _ours(reader: ExrReader) -> dict[str, Any]:
    """The attributes that say how the file was made."""
    return {
        name.removeprefix(ATTRIBUTE): value
        for name, value in reader.attributes.items()
        if name.startswith(ATTRIBUTE)
    }


def _demand_attributes(reader: ExrReader) -> None:
    ours = _ours(reader)
    missing = [ATTRIBUTE + name for name in NEEDED if ours.get(name) in (None, "")]
    if missing:
        raise MergeError(
            f"{reader.path} lacks {', '.join(missing)}: give the result.exr as it was rendered, "
            "by this version or a later one; programs that edit images drop attributes"
        )


def _demand_one_picture(readers: Sequence[ExrReader]) -> None:
    first = readers[0]
    for other in readers[1:]:
        pair = f"{first.path} and {other.path}"
        if (first.full_size, first.window) != (other.full_size, other.window):
            raise MergeError(f"{pair} show different pixels: {_pixels(first)}, and {_pixels(other)}")
        for ours, theirs in (
            (first.float_channels, other.float_channels),
            (first.integer_channels, other.integer_channels),
        ):
            if set(ours) != set(theirs):
                odd = ", ".join(sorted(set(ours) ^ set(theirs)))
                raise MergeError(f"{pair}: only one has {odd}; render both with the same film.layers")
        if _ours(first)["pictureHash"] != _ours(other)["pictureHash"]:
            raise MergeError(
                f"{pair} are of different scenes: only name, sampler, seed, stop rule, layers, storage and how "
                "lights are sampled may differ between them"
            )


def _pixels(reader: ExrReader) -> str:
    w = reader.window
    full = f"{reader.full_size[0]} x {reader.full_size[1]}"
    return f"{w.width} x {w.height} from ({w.x}, {w.y}) of {full}"


def _demand_independence(readers: Sequence[ExrReader]) -> None:
    for reader in readers:
        for sampler in str(_ours(reader)["sampler"]).split():
            if sampler in DETERMINISTIC_SAMPLERS:
                raise MergeError(
                    f"{reader.path}: the sampler {sampler!r} is deterministic, so that every seed gives the "
                    "same picture and merging adds nothing"
                )
    for one, other in combinations(readers, 2):
        shared = set(str(_ours(one)["seed"]).split()) & set(str(_ours(other)["seed"]).split())
        if shared:
            raise MergeError(
                f"{one.path} and {other.path} were both rendered with seed {min(shared)}: their samples are the "
                "same, not new ones. Render one of them again with another --seed"
            )
        samplers = [set(str(_ours(reader)["sampler"]).split()) for reader in (one, other)]
        if samplers[0] != samplers[1] and any(FIXED_POSITIONS in names for names in samplers):
            raise MergeError(
                f"{one.path} and {other.path}: {FIXED_POSITIONS!r} keeps fixed positions in the pixel and converges to "
                "another picture than other samplers; merge it with its own kind"
            )


def attributes(renders: Sequence[Mapping[str, Any]]) -> dict[str, Value]:
    """What a merged file says of its own making, from what its parts say."""
    told = {
        name: _joined([render.get(name, "") for render in renders])
        for name in sorted({name for render in renders for name in render})
    }
    for name in ("samples", "seconds", "deviceSeconds"):
        told[name] = float(sum(float(render.get(name, 0.0)) for render in renders))
    told["replicates"] = sum(int(render["replicates"]) for render in renders)
    told["rejectedSamples"] = str(sum(int(render.get("rejectedSamples", 0)) for render in renders))
    told["seed"] = " ".join(str(render["seed"]) for render in renders)
    told["sampler"] = " ".join(dict.fromkeys(w for r in renders for w in str(r["sampler"]).split()))
    told["mergedRenders"] = sum(int(render.get("mergedRenders", 1)) for render in renders)
    told["mergedFrom"] = "; ".join(str(render.get("mergedFrom") or _name(render)) for render in renders)
    if "shadowRays" in told:
        told["shadowRays"] = _joined([render.get("shadowRays", "the scene's") for render in renders])
    told["stopReason"] = "merged"
    told["biased"] = _joined([r["biased"] for r in renders if r["biased"] != "no"]) or "no"
    told["variance"] = (
        f"variance of the mean over {told['mergedRenders']} independent renders weighted by their samples, "
        "sum w_i^2 V_i, each V_i = sum (m_r - m)^2 / (R (R - 1))"
    )
    for stale in _OF_ONE_RUN:
        told.pop(stale, None)
    return told


def _name(render: Mapping[str, Any]) -> str:
    return (
        f"seed {render['seed']}: {float(render['samples']):g} samples of {render['sampler']} "
        f"in {int(render['replicates'])} replicates"
    )


def _joined(values: Sequence[Any]) -> Value:
    """The one value of all, or the different ones as text."""
    different = list(dict.fromkeys(value for value in values if value != ""))
    if len(different) == 1:
        value: Value = different[0]
        return value
    return "; ".join(str(value) for value in different)


def in_words(merged: Merged) -> str:
    """For people."""
    error = "unknown" if merged.relative_error is None else f"{100 * merged.relative_error:.3g} %"
    return (
        f"{merged.path}: {merged.renders} renders, {merged.samples:g} samples a pixel, relative error {error}, "
        f"{100 * merged.flagged_share:.3g} % of the pixels flagged"
    )
