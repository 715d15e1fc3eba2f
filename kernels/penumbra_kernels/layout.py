"""Every struct that host and device share, as numpy dtypes: the only source. `write_header` makes cl/layout.h from it.

Rules: no float3, large fields first, every pad named, sizes are multiples of 16 bytes where a struct holds vectors.
Lengths are metres relative to the scene's anchor (see compile/), times are seconds, colours linear Rec.709.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

F4: Final = (np.float32, 4)

CAMERA: Final = np.dtype(
    [
        ("world_from_camera", np.float32, (3, 4)),  # rows; at the shutter's opening where the camera moves
        (
            "scale_x",
            np.float32,
        ),  # camera-space x of the picture's right edge at z = -1 (perspective) or anywhere
        ("scale_y", np.float32),
        ("aperture_radius", np.float32),
        ("focus_distance", np.float32),
        ("blade_rotation", np.float32),  # radians
        ("shutter_open", np.float32),
        ("shutter_close", np.float32),
        ("kind", np.uint32),  # 0 perspective, 1 orthographic
        ("blades", np.uint32),
        ("first_keyframe", np.uint32),
        ("keyframe_count", np.uint32),  # 0: world_from_camera holds at all times
        ("pad0", np.uint32),
    ]
)

PARAMS: Final = np.dtype(
    [
        ("camera", CAMERA),
        ("seed", np.uint64),
        ("first_sample", np.uint64),  # of the sum node's range in each replicate
        ("sample_count", np.uint32),  # a power of two, at most 256
        ("first_replicate", np.uint32),
        ("replicate_count", np.uint32),
        ("strata", np.uint32),  # planned samples a replicate; 0: unknown, strata double
        ("tile_x", np.uint32),
        ("tile_y", np.uint32),
        ("tile_width", np.uint32),
        ("tile_height", np.uint32),
        ("film_width", np.uint32),  # of the full frame: samples are keyed by its pixels
        ("film_height", np.uint32),
        ("filter_radius", np.float32),
        ("max_bounces", np.uint32),
        ("roulette_start", np.uint32),
        ("shadow_rays", np.uint32),
        ("light_count", np.uint32),  # without the environment
        ("plane_count", np.uint32),
        ("items_per_group", np.uint32),  # (pixel, replicate) pairs that one work-item loops over
        ("item_count", np.uint32),  # pairs in this launch's node
        ("root", np.uint32),  # child word of the world tree's root
        ("environment_light", np.uint32),  # its index in the light choice, or NONE
        ("log2_samples", np.uint32),  # blue noise: bits of the sample index below the pixel's rank
        ("options", np.uint32),  # OPTION_* bits
        ("kept", np.uint32),  # adaptive: indices that every pixel takes, 0 or a power of two
        ("sum_stride", np.uint32),  # words from one plane of the node's sums to the next (sums.stride_of)
    ]
)

LAYERS: Final = np.dtype(
    [
        (
            "albedo_depth",
            np.float32,
            (4,),
        ),  # sums of the first hit's albedo, and of its distance along the view axis
        ("normal", np.float32, (3,)),  # sum of the first hit's shading normal, world frame
        ("object_id", np.uint32),  # 1 + index of the shape hit by the node's first sample, 0 for none
    ]
)

KEYFRAME: Final = np.dtype(
    [
        ("rotation", np.float32, (4,)),  # quaternion x y z w
        ("translation", np.float32, (3,)),
        ("time", np.float32),  # seconds from the frame's time
        # symmetric 3x3 applied before the rotation; column 3: squared half angle to the next keyframe's rotation,
        # half angle / sin(half angle), unused
        ("stretch", np.float32, (3, 4)),
    ]
)

INSTANCE: Final = np.dtype(
    [
        ("object_from_world", np.float32, (3, 4)),
        ("world_from_object", np.float32, (3, 4)),
        ("root", np.uint32),  # child word of its tree
        ("first_keyframe", np.uint32),
        ("keyframe_count", np.uint32),  # 0: still
        ("object_id", np.uint32),
        (
            "inner_first_keyframe",
            np.uint32,
        ),  # a motion within the prototype, applied before the instance's own
        ("inner_keyframe_count", np.uint32),
        # 1: its keyframes differ in their translation alone, and the linear parts above hold at all times
        ("slides", np.uint32),
        # of what moves: the node whose box k holds it in the k-th of MOTION_BOXES even parts of the time that its keyframes
        # span (the outer ones, where there are some)
        ("motion_node", np.uint32),
    ]
)

NODE8: Final = np.dtype(
    [
        ("lo_x", np.float32, (8,)),
        ("hi_x", np.float32, (8,)),
        ("lo_y", np.float32, (8,)),
        ("hi_y", np.float32, (8,)),
        ("lo_z", np.float32, (8,)),
        ("hi_z", np.float32, (8,)),
        ("child", np.uint32, (8,)),  # inner: node index; leaf: LEAF_* bits
        ("pad", np.uint32, (8,)),
    ]
)

PACKET8: Final = np.dtype(
    [
        ("v0", np.float32, (3, 8)),
        ("v1", np.float32, (3, 8)),
        ("v2", np.float32, (3, 8)),
        ("primitive", np.uint32, (8,)),  # triangle index; padded by repeating the last triangle
    ]
)

PACKET_CORNERS: Final = np.dtype(
    [
        ("corner", np.float32, (24, 4)),  # x, y, z of each corner once, and 0
        ("index", np.uint8, (24,)),  # 3 i + k: where corner k of triangle i stands
        ("corners", np.uint32),
        ("triangles", np.uint32),
    ]
)

COMPACT_NODE: Final = np.dtype(
    [
        ("lo_x", np.uint8, (8,)),  # planes in steps of 2^(exponent - 127) from the origin
        ("hi_x", np.uint8, (8,)),
        ("lo_y", np.uint8, (8,)),
        ("hi_y", np.uint8, (8,)),
        ("lo_z", np.uint8, (8,)),
        ("hi_z", np.uint8, (8,)),
        ("child", np.uint32, (8,)),  # as NODE8's
        ("origin", np.float32, (3,)),
        ("exponents", np.uint32),  # x in bits 0-7, y in 8-15, z in 16-23
    ]
)

COMPACT_TRIANGLE: Final = np.dtype(
    [
        ("v0", np.float32, (3,)),
        ("v1", np.float32, (3,)),
        ("v2", np.float32, (3,)),
        ("primitive", np.uint32),
        ("last", np.uint32),  # 1: the packet's other lanes repeat this one
        ("pad0", np.uint32),
    ]
)

SPHERE: Final = np.dtype(
    [
        ("center", np.float32, (3,)),
        ("radius", np.float32),
        (
            "frame",
            np.float32,
            (3,),
        ),  # quaternion x y z of the object frame for uv; w = sqrt(1 - |xyz|^2) >= 0
        ("shape", np.uint32),
    ]
)

DISC: Final = np.dtype(
    [
        ("center", np.float32, (3,)),
        ("shape", np.uint32),
        (
            "u",
            np.float32,
            (4,),
        ),  # half axes: points center + a u + b v with a^2 + b^2 <= 1; an ellipse after scaling
        ("v", np.float32, (4,)),
    ]
)

PLANE: Final = np.dtype(
    [
        ("point", np.float32, (3,)),
        ("shape", np.uint32),
        ("normal", np.float32, (4,)),
        (
            "tangent_u",
            np.float32,
            (4,),
        ),  # u = dot(position - point, xyz) + w; point is the plane's nearest to the anchor
        ("tangent_v", np.float32, (4,)),
        ("first_keyframe", np.uint32),  # of its motion; the fields above are then in the plane's own frame
        ("keyframe_count", np.uint32),  # 0: still
        ("pad0", np.uint32),
        ("pad1", np.uint32),
    ]
)

SHAPE: Final = np.dtype(
    [
        ("material", np.uint32),
        ("light", np.uint32),  # index of its light, or NONE
        ("flags", np.uint32),  # SHAPE_* bits
        ("object_id", np.uint32),  # 1 + index in the scene's shapes
        ("normal_offset", np.int32),  # add to a vertex index to find its normal
        ("uv_offset", np.int32),
        ("first_triangle", np.uint32),
        ("triangle_count", np.uint32),
        ("deform_stride", np.uint32),  # vertices from one deformation keyframe to the next
        ("deform_count", np.uint32),  # deformation keyframes, 0: rigid
        ("deform_first_time", np.uint32),  # index of their times in the `times` buffer
        ("pad0", np.uint32),
    ]
)

TRIANGLE: Final = np.dtype([("vertex", np.uint32, (3,)), ("shape", np.uint32)])

MATERIAL: Final = np.dtype(
    [
        ("color0", np.float32, (3,)),  # base color, or reflectance
        ("texture0", np.uint32),  # or NONE
        ("color1", np.float32, (3,)),  # specular color, transmission color, transmittance
        ("texture1", np.uint32),
        ("alpha_x", np.float32),  # GGX; both 0 for a perfect mirror or pane
        ("alpha_y", np.float32),
        ("rotation", np.float32),  # radians, in [0, 2 pi)
        ("ior", np.float32),
        ("exponent", np.float32),
        ("type", np.uint32),  # MATERIAL_*
        ("flags", np.uint32),
        ("albedo", np.uint32),  # index of its first table in `albedo_table`, or NONE
    ]
)

TEXTURE: Final = np.dtype(
    [
        ("color0", np.float32, (3,)),
        ("type", np.uint32),  # 0 constant, 1 checker, 2 image
        ("color1", np.float32, (3,)),
        ("flags", np.uint32),  # bit 0 bilinear; bits 1-2 wrap: 0 repeat, 1 mirror, 2 clamp
        ("uv_scale", np.float32, (2,)),
        ("uv_offset", np.float32, (2,)),
        ("width", np.uint32),
        ("height", np.uint32),
        ("first_texel", np.uint64),  # index into `texels` (float4 each)
    ]
)

LIGHT: Final = np.dtype(
    [
        ("radiance", np.float32, (3,)),  # radiance, intensity (point, spot) or irradiance (directional)
        ("type", np.uint32),  # LIGHT_*
        # Geometry is in the frame of `instance`, or of the light's own keyframes, or, without both, in the world.
        # An image environment keeps the rows of its own frame from the world in position, direction, axis_v.
        ("position", np.float32, (3,)),  # point, spot; quad: origin; disc, sphere: center
        ("shape", np.uint32),  # of area lights, or NONE
        (
            "direction",
            np.float32,
            (3,),
        ),  # spot, directional: where the light goes, unit; quad: u; disc: half axis
        ("inner", np.float32),  # spot: 1 - cos of the angle within which the light is full; sphere: radius
        ("axis_v", np.float32, (3,)),  # quad: v; disc: second half axis
        ("outer", np.float32),  # spot: 1 - cos of the angle beyond which there is no light
        ("area", np.float32),  # area lights; at the shutter's opening where they move
        ("pmf", np.float32),  # chance of this light in the light choice
        ("first_cdf", np.uint32),  # mesh: its triangles' CDF in `emitter_cdf`, triangle_count + 1 entries
        ("triangle_count", np.uint32),
        ("first_triangle", np.uint32),
        ("instance", np.uint32),  # that moves it, or NONE
        ("flags", np.uint32),  # bit 0: two-sided
        ("first_keyframe", np.uint32),  # point, spot, directional: their own motion
        ("keyframe_count", np.uint32),  # 0: still
        ("width", np.uint32),  # texels of an image environment, 0 of a constant one
        ("height", np.uint32),
        ("leaf", np.uint32),  # its place in the light tree's order, or NONE: the tree never chooses it
    ]
)

LIGHT_NODE: Final = np.dtype(
    [
        # Bounds of the lights below each of eight children (lights/tree.cl). A sphere holds their places over the
        # shutter interval; a negative radius: infinitely far, the center is the mean direction to them, unit.
        ("x", np.float32, (8,)),
        ("y", np.float32, (8,)),
        ("z", np.float32, (8,)),
        ("radius", np.float32, (8,)),
        # All that they emit goes within the angle `spread + falloff` of the axis, and from normals within `spread` of
        # it. Of far lights: every direction to them is within `spread` of the center.
        ("axis_x", np.float32, (8,)),
        ("axis_y", np.float32, (8,)),
        ("axis_z", np.float32, (8,)),
        ("cos_spread", np.float32, (8,)),
        ("sin_spread", np.float32, (8,)),
        ("cos_falloff", np.float32, (8,)),
        (
            "strength",
            np.float32,
            (8,),
        ),  # radiant intensity, of far lights irradiance: shares of each kind's total
        ("child", np.uint32, (8,)),  # inner: index of a node; with LEAF_FLAG: of a light
        ("count", np.uint32, (8,)),  # lights below; 0: no child
    ]
)

ALIAS: Final = np.dtype(
    [
        (
            "threshold",
            np.float32,
        ),  # keep this entry where the number, remapped to [0, 1) in the entry, is below
        ("other", np.uint32),
        ("pmf", np.float32),
        ("first", np.float32),  # of the entry's numbers, remapped so, the least: 0 but for rounding
    ]
)

STRUCTS: Final[dict[str, np.dtype[Any]]] = {
    "Camera": CAMERA,
    "Params": PARAMS,
    "Layers": LAYERS,
    "Keyframe": KEYFRAME,
    "Instance": INSTANCE,
    "Node8": NODE8,
    "Packet8": PACKET8,
    "PacketCorners": PACKET_CORNERS,
    "CompactNode": COMPACT_NODE,
    "CompactTriangle": COMPACT_TRIANGLE,
    "SphereData": SPHERE,
    "DiscData": DISC,
    "PlaneData": PLANE,
    "ShapeData": SHAPE,
    "TriangleData": TRIANGLE,
    "Material": MATERIAL,
    "Texture": TEXTURE,
    "Light": LIGHT,
    "LightNode": LIGHT_NODE,
    "Alias": ALIAS,
}

CONSTANTS: Final[dict[str, int]] = {
    "NONE": 0xFFFFFFFF,
    "MOTION_BOXES": 8,  # a node's
    "SHAPE_HAS_NORMALS": 1,
    "SHAPE_HAS_UVS": 2,
    "SHAPE_FLIP": 4,  # the transform mirrors: the outside is on the other side of the winding
    "SHAPE_QUAD": 8,  # two triangles whose barycentrics make the quad's uv
    "LEAF_FLAG": 1 << 31,  # child words: without it, the index of an inner node
    "LEAF_TYPE_SHIFT": 29,  # two bits: what the leaf holds
    "LEAF_TRIANGLES": 0,  # bits 27-28 number of packets (0: nothing), bits 0-26 first packet
    "LEAF_ROUND": 1,  # bit 28: 0 sphere, 1 disc; bits 0-27 its index
    "LEAF_INSTANCE": 2,  # bits 0-28 its index
    "LEAF_DEFORMING": 3,  # bits 0-26 packet of the first keyframe; those of the others follow
    "LEAF_COUNT_SHIFT": 27,
    "LEAF_PACKET_MASK": (1 << 27) - 1,
    "LEAF_DISC_SHIFT": 28,
    "LEAF_ROUND_MASK": (1 << 28) - 1,
    "LEAF_INSTANCE_MASK": (1 << 29) - 1,
    "MATERIAL_DIFFUSE": 0,
    "MATERIAL_PHONG": 1,
    "MATERIAL_MIRROR": 2,
    "MATERIAL_CONDUCTOR": 3,
    "MATERIAL_PLASTIC": 4,
    "MATERIAL_DIELECTRIC": 5,
    "MATERIAL_THIN_DIELECTRIC": 6,
    "MATERIAL_DIFFUSE_TRANSMISSION": 7,
    "MATERIAL_BLACK": 8,
    "MATERIAL_FLAG_FRESNEL": 1,
    "MATERIAL_FLAG_COMPENSATE": 2,
    "ALBEDO_NODES": 32,  # heights in a table of lost light, see materials/compensation.cl
    "ALBEDO_AZIMUTHS": 5,  # azimuths in it where the roughness is anisotropic
    "TEXTURE_CONSTANT": 0,
    "TEXTURE_CHECKER": 1,
    "TEXTURE_IMAGE": 2,
    "TEXTURE_BILINEAR": 1,
    "LIGHT_POINT": 0,
    "LIGHT_SPOT": 1,
    "LIGHT_DIRECTIONAL": 2,
    "LIGHT_QUAD": 3,
    "LIGHT_DISC": 4,
    "LIGHT_SPHERE": 5,
    "LIGHT_MESH": 6,
    "LIGHT_ENVIRONMENT": 7,
    "LIGHT_TWO_SIDED": 1,
    "OPTION_ALL_LIGHTS": 1,  # every light at every hit, instead of picks
    "OPTION_NO_MIS": 2,
    "OPTION_LIGHT_TREE": 4,  # picks by the light tree, not by the table
    "OPTION_LIGHTS_TO_MEET": 8,  # some light has an extent, so that a ray can meet it
    "LEVEL_NONE": 255,  # adaptive: a pixel that takes the kept samples and no others
    "OPTION_TOGETHER": 16,  # on CPUs all rays of sixteen paths go through the trees together, not only those that are alike
    "OPTION_OTHER_SHIFT": 16,  # above: the groups of dimensions that draw from the second stream (sensitivity.py)
    "GROUP_PIXEL": 1,
    "GROUP_LENS": 2,
    "GROUP_TIME": 4,
    "GROUP_LIGHTS": 8,
    "GROUP_DIRECTIONS": 16,
    "DRAWN_BOUNCE": 2,  # of the counters of numbers drawn, that of a hit's slot 0, which is free (dimensions.py)
    "DRAWN_COUNT": 8,
    # planes of a node's sums (sums.py), `params.item_count` words each, `params.sum_stride` apart
    "SUM_RGBA": 0,  # float, four of them: over the samples that were taken and not rejected
    "SUM_TAKEN": 4,  # samples that count, zeros included, rejected ones not
    "SUM_LIT": 5,  # of these, samples that carried light
    "SUM_REJECTED": 6,  # NaN, infinite or negative
    "SUM_REJECTED_IN": 7,  # bits of the effects in which rejected samples arose (base/effects.h)
    "SUM_RAYS": 8,  # traced by all samples, rejected ones included: what they cost, counted
    "SUM_PLANES": 9,
    "SAMPLER_REGULAR": 0,
    "SAMPLER_RANDOM": 1,
    "SAMPLER_INDEPENDENT": 2,
    "SAMPLER_STRATIFIED": 3,
    "SAMPLER_JITTERED": 4,
    "SAMPLER_SOBOL": 5,
    "SAMPLER_BLUE_NOISE": 6,
}

_C_NAMES: Final = {
    "uint8": "uchar",
    "float32": "float",
    "uint32": "uint",
    "int32": "int",
    "uint64": "ulong",
    "float64": "double",
}

HEADER: Final = Path(__file__).parent / "cl" / "layout.h"


def _c_type(dtype: np.dtype[Any]) -> str:
    for name, struct in STRUCTS.items():
        if dtype == struct:
            return name
    return _C_NAMES[dtype.name]


def _struct(name: str, dtype: np.dtype[Any]) -> str:
    assert dtype.names is not None
    assert dtype.fields is not None
    lines = ["typedef struct {"]
    for field in dtype.names:
        base = dtype.fields[field][0]
        shape = base.shape
        lines.append(f"  {_c_type(base.base)} {field}{''.join(f'[{n}]' for n in shape)};")
    return "\n".join([*lines, f"}} {name};", f"// sizeof({name}) == {dtype.itemsize}"])


def header() -> str:
    """The text of cl/layout.h."""
    constants = "\n".join(f"#define {name} {value}u" for name, value in CONSTANTS.items())
    structs = "\n\n".join(_struct(name, dtype) for name, dtype in STRUCTS.items())
    return (
        "// Generated from layout.py by `python -m penumbra_kernels.layout`: edit that, not this.\n\n"
        f"{constants}\n\n{structs}\n"
    )


def write_header() -> None:
    HEADER.write_text(header())


if __name__ == "__main__":
    write_header()
