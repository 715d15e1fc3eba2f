// conductor.cl and mirror.cl in sixteen lanes.
#include "materials/compensation16.cl"
#include "materials/fresnel16.cl"
#include "materials/microfacet16.cl"

static inline Mask16 has_fresnel16(const Bsdf16 *b) { return (b->flags & MATERIAL_FLAG_FRESNEL) != 0u; }

static inline Vec16 conductor_fresnel16(const Bsdf16 *b, const float16 c) {
  return where16(has_fresnel16(b), fresnel_schlick16(b->color0, c), b->color0);
}

static inline float16 multiple_color16(const float16 f0, const Mask16 fresnel, const float16 e) {
  const float16 f = fresnel ? f0 + (1.0f - f0) * (1.0f / 21.0f) : f0;
  return f * f * e / (1.0f - f * (1.0f - e));
}

static inline Vec16 conductor_multiple_color16(const SceneData *scene, const Bsdf16 *b, const Mask16 on) {
  const float16 e = table_entry16(scene, b->near_table, 3u, on);
  const Mask16 fresnel = has_fresnel16(b);
  return vec16(multiple_color16(b->color0.x, fresnel, e), multiple_color16(b->color0.y, fresnel, e),
               multiple_color16(b->color0.z, fresnel, e));
}

static inline void conductor_start16(const SceneData *scene, const Mask16 on, Bsdf16 *b) {
  const Mask16 loses = on & (b->near_table != NONE) & b->smooth;
  if (!any16(loses)) return;
  const float16 missing = table_missing16(scene, b, b->near_table, b->wo, loses);
  const float16 many = missing * max3_16(conductor_multiple_color16(scene, b, loses));
  const float16 once = (1.0f - missing) * max3_16(conductor_fresnel16(b, b->wo.z));
  b->missing = loses ? missing : b->missing;
  b->lobe = (loses & (many > 0.0f)) ? many / (many + once) : b->lobe;
}

// The lanes that are not `on` get 0.
static inline Vec16 conductor_eval16(const SceneData *scene, const Bsdf16 *b, const Vec16 wi, const Mask16 on, float16 *pdf) {
  const float16 zero = 0.0f;
  Vec16 h;
  const Mask16 lit = on & half_vector16(b->wo, wi, &h) & ~(wi.z <= 0.0f);
  float16 density;
  const float16 once = ggx_reflect16(b, wi, h, &density);
  Vec16 value = scale16(conductor_fresnel16(b, dot16(b->wo, h)), once);
  const Mask16 many = lit & (b->lobe > 0.0f);
  if (any16(many)) {
    const float16 again = multiple_eval16(scene, b, b->near_table, wi, many);
    value = where16(many, add16(value, scale16(conductor_multiple_color16(scene, b, many), again)), value);
    const float16 broad = multiple_pdf16(scene, b->near_table, wi.z, many);
    density = many ? (1.0f - b->lobe) * density + b->lobe * broad : density;
  }
  *pdf = lit ? density : zero;
  return where16(lit, value, vec16(zero, zero, zero));
}

static inline Mask16 conductor_sample16(const SceneData *scene, const Bsdf16 *b, Point16 at, const Mask16 on, BsdfSample16 *out) {
  const Mask16 delta = on & (b->alpha_x == 0.0f), rough = on & ~delta;
  if (any16(delta)) {
    delta_event16(delta, mirror_of16(b->wo), conductor_fresnel16(b, b->wo.z), (float16)(1.0f), 0u, out);
  }
  const Mask16 many = rough & takes_lobe16(b->lobe, &at), once = rough & ~many;
  if (any16(many)) smooth_event16(many, multiple_sample16(scene, b->near_table, &at, many), out);
  if (any16(once)) {
    smooth_event16(once, reflect_about16(b->wo, ggx_sample_visible16(b->wo, b->alpha_x, b->alpha_y, &at)), out);
  }
  return delta | (rough & (out->event == 0u));
}

static inline Mask16 mirror_sample16(const Bsdf16 *b, const Mask16 on, BsdfSample16 *out) {
  delta_event16(on, mirror_of16(b->wo), b->color0, (float16)(1.0f), 0u, out);
  return on;
}
