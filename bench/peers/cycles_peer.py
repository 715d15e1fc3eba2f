"""A plain scene in Cycles, by Blender as a Python module (bpy): path tracing on the CPU with what makes it comparable.

Off: adaptive sampling, denoising, clamping, roulette (least bounces beyond the most), filtered gloss, the light threshold. On:
the light tree, caustics, a box of one pixel. Spheres are points of a radius, which Cycles intersects as spheres; spherical
lamps are point lights of that radius, since points that emit are not sampled.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

VERSION = bpy.app.version_string
ROULETTE_OFF = 1024
INSIDE = 0.999
Render = Callable[[int, int], tuple[float, Any]]


def _nodes(material: Any) -> tuple[Any, Any]:
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    return tree, tree.nodes.new("ShaderNodeOutputMaterial")


def _surface(name: str, given: dict[str, Any]) -> Any:
    material = bpy.data.materials.new(name)
    tree, output = _nodes(material)
    if given["type"] == "diffuse":
        shader = tree.nodes.new("ShaderNodeBsdfDiffuse")
        shader.inputs["Roughness"].default_value = 0.0
        if "checker" in given:
            color0, color1, scale = given["checker"]
            checker = tree.nodes.new("ShaderNodeTexChecker")
            checker.inputs["Color2"].default_value = (*color0, 1.0)  # where both cells' numbers are even
            checker.inputs["Color1"].default_value = (*color1, 1.0)
            checker.inputs["Scale"].default_value = 2.0 * scale  # cells, of which a unit has two
            uv = tree.nodes.new("ShaderNodeUVMap")
            tree.links.new(uv.outputs["UV"], checker.inputs["Vector"])
            tree.links.new(checker.outputs["Color"], shader.inputs["Color"])
        else:
            shader.inputs["Color"].default_value = (*given["color"], 1.0)
    elif given["type"] == "metal":
        shader = tree.nodes.new("ShaderNodeBsdfAnisotropic")
        shader.distribution = "GGX"
        shader.inputs["Color"].default_value = (*given["color"], 1.0)
        shader.inputs["Roughness"].default_value = math.sqrt(given["alpha"])
    elif given["type"] == "glass":
        shader = tree.nodes.new("ShaderNodeBsdfGlass")
        shader.distribution = "GGX"
        shader.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
        shader.inputs["Roughness"].default_value = math.sqrt(given["alpha"])
        shader.inputs["IOR"].default_value = given["ior"]
    else:
        raise NotImplementedError(f"material {given['type']}")
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return material


def _lamp(radiance: list[float]) -> Any:
    """Emits from the front alone; the back is black."""
    material = bpy.data.materials.new("lamp")
    material.cycles.emission_sampling = "FRONT"
    tree, output = _nodes(material)
    emission = tree.nodes.new("ShaderNodeEmission")
    strength = max(radiance)
    emission.inputs["Color"].default_value = (*(x / strength for x in radiance), 1.0)
    side = tree.nodes.new("ShaderNodeNewGeometry")
    front = tree.nodes.new("ShaderNodeMath")
    front.operation = "MULTIPLY_ADD"
    front.inputs[1].default_value = -strength
    front.inputs[2].default_value = strength
    tree.links.new(side.outputs["Backfacing"], front.inputs[0])
    tree.links.new(front.outputs[0], emission.inputs["Strength"])
    tree.links.new(emission.outputs[0], output.inputs["Surface"])
    return material


def _points_of_radius(radius: float, material: Any) -> Any:
    """Geometry nodes that turn vertices into points."""
    tree = bpy.data.node_groups.new("sphere", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    start, end = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    points = tree.nodes.new("GeometryNodeMeshToPoints")
    points.inputs["Radius"].default_value = radius
    paint = tree.nodes.new("GeometryNodeSetMaterial")
    paint.inputs["Material"].default_value = material
    tree.links.new(start.outputs[0], points.inputs["Mesh"])
    tree.links.new(points.outputs[0], paint.inputs["Geometry"])
    tree.links.new(paint.outputs[0], end.inputs[0])
    return tree


def _mesh(positions: Any, indices: Any, uvs: Any = None) -> Any:
    mesh = bpy.data.meshes.new("mesh")
    positions, indices = np.ascontiguousarray(positions, np.float32), np.ascontiguousarray(indices, np.int32)
    mesh.vertices.add(len(positions))
    mesh.vertices.foreach_set("co", positions.ravel())
    mesh.loops.add(indices.size)
    mesh.loops.foreach_set("vertex_index", indices.ravel())
    mesh.polygons.add(len(indices))
    mesh.polygons.foreach_set("loop_start", np.arange(0, indices.size, 3, dtype=np.int32))
    if uvs is not None:
        layer = mesh.uv_layers.new(name="UVMap")
        layer.data.foreach_set("uv", np.ascontiguousarray(uvs, np.float32).ravel())
    mesh.shade_flat()
    mesh.update()
    return mesh


def _quad_mesh(shape: dict[str, Any]) -> Any:
    o, u, v = (np.array(shape[key]) for key in ("origin", "u", "v"))
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    indices = np.array([[0, 1, 2], [0, 2, 3]])
    return _mesh(o + corners[:, :1] * u + corners[:, 1:] * v, indices, corners[indices].reshape(-1, 2))


def _place(data: Any, motion: list[float], at: Any = (0.0, 0.0, 0.0)) -> Any:
    """An object that goes from `at` by `motion` while the shutter is open, frames 0 to 1."""
    thing = bpy.data.objects.new("shape", data)
    bpy.context.scene.collection.objects.link(thing)
    thing.location = at
    if any(motion):
        thing.keyframe_insert("location", frame=0)
        thing.location = [a + b for a, b in zip(at, motion, strict=True)]
        thing.keyframe_insert("location", frame=1)
        for layer in thing.animation_data.action.layers:
            for strip in layer.strips:
                for bag in strip.channelbags:
                    for curve in bag.fcurves:
                        for key in curve.keyframe_points:
                            key.interpolation = "LINEAR"
    return thing


def _sphere_lamp(shape: dict[str, Any]) -> None:
    """A point light of radius r and power P has the radiance P / (4 pi^2 r^2). Other light passes through it, so that a black
    ball is inside."""
    light = bpy.data.lights.new("lamp", "POINT")
    strength = max(shape["radiance"])
    light.color = [x / strength for x in shape["radiance"]]
    light.energy = strength * 4.0 * math.pi**2 * shape["radius"] ** 2
    light.shadow_soft_size = shape["radius"]
    light.use_soft_falloff = False
    light.cycles.max_bounces = ROULETTE_OFF
    _place(light, shape["motion"], shape["center"]).visible_camera = True
    _add_ball(INSIDE * shape["radius"], bpy.data.materials["black"], shape)


def _add_ball(radius: float, material: Any, shape: dict[str, Any]) -> None:
    vertex = bpy.data.meshes.new("center")
    vertex.from_pydata([(0.0, 0.0, 0.0)], [], [])
    thing = _place(vertex, shape["motion"], shape["center"])
    thing.modifiers.new("sphere", "NODES").node_group = _points_of_radius(radius, material)


def _add(shape: dict[str, Any], materials: dict[str, Any]) -> None:
    if shape["type"] == "sphere" and shape["radiance"]:
        _sphere_lamp(shape)
        return
    material = _lamp(shape["radiance"]) if shape["radiance"] else materials[shape["material"]]
    if shape["type"] == "sphere":
        _add_ball(shape["radius"], material, shape)
        return
    if shape["type"] == "quad":
        mesh = _quad_mesh(shape)
    else:
        stored = np.load(shape["file"])
        mesh = _mesh(stored["positions"], stored["indices"])
    mesh.materials.append(material)
    _place(mesh, shape["motion"])


def _set_camera(camera: dict[str, Any]) -> None:
    data = bpy.data.cameras.new("camera")
    data.angle = math.radians(camera["fov"])
    data.clip_start, data.clip_end = 1e-4, 1e6
    if camera["aperture"]:
        data.dof.use_dof = True
        data.dof.focus_distance = camera["focus"]
        data.dof.aperture_fstop = data.lens * 1e-3 / (2.0 * camera["aperture"])
    thing = bpy.data.objects.new("camera", data)
    thing.matrix_world = Matrix(camera["matrix"])
    scene = bpy.context.scene
    scene.collection.objects.link(thing)
    scene.camera = thing
    scene.render.resolution_x = scene.render.resolution_y = camera["size"]
    scene.render.resolution_percentage = 100
    scene.render.use_motion_blur = camera["moves"]
    if camera["moves"]:
        scene.frame_set(0)
        scene.render.motion_blur_position = "START"
        scene.render.motion_blur_shutter = 1.0
        for point in scene.render.motion_blur_shutter_curve.curves[0].points:
            point.location[1] = 1.0
        scene.render.motion_blur_shutter_curve.update()


def _set_integrator(max_bounces: int) -> None:
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.render.use_persistent_data = True
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_auto_tile = False
    cycles.use_guiding = cycles.use_fast_gi = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.blur_glossy = cycles.light_sampling_threshold = 0.0
    cycles.use_light_tree = cycles.caustics_reflective = cycles.caustics_refractive = True
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0
    for name in ("max", "diffuse", "glossy", "transmission"):
        setattr(cycles, f"{name}_bounces", max_bounces)
    cycles.min_light_bounces = ROULETTE_OFF
    settings = scene.render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGB", "32"
    settings.exr_codec = "NONE"


def _set_world(radiance: list[float] | None) -> None:
    world = bpy.data.worlds.new("world")
    bpy.context.scene.world = world
    world.use_nodes = True
    background = world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (*(radiance or (0.0, 0.0, 0.0)), 1.0)
    background.inputs["Strength"].default_value = 1.0 if radiance else 0.0


def _read(file: Path) -> Any:
    image = bpy.data.images.load(str(file))
    image.colorspace_settings.name = "Non-Color"
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    width, height = image.size
    bpy.data.images.remove(image)
    return pixels.reshape(height, width, -1)[::-1, :, :3]


def load(plain: dict[str, Any]) -> Render:
    """The scene in Blender's one session."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    _set_integrator(plain["max_bounces"])
    _set_world(plain["environment"])
    materials = {name: _surface(name, given) for name, given in plain["materials"].items()}
    _surface("black", {"type": "diffuse", "color": [0.0, 0.0, 0.0]})
    for shape in plain["shapes"]:
        _add(shape, materials)
    _set_camera(plain["camera"])
    scene = bpy.context.scene
    file = Path(tempfile.mkdtemp()) / "picture.exr"
    scene.render.filepath = str(file)

    def render(samples: int, seed: int) -> tuple[float, Any]:
        scene.cycles.samples, scene.cycles.seed = samples, seed
        bpy.ops.render.render(write_still=True)
        return samples, _read(file)

    return render
