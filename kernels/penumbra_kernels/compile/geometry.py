"""Shapes -> vertices, primitives, instances and the trees over them.

What stands still is flattened into the world's tree, relative to the anchor in float64. What moves,
prototypes, and spheres that a transform makes ellipsoids have trees of their own, placed by instances.
What stands still while the shutter is open but is elsewhere, or of another form, in other frames lies in the world's
frame as well. Where much never changes and something else does, or there are instances, what never changes is a tree of
its own below the world's, so that it is found again in the next frame, whatever moved.
Shapes of prototypes that emit are copied for each placement, so that every light has its own shape record.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from penumbra_scene.area import emits
from penumbra_scene.scene import Scene
from penumbra_scene.shapes import Disc, Instance, Mesh, Plane, Quad, Sphere

from penumbra_kernels.accel.binary import SWEEP_LIMIT
from penumbra_kernels.accel.build import MAX_STACK, Tree, boxes_only, instance_word
from penumbra_kernels.accel.trees import Trees
from penumbra_kernels.assets import Assets
from penumbra_kernels.compile import bounds
from penumbra_kernels.compile.materials import BLACK_MATERIAL, DEFAULT_MATERIAL
from penumbra_kernels.compile.placement import (
    Motion,
    Shutter,
    is_deformed,
    shutter_parts,
    slide,
    static_motion,
)
from penumbra_kernels.compile.primitives import (
    NONE,
    Growing,
    TreeItems,
    Vertices,
    add_disc,
    add_plane,
    add_sphere,
    add_triangles,
)
from penumbra_kernels.compile.together import packet_corners, together
from penumbra_kernels.compile.transforms import is_animated, is_similarity
from penumbra_kernels.layout import CONSTANTS, INSTANCE, KEYFRAME, SHAPE

Surface = Sphere | Quad | Disc | Mesh

PRIMITIVE_TRIANGLE: Final = 0
PRIMITIVE_SPHERE: Final = 1
PRIMITIVE_DISC: Final = 2
PRIMITIVE_PLANE: Final = 3


@dataclass(frozen=True)
class ShapeRecord:
    """One entry of `shapes`, and where its primitives are."""

    shape: int
    """Index into arrays["shapes"]; the lights compiler writes its light's index into ["light"] there."""
    scene_shape: int
    """Index into scene.shapes (of the Instance, where a prototype was placed)."""
    model: Surface | Plane
    kind: int
    """PRIMITIVE_*."""
    first: int
    """First primitive in the arrays of that kind."""
    count: int
    instance: int
    """That places the primitives, or NONE: they are in the world frame. Of several (a prototype's), the
    first."""
    world_from_object: NDArray[np.float64]
    """(4, 4) from the model's own frame (before any transform) to the anchor-relative world, at the
    shutter's opening."""
    moving: bool
    """The instance moves while the shutter is open: its keyframes say how."""

    @property
    def emits(self) -> bool:
        return emits(self.model)


@dataclass(frozen=True)
class CompiledGeometry:
    """Everything that intersect and surface_at read."""

    arrays: dict[str, NDArray[Any]]
    """nodes, packets, corners, spheres, discs, planes, instances, times, shapes, triangles, positions, normals,
    uvs."""
    keyframes: NDArray[Any]
    """(n,) of KEYFRAME, those of instances and planes; indices count from its start."""
    root: int
    """Child word of the world's tree."""
    plane_count: int
    triangle_count: int
    records: tuple[ShapeRecord, ...]
    """In the order of arrays["shapes"]."""
    instance_boxes: tuple[tuple[NDArray[np.float64], NDArray[np.float64]], ...]
    """In the order of arrays["instances"], without the world's still part: around all that each passes through while the
    shutter is open."""

    @property
    def emitters(self) -> tuple[ShapeRecord, ...]:
        """The records that give light."""
        return tuple(record for record in self.records if record.emits)


@dataclass(frozen=True)
class _Part:
    """A tree of its own, to be placed by instances."""

    root: int
    lo: NDArray[np.float64]
    hi: NDArray[np.float64]
    inner: Motion
    """What is applied before the placement."""


