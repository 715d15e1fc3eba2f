// Items: a pixel of one replicate each, with the samples that a node has of it. Here one after the other, path by path: for GPUs, whose
// threads take one each, and for the plane-wide random sampler. items16.cl takes sixteen paths at once.
#include "film/filter.cl"
#include "film/gather.cl"
#include "camera/camera.cl"
#include "integrators/path.cl"
#include "sampling/share.cl"

// What all items read.
typedef struct {
  const SceneData *scene;
  const __global Params *params;
  const __global float *filter_table;
  const __global float *shutter_table;  // null where nothing moves
  const __global ushort *counts;        // points that fell into each sample (random), else null
  const __global uchar *levels;         // of the tile's pixels (adaptive), else null
} Launch;

typedef struct {
  uint x, y;        // of the full frame
  uint pixel;       // of the tile
  uint replicate;   // of the launch
  Sampler sampler;
  Share share;
} Item;

// Which (replicate, pixel) entry is item number i. CPUs go row by row, and take all replicates of a pixel before the next: their rays
// stay together as long as those of one do. On GPUs the 32 threads that run in step take 8 x 4 pixels of one replicate, whose rays stay
// together longer. Who takes what changes nothing in the result.
static inline uint entry_of(const __global Params *params, const uint i) {
#if PENUMBRA_DEVICE_GPU
  const uint width = params->tile_width, height = params->tile_height;
  if ((width & 7u) == 0u && (height & 3u) == 0u) {
    const uint block = i >> 5, columns = width >> 3;
    const uint x = block % columns * 8u + (i & 7u), row = block / columns * 4u + ((i >> 3) & 3u);
    return row * width + x;  // rows of all replicates count on: the height is a multiple of 4
  }
  return i;
#else
  const uint pixel = i / params->replicate_count;
  return (i - pixel * params->replicate_count) * (params->tile_width * params->tile_height) + pixel;
#endif
}

static inline Item item_at(const Launch *launch, const uint entry) {
  const __global Params *params = launch->params;
  const uint pixels = params->tile_width * params->tile_height;
  Item item;
  item.replicate = entry / pixels;
  item.pixel = entry - item.replicate * pixels;
  item.x = params->tile_x + item.pixel % params->tile_width;
  item.y = params->tile_y + item.pixel / params->tile_width;
  item.sampler = sampler_start(params, item.x, item.y, params->first_replicate + item.replicate);
#if PENUMBRA_ADAPTIVE
  item.share = share_of(params, launch->levels[item.pixel]);
  sampler_share(&item.sampler, params, launch->levels[item.pixel], &item.share);
#else
  item.share = whole_share(params);
#endif
  return item;
}

static inline Ray start_ray(const Launch *launch, const Item *item, const Sampler *sampler, float *weight) {
  const __global Params *params = launch->params;
  const float2 offset = filter_sample(launch->filter_table, params->filter_radius, sample_2d(sampler, DIM_PIXEL), weight);
  const float2 film = (float2)(((float)item->x + 0.5f + offset.x) / (float)params->film_width,
                               ((float)item->y + 0.5f + offset.y) / (float)params->film_height);
#if PENUMBRA_LENS
  const float2 lens = sample_2d(sampler, DIM_LENS);
#else
  const float2 lens = (float2)(0.5f);
#endif
#if PENUMBRA_MOTION || PENUMBRA_CAMERA_MOTION || PENUMBRA_DEFORMATION
  const float time = camera_time(&params->camera, launch->shutter_table, sample_1d(sampler, DIM_TIME));
#else
  const float time = params->camera.shutter_open;
#endif
  return camera_ray(&params->camera, launch->scene->keyframes, film, lens, time);
}

// A camera path's sample, and what its value is to be multiplied with.
static inline PathSample item_path(const Launch *launch, const Item *item, const Sampler *sampler, float *weight) {
  Path path;
  path_start(&path, start_ray(launch, item, sampler, weight));
  trace_path(launch->scene, launch->params, sampler, &path);
  return path.result;
}

#if PENUMBRA_SAMPLER == SAMPLER_RANDOM
// The plane-wide random sampler takes several paths a sample index: their layers add up, the object is the last one's.
static inline void add_layers(PathSample *sum, const PathSample *path) {
  sum->albedo += path->albedo;
  sum->normal += path->normal;
  sum->depth += path->depth;
  sum->object_id = path->object_id;
}

// Sample number i of the item: what all paths that fell into it bring.
static inline float4 item_sample(const Launch *launch, Item *item, const uint i, PathSample *layers, Gather *gather) {
  const uint pixels = launch->params->tile_width * launch->params->tile_height;
  const uint count = launch->counts[((ulong)item->replicate * launch->params->sample_count + i) * pixels + item->pixel];
  float4 value = (float4)(0.0f);
  *layers = no_path();
  for (uint k = 0; k < count; k++) {
    float weight;
    sampler_next_of(&item->sampler, item->share.first + i, k);
    const PathSample path = item_path(launch, item, &item->sampler, &weight);
    value += path_value(&path, weight, gather);
    add_layers(layers, &path);
  }
  return value;
}
#else
static inline float4 item_sample(const Launch *launch, Item *item, const uint i, PathSample *layers, Gather *gather) {
  float weight;
  sampler_next(&item->sampler, item->share.first + i);
  *layers = item_path(launch, item, &item->sampler, &weight);
  return path_value(layers, weight, gather);
}
#endif

// layers: null where there are none. drawn: DRAWN_COUNT numbers (counting draws), else null.
static PENUMBRA_NOINLINE void trace_item(const Launch *launch, const uint number, __global Layers *layers, __global uint *drawn,
                                         __global uint *out) {
  Item item = item_at(launch, number);
#if PENUMBRA_COUNT_DRAWS
  uint counted[DRAWN_COUNT];
  for (uint k = 0; k < DRAWN_COUNT; k++) counted[k] = 0u;
  item.sampler.drawn = counted;
#endif
  Gather gather;
  gather_start(&gather);
  for (uint i = 0; i < item.share.count; i++) {
    PathSample sample;
    const float4 value = item_sample(launch, &item, i, &sample, &gather);
    tree_add(gather.levels, i, leaf(value, item.share.thinned));
    gather_layers(&gather, i, &sample, item.share.thinned);
  }
  gather_write(&gather, item.share.count, launch->params->sum_stride, layers, out);
#if PENUMBRA_COUNT_DRAWS
  for (uint k = 0; k < DRAWN_COUNT; k++) drawn[k] = counted[k];
#endif
}
