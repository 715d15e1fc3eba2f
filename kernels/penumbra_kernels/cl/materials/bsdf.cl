// What a surface does with light: one interface over all materials. Directions are unit, in the world frame, and point away
// from the surface; values are f times the cosine of wi, radiance towards wo per radiance from wi.
//   bsdf_start       looks textures up, builds the frame, decides the lobes' probabilities
//   bsdf_eval        all smooth lobes, and the density with which bsdf_sample draws wi from them
//   bsdf_sample      a direction; false where the light ends. Smooth lobes: weight = value / density of all of them together;
//                    delta lobes: BSDF_EVENT_DELTA, pdf their discrete probability, weight already divided by it
//   bsdf_has_smooth  whether bsdf_eval can be anything but 0
//   bsdf_is_wide     whether none of its smooth lobes is narrow
//   bsdf_transmits   whether it can be for a wi on the far side
//   bsdf_albedo      reflectance and transmittance towards wo, about: for the albedo layer
//
// Sides. Reflection needs both directions above the geometric and the shading normal, transmission wi below both: whatever a
// shading normal bends through the surface is absorbed, and f(wo, wi) and f(wi, wo) agree. A viewer behind the shading normal
// meets the geometric one in its place, for delta lobes alone.
// This file gates materials by effect; what remains computes the same bits whatever else is there.
// A file's first #include is the only one that counts, whether or not an #if leaves it out: so what several files share is
// included here, outside or in the wider of their conditions, before those that need it.
#include "base/transcendental.cl"
#include "materials/bsdf.h"
#include "materials/diffuse.cl"
#if PENUMBRA_TEXTURES
#include "materials/texture.cl"
#endif
#if PENUMBRA_GLOSS || PENUMBRA_TRANSMISSION
#include "materials/compensation.cl"
#include "materials/fresnel.cl"
#include "materials/microfacet.cl"
#endif
#if PENUMBRA_GLOSS
#include "materials/conductor.cl"
#include "materials/mirror.cl"
#include "materials/phong.cl"
#include "materials/plastic.cl"
#endif
#if PENUMBRA_TRANSMISSION
#include "materials/dielectric.cl"
#include "materials/diffuse_transmission.cl"
#include "materials/thin_dielectric.cl"
#endif

// Turns the axes by an angle in [0, 2 pi) about the normal.
static inline void rotate_axes(const float angle, float3 *s, float3 *t) {
  float sine, cosine;
  sincos_2pi(MIN(angle * INV_2PI_F, 1.0f), &sine, &cosine);
  const float3 turned = *s * cosine + *t * sine;
  *t = *t * cosine - *s * sine;
  *s = turned;
}

static inline void bsdf_frame(const Surface *surface, const float3 wo, const float rotation, Bsdf *b) {
  const float side = dot3(wo, surface->ng) < 0.0f ? -1.0f : 1.0f;
  b->ng = surface->ng * side;
  b->n = surface->ns * side;
  b->s = surface->tangent;
  b->t = cross3(b->n, b->s);
  b->smooth = dot3(wo, b->n) > 0.0f;
  if (!b->smooth) {
    b->n = b->ng;
    make_frame(b->n, &b->s, &b->t);
  } else if (rotation != 0.0f) {
    rotate_axes(side * rotation < 0.0f ? 2.0f * PI_F - rotation : rotation, &b->s, &b->t);
  }
  b->wo_world = wo;
  b->wo = to_local(b, wo);
}

static inline void bsdf_colors(const SceneData *scene, const __global Material *material, const float2 uv, Bsdf *b) {
  b->color0 = load3(material->color0);
  b->color1 = load3(material->color1);
#if PENUMBRA_TEXTURES
  if (material->texture0 != NONE) b->color0 = texture_lookup(scene, material->texture0, uv);
  if (material->texture1 != NONE) b->color1 = texture_lookup(scene, material->texture1, uv);
#endif
}

// Everything that only microfacets, cones and interfaces need.
#if PENUMBRA_GLOSS || PENUMBRA_TRANSMISSION
static inline void bsdf_gloss(const SceneData *scene, const __global Material *material, const bool outside, Bsdf *b) {
  b->alpha_x = material->alpha_x;
  b->alpha_y = material->alpha_y;
  b->exponent = material->exponent;
  b->eta = material->ior;
  b->near_table = b->far_table = 0;
  if (material->albedo != NONE) {
    b->near_table = scene->albedo_table + material->albedo;
    b->far_table = b->type == MATERIAL_DIELECTRIC ? b->near_table + table_size(b) : b->near_table;
  }
  if (outside || b->type != MATERIAL_DIELECTRIC) return;
  b->eta = 1.0f / material->ior;
  const __global float *inner = b->far_table;
  b->far_table = b->near_table;
  b->near_table = inner;
}
#endif

