// The tracer's one kernel: for a tile, every replicate and an aligned power-of-two range of sample indices, the sum node.
//
// Reads: params, the scene's buffers. Writes: sums (and layers), one entry per (replicate, pixel of the tile), replicate
// slowest, then rows. Runs: one work-item per `items_per_group` consecutive entries from first_item on; the host splits a
// node into launches by it, which changes nothing in the result. Who is next: the host merges nodes (nodes.py).
//
// This file alone decides which effects a program has, by 0/1 macros; every argument stands in tracer.py's table in the same
// order under the same conditions.
#include "base/types.h"
#include "base/effects.h"
#define PENUMBRA_AHEAD (PENUMBRA_SAMPLER == SAMPLER_SOBOL && !PENUMBRA_DEVICE_GPU && !PENUMBRA_PICK_FREEZE)
#include "film/filter.cl"
#include "camera/camera.cl"
#include "integrators/paths.cl"
#include "sampling/share.cl"

#define MAX_LEVELS 9  // nodes of up to 2^8 samples are summed here, pairwise

// Adds sample number i to the partial sums of a binary tree over sample indices: after 2^k samples level k holds their sum,
// each parent the sum of its two children in index order.
static inline void tree_add(float4 *levels, const uint i, float4 value) {
  uint level = 0;
  for (; (i >> level) & 1u; level++) value = levels[level] + value;
  levels[level] = value;
}

static inline uint level_of(const uint count) { return CTZ(count); }

static inline bool is_valid(const float3 c) {
  return is_finite(c.x) && is_finite(c.y) && is_finite(c.z) && c.x >= 0.0f && c.y >= 0.0f && c.z >= 0.0f;
}

static inline Ray start_ray(const __global Params *params, const __global float *filter_table,
                            const __global float *shutter_table, const __global Keyframe *keyframes,
                            const Sampler *sampler, const uint x, const uint y, float *weight) {
  const float2 offset = filter_sample(filter_table, params->filter_radius, sample_2d(sampler, DIM_PIXEL), weight);
  const float2 film = (float2)(((float)x + 0.5f + offset.x) / (float)params->film_width,
                               ((float)y + 0.5f + offset.y) / (float)params->film_height);
#if PENUMBRA_LENS
  const float2 lens = sample_2d(sampler, DIM_LENS);
#else
  const float2 lens = (float2)(0.5f);
#endif
#if PENUMBRA_MOTION || PENUMBRA_CAMERA_MOTION || PENUMBRA_DEFORMATION
  const float time = camera_time(&params->camera, shutter_table, sample_1d(sampler, DIM_TIME));
#else
  const float time = params->camera.shutter_open;
#endif
  return camera_ray(&params->camera, keyframes, film, lens, time);
}

// What a node gathers for one pixel and replicate.
typedef struct {
  float4 levels[MAX_LEVELS];
  uint taken, lit, rejected, rejected_in, rays;
#if PENUMBRA_LAYERS
  float4 albedo_depth[MAX_LEVELS];
  float4 normal[MAX_LEVELS];
  uint object_id;
#endif
} Gather;

// Draws a camera path's ray, and what the path's value is to be multiplied with.
static inline void start_path(const SceneData *scene, const __global Params *params, const __global float *filter_table,
                              const __global float *shutter_table, const Sampler *sampler, const uint x, const uint y,
                              Path *path, float *weight) {
  path_start(path, start_ray(params, filter_table, shutter_table, scene->keyframes, sampler, x, y, weight));
}

// One camera path's value; counts it.
static inline float4 path_value(const PathSample *path, const float weight, Gather *gather) {
  gather->rays += path->rays;
  const float3 c = path->radiance;
  if (!is_valid(c)) {
    gather->rejected++;
    gather->rejected_in |= path->effects;
    return (float4)(0.0f);
  }
  gather->taken++;
  gather->lit += max3(c) > 0.0f ? 1u : 0u;
  return (float4)(c * weight, path->alpha * weight);
}

