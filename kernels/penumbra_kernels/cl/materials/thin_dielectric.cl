// A thin sheet with two parallel faces: light passes without being bent. With R the reflectance of one face, all reflections
// between the faces sum to R' = 2 R / (1 + R) and 1 - R' passes, tinted by color1. A rough sheet blurs both: microfacets
// reflect with R', and what passes is the mirror image of what is reflected, below the surface, so that roughness means the
// same width for both. `lobe` is the probability of the lobes of several bounces.
#include "materials/compensation.cl"
#include "materials/fresnel.cl"
#include "materials/microfacet.cl"

static inline float sheet_reflectance(const Bsdf *b, const float c) {
  float cos_t;
  const float r = fresnel_dielectric(c, b->eta, &cos_t);
  return 2.0f * r / (1.0f + r);
}

static inline void thin_dielectric_start(Bsdf *b) {
  b->lobe = 0.0f;
  if (!b->near_table || !b->smooth) return;
  b->missing = table_missing(b, b->near_table, b->wo);
  b->lobe = b->missing;
}

static inline float3 thin_dielectric_eval(const Bsdf *b, const float3 wi, float *pdf) {
  const bool reflects = wi.z > 0.0f;
  const float3 up = (float3)(wi.x, wi.y, FABS(wi.z));
  float3 h;
  if (!half_vector(b->wo, up, &h)) return (float3)(0.0f);
  const float reflectance = sheet_reflectance(b, dot3(b->wo, h));
  const float part = reflects ? reflectance : 1.0f - reflectance;
  float value = part * ggx_reflect(b, up, h, pdf);
  *pdf *= part;
  if (b->lobe > 0.0f) {
    const float share = reflects ? 1.0f - b->near_table[2] : b->near_table[2];
    value += share * multiple_eval(b, b->near_table, up);
    *pdf = (1.0f - b->lobe) * *pdf + b->lobe * share * multiple_pdf(b->near_table, up.z);
  }
  return (reflects ? (float3)(1.0f) : b->color1) * value;
}

static inline bool thin_dielectric_sample(const Bsdf *b, const float u_lobe, const float2 u, BsdfSample *out) {
  if (b->alpha_x == 0.0f) {
    const float reflectance = sheet_reflectance(b, b->wo.z);
    if (u_lobe < reflectance) delta_event(out, mirror_of(b->wo), (float3)(1.0f), reflectance, 0u);
    else delta_event(out, -b->wo, b->color1, 1.0f - reflectance, BSDF_EVENT_TRANSMIT);
    return true;
  }
  float3 wi;
  bool transmits;
  if (u_lobe < b->lobe) {
    wi = multiple_sample(b->near_table, u);
    transmits = reuse_below(u_lobe, b->lobe) < b->near_table[2];
  } else {
    const float3 h = ggx_sample_visible(b->wo, b->alpha_x, b->alpha_y, u);
    wi = reflect_about(b->wo, h);
    if (wi.z <= 0.0f) return false;
    transmits = reuse_above(u_lobe, b->lobe) >= sheet_reflectance(b, dot3(b->wo, h));
  }
  if (transmits) wi.z = -wi.z;
  smooth_event(out, wi);
  return true;
}
