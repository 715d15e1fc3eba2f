// plastic.cl in sixteen lanes.
#include "materials/compensation16.cl"
#include "materials/fresnel16.cl"
#include "materials/microfacet16.cl"

static inline float16 coat_transmittance16(const SceneData *scene, const Bsdf16 *b, const Vec16 w, const Mask16 on) {
  const Mask16 rough = on & (b->alpha_x > 0.0f);
  float16 cos_t;
  float16 passing = 1.0f - fresnel_dielectric16(w.z, b->eta, &cos_t);
  if (any16(rough)) {
    const float16 tabulated = table_lookup16(scene, b, b->near_table, ALBEDO_HEADER, w, rough);
    passing = rough ? tabulated : passing;
  }
  return passing;
}

static inline void plastic_start16(const SceneData *scene, const Mask16 on, Bsdf16 *b) {
  const float16 passing = coat_transmittance16(scene, b, b->wo, on);
  const float16 mean = table_entry16(scene, b->near_table, 1u, on);
  const float16 coat = 1.0f - passing, base = passing * max3_16(b->color0), one = 1.0f;
  const float16 share = coat + base > 0.0f ? coat / (coat + base) : one;
  b->missing = on ? passing * mean : b->missing;
  b->lobe = on ? share : b->lobe;
}

static inline Vec16 plastic_eval16(const SceneData *scene, const Bsdf16 *b, const Vec16 wi, const Mask16 on, float16 *pdf) {
  const float16 zero = 0.0f;
  const float16 cosine = wi.z * INV_PI_F;
  const Mask16 lit = on & ~(wi.z <= 0.0f);
  Vec16 value = scale16(b->color0, b->missing * coat_transmittance16(scene, b, wi, on) * cosine);
  float16 density = (1.0f - b->lobe) * cosine;
  const Mask16 rough = lit & (b->alpha_x > 0.0f);
  if (any16(rough)) {
    Vec16 h;
    float16 cos_t, coat_pdf;
    const Mask16 has = rough & half_vector16(b->wo, wi, &h);
    const float16 coat = ggx_reflect16(b, wi, h, &coat_pdf);
    const float16 reflected = coat * fresnel_dielectric16(dot16(b->wo, h), b->eta, &cos_t);
    value = where16(has, add16(value, vec16(reflected, reflected, reflected)), value);
    density = has ? density + b->lobe * coat_pdf : density;
  }
  *pdf = lit ? density : zero;
  return where16(lit, value, vec16(zero, zero, zero));
}

static inline Mask16 plastic_sample16(const Bsdf16 *b, Point16 at, const Mask16 on, BsdfSample16 *out) {
  const Mask16 coat = on & takes_lobe16(b->lobe, &at), base = on & ~coat;
  const Mask16 clear = coat & (b->alpha_x == 0.0f), rough = coat & ~clear;
  if (any16(base)) smooth_event16(base, cosine_direction16(&at), out);
  if (any16(clear)) {
    float16 cos_t;
    const float16 share = fresnel_dielectric16(b->wo.z, b->eta, &cos_t) / b->lobe;
    delta_event16(clear, mirror_of16(b->wo), vec16(share, share, share), b->lobe, 0u, out);
  }
  if (any16(rough)) {
    smooth_event16(rough, reflect_about16(b->wo, ggx_sample_visible16(b->wo, b->alpha_x, b->alpha_y, &at)), out);
  }
  return base | clear | (rough & (out->event == 0u));
}