// The plane-wide random sampler takes several paths a sample index: their layers add up, the object is the last one's.
static inline void add_layers(PathSample *sum, const PathSample *path) {
  sum->albedo += path->albedo;
  sum->normal += path->normal;
  sum->depth += path->depth;
  sum->object_id = path->object_id;
}

static inline void gather_start(Gather *gather) {
  gather->taken = gather->lit = gather->rejected = gather->rejected_in = gather->rays = 0u;
  gather->levels[0] = (float4)(0.0f);
#if PENUMBRA_LAYERS
  gather->albedo_depth[0] = gather->normal[0] = (float4)(0.0f);
  gather->object_id = 0u;
#endif
}

// A leaf of the tree: a sample's value, or where indices around it are not taken its sum with their zeros, which turns -0
// into 0 as any larger node does.
static inline float4 leaf(const float4 value, const bool thinned) { return thinned ? value + (float4)(0.0f) : value; }

static inline void gather_layers(Gather *gather, const uint i, const PathSample *path, const bool thinned) {
#if PENUMBRA_LAYERS
  tree_add(gather->albedo_depth, i, leaf((float4)(path->albedo, path->depth), thinned));
  tree_add(gather->normal, i, leaf((float4)(path->normal, 0.0f), thinned));
  if (i == 0) gather->object_id = path->object_id;
#endif
}

// One pixel of one replicate: all samples of the node. counts: points that fell into each sample (random), else null;
// levels: of the tile's pixels (adaptive), else null; layers: null where there are none; drawn: DRAWN_COUNT numbers of the item's
// (counting draws), else null.
static PENUMBRA_NOINLINE void trace_item(const SceneData *scene, const __global Params *params,
                                         const __global float *filter_table, const __global float *shutter_table,
                                         const __global ushort *counts, const __global uchar *levels,
                                         __global Layers *layers, __global uint *drawn, __global Sum *out,
                                         const uint item) {
  const uint pixels = params->tile_width * params->tile_height;
  const uint replicate = item / pixels;
  const uint pixel = item - replicate * pixels;
  const uint x = params->tile_x + pixel % params->tile_width;
  const uint y = params->tile_y + pixel / params->tile_width;
  Sampler sampler = sampler_start(params, x, y, params->first_replicate + replicate);
#if PENUMBRA_AHEAD
  Ahead ahead;
  ahead_start(&sampler, &ahead);
#endif
#if PENUMBRA_COUNT_DRAWS
  uint counted[DRAWN_COUNT];
  for (uint k = 0; k < DRAWN_COUNT; k++) counted[k] = 0u;
  sampler.drawn = counted;
#endif
  Gather gather;
  gather_start(&gather);
#if PENUMBRA_ADAPTIVE
  Share share = share_of(params, levels[pixel]);
  sampler_share(&sampler, params, levels[pixel], &share);
#else
  const Share share = whole_share(params);
#endif
#if PENUMBRA_SAMPLER == SAMPLER_RANDOM
  for (uint i = 0; i < share.count; i++) {
    const uint count = counts[((ulong)replicate * params->sample_count + i) * pixels + pixel];
    float4 value = (float4)(0.0f);
    PathSample sum = no_path();
    for (uint k = 0; k < count; k++) {
      Path path;
      float weight;
      sampler_next_of(&sampler, share.first + i, k);
      start_path(scene, params, filter_table, shutter_table, &sampler, x, y, &path, &weight);
      trace_path(scene, params, &sampler, &path);
      value += path_value(&path.result, weight, &gather);
      add_layers(&sum, &path.result);
    }
    tree_add(gather.levels, i, leaf(value, share.thinned));
    gather_layers(&gather, i, &sum, share.thinned);
  }
#else
  Sampler samplers[PATHS];
  Path paths[PATHS];
  float weights[PATHS];
  for (uint i = 0, count; i < share.count; i += count) {
    const ulong first = share.first + i;
    count = paths_from(first, share.count - i);
    for (uint k = 0; k < count; k++) {
      sampler_next(&sampler, first + k);
      samplers[k] = sampler;
      start_path(scene, params, filter_table, shutter_table, &sampler, x, y, paths + k, weights + k);
    }
    trace_paths(scene, params, samplers, count, paths);
    for (uint k = 0; k < count; k++) {
      const float4 value = path_value(&paths[k].result, weights[k], &gather);
      tree_add(gather.levels, i + k, leaf(value, share.thinned));
      gather_layers(&gather, i + k, &paths[k].result, share.thinned);
    }
  }
#endif
  const uint top = level_of(MAX(share.count, 1u));
  out->rgba[0] = gather.levels[top].x;
  out->rgba[1] = gather.levels[top].y;
  out->rgba[2] = gather.levels[top].z;
  out->rgba[3] = gather.levels[top].w;
  out->taken = gather.taken;
  out->lit = gather.lit;
  out->rejected = gather.rejected;
  out->rejected_in = gather.rejected_in;
  out->rays = gather.rays;
#if PENUMBRA_COUNT_DRAWS
  for (uint k = 0; k < DRAWN_COUNT; k++) drawn[k] = counted[k];
#endif
#if PENUMBRA_LAYERS
  layers->albedo_depth[0] = gather.albedo_depth[top].x;
  layers->albedo_depth[1] = gather.albedo_depth[top].y;
  layers->albedo_depth[2] = gather.albedo_depth[top].z;
  layers->albedo_depth[3] = gather.albedo_depth[top].w;
  layers->normal[0] = gather.normal[top].x;
  layers->normal[1] = gather.normal[top].y;
  layers->normal[2] = gather.normal[top].z;
  layers->object_id = gather.object_id;
#endif
}

