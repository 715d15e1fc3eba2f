// Glass and water: an interface that reflects and refracts, perfectly (alpha 0) or by GGX microfacets (Walter et al. 2007).
// color1 tints what passes. Values are of radiance: through the interface it scales with the square of the index of
// refraction, so transmission carries 1 / eta^2 (Veach 1997, section 5.2), and f / n^2 is what is reciprocal.
// `lobe` is the probability of the lobes of several bounces.
#include "materials/compensation.cl"
#include "materials/fresnel.cl"
#include "materials/microfacet.cl"

static inline void dielectric_start(Bsdf *b) {
  b->lobe = 0.0f;
  if (!b->near_table || !b->smooth) return;
  b->missing = table_missing(b, b->near_table, b->wo);
  b->lobe = b->missing;
}

// Microfacet transmission times the cosine of wi (wi.z < 0), and its density for a certain transmission. The half vector is
// Walter et al.'s eq. 16, the Jacobian their eq. 17; masking is the separable G1 G1 of their eq. 23, since heights on the two
// sides of one interface are not correlated as those on one side are.
static inline float ggx_transmit(const Bsdf *b, const float3 wi, float *passing, float *pdf) {
  *pdf = 0.0f;
  *passing = 0.0f;
  float3 h;
  if (!half_vector(b->wo, wi * b->eta, &h)) return 0.0f;
  if (h.z < 0.0f) h = -h;
  const float ho = dot3(b->wo, h), hi = dot3(wi, h);
  if (!(ho > 0.0f && hi < 0.0f)) return 0.0f;
  float cos_t;
  *passing = 1.0f - fresnel_dielectric(ho, b->eta, &cos_t);
  const float jacobian = -hi / sqr(hi + ho / b->eta);
  *pdf = ggx_visible_pdf(b->wo, h, b->alpha_x, b->alpha_y) * jacobian;
  return *pdf * ggx_g1(wi, b->alpha_x, b->alpha_y) / (b->eta * b->eta);
}

static inline float3 dielectric_eval(const Bsdf *b, const float3 wi, float *pdf) {
  float3 value = (float3)(0.0f);
  const bool reflects = wi.z > 0.0f;
  if (reflects) {
    float3 h;
    if (!half_vector(b->wo, wi, &h)) return value;
    float cos_t;
    const float fresnel = fresnel_dielectric(dot3(b->wo, h), b->eta, &cos_t);
    value = (float3)(fresnel * ggx_reflect(b, wi, h, pdf));
    *pdf *= fresnel;
  } else {
    float passing;
    const float once = ggx_transmit(b, wi, &passing, pdf);
    value = b->color1 * (passing * once);
    *pdf *= passing;
  }
  if (b->lobe > 0.0f) {
    const __global float *table = reflects ? b->near_table : b->far_table;
    const float transmitted = b->near_table[2];
    const float share = reflects ? 1.0f - transmitted : transmitted;
    const float many = share * multiple_eval(b, table, wi);
    value += reflects ? (float3)(many) : b->color1 * (many / (b->eta * b->eta));
    *pdf = (1.0f - b->lobe) * *pdf + b->lobe * share * multiple_pdf(table, FABS(wi.z));
  }
  return value;
}

// A perfect interface. Index-matched (eta 1) it is invisible: the ray goes on, bit for bit, in its direction.
static inline bool dielectric_sample_delta(const Bsdf *b, const float u_lobe, BsdfSample *out) {
  float cos_t;
  const float fresnel = fresnel_dielectric(b->wo.z, b->eta, &cos_t);
  if (u_lobe < fresnel) {
    delta_event(out, mirror_of(b->wo), (float3)(1.0f), fresnel, 0u);
    return true;
  }
  const float3 wi = (float3)(-b->wo.x / b->eta, -b->wo.y / b->eta, -cos_t);
  delta_event(out, wi, b->color1 / (b->eta * b->eta), 1.0f - fresnel, BSDF_EVENT_TRANSMIT);
  return true;
}

static inline bool dielectric_sample(const Bsdf *b, const float u_lobe, const float2 u, BsdfSample *out) {
  if (b->alpha_x == 0.0f) return dielectric_sample_delta(b, u_lobe, out);
  if (u_lobe < b->lobe) {
    const bool transmits = reuse_below(u_lobe, b->lobe) < b->near_table[2];
    float3 wi = multiple_sample(transmits ? b->far_table : b->near_table, u);
    if (transmits) wi.z = -wi.z;
    smooth_event(out, wi);
    return true;
  }
  const float3 h = ggx_sample_visible(b->wo, b->alpha_x, b->alpha_y, u);
  const float c = dot3(b->wo, h);
  float cos_t;
  const float fresnel = fresnel_dielectric(c, b->eta, &cos_t);
  const bool reflects = reuse_above(u_lobe, b->lobe) < fresnel;
  smooth_event(out, reflects ? reflect_about(b->wo, h) : refract_about(b->wo, h, c, cos_t, b->eta));
  return reflects == (out->event == 0u);  // else it ends between the microfacets
}
