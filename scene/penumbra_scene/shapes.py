"""Shapes. Each has a material, a transform, and may emit light. Outside is where its normal points."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, model_validator

from penumbra_scene import limits
from penumbra_scene.assets import AssetRef
from penumbra_scene.base import Bool, Direction, Float, Model, Name, Positive, Radiance, Vec2, Vec3, error_at
from penumbra_scene.transforms import Transform


class Emission(Model):
    """Makes the shape an area light."""

    radiance: Radiance
    """W / (m^2 sr)."""
    two_sided: Bool = False
    """Emit on the back of the surface as well."""


class _Shape(Model):
    name: Name | None = None
    transform: Transform = ()


class _Surface(_Shape):
    material: Name | None = None
    """A name under the scene's `materials`; without one, a gray diffuse surface (black where it emits)."""
    emission: Emission | None = None


class Sphere(_Surface):
    type: Literal["sphere"]
    center: Vec3 = (0.0, 0.0, 0.0)
    radius: Positive = 1.0


class Quad(_Surface):
    """The parallelogram origin + a*u + b*v, a and b in [0, 1]; its normal is u x v and (a, b) its uv."""

    type: Literal["quad"]
    origin: Vec3 = (-1.0, -1.0, 0.0)
    u: Direction = (2.0, 0.0, 0.0)
    v: Direction = (0.0, 2.0, 0.0)

    @model_validator(mode="after")
    def _has_area(self) -> Quad:
        u, v = self.u, self.v
        cross = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
        if sum(x * x for x in cross) <= 1e-12 * sum(x * x for x in u) * sum(x * x for x in v):
            raise error_at("/v", "u and v are parallel", "a vector that is not parallel to u")
        return self


class Disc(_Surface):
    type: Literal["disc"]
    center: Vec3 = (0.0, 0.0, 0.0)
    normal: Direction = (0.0, 0.0, 1.0)
    radius: Positive = 1.0


class Plane(_Shape):
    """An infinite plane; uv are metres along two fixed axes in it. It cannot emit."""

    type: Literal["plane"]
    material: Name | None = None
    point: Vec3 = (0.0, 0.0, 0.0)
    normal: Direction = (0.0, 1.0, 0.0)


Index = Annotated[int, Field(strict=True, ge=0, lt=2**31)]
Triangle = tuple[Index, Index, Index]
# fail_fast: one error says enough about an array, and a list of a million errors helps nobody.
Positions = Annotated[tuple[Vec3, ...], Field(min_length=3, fail_fast=True)]
Triangles = Annotated[
    tuple[Triangle, ...], Field(min_length=1, max_length=limits.MAX_TRIANGLES, fail_fast=True)
]
Normals = Annotated[tuple[Direction, ...], Field(fail_fast=True)]
Uvs = Annotated[tuple[Vec2, ...], Field(fail_fast=True)]


_MESH_FORMS = "positions with indices, or source"


class MeshKeyframe(Model):
    time: Float
    """Seconds."""
    positions: Positions
    """As many as the mesh has."""


class Mesh(_Surface):
    """Triangles: inline arrays (positions and indices), or an asset (OBJ, PLY, GLB)."""

    type: Literal["mesh"]
    positions: Positions | None = None
    """Metres, before the transform."""
    indices: Triangles | None = None
    """Counter-clockwise seen from outside."""
    normals: Normals | None = None
    """One a vertex; without them triangles are flat."""
    uvs: Uvs | None = None
    """One a vertex, (0, 0) at an image's lower left."""
    source: AssetRef | None = None
    """OBJ, PLY or GLB, read with its own normals and uvs."""
    smooth: Bool = False
    """Compute vertex normals where the mesh brings none."""
    deformation: Annotated[tuple[MeshKeyframe, ...], Field(min_length=2, max_length=256)] | None = None
    """Vertex positions over time, linear in between; they replace `positions`."""

    @model_validator(mode="after")
    def _consistent(self) -> Mesh:
        inline = self.positions is not None or self.indices is not None
        if (self.normals is not None or self.uvs is not None) and self.source is not None:
            raise error_at("/source", "normals and uvs come from the source", "source alone")
        if inline == (self.source is not None):
            raise error_at("", "has neither or both of inline arrays and a source", _MESH_FORMS)
        if inline:
            self._check_arrays()
        if self.deformation is not None:
            self._check_deformation()
        return self

    def _check_arrays(self) -> None:
        if self.positions is None or self.indices is None:
            raise error_at("", "positions and indices belong together", _MESH_FORMS)
        count = len(self.positions)
        for i, triangle in enumerate(self.indices):
            if max(triangle) >= count:
                raise error_at(f"/indices/{i}", f"there are {count} positions", f"0 to {count - 1}")
        for key in ("normals", "uvs"):
            values = getattr(self, key)
            if values is not None and len(values) != count:
                raise error_at(f"/{key}", f"{len(values)} entries for {count} positions", f"{count} entries")

    def _check_deformation(self) -> None:
        assert self.deformation is not None
        times = [k.time for k in self.deformation]
        if any(b <= a for a, b in pairwise(times)):
            raise error_at("/deformation", "times must rise strictly", "times that rise")
        if self.emission is not None:
            raise error_at("/emission", "a deforming mesh cannot emit", "null")
        counts = {len(k.positions) for k in self.deformation}
        if len(counts) > 1 or (self.positions is not None and counts != {len(self.positions)}):
            raise error_at("/deformation", "a keyframe has not as many positions as the mesh", "equal counts")


class Instance(_Shape):
    """A copy of a prototype, placed by its own transform; geometry is stored once."""

    type: Literal["instance"]
    prototype: Name
    """A name under the scene's `prototypes`."""


Shape = Annotated[Sphere | Quad | Disc | Plane | Mesh | Instance, Field(discriminator="type")]
PrototypeShape = Annotated[Sphere | Quad | Disc | Mesh, Field(discriminator="type")]