// Which (replicate, pixel) entry the work-item of number i takes. CPUs go row by row; on GPUs the 32 threads that run in step take
// 8 x 4 pixels of one replicate, whose rays stay together longer. Who takes what changes nothing in the result.
static inline uint entry_of(const __global Params *params, const uint i) {
#if PENUMBRA_DEVICE_GPU
  const uint width = params->tile_width, height = params->tile_height;
  if ((width & 7u) == 0u && (height & 3u) == 0u) {
    const uint block = i >> 5, columns = width >> 3;
    const uint x = block % columns * 8u + (i & 7u), row = block / columns * 4u + ((i >> 3) & 3u);
    return row * width + x;  // rows of all replicates count on: the height is a multiple of 4
  }
#endif
  return i;
}

__kernel void trace(const __global Params *params, const __global float *filter_table,
#if PENUMBRA_MOTION || PENUMBRA_CAMERA_MOTION || PENUMBRA_DEFORMATION
                    const __global float *shutter_table,
#endif
                    const __global TreeNode *nodes, const __global TreeTriangles *packets,
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
                    __global Sum *sums, const uint first_item) {
  SceneData scene;
  scene.nodes = nodes;
  scene.packets = packets;
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
  const __global ushort *item_counts = 0;
#if PENUMBRA_SAMPLER == SAMPLER_RANDOM
  item_counts = counts;
#endif
  const __global uchar *pixel_levels = 0;
#if PENUMBRA_ADAPTIVE
  pixel_levels = levels;
#endif
  const uint first = first_item + (uint)get_global_id(0) * params->items_per_group;
  const uint end = MIN(first + params->items_per_group, params->item_count);
  for (uint i = first; i < end; i++) {
    const uint item = entry_of(params, i);
    __global Layers *item_layers = 0;
#if PENUMBRA_LAYERS
    item_layers = layers + item;
#endif
    __global uint *item_drawn = 0;
#if PENUMBRA_COUNT_DRAWS
    item_drawn = drawn + item * DRAWN_COUNT;
#endif
    trace_item(&scene, params, filter_table, shutter_table, item_counts, pixel_levels, item_layers, item_drawn,
               sums + item, item);
  }
}
