// The tracer's one kernel: for a tile, every replicate and an aligned power-of-two range of sample indices, the sum node.
//
// Reads: params, the scene's buffers. Writes: sums (and layers), one entry per (replicate, pixel of the tile), replicate
// slowest, then rows; of sums one plane after the other (SUM_*). Runs: one work-item per `items_per_group` entries (entry_of)
// from first_item on; the host splits a node into launches by it, which changes nothing in the result. Who is next: the host
// merges nodes (nodes.py).
//
// This file alone decides which effects a program has, by 0/1 macros; every argument stands in tracer.py's table in the same
// order under the same conditions.
#if PENUMBRA_BARE
#include "base/library.h"
#endif
#include "base/types.h"
#define PENUMBRA_LANES (PENUMBRA_TOGETHER && !PENUMBRA_DEVICE_GPU && !PENUMBRA_COMPACT_TREE && PENUMBRA_SAMPLER != SAMPLER_RANDOM)
#include "integrators/item.cl"
#if PENUMBRA_LANES
#include "integrators/items16.cl"
#endif

__kernel void trace(const __global Params *params, const __global float *filter_table,
#if PENUMBRA_MOTION || PENUMBRA_CAMERA_MOTION || PENUMBRA_DEFORMATION
                    const __global float *shutter_table,
#endif
                    const __global TreeNode *nodes, const __global TreeTriangles *packets,
                    const __global PacketCorners *corners,
                    const __global ShapeData *shapes, const __global TriangleData *triangles,
                    const __global float *positions, const __global float *normals, const __global float *uvs,
                    const __global Material *materials, const __global Light *lights,
#if PENUMBRA_GLOSS
                    const __global float *albedo_table,
#endif
#if PENUMBRA_ROUND
                    const __global SphereData *spheres, const __global DiscData *discs,
                    const __global PlaneData *planes,
#endif
#if PENUMBRA_INSTANCING
                    const __global Instance *instances,
#endif
#if PENUMBRA_MOTION || PENUMBRA_CAMERA_MOTION
                    const __global Keyframe *keyframes,
#endif
#if PENUMBRA_DEFORMATION
                    const __global float *times,
#endif
#if PENUMBRA_TEXTURES
                    const __global Texture *textures, const __global float4 *texels,
#endif
#if PENUMBRA_MANY_LIGHTS
                    const __global Alias *light_table,
#endif
#if PENUMBRA_LIGHT_TREE
                    const __global LightNode *light_nodes,
#endif
#if PENUMBRA_AREA_LIGHTS
                    const __global float *emitter_cdf,
#endif
#if PENUMBRA_ENVIRONMENT
                    const __global float4 *environment,
#endif
#if PENUMBRA_SAMPLER == SAMPLER_RANDOM
                    const __global ushort *counts,
#endif
#if PENUMBRA_ADAPTIVE
                    const __global uchar *levels,
#endif
#if PENUMBRA_LAYERS
                    __global Layers *layers,
#endif
#if PENUMBRA_COUNT_DRAWS
                    __global uint *drawn,
#endif
                    __global uint *sums, const uint first_item) {
  SceneData scene;
  scene.nodes = nodes;
  scene.packets = packets;
  scene.corners = (params->options & OPTION_TOGETHER) ? corners : 0;
  scene.shapes = shapes;
  scene.triangles = triangles;
  scene.positions = positions;
  scene.normals = normals;
  scene.uvs = uvs;
  scene.materials = materials;
  scene.lights = lights;
  scene.albedo_table = 0;
  scene.spheres = 0;
  scene.discs = 0;
  scene.planes = 0;
  scene.instances = 0;
  scene.keyframes = 0;
  scene.times = 0;
  scene.textures = 0;
  scene.texels = 0;
  scene.light_table = 0;
  scene.light_nodes = 0;
  scene.emitter_cdf = 0;
  scene.environment = 0;
#if PENUMBRA_GLOSS
  scene.albedo_table = albedo_table;
#endif
#if PENUMBRA_ROUND
  scene.spheres = spheres;
  scene.discs = discs;
  scene.planes = planes;
#endif
#if PENUMBRA_INSTANCING
  scene.instances = instances;
#endif
#if PENUMBRA_MOTION || PENUMBRA_CAMERA_MOTION
  scene.keyframes = keyframes;
#endif
#if PENUMBRA_DEFORMATION
  scene.times = times;
#endif
#if PENUMBRA_TEXTURES
  scene.textures = textures;
  scene.texels = texels;
#endif
#if PENUMBRA_MANY_LIGHTS
  scene.light_table = light_table;
#endif
#if PENUMBRA_LIGHT_TREE
  scene.light_nodes = light_nodes;
#endif
#if PENUMBRA_AREA_LIGHTS
  scene.emitter_cdf = emitter_cdf;
#endif
#if PENUMBRA_ENVIRONMENT
  scene.environment = environment;
#endif
  scene.plane_count = params->plane_count;
  scene.light_count = params->light_count;
  scene.root = params->root;
  scene.environment_light = params->environment_light;
  scene.light_tree = (params->options & OPTION_LIGHT_TREE) != 0u;

#if !(PENUMBRA_MOTION || PENUMBRA_CAMERA_MOTION || PENUMBRA_DEFORMATION)
  const __global float *shutter_table = 0;
#endif
  Launch launch;
  launch.scene = &scene;
  launch.params = params;
  launch.filter_table = filter_table;
  launch.shutter_table = shutter_table;
  launch.counts = 0;
  launch.levels = 0;
#if PENUMBRA_SAMPLER == SAMPLER_RANDOM
  launch.counts = counts;
#endif
#if PENUMBRA_ADAPTIVE
  launch.levels = levels;
#endif
  __global Layers *item_layers = 0;
#if PENUMBRA_LAYERS
  item_layers = layers;
#endif
  __global uint *item_drawn = 0;
#if PENUMBRA_COUNT_DRAWS
  item_drawn = drawn;
#endif
  const uint first = first_item + (uint)get_global_id(0) * params->items_per_group;
  const uint end = MIN(first + params->items_per_group, params->item_count);
#if PENUMBRA_LANES
  for (uint i = first; i < end;) i += trace_items16(&launch, i, end, item_layers, item_drawn, sums);
#else
  for (uint i = first; i < end; i++) {
    const uint entry = entry_of(params, i);
    trace_item(&launch, entry, item_layers + entry, item_drawn + entry * DRAWN_COUNT, sums + entry);
  }
#endif
}
