"""Tracing sum nodes on one device: uploads a compiled scene, picks its program, launches, merges."""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from penumbra_kernels.accel.compact import tree_arrays
from penumbra_kernels.allotment import AS_GIVEN, Allotment, even, halves, pilot_seed
from penumbra_kernels.layout import CONSTANTS, LAYERS, PARAMS
from penumbra_kernels.nodes import FLOAT32_SAMPLES, SumNode, Tile, joined, merge
from penumbra_kernels.sums import of_words, stride_of

if TYPE_CHECKING:
    import pyopencl as cl

    from penumbra_kernels.compile.scene import CompiledScene
    from penumbra_kernels.device import Device

LAUNCH_SECONDS: Final = 0.05
"""Display drivers kill longer launches; CPUs have none, and each launch waits for its slowest core."""
GROUP_SAMPLES: Final = 256
"""About as many samples a work-item of a CPU takes, over one or more (pixel, replicate) pairs: small groups spread evenly."""
MOST_GROUP_SAMPLES: Final = 1024
"""Where pixels take different numbers of samples."""
MAX_GROUPS: Final = 32768
"""PoCL compiles a kernel once more for grids of 65,535 and up, and once more for global offsets: neither is used."""
FIRST_THREADS: Final = 4096
"""Least work-items of a launch on a GPU, the first one's too: small ones leave it empty."""
MAX_THREADS: Final = 1 << 22
"""Work-items of one launch on a GPU: enough to fill any."""

_OTHER_SEED: Final = 0x2545F4914F6CDD1D

Flags = Mapping[str, int]


def _has(*names: str) -> Callable[[Flags], bool]:
    return lambda flags: any(flags[f"PENUMBRA_{name}"] for name in names)


def _always(flags: Flags) -> bool:
    return True


ARGUMENTS: Final[tuple[tuple[str, Callable[[Flags], bool]], ...]] = (
    ("params", _always),
    ("filter_table", _always),
    ("shutter_table", _has("MOTION", "CAMERA_MOTION", "DEFORMATION")),
    ("nodes", _always),
    ("packets", _always),
    ("corners", _always),
    ("shapes", _always),
    ("triangles", _always),
    ("positions", _always),
    ("normals", _always),
    ("uvs", _always),
    ("materials", _always),
    ("lights", _always),
    ("albedo_table", _has("GLOSS")),
    ("spheres", _has("ROUND")),
    ("discs", _has("ROUND")),
    ("planes", _has("ROUND")),
    ("instances", _has("INSTANCING")),
    ("keyframes", _has("MOTION", "CAMERA_MOTION")),
    ("times", _has("DEFORMATION")),
    ("textures", _has("TEXTURES")),
    ("texels", _has("TEXTURES")),
    ("light_table", _has("MANY_LIGHTS")),
    ("light_nodes", _has("LIGHT_TREE")),
    ("emitter_cdf", _has("AREA_LIGHTS")),
    ("environment", _has("ENVIRONMENT")),
    ("counts", lambda flags: flags["PENUMBRA_SAMPLER"] == CONSTANTS["SAMPLER_RANDOM"]),
    ("levels", _has("ADAPTIVE")),
    ("layers", _has("LAYERS")),
    ("drawn", lambda flags: bool(flags.get("PENUMBRA_COUNT_DRAWS"))),
    ("sums", _always),
    ("first_item", _always),
)
"""trace.cl's arguments in order, each with the condition under which the program has it."""

PER_LAUNCH: Final = frozenset({"params", "counts", "levels", "layers", "drawn", "sums", "first_item"})


MEASURING: Final[Flags] = {"PENUMBRA_PICK_FREEZE": 1, "PENUMBRA_COUNT_DRAWS": 1}
"""Macros of the programs that measure noise and count random numbers, and that no picture is made with."""