class _Compiler:
    def __init__(
        self,
        scene: Scene,
        assets: Assets,
        shutter: Shutter,
        anchor: NDArray[np.float64],
        materials: Mapping[str, int],
        known: Trees,
    ) -> None:
        self.scene, self.assets, self.shutter, self.anchor, self.materials = (
            scene,
            assets,
            shutter,
            anchor,
            materials,
        )
        self.known = known
        self.vertices = Vertices()
        self.world = TreeItems()
        self.changing: list[tuple[int, int]] = []
        """Ranges of its items that are elsewhere, or of another form, in other frames."""
        self.placed: list[tuple[NDArray[np.float64], NDArray[np.float64], int]] = []
        """Boxes and leaf words of the instances."""
        self.trees: list[Tree] = []
        self.packets: list[NDArray[Any]] = []
        self.nodes = 0
        self.packet_count = 0
        self.shapes: list[NDArray[Any]] = []
        self.records: list[ShapeRecord] = []
        self.instances: list[NDArray[Any]] = []
        self.keyframes = Growing(KEYFRAME)
        self.prototypes: dict[str, list[_Part]] = {}

    def compile(self) -> CompiledGeometry:
        for i, shape in enumerate(self.scene.shapes):
            where = f"shapes/{i}"
            if isinstance(shape, Instance):
                self._instance(shape, i, where)
            elif isinstance(shape, Plane):
                self._plane(shape, i)
            else:
                self._place(shape, i, self._outer(shape), where, changes=is_animated(shape.transform))
        return self._result(self._world())

    def _outer(self, shape: Surface | Plane | Instance) -> Motion:
        return Motion.of(shape.transform, self.shutter, self.anchor)

    def _material(self, shape: Surface | Plane) -> int:
        if shape.material is not None:
            return self.materials[shape.material]
        lamp = not isinstance(shape, Plane) and shape.emission is not None
        return BLACK_MATERIAL if lamp else DEFAULT_MATERIAL

    def _shape(self, model: Surface | Plane, scene_shape: int) -> NDArray[Any]:
        record = np.zeros((), SHAPE)
        record["material"] = self._material(model)
        record["light"] = NONE
        record["object_id"] = scene_shape + 1
        self.shapes.append(record)
        return record

    def _primitives(
        self, model: Surface, scene_shape: int, matrix: NDArray[np.float64], items: TreeItems, where: str
    ) -> tuple[int, int, int]:
        """Write one shape's primitives, under a still matrix, into a tree: (kind, first, count)."""
        record = self._shape(model, scene_shape)
        number = len(self.shapes) - 1
        if isinstance(model, Sphere):
            return PRIMITIVE_SPHERE, add_sphere(self.vertices, items, model, matrix, number, record), 1
        if isinstance(model, Disc):
            return PRIMITIVE_DISC, add_disc(self.vertices, items, model, matrix, number, record), 1
        first, count = add_triangles(
            self.vertices, items, model, self.assets, matrix, number, record, self.shutter, where
        )
        return PRIMITIVE_TRIANGLE, first, count

    def _note(
        self,
        model: Surface | Plane,
        scene_shape: int,
        ranges: tuple[int, int, int],
        instance: int,
        motions: Sequence[Motion],
    ) -> None:
        matrix = np.eye(4)
        for motion in motions:
            matrix = matrix @ motion.start
        moving = any(motion.moves for motion in motions)
        kind, first, count = ranges
        number = len(self.shapes) - 1
        self.records.append(
            ShapeRecord(number, scene_shape, model, kind, first, count, instance, matrix, moving)
        )

    def _place(
        self,
        model: Surface,
        scene_shape: int,
        outer: Motion,
        where: str,
        inner: Motion | None = None,
        *,
        changes: bool,
    ) -> None:
        """A shape of its own: in the world's tree where it stands still, else an instance. `changes`: it is elsewhere in
        other frames."""
        motions = [outer] if inner is None else [outer, inner]
        if not any(m.moves for m in motions):
            matrix = outer.start if inner is None else outer.start @ inner.start
            if not isinstance(model, Sphere) or is_similarity(matrix):
                first = self.world.count
                ranges = self._primitives(model, scene_shape, matrix, self.world, where)
                if changes or (isinstance(model, Mesh) and is_deformed(model)):
                    self.changing.append((first, self.world.count))
                self._note(model, scene_shape, ranges, NONE, motions)
                return
        items = TreeItems()
        ranges = self._primitives(model, scene_shape, np.eye(4), items, where)
        part = self._part(items, inner or static_motion(np.eye(4)))
        instance = NONE if part is None else self._add_instance(part, outer, 0)
        self._note(model, scene_shape, ranges, instance, motions)

    def _part(self, items: TreeItems, inner: Motion) -> _Part | None:
        if not items.count:
            return None
        lo, hi = items.bounds()
        return _Part(self._tree(items).root, lo, hi, inner)

    def _add_instance(self, part: _Part, outer: Motion, object_id: int) -> int:
        record = np.zeros((), INSTANCE)
        record["root"] = part.root
        record["object_id"] = object_id
        matrix = self._set_motion(record, outer, part.inner)
        # Coming into the object's frame rounds the ray's origin, the more the further the object's frame is
        # off.
        offset = np.abs(matrix[:3, :3]) @ np.abs(record["object_from_world"][:, 3].astype(np.float64))
        pad = bounds.BOX_SLACK * (offset + np.abs(matrix[:3, 3]))
        if outer.moves or part.inner.moves:
            lo, hi = self._sweep(record, outer, part)
            record["motion_node"] = self.nodes
            boxes = bounds.padded(lo - pad, hi + pad)
            self._append(boxes_only(*boxes, instance_word(len(self.instances))))
        else:
            lo, hi = (x[None] for x in bounds.transformed(part.lo, part.hi, matrix))
        index = len(self.instances)
        self.instances.append(record)
        self.placed.append((lo.min(axis=0) - pad, hi.max(axis=0) + pad, instance_word(index)))
        return index

    def _sweep(self, record: NDArray[Any], outer: Motion, part: _Part) -> tuple[NDArray[np.float64], ...]:
        """(MOTION_BOXES, 3) lower and upper corners of what a moving instance passes through, part by part of the time that
        its keyframes span."""
        which = "" if record["keyframe_count"] else "inner_"
        first, count = int(record[f"{which}first_keyframe"]), int(record[f"{which}keyframe_count"])
        times = shutter_parts(self.shutter, self.keyframes.array[first : first + count])
        lo, hi = (np.broadcast_to(x, (len(times[0]), 3)) for x in (part.lo, part.hi))
        return outer.sweep(*part.inner.sweep(lo, hi, times), times)

    def _set_motion(self, record: NDArray[Any], outer: Motion, inner: Motion) -> NDArray[np.float64]:
        """Write an instance's matrices and keyframes; returns the one that it has at the shutter's opening."""
        together = slide(outer, inner)
        apart = together is None and (outer.moves or inner.moves)
        matrix = outer.start if apart else outer.start @ inner.start
        record["world_from_object"] = matrix[:3]
        record["object_from_world"] = np.linalg.inv(matrix)[:3]
        if together is not None:
            record["slides"] = 1
            record["first_keyframe"], record["keyframe_count"] = self._add_keyframes(together)
        if apart and outer.moves:
            record["first_keyframe"], record["keyframe_count"] = self._add_keyframes(outer.keyframes())
        if apart and (inner.moves or not inner.is_identity):
            keys = inner.keyframes()
            record["inner_first_keyframe"], record["inner_keyframe_count"] = self._add_keyframes(keys)
        return matrix

    def _add_keyframes(self, keys: NDArray[Any]) -> tuple[int, int]:
        return self.keyframes.append(keys), len(keys)

    def _instance(self, instance: Instance, scene_shape: int, where: str) -> None:
        outer = self._outer(instance)
        name = instance.prototype
        if name not in self.prototypes:
            self.prototypes[name] = self._prototype(name, scene_shape, outer)
        for part in self.prototypes[name]:
            self._add_instance(part, outer, scene_shape + 1)
        for model in self.scene.prototypes[name]:
            if emits(model):
                inner = Motion.of(model.transform, self.shutter)
                changes = is_animated(instance.transform) or is_animated(model.transform)
                self._place(model, scene_shape, outer, where, inner, changes=changes)

    def _prototype(self, name: str, scene_shape: int, outer: Motion) -> list[_Part]:
        """A tree for what stands still in the prototype, and one for each shape that moves in it or is an
        ellipsoid."""
        still = TreeItems()
        parts: list[_Part] = []
        next_instance = len(self.instances)
        for i, model in enumerate(self.scene.prototypes[name]):
            if emits(model):
                continue
            where = f"prototypes/{name}/{i}"
            inner = Motion.of(model.transform, self.shutter)
            if not inner.moves and (not isinstance(model, Sphere) or is_similarity(inner.start)):
                ranges = self._primitives(model, scene_shape, inner.start, still, where)
                self._note(model, scene_shape, ranges, next_instance, [outer, inner])
                continue
            items = TreeItems()
            ranges = self._primitives(model, scene_shape, np.eye(4), items, where)
            self._note(model, scene_shape, ranges, next_instance, [outer, inner])
            part = self._part(items, inner)
            parts += [part] if part is not None else []
        base = self._part(still, static_motion(np.eye(4)))
        return ([base] if base is not None else []) + parts

    def _plane(self, plane: Plane, scene_shape: int) -> None:
        motion = self._outer(plane)
        self._shape(plane, scene_shape)
        index = add_plane(
            self.vertices, plane, np.eye(4) if motion.moves else motion.start, len(self.shapes) - 1
        )
        if motion.moves:
            record = self.vertices.planes[index]
            record["first_keyframe"], record["keyframe_count"] = self._add_keyframes(motion.keyframes())
        self._note(plane, scene_shape, (PRIMITIVE_PLANE, index, 1), NONE, [motion])

    def _tree(self, items: TreeItems) -> Tree:
        tree = self.known.tree(items.items(), items.copies()).moved(self.nodes, self.packet_count)
        self.packets.append(items.packets(tree, self.vertices))
        self._append(tree)
        return tree

    def _append(self, tree: Tree) -> None:
        self.trees.append(tree)
        self.nodes += len(tree.nodes)
        self.packet_count += len(tree.packet_items)

    def _world(self) -> int:
        """The root of the world's tree."""
        still = self.world.count - sum(end - first for first, end in self.changing)
        if still > SWEEP_LIMIT and (self.placed or still < self.world.count):
            root = self._world_in_parts()
            if root is not None:
                return root
        for lo, hi, word in self.placed:
            self.world.add(lo[None], hi[None], word)
        return self._tree(self.world).root

    def _world_in_parts(self) -> int | None:
        """The trees over what never changes and over what does, as leaves of a tree over them and the instances; None where
        that is too deep."""
        parts = (
            [items for items in self.world.split(self.changing) if items.count]
            if self.changing
            else [self.world]
        )
        top_items = TreeItems()
        for lo, hi, word in self.placed:
            top_items.add(lo[None], hi[None], word)
        # Words that stand for them: no instance has these numbers.
        words = [instance_word(CONSTANTS["LEAF_INSTANCE_MASK"] - i) for i in range(len(parts))]
        for items, word in zip(parts, words, strict=True):
            lo, hi = items.bounds()
            top_items.add(lo[None], hi[None], word)
        top = self.known.tree(top_items.items(), top_items.copies())
        stack = max(self.known.tree(items.items(), items.copies()).stack for items in parts)
        if top.stack + stack > MAX_STACK:
            return None
        roots = [self._tree(items).root for items in parts]
        top = top.moved(self.nodes, self.packet_count)
        for word, root in zip(words, roots, strict=True):
            top = top.grafted(word, root)
        self._append(top)
        return top.root

    def _result(self, root: int) -> CompiledGeometry:
        arrays = self.vertices.arrays()
        arrays["nodes"] = _joined([tree.nodes for tree in self.trees])
        arrays["packets"] = packets = _joined(self.packets)
        arrays["corners"] = packet_corners(packets if together(arrays) else packets[:0])
        arrays["instances"] = np.array(self.instances, INSTANCE)
        arrays["shapes"] = np.array(self.shapes, SHAPE)
        planes, triangles = len(arrays["planes"]), len(arrays["triangles"])
        records, boxes = tuple(self.records), tuple((lo, hi) for lo, hi, _ in self.placed)
        return CompiledGeometry(arrays, self.keyframes.array, root, planes, triangles, records, boxes)


def _joined(parts: list[NDArray[Any]]) -> NDArray[Any]:
    """One after the other; a single one as it is."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def compile_geometry(
    scene: Scene,
    assets: Assets,
    time: float,
    anchor: NDArray[np.float64],
    materials: Mapping[str, int],
    trees: Trees | None = None,
) -> CompiledGeometry:
    """The frame at `time` seconds. materials: name -> index. trees: where trees of frames before are found.
    Raises AssetError for assets that are missing or broken."""
    shutter = Shutter(time, scene.camera.shutter.open, scene.camera.shutter.close)
    at = np.asarray(anchor, np.float64)
    return _Compiler(scene, assets, shutter, at, materials, trees or Trees()).compile()
