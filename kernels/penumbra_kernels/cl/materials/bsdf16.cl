// bsdf.cl in sixteen lanes: each lane gets, bit for bit, what the function of that name there gives for it. A kind of material is
// looked at where some lane has it. Tables and textures are read through the scene.
#include "materials/bsdf.cl"
#include "materials/bsdf16.h"
#include "materials/diffuse16.cl"
#if PENUMBRA_TEXTURES
#include "materials/texture16.cl"
#endif
#if PENUMBRA_GLOSS || PENUMBRA_TRANSMISSION
#include "materials/compensation16.cl"
#include "materials/fresnel16.cl"
#include "materials/microfacet16.cl"
#endif
#if PENUMBRA_GLOSS
#include "base/transcendental16.cl"
#include "materials/conductor16.cl"
#include "materials/phong16.cl"
#include "materials/plastic16.cl"
#endif
#if PENUMBRA_TRANSMISSION
#include "materials/dielectric16.cl"
#include "materials/diffuse_transmission16.cl"
#include "materials/thin_dielectric16.cl"
#endif

// With one kind of material these are a few operations; with all of them they are kept out of their callers.
#if PENUMBRA_GLOSS || PENUMBRA_TRANSMISSION
#define LOBES_FUNCTION static PENUMBRA_NOINLINE PENUMBRA_WIDE
#else
#define LOBES_FUNCTION static inline
#endif

static inline void rotate_axes16(const float16 angle, Vec16 *s, Vec16 *t) {
  const float16 turns = angle * INV_2PI_F, one = 1.0f;
  float16 sine, cosine;
  sincos_2pi16(MIN16(turns, one), &sine, &cosine);
  const Vec16 turned = add16(scale16(*s, cosine), scale16(*t, sine));
  *t = sub16(scale16(*t, cosine), scale16(*s, sine));
  *s = turned;
}

static inline void bsdf_frame16(const Surface16 *surface, const Vec16 wo, const float16 rotation, const Mask16 on, Bsdf16 *b) {
  const float16 one = 1.0f;
  const float16 side = dot16(wo, surface->ng) < 0.0f ? -one : one;
  b->ng = scale16(surface->ng, side);
  b->n = scale16(surface->ns, side);
  b->s = surface->tangent;
  b->t = cross16(b->n, b->s);
  b->smooth = dot16(wo, b->n) > 0.0f;
  const Mask16 behind = on & ~b->smooth;
  if (any16(behind)) {
    Vec16 s, t;
    make_frame16(b->ng, &s, &t);
    b->n = where16(behind, b->ng, b->n);
    b->s = where16(behind, s, b->s);
    b->t = where16(behind, t, b->t);
  }
#if PENUMBRA_GLOSS || PENUMBRA_TRANSMISSION
  const Mask16 rotated = on & b->smooth & (rotation != 0.0f);
  if (any16(rotated)) {
    Vec16 s = b->s, t = b->t;
    rotate_axes16(side * rotation < 0.0f ? 2.0f * PI_F - rotation : rotation, &s, &t);
    b->s = where16(rotated, s, b->s);
    b->t = where16(rotated, t, b->t);
  }
#endif
  b->wo_world = wo;
  b->wo = to_local16(b, wo);
}

static inline Vec16 material_color16(const SceneData *scene, const __global float *color, const uint texture,
                                     const Surface16 *surface, const Mask16 on) {
#if PENUMBRA_TEXTURES
  if (texture != NONE) {
    Vec16 looked_up;
    texture_lookup16(scene, texture, &surface->u, &surface->v, &on, &looked_up);
    return looked_up;
  }
#endif
  return all16(load3(color));
}

#if PENUMBRA_GLOSS || PENUMBRA_TRANSMISSION
// bsdf_gloss of the lanes of one material.
static inline void material_gloss16(const __global Material *material, const Mask16 outside, const Mask16 on, Bsdf16 *b) {
  const uint near_table = material->albedo;
  uint far_table = near_table;
  if (near_table != NONE && material->type == MATERIAL_DIELECTRIC) {
    far_table += ALBEDO_ROWS + (material->alpha_x != material->alpha_y ? ALBEDO_AZIMUTHS : 1u) * ALBEDO_NODES;
  }
  const Mask16 turned = ~outside & (Mask16)(material->type == MATERIAL_DIELECTRIC ? -1 : 0);
  const float16 ior = material->ior;
  const uint16 first = near_table, second = far_table;
  b->alpha_x = on ? (float16)(material->alpha_x) : b->alpha_x;
  b->alpha_y = on ? (float16)(material->alpha_y) : b->alpha_y;
  b->exponent = on ? (float16)(material->exponent) : b->exponent;
  b->eta = on ? (turned ? 1.0f / ior : ior) : b->eta;
  b->near_table = on ? (turned ? second : first) : b->near_table;
  b->far_table = on ? (turned ? first : second) : b->far_table;
  b->flags = on ? (uint16)(material->flags) : b->flags;
}
#endif