@dataclass(frozen=True)
class SamplePlan:
    """How samples are laid out over a pixel; part of what determines the bits."""

    replicates: int
    strata: int = 0
    """Planned samples a replicate, 0 where that is not known beforehand."""


def items_per_group(taken: Mapping[int, int]) -> int:
    """Of a CPU's work-item: GROUP_SAMPLES samples even where all of its pixels take the fewest that any does, since lanes
    that a pixel leaves free go to the next one of the group; but no more than MOST_GROUP_SAMPLES on average. taken: pixels by
    how many samples they take."""
    fewest = min((own for own in taken if own), default=1)
    mean = sum(own * pixels for own, pixels in taken.items()) / max(sum(taken.values()), 1)
    most = MOST_GROUP_SAMPLES / max(mean, 1.0)
    return max(int(min(GROUP_SAMPLES / fewest, most)), int(GROUP_SAMPLES / max(mean, 1.0)), 1)


def build_program(device: Device, flags: Flags) -> cl.Program:
    """trace.cl with these flags on this device, from the cache or compiled to its final code. Raises BuildError."""

    def launch_nothing(program: cl.Program) -> None:
        """Every argument is there, and no pixel: item_count is 0."""
        import pyopencl as cl

        blank = device.upload(np.zeros((), PARAMS))
        names = [name for name, present in ARGUMENTS if present(flags) and name != "first_item"]
        arguments = [blank, *(device.allocate(0) for _ in names[1:]), np.uint32(0)]
        device.launch(
            cl.Kernel(program, "trace"), arguments, *((1, 1) if device.info.kind == "cpu" else (64, 64))
        )

    return device.build("trace.cl", flags, first_launch=launch_nothing)


