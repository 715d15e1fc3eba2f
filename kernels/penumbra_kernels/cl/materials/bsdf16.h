// bsdf.h in sixteen lanes: the scattering states of sixteen hits. Masks say which lanes a function is asked for; in the others its
// results mean nothing.
#include "base/types16.h"
#include "materials/bsdf.h"
#include "sampling/warp16.cl"

// Bsdf of each lane. Tables are places in scene->albedo_table, or NONE. Where only diffuse materials are, just the frame, color0,
// type and smooth are there.
typedef struct {
  Vec16 s, t, n, ng, wo_world, wo, color0, color1;
  float16 alpha_x, alpha_y, eta, exponent, lobe, missing;
  uint16 near_table, far_table, type, flags;
  Mask16 smooth;
} Bsdf16;

// BsdfSample of each lane.
typedef struct {
  Vec16 wi, weight;
  float16 pdf;
  uint16 event;
} BsdfSample16;

static inline const __global float *table_at(const SceneData *scene, const uint place) {
  return place == NONE ? 0 : scene->albedo_table + place;
}

// The state of a lane that goes on alone.
static inline Bsdf lane_bsdf(const SceneData *scene, const Bsdf16 *b, const uint k) {
  Bsdf bsdf;
  bsdf.s = lane3(&b->s, k);
  bsdf.t = lane3(&b->t, k);
  bsdf.n = lane3(&b->n, k);
  bsdf.ng = lane3(&b->ng, k);
  bsdf.wo_world = lane3(&b->wo_world, k);
  bsdf.wo = lane3(&b->wo, k);
  bsdf.color0 = lane3(&b->color0, k);
  bsdf.type = LANE_U(b->type, k);
  bsdf.smooth = LANE_I(b->smooth, k) != 0;
#if PENUMBRA_GLOSS || PENUMBRA_TRANSMISSION
  bsdf.color1 = lane3(&b->color1, k);
  bsdf.alpha_x = LANE_F(b->alpha_x, k);
  bsdf.alpha_y = LANE_F(b->alpha_y, k);
  bsdf.eta = LANE_F(b->eta, k);
  bsdf.exponent = LANE_F(b->exponent, k);
  bsdf.lobe = LANE_F(b->lobe, k);
  bsdf.missing = LANE_F(b->missing, k);
  bsdf.near_table = table_at(scene, LANE_U(b->near_table, k));
  bsdf.far_table = table_at(scene, LANE_U(b->far_table, k));
  bsdf.flags = LANE_U(b->flags, k);
#endif
  return bsdf;
}

static inline Vec16 to_local16(const Bsdf16 *b, const Vec16 w) { return vec16(dot16(w, b->s), dot16(w, b->t), dot16(w, b->n)); }

static inline Vec16 to_world16(const Bsdf16 *b, const Vec16 w) {
  return add16(add16(scale16(b->s, w.x), scale16(b->t, w.y)), scale16(b->n, w.z));
}

static inline Vec16 cosine_direction16(const Point16 *at) {
  float16 pdf;
  return square_to_cosine_hemisphere16(at->x, at->y, &pdf);
}

#if PENUMBRA_GLOSS || PENUMBRA_TRANSMISSION
// Scales both colours down where their sum is above 1.
static inline void limit_sum16(const Mask16 on, Bsdf16 *b) {
  const Vec16 sum = add16(b->color0, b->color1);
  const float16 one = 1.0f;
  const Vec16 scale = vec16(1.0f / MAX16(sum.x, one), 1.0f / MAX16(sum.y, one), 1.0f / MAX16(sum.z, one));
  b->color0 = where16(on, mul16(b->color0, scale), b->color0);
  b->color1 = where16(on, mul16(b->color1, scale), b->color1);
}
#endif

// What lobes of the lanes `on` drew: for all kinds of materials one after the other.
static inline void smooth_event16(const Mask16 on, const Vec16 wi, BsdfSample16 *out) {
  const uint16 event = wi.z < 0.0f ? (uint16)(BSDF_EVENT_TRANSMIT) : (uint16)(0u);
  out->wi = where16(on, wi, out->wi);
  out->event = on ? event : out->event;
}

static inline void delta_event16(const Mask16 on, const Vec16 wi, const Vec16 weight, const float16 probability, const uint event,
                                 BsdfSample16 *out) {
  out->wi = where16(on, wi, out->wi);
  out->weight = where16(on, weight, out->weight);
  out->pdf = on ? probability : out->pdf;
  out->event = on ? (uint16)(BSDF_EVENT_DELTA | event) : out->event;
}

static inline Vec16 mirror_of16(const Vec16 wo) { return vec16(-wo.x, -wo.y, wo.z); }

static inline float16 reuse_below16(const float16 u, const float16 p) {
  const float16 rest = u / p, most = ONE_MINUS_EPSILON;
  return MIN16(rest, most);
}
static inline float16 reuse_above16(const float16 u, const float16 p) {
  const float16 rest = (u - p) / (1.0f - p), most = ONE_MINUS_EPSILON;
  return MIN16(rest, most);
}

static inline Mask16 takes_lobe16(const float16 p, Point16 *u) {
  const Mask16 takes = u->x < p;
  u->x = takes ? reuse_below16(u->x, p) : reuse_above16(u->x, p);
  return takes;
}
