// A diffuse base under a dielectric coat of GGX microfacets (perfectly smooth for alpha 0). The coat lets T(w) = 1 - R(w) of
// the light from direction w pass to the base and back, R its albedo; the base is color0 / pi times T(wo) T(wi) / mean T, which
// with a white base gives back just what the coat does not reflect (the coupling of Kelemen and Szirmay-Kalos 2001, with
// the coat's own albedo). Reciprocal, and 1 in a white furnace.
// `lobe` is the probability of the coat. T is tabulated in the layout of compensation.cl, its rows right after the header.
#include "materials/compensation.cl"
#include "materials/fresnel.cl"
#include "materials/microfacet.cl"

// Share of light from direction w that passes the coat.
static inline float coat_transmittance(const Bsdf *b, const float3 w) {
  if (b->alpha_x > 0.0f) return table_lookup(b->near_table, b->near_table + ALBEDO_HEADER, is_anisotropic(b), w);
  float cos_t;
  return 1.0f - fresnel_dielectric(w.z, b->eta, &cos_t);
}

static inline void plastic_start(Bsdf *b) {
  const float passing = coat_transmittance(b, b->wo);
  b->missing = passing * b->near_table[1];  // T(wo) / mean T
  const float coat = 1.0f - passing, base = passing * max3(b->color0);
  b->lobe = coat + base > 0.0f ? coat / (coat + base) : 1.0f;
}

static inline float3 plastic_eval(const Bsdf *b, const float3 wi, float *pdf) {
  if (wi.z <= 0.0f) return (float3)(0.0f);
  const float cosine = wi.z * INV_PI_F;
  float3 value = b->color0 * (b->missing * coat_transmittance(b, wi) * cosine);
  *pdf = (1.0f - b->lobe) * cosine;
  float3 h;
  if (b->alpha_x > 0.0f && half_vector(b->wo, wi, &h)) {
    float cos_t, coat_pdf;
    const float coat = ggx_reflect(b, wi, h, &coat_pdf);
    value += (float3)(coat * fresnel_dielectric(dot3(b->wo, h), b->eta, &cos_t));
    *pdf += b->lobe * coat_pdf;
  }
  return value;
}

static inline bool plastic_sample(const Bsdf *b, float2 u, BsdfSample *out) {
  if (!takes_lobe(b->lobe, &u)) {
    smooth_event(out, cosine_direction(u));
    return true;
  }
  if (b->alpha_x == 0.0f) {
    float cos_t;
    const float fresnel = fresnel_dielectric(b->wo.z, b->eta, &cos_t);
    delta_event(out, mirror_of(b->wo), (float3)(fresnel / b->lobe), b->lobe, 0u);
    return true;
  }
  smooth_event(out, reflect_about(b->wo, ggx_sample_visible(b->wo, b->alpha_x, b->alpha_y, u)));
  return out->event == 0u;
}
