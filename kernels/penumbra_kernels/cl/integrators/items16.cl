// Items, sixteen paths at once: an item's next sixteen samples, or, where a node has fewer of it, those of consecutive items together.
// Each lane gives the bits that item.cl gives its sample.
#include "integrators/item.cl"
#include "integrators/paths16.cl"
#include "camera/camera16.cl"

// A lane's pixel, in pixels of the full frame.
static inline Point16 lane_pixels(const Item *items, const uint shift) {
  Point16 at;
  at.x = (float)items->x;
  at.y = (float)items->y;
  if (shift == LANE_LEVELS) return at;
  for (uint k = 0u; k < LANES; k++) {
    LANE_F(at.x, k) = (float)items[k >> shift].x;
    LANE_F(at.y, k) = (float)items[k >> shift].y;
  }
  return at;
}

static inline Ray16 start_rays16(const Launch *launch, const Item *items, const Sampler16 *samples, const Mask16 on,
                                 float16 *weight) {
  const __global Params *params = launch->params;
  const Point16 u = sample_2d16(samples, DIM_PIXEL, on), at = lane_pixels(items, samples->shift);
  float16 offset_x, offset_y;
  filter_sample16(launch->filter_table, params->filter_radius, u.x, u.y, on, &offset_x, &offset_y, weight);
  const float16 film_x = (at.x + 0.5f + offset_x) / (float)params->film_width;
  const float16 film_y = (at.y + 0.5f + offset_y) / (float)params->film_height;
  Point16 lens;
  lens.x = lens.y = 0.5f;
#if PENUMBRA_LENS
  lens = sample_2d16(samples, DIM_LENS, on);
#endif
#if PENUMBRA_MOTION || PENUMBRA_CAMERA_MOTION || PENUMBRA_DEFORMATION
  const float16 time = camera_time16(&params->camera, launch->shutter_table, sample_1d16(samples, DIM_TIME, on), on);
#else
  const float16 time = params->camera.shutter_open;
#endif
  return camera_rays16(&params->camera, launch->scene->keyframes, film_x, film_y, lens.x, lens.y, time, on);
}

// What sixteen samples bring: radiance and alpha, times their weight, 0 where it is not to be counted; and their layers.
typedef struct {
  float16 value[4];
  uint valid, lit;  // a bit a lane
} Values16;