// wo need not face the surface: the material is seen from whichever side wo is on.
static inline void bsdf_start(const SceneData *scene, const Surface *surface, const float3 wo, Bsdf *b) {
  const __global Material *material = scene->materials + scene->shapes[surface->shape].material;
  b->type = material->type;
  b->flags = material->flags;
  bsdf_frame(surface, wo, material->rotation, b);
  bsdf_colors(scene, material, surface->uv, b);
#if PENUMBRA_GLOSS || PENUMBRA_TRANSMISSION
  bsdf_gloss(scene, material, dot3(wo, surface->ng) >= 0.0f, b);
#endif
#if PENUMBRA_GLOSS
  if (b->type == MATERIAL_PHONG) phong_start(b);
  if (b->type == MATERIAL_CONDUCTOR) conductor_start(b);
  if (b->type == MATERIAL_PLASTIC) plastic_start(b);
#endif
#if PENUMBRA_TRANSMISSION
  if (b->type == MATERIAL_DIELECTRIC) dielectric_start(b);
  if (b->type == MATERIAL_THIN_DIELECTRIC) thin_dielectric_start(b);
  if (b->type == MATERIAL_DIFFUSE_TRANSMISSION) diffuse_transmission_start(b);
#endif
}

// Whether bsdf_sample asks for u: mirrors and clear panes send light on in directions that they have already.
static inline bool bsdf_has_spread(const Bsdf *b) {
#if PENUMBRA_GLOSS || PENUMBRA_TRANSMISSION
  if (b->type == MATERIAL_MIRROR) return false;
  if (b->type == MATERIAL_CONDUCTOR || b->type == MATERIAL_DIELECTRIC || b->type == MATERIAL_THIN_DIELECTRIC) {
    return b->alpha_x > 0.0f;
  }
#endif
  return true;
}

static inline bool bsdf_has_smooth(const Bsdf *b) {
  return b->smooth && b->type != MATERIAL_BLACK && bsdf_has_spread(b);
}

// Whether light from behind the surface can count; if not, wi has to lie above the shading normal (and the geometric one).
static inline bool bsdf_transmits(const Bsdf *b) {
#if PENUMBRA_TRANSMISSION
  return b->type == MATERIAL_DIELECTRIC || b->type == MATERIAL_THIN_DIELECTRIC || b->type == MATERIAL_DIFFUSE_TRANSMISSION;
#else
  return false;
#endif
}

// Whether bsdf_sample asks for u_lobe: interfaces do, which have no direction yet where they choose, or a microfacet already.
// All others choose by u (takes_lobe).
static inline bool bsdf_has_lobes(const Bsdf *b) {
#if PENUMBRA_TRANSMISSION
  return b->type == MATERIAL_DIELECTRIC || b->type == MATERIAL_THIN_DIELECTRIC;
#else
  return false;
#endif
}

// Whether every smooth lobe is about as wide as a hemisphere.
static inline bool bsdf_is_wide(const Bsdf *b) {
#if PENUMBRA_GLOSS || PENUMBRA_TRANSMISSION
  return b->type == MATERIAL_DIFFUSE || b->type == MATERIAL_DIFFUSE_TRANSMISSION;
#else
  return true;
#endif
}

// All smooth lobes for a local wi, on whichever side it is.
static inline float3 lobes_eval(const Bsdf *b, const float3 wi, float *pdf) {
  *pdf = 0.0f;
  if (b->type == MATERIAL_DIFFUSE) return diffuse_eval(b, wi, pdf);
#if PENUMBRA_GLOSS
  if (b->type == MATERIAL_PHONG) return phong_eval(b, wi, pdf);
  if (b->type == MATERIAL_CONDUCTOR) return conductor_eval(b, wi, pdf);
  if (b->type == MATERIAL_PLASTIC) return plastic_eval(b, wi, pdf);
#endif
#if PENUMBRA_TRANSMISSION
  if (b->type == MATERIAL_DIELECTRIC) return dielectric_eval(b, wi, pdf);
  if (b->type == MATERIAL_THIN_DIELECTRIC) return thin_dielectric_eval(b, wi, pdf);
  if (b->type == MATERIAL_DIFFUSE_TRANSMISSION) return diffuse_transmission_eval(b, wi, pdf);
#endif
  return (float3)(0.0f);
}

