// Items in batches of paths: an item's next samples, or, where a node has fewer of it, those of consecutive items together, which are
// replicates of one pixel first. Each lane gives the bits that item.cl gives its sample.
#include "integrators/item.cl"
#include "integrators/batch16.cl"
#include "camera/camera16.cl"

#define MAX_ITEMS 64u  // of a batch

// The pixels of `count` samples or more, up to LANES, in pixels of the full frame. of: each sample's item, rising.
static inline Point16 lane_pixels(const Item *items, const uchar *of, const uint count) {
  Point16 at;
  if (of[0] == of[count - 1u]) {
    at.x = (float)items[of[0]].x;
    at.y = (float)items[of[0]].y;
    return at;
  }
  for (uint k = 0u; k < LANES; k++) {
    LANE_F(at.x, k) = (float)items[of[k]].x;
    LANE_F(at.y, k) = (float)items[of[k]].y;
  }
  return at;
}

// u: points of the square, in the pixel and on the lens.
static inline Ray16 start_rays16(const Launch *launch, const Point16 at, const Sampler16 *samples, const Mask16 on, const Point16 *u,
                                 const Point16 *lens, float16 *weight) {
  const __global Params *params = launch->params;
  float16 offset_x, offset_y;
  filter_sample16(launch->filter_table, params->filter_radius, u->x, u->y, on, &offset_x, &offset_y, weight);
  const float16 film_x = (at.x + 0.5f + offset_x) / (float)params->film_width;
  const float16 film_y = (at.y + 0.5f + offset_y) / (float)params->film_height;
#if PENUMBRA_MOTION || PENUMBRA_CAMERA_MOTION || PENUMBRA_DEFORMATION
  const float16 time = camera_time16(&params->camera, launch->shutter_table, sample_1d16(samples, DIM_TIME, on), on);
#else
  const float16 time = params->camera.shutter_open;
#endif
  return camera_rays16(&params->camera, launch->scene->keyframes, film_x, film_y, lens->x, lens->y, time, on);
}

// What sixteen samples bring: radiance and alpha, times their weight, 0 where it is not to be counted; and their layers.
typedef struct {
  float16 value[4];
  uint valid, lit;  // a bit a lane
} Values16;

static inline Values16 values16(const PathSamples16 *p, const float16 weight) {
  const float16 r = p->radiance.x, g = p->radiance.y, b = p->radiance.z, zero = 0.0f;
  const Mask16 valid = is_finite16(r) & is_finite16(g) & is_finite16(b) & (r >= 0.0f) & (g >= 0.0f) & (b >= 0.0f);
  Values16 out;
  out.value[0] = valid ? r * weight : zero;
  out.value[1] = valid ? g * weight : zero;
  out.value[2] = valid ? b * weight : zero;
  out.value[3] = valid ? p->alpha * weight : zero;
  out.valid = mask16(valid);
  out.lit = mask16(valid & (max3_16(p->radiance) > 0.0f));
  return out;
}

// The sum of all lanes as tree_add forms it.
static inline float tree_sum16(const float16 v, const bool thinned) {
  const float16 leaves = thinned ? v + 0.0f : v;
  const float8 a = leaves.even + leaves.odd;
  const float4 b = a.even + a.odd;
  const float2 c = b.even + b.odd;
  return c.x + c.y;
}

// Counts what the lanes of `bits` brought.
static inline void count16(const PathSamples16 *p, const Values16 *values, const uint bits, Gather *gather) {
  gather->taken += POPCOUNT(values->valid & bits);
  gather->lit += POPCOUNT(values->lit & bits);
  for (uint left = bits; left; left &= left - 1u) gather->rays += LANE_U(p->rays, CTZ(left));
  for (uint left = bits & ~values->valid; left; left &= left - 1u) {
    gather->rejected++;
    gather->rejected_in |= LANE_U(p->effects, CTZ(left));
  }
}