static inline Values16 values16(const Paths16 *p, const float16 weight) {
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

// Sums of 2^shift lanes each, as tree_add forms them.
static inline void tree_sums16(const float16 v, const uint shift, const bool thinned, float16 *out) {
  const float16 leaves = thinned ? v + 0.0f : v;
  *out = leaves;
  if (shift == 0u) return;
  const float8 a = leaves.even + leaves.odd;
  out->lo = a;
  if (shift == 1u) return;
  const float4 b = a.even + a.odd;
  out->lo.lo = b;
  if (shift == 2u) return;
  const float2 c = b.even + b.odd;
  out->lo.lo.lo = c;
  if (shift == 3u) return;
  out->s0 = c.x + c.y;
}

// Counts what the lanes of `bits` brought.
static inline void count16(const Paths16 *p, const Values16 *values, const uint bits, Gather *gather) {
  gather->taken += POPCOUNT(values->valid & bits);
  gather->lit += POPCOUNT(values->lit & bits);
  for (uint left = bits; left; left &= left - 1u) gather->rays += LANE_U(p->rays, CTZ(left));
  for (uint left = bits & ~values->valid; left; left &= left - 1u) {
    gather->rejected++;
    gather->rejected_in |= LANE_U(p->effects, CTZ(left));
  }
}

// The sums of 2^shift samples of every item that the lanes hold, into its gather: its samples from number i on, which is a multiple of
// that.
static inline void gather16_items(const Paths16 *p, const float16 weight, const uint shift, const uint i, const bool thinned,
                                  const uint items, Gather *gathers) {
  const Values16 values = values16(p, weight);
  float16 sums[4];
  for (uint c = 0u; c < 4u; c++) tree_sums16(values.value[c], shift, thinned, sums + c);
#if PENUMBRA_LAYERS
  float16 layers[7];
  const float16 channels[7] = {p->albedo.x, p->albedo.y, p->albedo.z, p->depth, p->normal.x, p->normal.y, p->normal.z};
  for (uint c = 0u; c < 7u; c++) tree_sums16(channels[c], shift, thinned, layers + c);
#endif
  for (uint j = 0u; j < items; j++) {
    Gather *gather = gathers + j;
    count16(p, &values, ((1u << (1u << shift)) - 1u) << (j << shift), gather);
    tree_add_from(gather->levels, shift, i,
                  (float4)(LANE_F(sums[0], j), LANE_F(sums[1], j), LANE_F(sums[2], j), LANE_F(sums[3], j)));
#if PENUMBRA_LAYERS
    tree_add_from(gather->albedo_depth, shift, i,
                  (float4)(LANE_F(layers[0], j), LANE_F(layers[1], j), LANE_F(layers[2], j), LANE_F(layers[3], j)));
    tree_add_from(gather->normal, shift, i,
                  (float4)(LANE_F(layers[4], j), LANE_F(layers[5], j), LANE_F(layers[6], j), 0.0f));
    if (i == 0) gather->object_id = LANE_U(p->object_id, j << shift);
#endif
  }
}

// The items from number `first` on that have as many samples as the first, up to LANES samples in all; how many.
static inline uint alike_items(const Launch *launch, const uint first, const uint end, Item *items) {
  items[0] = item_at(launch, first);
  const Share share = items[0].share;
  if (share.count == 0u || share.count >= LANES) return 1u;
  uint n = 1u;
  for (; n < LANES / share.count && first + n < end; n++) {
    items[n] = item_at(launch, first + n);
    if (items[n].share.count != share.count || items[n].share.first != share.first) break;
  }
  return n;
}

static inline uint log2_of(const uint count) { return CTZ(count); }

// All samples of some items from number `first` on, of those before `end`; how many items they were. layers: null where there are
// none. drawn: DRAWN_COUNT numbers an item (counting draws), else null.
static PENUMBRA_NOINLINE PENUMBRA_WIDE uint trace_items16(const Launch *launch, const uint first, const uint end,
                                                          __global Layers *layers, __global uint *drawn, __global Sum *sums) {
  Item items[LANES];
  Sampler samplers[LANES];
  Gather gathers[LANES];
  const uint n = alike_items(launch, first, end, items);
  const Share share = items->share;
#if PENUMBRA_COUNT_DRAWS
  uint counted[LANES][DRAWN_COUNT];
  for (uint j = 0u; j < n; j++) {
    for (uint k = 0u; k < DRAWN_COUNT; k++) counted[j][k] = 0u;
    items[j].sampler.drawn = counted[j];
  }
#endif
  for (uint j = 0u; j < n; j++) {
    samplers[j] = items[j].sampler;
    gather_start(gathers + j);
  }
  const uint step = MIN(share.count, LANES);
  for (uint i = 0u; i < share.count; i += step) {
    const Sampler16 samples = sampler_start16(samplers, n, share.first + i, log2_of(step));
    const Mask16 on = lanes_from(0u, n * step);
    float16 weight;
    Paths16 paths;
    paths_start16(&paths, start_rays16(launch, items, &samples, on, &weight));
    trace_paths16(launch->scene, launch->params, &samples, on, &paths);
    gather16_items(&paths, weight, log2_of(step), i, share.thinned, n, gathers);
  }
  for (uint j = 0u; j < n; j++) {
    const uint item = first + j;
    gather_write(gathers + j, share.count, layers + item, sums + item);
#if PENUMBRA_COUNT_DRAWS
    for (uint k = 0u; k < DRAWN_COUNT; k++) drawn[item * DRAWN_COUNT + k] = counted[j][k];
#endif
  }
  return n;
}
