// A metal: GGX microfacets with Schlick's Fresnel between color0 and white (or color0 at every angle), and the light of
// several bounces between them. `lobe` is the probability of the lobe of several bounces.
#include "materials/compensation.cl"
#include "materials/fresnel.cl"
#include "materials/microfacet.cl"

static inline float3 conductor_fresnel(const Bsdf *b, const float c) {
  return (b->flags & MATERIAL_FLAG_FRESNEL) ? fresnel_schlick(b->color0, c) : b->color0;
}

// Colour of light after two bounces and more, with F the mean Fresnel and E the mean albedo of one bounce:
// F^2 E / (1 - F (1 - E)) (Kulla and Conty 2017). Schlick's mean is f0 + (1 - f0) / 21.
static inline float3 conductor_multiple_color(const Bsdf *b) {
  const float e = b->near_table[3];
  float3 f = b->color0;
  if (b->flags & MATERIAL_FLAG_FRESNEL) f += ((float3)(1.0f) - f) * (1.0f / 21.0f);
  return f * f * e / ((float3)(1.0f) - f * (1.0f - e));
}

static inline void conductor_start(Bsdf *b) {
  b->lobe = 0.0f;
  if (!b->near_table || !b->smooth) return;
  b->missing = table_missing(b, b->near_table, b->wo);
  const float many = b->missing * max3(conductor_multiple_color(b));
  const float once = (1.0f - b->missing) * max3(conductor_fresnel(b, b->wo.z));
  b->lobe = many > 0.0f ? many / (many + once) : 0.0f;
}

static inline float3 conductor_eval(const Bsdf *b, const float3 wi, float *pdf) {
  float3 h;
  if (wi.z <= 0.0f || !half_vector(b->wo, wi, &h)) return (float3)(0.0f);
  const float once = ggx_reflect(b, wi, h, pdf);
  float3 value = conductor_fresnel(b, dot3(b->wo, h)) * once;
  if (b->lobe > 0.0f) {
    value += conductor_multiple_color(b) * multiple_eval(b, b->near_table, wi);
    *pdf = (1.0f - b->lobe) * *pdf + b->lobe * multiple_pdf(b->near_table, wi.z);
  }
  return value;
}

static inline bool conductor_sample(const Bsdf *b, float2 u, BsdfSample *out) {
  if (b->alpha_x == 0.0f) {
    delta_event(out, mirror_of(b->wo), conductor_fresnel(b, b->wo.z), 1.0f, 0u);
    return true;
  }
  if (takes_lobe(b->lobe, &u)) smooth_event(out, multiple_sample(b->near_table, u));
  else smooth_event(out, reflect_about(b->wo, ggx_sample_visible(b->wo, b->alpha_x, b->alpha_y, u)));
  return out->event == 0u;
}
