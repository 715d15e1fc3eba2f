// What all materials share: the scattering state of one hit, its local frame, and how lobes report what they drew.
// Local frame: z is the shading normal on the viewer's side, x the tangent that anisotropy follows. Directions are unit and
// point away from the surface. The viewer's side is decided by the geometric normal alone.
#include "base/types.h"
#include "sampling/warp.cl"

#define BSDF_EVENT_DELTA 1u     // a direction of a perfect mirror or pane: weight is final, pdf its discrete probability
#define BSDF_EVENT_TRANSMIT 2u  // through the surface

typedef struct {
  float3 s, t, n;            // local axes in the world frame
  float3 ng;                 // unit geometric normal on the viewer's side
  float3 wo_world;           // towards the viewer
  float3 wo;                 // the same, local; wo.z > 0 where `smooth`
  float3 color0, color1;     // textures looked up; see Material
  float alpha_x, alpha_y;    // GGX; 0 for a perfect mirror or pane
  float eta;                 // index of refraction of the far side over the viewer's side
  float exponent;            // Phong
  float lobe;                // probability of the material's first lobe (each says which)
  float missing;             // share of light that single scattering on the microfacets loses towards wo
  const __global float *near_table;  // its losses on the viewer's side (compensation.cl), or null
  const __global float *far_table;   // and on the far side
  uint type;                 // MATERIAL_*
  uint flags;
  bool smooth;               // the viewer is above the shading normal too; if not, only delta lobes remain
} Bsdf;

// What a lobe drew, in the local frame. Delta lobes fill weight and pdf in, for the others bsdf.cl does.
typedef struct {
  float3 wi;
  float3 weight;
  float pdf;
  uint event;  // BSDF_EVENT_* bits
} BsdfSample;

static inline float3 to_local(const Bsdf *b, const float3 w) {
  return (float3)(dot3(w, b->s), dot3(w, b->t), dot3(w, b->n));
}

static inline float3 to_world(const Bsdf *b, const float3 w) { return b->s * w.x + b->t * w.y + b->n * w.z; }

// The mirror direction of wo about the normal.
static inline float3 mirror_of(const float3 wo) { return (float3)(-wo.x, -wo.y, wo.z); }

// What is left of a random number after it chose between [0, p) and [p, 1): uniform again, below 1.
static inline float reuse_below(const float u, const float p) { return MIN(u / p, ONE_MINUS_EPSILON); }
static inline float reuse_above(const float u, const float p) { return MIN((u - p) / (1.0f - p), ONE_MINUS_EPSILON); }

// Whether a point of the square chooses the lobe of probability p: one left of p does. Each lobe then has its part of the square
// stretched over the whole of it, so that what spreads points evenly over the square spreads every lobe's own evenly.
static inline bool takes_lobe(const float p, float2 *u) {
  const bool takes = u->x < p;
  u->x = takes ? reuse_below(u->x, p) : reuse_above(u->x, p);
  return takes;
}

// Cosine-distributed direction about +z; density z / pi.
static inline float3 cosine_direction(const float2 u) {
  float pdf;
  return square_to_cosine_hemisphere(u, &pdf);
}

static inline void delta_event(BsdfSample *out, const float3 wi, const float3 weight, const float probability,
                               const uint event) {
  out->wi = wi;
  out->weight = weight;
  out->pdf = probability;
  out->event = BSDF_EVENT_DELTA | event;
}

static inline void smooth_event(BsdfSample *out, const float3 wi) {
  out->wi = wi;
  out->event = wi.z < 0.0f ? BSDF_EVENT_TRANSMIT : 0u;
}