// Type, colours and widths, material by material: those that sixteen lanes meet are few.
static inline void bsdf_materials16(const SceneData *scene, const Surface16 *surface, const Vec16 wo, const Mask16 on, Bsdf16 *b,
                                    float16 *rotation) {
  const Rows16 shapes = gather_rows16(scene->shapes, surface->shape * WORDS(ShapeData), on);
  const uint16 index = as_uint16(shapes.x);
  const float16 zero = 0.0f;
  b->color0 = vec16(zero, zero, zero);
  b->type = MATERIAL_BLACK;
  *rotation = zero;
#if PENUMBRA_GLOSS || PENUMBRA_TRANSMISSION
  const Mask16 outside = dot16(wo, surface->ng) >= 0.0f;
  b->color1 = vec16(zero, zero, zero);
  b->alpha_x = b->alpha_y = b->exponent = b->eta = b->lobe = b->missing = zero;
  b->near_table = b->far_table = NONE;
  b->flags = 0u;
#endif
  for (Mask16 left = on; any16(left);) {
    const uint which = LANE_U(index, CTZ(mask16(left)));
    const Mask16 same = left & (index == which);
    const __global Material *material = scene->materials + which;
    left &= ~same;
    b->type = same ? (uint16)(material->type) : b->type;
    b->color0 = where16(same, material_color16(scene, material->color0, material->texture0, surface, same), b->color0);
#if PENUMBRA_GLOSS || PENUMBRA_TRANSMISSION
    b->color1 = where16(same, material_color16(scene, material->color1, material->texture1, surface, same), b->color1);
    *rotation = same ? (float16)(material->rotation) : *rotation;
    material_gloss16(material, outside, same, b);
#endif
  }
}

// The lanes of a kind of material.
#define LANES_WITH(kind) (on & (b->type == (kind)))

LOBES_FUNCTION void lobes_start16(const SceneData *scene, const Mask16 *lanes, Bsdf16 *b) {
#if PENUMBRA_GLOSS || PENUMBRA_TRANSMISSION
  const Mask16 on = *lanes;
#if PENUMBRA_GLOSS
  const Mask16 phong = LANES_WITH(MATERIAL_PHONG), plastic = LANES_WITH(MATERIAL_PLASTIC);
  if (any16(phong)) phong_start16(phong, b);
  conductor_start16(scene, LANES_WITH(MATERIAL_CONDUCTOR), b);
  if (any16(plastic)) plastic_start16(scene, plastic, b);
#endif
#if PENUMBRA_TRANSMISSION
  dielectric_start16(scene, LANES_WITH(MATERIAL_DIELECTRIC) | LANES_WITH(MATERIAL_THIN_DIELECTRIC), b);
  const Mask16 paper = LANES_WITH(MATERIAL_DIFFUSE_TRANSMISSION);
  if (any16(paper)) diffuse_transmission_start16(paper, b);
#endif
#endif
}

static inline void bsdf_start16(const SceneData *scene, const Surface16 *surface, const Vec16 wo, const Mask16 on, Bsdf16 *b) {
  float16 rotation;
  bsdf_materials16(scene, surface, wo, on, b, &rotation);
  bsdf_frame16(surface, wo, rotation, on, b);
  lobes_start16(scene, &on, b);
}

#define ALL_LANES ((Mask16)(-1))
#define NO_LANES ((Mask16)(0))

static inline Mask16 bsdf_has_spread16(const Bsdf16 *b) {
#if PENUMBRA_GLOSS || PENUMBRA_TRANSMISSION
  const Mask16 faces = (b->type == MATERIAL_CONDUCTOR) | (b->type == MATERIAL_DIELECTRIC) | (b->type == MATERIAL_THIN_DIELECTRIC);
  return ~((b->type == MATERIAL_MIRROR) | (faces & ~(b->alpha_x > 0.0f)));
#else
  return ALL_LANES;
#endif
}