class Tracer:
    """A scene on a device. `program` picks the effects that are compiled in: just the scene's ('specialised') or all
    ('generic'); the bits are the same."""

    def __init__(
        self,
        device: Device,
        compiled: CompiledScene,
        plan: SamplePlan,
        *,
        program: str = "specialised",
        together: bool = True,
        measuring: bool = False,
        keep_arrays: bool = True,
    ) -> None:
        """together: CPUs take sixteen paths at a time; without, the scene's own program takes one, to the same bits.
        keep_arrays: leave the scene's arrays where they are; without, each is let go once the device has its copy.
        measuring: `other_groups` may name groups of dimensions that draw from a second stream (sensitivity.py), and `drawn`
        counts the numbers that are drawn."""
        self.device = device
        self.compiled = compiled
        self.plan = plan
        self.other_groups = 0
        """GROUP_* bits."""
        self.drawn = np.zeros(CONSTANTS["DRAWN_COUNT"], np.int64)
        """Numbers drawn so far, by dimension (dimensions.DRAWN); zeros where it is not measuring."""
        apart = {} if together else {"PENUMBRA_TOGETHER": 0}
        self._take_program(program, {**apart, **(MEASURING if measuring else {})})
        started = time.perf_counter()
        arrays = tree_arrays(compiled.arrays, device.flags)
        self._buffers: dict[str, cl.Buffer] = {}
        self._sizes: dict[str, int] = {}
        for name in self._uploaded():
            self._buffers[name] = device.upload(arrays[name])
            self._sizes[name] = arrays[name].nbytes
            if not keep_arrays:
                del arrays[name]
                compiled.arrays.pop(name, None)
        self.upload_seconds = time.perf_counter() - started
        self._params = compiled.params.copy()
        self._options = self._params["options"].copy()
        self._plan_strata(plan.strata)
        self._items_per_second = 0.0

    def _take_program(self, program: str, more: Flags) -> None:
        import pyopencl as cl

        features = self.compiled.features
        flags = features.flags() if program == "specialised" else features.generic_flags()
        started, builds = time.perf_counter(), self.device.builds
        self._program = build_program(self.device, {**flags, **more})  # held, so that the device knows it
        self._kernel = cl.Kernel(self._program, "trace")
        self.flags: Flags = {**flags, **more}
        self.compile_seconds = time.perf_counter() - started
        self.compiled_cold = self.device.builds > builds

    def _uploaded(self) -> list[str]:
        return [name for name, present in ARGUMENTS if present(self.flags) and name not in PER_LAUNCH]

    @property
    def scene_bytes(self) -> int:
        """Of scene data on the device that the program reads."""
        return sum(self._sizes[name] for name in self._buffers)

    def specialised(self) -> Tracer:
        """A tracer of the scene's own program on the buffers of this one, which has the generic program. Raises BuildError."""
        own = copy.copy(self)
        own._take_program("specialised", {})
        own._params = self._params.copy()
        own._buffers = {name: self._buffers[name] for name in own._uploaded()}
        return own

    def reseed(self, seed: int) -> None:
        """Take other random numbers from now on; scene and program stay."""
        self._params["seed"] = seed

    def trace(
        self, tile: Tile, first_sample: int, sample_count: int, allotment: Allotment | None = None
    ) -> SumNode:
        """The sum node of an aligned power-of-two range of samples, for every replicate; of an adaptive scene those that
        the allotment has the pixels take, or all.

        Work beyond FLOAT32_SAMPLES samples is done in such pieces and merged, and so is what reaches across the kept
        samples.
        """
        if self.flags["PENUMBRA_ADAPTIVE"]:
            allotment = allotment or even(tile, self.plan.strata)
            seed = int(self.compiled.params["seed"])
            self._params["seed"] = pilot_seed(seed) if allotment.pilot else seed
            self._params["kept"] = allotment.kept
        return self._trace(tile, first_sample, sample_count, allotment)

    def _trace(
        self, tile: Tile, first_sample: int, sample_count: int, allotment: Allotment | None
    ) -> SumNode:
        end = first_sample + sample_count
        if sample_count > FLOAT32_SAMPLES or first_sample < int(self._params["kept"]) < end:
            half = sample_count // 2
            left = self._trace(tile, first_sample, half, allotment)
            return merge(left, self._trace(tile, first_sample + half, half, allotment))
        return self._launch(tile, first_sample, sample_count, allotment)

    def _taken(self, first_sample: int, sample_count: int, allotment: Allotment | None) -> dict[int, int]:
        """Pixels by how many of these samples they take."""
        if allotment is None or not self.flags["PENUMBRA_ADAPTIVE"]:
            return {sample_count: 1}
        return allotment.samples(first_sample, sample_count)

    def _plan_strata(self, strata: int) -> None:
        self._params["strata"] = strata
        self._params["log2_samples"] = max(strata - 1, 0).bit_length() if strata else 32

    def _launch(
        self, tile: Tile, first_sample: int, sample_count: int, allotment: Allotment | None
    ) -> SumNode:
        """All replicates together, or one half after the other where their hits take different numbers of shadow rays."""
        rays = allotment.shadow_rays_at(first_sample) if allotment is not None else AS_GIVEN
        whole = (slice(self.plan.replicates),)
        chosen = whole if rays[0] == rays[1] else halves(self.plan.replicates)
        parts = []
        for replicates, of_hit in zip(chosen, rays, strict=False):
            self._params["shadow_rays"] = of_hit or self.compiled.params["shadow_rays"]
            parts.append(self._launch_part(replicates, tile, first_sample, sample_count, allotment))
        return parts[0] if len(parts) == 1 else joined(parts)

    def _launch_part(
        self, chosen: slice, tile: Tile, first_sample: int, sample_count: int, allotment: Allotment | None
    ) -> SumNode:
        """`chosen`: replicates."""
        params = self._params
        first_replicate, replicates = chosen.start or 0, chosen.stop - (chosen.start or 0)
        params["first_replicate"], params["replicate_count"] = first_replicate, replicates
        shape = (replicates, tile.height, tile.width)
        items = replicates * tile.height * tile.width
        buffers = dict(self._buffers)
        if allotment is not None and self.flags["PENUMBRA_ADAPTIVE"]:
            buffers["levels"] = self.device.upload(allotment.levels)
            # What is kept has the strata that it had before anything was decided.
            begun = first_sample < allotment.kept
            of_kept = allotment.kept if allotment.kept_planned is None else allotment.kept_planned
            self._plan_strata(of_kept if begun else allotment.planned)
        params["tile_x"], params["tile_y"] = tile.x, tile.y
        params["tile_width"], params["tile_height"] = tile.width, tile.height
        params["first_sample"], params["sample_count"] = first_sample, sample_count
        params["items_per_group"] = 1
        if self.device.info.kind == "cpu":
            params["items_per_group"] = items_per_group(self._taken(first_sample, sample_count, allotment))
        params["item_count"] = items
        params["options"] = self._options | np.uint32(self.other_groups << CONSTANTS["OPTION_OTHER_SHIFT"])
        params["sum_stride"] = stride = stride_of(items)
        words = np.empty((CONSTANTS["SUM_PLANES"], *shape), np.uint32)
        layers = np.empty(shape, LAYERS) if self.flags["PENUMBRA_LAYERS"] else None
        buffers["params"] = self.device.upload(params)
        buffers["sums"] = self.device.allocate(4 * len(words) * stride)
        if layers is not None:
            buffers["layers"] = self.device.allocate(layers.nbytes)
        counted = self.flags.get("PENUMBRA_COUNT_DRAWS")
        drawn = np.empty((items, len(self.drawn)), np.uint32) if counted else None
        if drawn is not None:
            buffers["drawn"] = self.device.allocate(drawn.nbytes)
        if self.flags["PENUMBRA_SAMPLER"] == CONSTANTS["SAMPLER_RANDOM"]:
            buffers["counts"] = self.device.upload(self._counts(tile, first_sample, sample_count))
        arguments = [
            buffers[name] for name, present in ARGUMENTS if present(self.flags) and name != "first_item"
        ]
        self._run(arguments, items, int(params["items_per_group"]), sample_count)
        self.device.download_rows(buffers["sums"], words.reshape(len(words), items), 4 * stride)
        if layers is not None:
            self.device.download(buffers["layers"], layers)
        if drawn is not None:
            self.device.download(buffers["drawn"], drawn)
            self.drawn += drawn.sum(axis=0, dtype=np.int64)
        return SumNode(tile, first_sample, sample_count, of_words(words), layers)

    def _run(self, arguments: list[Any], items: int, per_group: int, sample_count: int) -> None:
        """Launch all items, on GPUs in slices of about LAUNCH_SECONDS at the rate measured so far."""
        cpu = self.device.info.kind == "cpu"
        local = 1 if cpu else 64
        at = 0
        while at < items:
            rate = self._items_per_second / sample_count
            most = max(int(rate * LAUNCH_SECONDS / per_group), FIRST_THREADS)
            groups = MAX_GROUPS if cpu else min(most, MAX_THREADS)
            groups = -(-min(groups, -(-(items - at) // per_group)) // local) * local
            started = time.perf_counter()
            self.device.launch(self._kernel, [*arguments, np.uint32(at)], groups, local)
            elapsed = max(time.perf_counter() - started, 1e-6)
            done = min(groups * per_group, items - at)
            self._items_per_second = done * sample_count / elapsed
            at += done

    def _counts(self, tile: Tile, first_sample: int, sample_count: int) -> np.ndarray[Any, Any]:
        from penumbra_kernels.sampling.random_plane import counts

        params = self._params
        other = self.other_groups & CONSTANTS["GROUP_PIXEL"]  # how many fall where is the pixel's dimension
        return counts(
            int(params["seed"]) ^ (_OTHER_SEED if other else 0),
            int(params["film_width"]),
            int(params["film_height"]),
            tile,
            self.plan.replicates,
            first_sample,
            sample_count,
        )