static inline bool lobes_sample(const Bsdf *b, const float u_lobe, const float2 u, BsdfSample *out) {
  if (b->type == MATERIAL_DIFFUSE) return diffuse_sample(u, out);
#if PENUMBRA_GLOSS
  if (b->type == MATERIAL_PHONG) return phong_sample(b, u, out);
  if (b->type == MATERIAL_MIRROR) return mirror_sample(b, out);
  if (b->type == MATERIAL_CONDUCTOR) return conductor_sample(b, u, out);
  if (b->type == MATERIAL_PLASTIC) return plastic_sample(b, u, out);
#endif
#if PENUMBRA_TRANSMISSION
  if (b->type == MATERIAL_DIELECTRIC) return dielectric_sample(b, u_lobe, u, out);
  if (b->type == MATERIAL_THIN_DIELECTRIC) return thin_dielectric_sample(b, u_lobe, u, out);
  if (b->type == MATERIAL_DIFFUSE_TRANSMISSION) return diffuse_transmission_sample(b, u, out);
#endif
  return false;
}

// Whether wi lies on one side of both normals: above for reflection, below for transmission.
static inline bool same_side(const Bsdf *b, const float3 wi, const float local_z) {
  const float geometric = dot3(wi, b->ng);
  return (geometric > 0.0f && local_z > 0.0f) || (geometric < 0.0f && local_z < 0.0f);
}

static inline float3 bsdf_eval(const Bsdf *b, const float3 wi, float *pdf) {
  *pdf = 0.0f;
  if (!bsdf_has_smooth(b)) return (float3)(0.0f);
  const float3 inner = to_local(b, wi);
  if (!same_side(b, wi, inner.z)) return (float3)(0.0f);
  return lobes_eval(b, inner, pdf);
}

// A delta transmission straight on keeps the viewer's direction bit for bit.
static inline float3 sampled_direction(const Bsdf *b, const BsdfSample *out) {
  const bool straight = out->wi.x == -b->wo.x && out->wi.y == -b->wo.y && out->wi.z == -b->wo.z;
  return straight ? -b->wo_world : to_world(b, out->wi);
}

static inline bool bsdf_sample(const Bsdf *b, const float u_lobe, const float2 u, float3 *wi, float3 *weight,
                               float *pdf, uint *event) {
  BsdfSample out;
  if (!lobes_sample(b, u_lobe, u, &out)) return false;
  *wi = sampled_direction(b, &out);
  *event = out.event;
  const bool transmits = (out.event & BSDF_EVENT_TRANSMIT) != 0u;
  if (!same_side(b, *wi, out.wi.z) || transmits != (out.wi.z < 0.0f)) return false;
  if (out.event & BSDF_EVENT_DELTA) {
    *weight = out.weight;
    *pdf = out.pdf;
    return true;
  }
  if (!b->smooth) return false;
  const float3 value = lobes_eval(b, out.wi, pdf);
  if (!(*pdf > 0.0f)) return false;
  *weight = (float3)(value.x / *pdf, value.y / *pdf, value.z / *pdf);
  return true;
}

static inline float3 bsdf_albedo(const Bsdf *b) {
  if (b->type == MATERIAL_BLACK) return (float3)(0.0f);
#if PENUMBRA_GLOSS
  if (b->type == MATERIAL_PHONG) return b->color0 + b->color1;
  if (b->type == MATERIAL_PLASTIC) {
    const float passing = coat_transmittance(b, b->wo);
    return (float3)(1.0f - passing) + b->color0 * passing;
  }
#endif
#if PENUMBRA_TRANSMISSION
  if (b->type == MATERIAL_DIFFUSE_TRANSMISSION) return b->color0 + b->color1;
  if (b->type == MATERIAL_DIELECTRIC) {
    float cos_t;
    const float fresnel = fresnel_dielectric(FABS(b->wo.z), b->eta, &cos_t);
    return (float3)(fresnel) + b->color1 * (1.0f - fresnel);
  }
  if (b->type == MATERIAL_THIN_DIELECTRIC) {
    const float reflectance = sheet_reflectance(b, FABS(b->wo.z));
    return (float3)(reflectance) + b->color1 * (1.0f - reflectance);
  }
#endif
  return b->color0;
}