static inline Mask16 bsdf_has_smooth16(const Bsdf16 *b) {
  return b->smooth & (b->type != MATERIAL_BLACK) & bsdf_has_spread16(b);
}

static inline Mask16 bsdf_transmits16(const Bsdf16 *b) {
#if PENUMBRA_TRANSMISSION
  return (b->type == MATERIAL_DIELECTRIC) | (b->type == MATERIAL_THIN_DIELECTRIC) | (b->type == MATERIAL_DIFFUSE_TRANSMISSION);
#else
  return NO_LANES;
#endif
}

static inline Mask16 bsdf_has_lobes16(const Bsdf16 *b) {
#if PENUMBRA_TRANSMISSION
  return (b->type == MATERIAL_DIELECTRIC) | (b->type == MATERIAL_THIN_DIELECTRIC);
#else
  return NO_LANES;
#endif
}

static inline Mask16 bsdf_is_wide16(const Bsdf16 *b) {
#if PENUMBRA_GLOSS || PENUMBRA_TRANSMISSION
  return (b->type == MATERIAL_DIFFUSE) | (b->type == MATERIAL_DIFFUSE_TRANSMISSION);
#else
  return ALL_LANES;
#endif
}

// Values of the kind of material that `on` has, as `part` computes them with their densities.
#define TAKE_VALUE(kind, part)                     \
  {                                                \
    const Mask16 some = LANES_WITH(kind);          \
    if (any16(some)) {                             \
      float16 density;                             \
      const Vec16 v = part;                        \
      *value = where16(some, v, *value);           \
      *pdf = some ? density : *pdf;                \
    }                                              \
  }

// lobes_eval; 0 where a lane is not on.
LOBES_FUNCTION void lobes_eval16(const SceneData *scene, const Bsdf16 *b, const Vec16 *wi, const Mask16 *lanes, Vec16 *value,
                                 float16 *pdf) {
  const Mask16 on = *lanes;
  const float16 zero = 0.0f;
  *value = vec16(zero, zero, zero);
  *pdf = zero;
  TAKE_VALUE(MATERIAL_DIFFUSE, diffuse_eval16(b, *wi, &density))
#if PENUMBRA_GLOSS
  TAKE_VALUE(MATERIAL_PHONG, phong_eval16(b, *wi, &density))
  TAKE_VALUE(MATERIAL_CONDUCTOR, conductor_eval16(scene, b, *wi, some, &density))
  TAKE_VALUE(MATERIAL_PLASTIC, plastic_eval16(scene, b, *wi, some, &density))
#endif
#if PENUMBRA_TRANSMISSION
  TAKE_VALUE(MATERIAL_DIELECTRIC, dielectric_eval16(scene, b, *wi, some, &density))
  TAKE_VALUE(MATERIAL_THIN_DIELECTRIC, thin_dielectric_eval16(scene, b, *wi, some, &density))
  TAKE_VALUE(MATERIAL_DIFFUSE_TRANSMISSION, diffuse_transmission_eval16(b, *wi, &density))
#endif
}

#define TAKE_SAMPLE(kind, part)            \
  {                                        \
    const Mask16 some = LANES_WITH(kind);  \
    if (any16(some)) *alive |= part;       \
  }

// *alive: the lanes where lobes_sample returns true.
LOBES_FUNCTION void lobes_sample16(const SceneData *scene, const Bsdf16 *b, const float16 *u_lobe, const Point16 *at,
                                   const Mask16 *lanes, BsdfSample16 *out, Mask16 *alive) {
  const float16 zero = 0.0f;
  const Mask16 on = *lanes;
  out->wi = out->weight = vec16(zero, zero, zero);
  out->pdf = zero;
  out->event = 0u;
  *alive = 0;
  TAKE_SAMPLE(MATERIAL_DIFFUSE, diffuse_sample16(some, at, out))
#if PENUMBRA_GLOSS
  TAKE_SAMPLE(MATERIAL_PHONG, phong_sample16(b, *at, some, out))
  TAKE_SAMPLE(MATERIAL_MIRROR, mirror_sample16(b, some, out))
  TAKE_SAMPLE(MATERIAL_CONDUCTOR, conductor_sample16(scene, b, *at, some, out))
  TAKE_SAMPLE(MATERIAL_PLASTIC, plastic_sample16(b, *at, some, out))
#endif
#if PENUMBRA_TRANSMISSION
  TAKE_SAMPLE(MATERIAL_DIELECTRIC, dielectric_sample16(scene, b, *u_lobe, at, some, out))
  TAKE_SAMPLE(MATERIAL_THIN_DIELECTRIC, thin_dielectric_sample16(scene, b, *u_lobe, at, some, out))
  TAKE_SAMPLE(MATERIAL_DIFFUSE_TRANSMISSION, diffuse_transmission_sample16(b, *at, some, out))
#endif
}