// Sixteen samples of one item, from number i of its share on, which is a multiple of that.
static inline void gather_one(const PathSamples16 *p, const float16 weight, const uint i, const bool thinned, Gather *gather) {
  const Values16 v = values16(p, weight);
  count16(p, &v, 0xffffu, gather);
  tree_add_from(gather->levels, LANE_LEVELS, i,
                (float4)(tree_sum16(v.value[0], thinned), tree_sum16(v.value[1], thinned), tree_sum16(v.value[2], thinned),
                         tree_sum16(v.value[3], thinned)));
#if PENUMBRA_LAYERS
  tree_add_from(gather->albedo_depth, LANE_LEVELS, i,
                (float4)(tree_sum16(p->albedo.x, thinned), tree_sum16(p->albedo.y, thinned), tree_sum16(p->albedo.z, thinned),
                         tree_sum16(p->depth, thinned)));
  tree_add_from(gather->normal, LANE_LEVELS, i,
                (float4)(tree_sum16(p->normal.x, thinned), tree_sum16(p->normal.y, thinned), tree_sum16(p->normal.z, thinned), 0.0f));
  if (i == 0) gather->object_id = LANE_U(p->object_id, 0u);
#endif
}

// `count` samples of some items, which are number `first` and following of the batch.
static inline void gather_each(const PathSamples16 *p, const float16 weight, const uint count, const Item *items,
                               const Samples *samples, const uint first, Gather *gathers) {
  const Values16 v = values16(p, weight);
  for (uint k = 0u; k < count; k++) {
    const uint of = samples->of[first + k];
    const Item *item = items + of;
    Gather *gather = gathers + of;
    const uint i = (uint)(samples->index[first + k] - item->share.first);
    const float4 value =
        (float4)(LANE_F(v.value[0], k), LANE_F(v.value[1], k), LANE_F(v.value[2], k), LANE_F(v.value[3], k));
    count16(p, &v, 1u << k, gather);
    tree_add(gather->levels, i, leaf(value, item->share.thinned));
#if PENUMBRA_LAYERS
    const PathSample path = lane_sample(p, k);
    gather_layers(gather, i, &path, item->share.thinned);
#endif
  }
}

// All samples of a batch. Items have powers of two of them, so that a vector that is one item's has a branch of its tree, unless items
// with fewer came before.
static inline void gather_batch(const Batch16 *batch, const float16 *weight, const uint count, const Item *items, Gather *gathers) {
  const Samples *samples = &batch->samples;
  for (uint w = 0u; w * LANES < count; w++) {
    const uint first = w * LANES, some = MIN(count - first, LANES), of = samples->of[first];
    const Share share = items[of].share;
    const uint i = (uint)(samples->index[first] - share.first);
    if (some == LANES && samples->of[first + LANES - 1u] == of && i % LANES == 0u) {
      gather_one(batch->results + w, weight[w], i, share.thinned, gathers + of);
    } else {
      gather_each(batch->results + w, weight[w], some, items, samples, first, gathers);
    }
  }
}

// Samples that a batch takes. Large trees want the cache for themselves.
static inline uint room_of(const __global Params *params) { return params->options & OPTION_TOGETHER ? BATCH : BATCH / 2u; }

// Whether the samples of n items are even.
static inline void note_even(Samples *samples, const Item *items, const uint n) {
#if PENUMBRA_ROWS
  samples->even = n <= FEW_SAMPLERS;
  samples->shift = level_of(MAX(items->share.count, 1u));
  samples->keys = 0ul;
  for (uint k = 0u; k < n && samples->even; k++) {
    samples->even = items[k].share.count == items->share.count && items[k].share.first == items->share.first;
    ((ulong *)&samples->keys)[k] = samples->samplers[k].key;
  }
#endif
}

// Items from number `first` on, of those before `end`: one that fills a batch, or as many as have room in one. samples: `count` in all,
// the first of each item.
static inline uint fill_batch(const Launch *launch, const uint first, const uint end, Item *items, Sampler *samplers, Samples *samples,
                              uint *count) {
  const uint room = room_of(launch->params);
  uint n = 0u;
  *count = 0u;
  for (; n < MAX_ITEMS && first + n < end && *count < room; n++) {
    items[n] = item_at(launch, entry_of(launch->params, first + n));
    const uint own = items[n].share.count;
    if (n && *count + own > room) break;
    samplers[n] = items[n].sampler;
    for (uint k = 0u; k < MIN(own, room); k++) {
      samples->of[*count] = (uchar)n;
      samples->index[(*count)++] = items[n].share.first + k;
    }
  }
  for (uint k = *count; k < BATCH; k++) samples->of[k] = 0u;
  samples->samplers = samplers;
  note_even(samples, items, n);
  return n;
}

// Traces the first `count` samples of the batch. weight: of each, by their numbers.
static PENUMBRA_NOINLINE PENUMBRA_WIDE void trace_samples(const Launch *launch, const Item *items, const uint count, Batch16 *batch,
                                                          float16 *weight) {
  const uint16 lane = as_uint16(LANE_NUMBERS);
  Point16 u[VECTORS], lens[VECTORS];
  batch->vectors = (count + LANES - 1u) / LANES;
  batch->moved = false;
  for (uint w = 0u; w < batch->vectors; w++) {
    batch->paths[w].number = lane + w * LANES;
    hold_paths16(batch, w, count);
    lens[w].x = lens[w].y = 0.5f;
  }
  sample_pairs16(batch->samplers, batch->on, batch->vectors, DIM_PIXEL, 1u, u);
#if PENUMBRA_LENS
  sample_pairs16(batch->samplers, batch->on, batch->vectors, DIM_LENS, 1u, lens);
#endif
  for (uint w = 0u; w < batch->vectors; w++) {
    const Point16 at = lane_pixels(items, batch->samples.of + w * LANES, MIN(count - w * LANES, LANES));
    paths_start16(batch->paths + w, start_rays16(launch, at, batch->samplers + w, batch->on[w], u + w, lens + w, weight + w));
  }
  trace_batch16(launch->scene, launch->params, batch);
}

// All samples of some items from number `first` on, of those before `end`; how many items they were. layers: null where there are
// none. drawn: DRAWN_COUNT numbers an item (counting draws), else null.
static PENUMBRA_NOINLINE PENUMBRA_WIDE uint trace_items16(const Launch *launch, const uint first, const uint end,
                                                          __global Layers *layers, __global uint *drawn, __global uint *sums) {
  Item items[MAX_ITEMS];
  Sampler samplers[MAX_ITEMS];
  Gather gathers[MAX_ITEMS];
  Batch16 batch;
  float16 weight[VECTORS];
  uint count;
  const uint n = fill_batch(launch, first, end, items, samplers, &batch.samples, &count);
  for (uint j = 0u; j < n; j++) gather_start(gathers + j);
#if PENUMBRA_COUNT_DRAWS
  uint counted[MAX_ITEMS][DRAWN_COUNT];
  for (uint j = 0u; j < n; j++) {
    for (uint k = 0u; k < DRAWN_COUNT; k++) counted[j][k] = 0u;
    samplers[j].drawn = counted[j];
  }
#endif
  for (uint done = 0u;;) {
    trace_samples(launch, items, count, &batch, weight);
    gather_batch(&batch, weight, count, items, gathers);
    done += count;
    if (n > 1u || done >= items->share.count) break;
    for (uint k = 0u; k < count; k++) batch.samples.index[k] += count;
    count = MIN(count, items->share.count - done);
  }
  for (uint j = 0u; j < n; j++) {
    const uint entry = entry_of(launch->params, first + j);
    gather_write(gathers + j, items[j].share.count, launch->params->sum_stride, layers + entry, sums + entry);
#if PENUMBRA_COUNT_DRAWS
    for (uint k = 0u; k < DRAWN_COUNT; k++) drawn[entry * DRAWN_COUNT + k] = counted[j][k];
#endif
  }
  return n;
}