static inline Mask16 same_side16(const Bsdf16 *b, const Vec16 wi, const float16 local_z) {
  const float16 geometric = dot16(wi, b->ng);
  return ((geometric > 0.0f) & (local_z > 0.0f)) | ((geometric < 0.0f) & (local_z < 0.0f));
}

// 0, and *pdf 0, where a lane is not on.
static inline Vec16 bsdf_eval16(const SceneData *scene, const Bsdf16 *b, const Vec16 wi, const Mask16 on, float16 *pdf) {
  const Vec16 inner = to_local16(b, wi);
  const Mask16 lit = on & bsdf_has_smooth16(b) & same_side16(b, wi, inner.z);
  Vec16 value;
  lobes_eval16(scene, b, &inner, &lit, &value, pdf);
  return value;
}

static inline Vec16 sampled_direction16(const Bsdf16 *b, const BsdfSample16 *out) {
  const Vec16 world = to_world16(b, out->wi);
#if PENUMBRA_TRANSMISSION
  const Mask16 straight = (out->wi.x == -b->wo.x) & (out->wi.y == -b->wo.y) & (out->wi.z == -b->wo.z);
  return where16(straight, neg16(b->wo_world), world);
#else
  return world;
#endif
}

// The lanes where bsdf_sample returns true. at: points of the square.
static inline Mask16 bsdf_sample16(const SceneData *scene, const Bsdf16 *b, const float16 u_lobe, const Point16 at,
                                   const Mask16 on, Vec16 *wi, Vec16 *weight, float16 *pdf, uint16 *event) {
  BsdfSample16 out;
  Mask16 drawn;
  lobes_sample16(scene, b, &u_lobe, &at, &on, &out, &drawn);
  *wi = sampled_direction16(b, &out);
  *event = out.event;
  const Mask16 transmits = (out.event & BSDF_EVENT_TRANSMIT) != 0u;
  const Mask16 alive = drawn & same_side16(b, *wi, out.wi.z) & ~(transmits ^ (out.wi.z < 0.0f));
  const Mask16 delta = (out.event & BSDF_EVENT_DELTA) != 0u;
  const Mask16 smooth = alive & ~delta & b->smooth;
  Vec16 value;
  lobes_eval16(scene, b, &out.wi, &smooth, &value, pdf);
  const Vec16 quotient = vec16(value.x / *pdf, value.y / *pdf, value.z / *pdf);
  const Mask16 goes_on = smooth & (*pdf > 0.0f);
#if PENUMBRA_GLOSS || PENUMBRA_TRANSMISSION
  *weight = where16(delta, out.weight, quotient);
  *pdf = delta ? out.pdf : *pdf;
  return goes_on | (alive & delta);
#else
  *weight = quotient;
  return goes_on;
#endif
}

static inline Vec16 bsdf_albedo16(const SceneData *scene, const Bsdf16 *b, const Mask16 on) {
  const float16 zero = 0.0f;
  Vec16 albedo = where16(b->type == MATERIAL_BLACK, vec16(zero, zero, zero), b->color0);
#if PENUMBRA_GLOSS || PENUMBRA_TRANSMISSION
  // Of a pixel's first hit alone: one lane after the other will do.
  const Mask16 plain = LANES_WITH(MATERIAL_DIFFUSE) | LANES_WITH(MATERIAL_MIRROR) | LANES_WITH(MATERIAL_CONDUCTOR);
  for (LANES_OF(k, on & ~plain)) {
    const Bsdf bsdf = lane_bsdf(scene, b, k);
    set_lane3(&albedo, k, bsdf_albedo(&bsdf));
  }
#endif
  return albedo;
}
