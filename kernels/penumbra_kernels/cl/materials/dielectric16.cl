// dielectric.cl in sixteen lanes.
#include "materials/compensation16.cl"
#include "materials/fresnel16.cl"
#include "materials/microfacet16.cl"

static inline void dielectric_start16(const SceneData *scene, const Mask16 on, Bsdf16 *b) {
  const Mask16 loses = on & (b->near_table != NONE) & b->smooth;
  if (!any16(loses)) return;
  const float16 missing = table_missing16(scene, b, b->near_table, b->wo, loses);
  b->missing = loses ? missing : b->missing;
  b->lobe = loses ? missing : b->lobe;
}

static inline float16 ggx_transmit16(const Bsdf16 *b, const Vec16 wi, float16 *passing, float16 *pdf) {
  const float16 zero = 0.0f;
  Vec16 sum;
  Mask16 lit = half_vector16(b->wo, scale16(wi, b->eta), &sum);
  const Vec16 h = where16(sum.z < 0.0f, neg16(sum), sum);
  const float16 ho = dot16(b->wo, h), hi = dot16(wi, h);
  lit &= (ho > 0.0f) & (hi < 0.0f);
  float16 cos_t;
  *passing = lit ? 1.0f - fresnel_dielectric16(ho, b->eta, &cos_t) : zero;
  const float16 jacobian = -hi / sqr16(hi + ho / b->eta);
  *pdf = lit ? ggx_visible_pdf16(b->wo, h, b->alpha_x, b->alpha_y) * jacobian : zero;
  return lit ? *pdf * ggx_g1_16(wi, b->alpha_x, b->alpha_y) / (b->eta * b->eta) : zero;
}

// The lobes of several bounces: adds them where there are any.
static inline void dielectric_many16(const SceneData *scene, const Bsdf16 *b, const Vec16 wi, const Mask16 on, Vec16 *value,
                                     float16 *pdf) {
  const Mask16 reflects = wi.z > 0.0f;
  const uint16 table = reflects ? b->near_table : b->far_table;
  const float16 transmitted = table_entry16(scene, b->near_table, 2u, on);
  const float16 share = reflects ? 1.0f - transmitted : transmitted;
  const float16 many = share * multiple_eval16(scene, b, table, wi, on);
  const Vec16 passed = scale16(b->color1, many / (b->eta * b->eta));
  *value = where16(on, add16(*value, where16(reflects, vec16(many, many, many), passed)), *value);
  const float16 broad = multiple_pdf16(scene, table, abs16(wi.z), on);
  *pdf = on ? (1.0f - b->lobe) * *pdf + b->lobe * share * broad : *pdf;
}

// The lanes that are not `on` get 0.
static inline Vec16 dielectric_eval16(const SceneData *scene, const Bsdf16 *b, const Vec16 wi, const Mask16 on, float16 *pdf) {
  const float16 zero = 0.0f;
  Vec16 value = vec16(zero, zero, zero);
  *pdf = zero;
  const Mask16 up = on & (wi.z > 0.0f), down = on & ~up;
  Mask16 lit = down;
  if (any16(up)) {
    Vec16 h;
    float16 cos_t, density;
    const Mask16 has = up & half_vector16(b->wo, wi, &h);
    const float16 fresnel = fresnel_dielectric16(dot16(b->wo, h), b->eta, &cos_t);
    const float16 once = fresnel * ggx_reflect16(b, wi, h, &density);
    value = where16(has, vec16(once, once, once), value);
    *pdf = has ? density * fresnel : *pdf;
    lit |= has;
  }
  if (any16(down)) {
    float16 passing, density;
    const float16 once = ggx_transmit16(b, wi, &passing, &density);
    value = where16(down, scale16(b->color1, passing * once), value);
    *pdf = down ? density * passing : *pdf;
  }
  const Mask16 many = lit & (b->lobe > 0.0f);
  if (any16(many)) dielectric_many16(scene, b, wi, many, &value, pdf);
  return value;
}

static inline void dielectric_sample_delta16(const Bsdf16 *b, const float16 u_lobe, const Mask16 on, BsdfSample16 *out) {
  float16 cos_t;
  const float16 fresnel = fresnel_dielectric16(b->wo.z, b->eta, &cos_t), one = 1.0f;
  const Mask16 reflects = u_lobe < fresnel;
  delta_event16(on & reflects, mirror_of16(b->wo), vec16(one, one, one), fresnel, 0u, out);
  const float16 eta2 = b->eta * b->eta;
  const Vec16 wi = vec16(-b->wo.x / b->eta, -b->wo.y / b->eta, -cos_t);
  const Vec16 weight = vec16(b->color1.x / eta2, b->color1.y / eta2, b->color1.z / eta2);
  delta_event16(on & ~reflects, wi, weight, 1.0f - fresnel, BSDF_EVENT_TRANSMIT, out);
}

static inline Mask16 dielectric_sample16(const SceneData *scene, const Bsdf16 *b, const float16 u_lobe, const Point16 *at,
                                         const Mask16 on, BsdfSample16 *out) {
  const Mask16 delta = on & (b->alpha_x == 0.0f), rough = on & ~delta;
  Mask16 alive = delta;
  if (any16(delta)) dielectric_sample_delta16(b, u_lobe, delta, out);
  const Mask16 many = rough & (u_lobe < b->lobe), once = rough & ~many;
  if (any16(many)) {
    const Mask16 transmits = reuse_below16(u_lobe, b->lobe) < table_entry16(scene, b->near_table, 2u, many);
    Vec16 wi = multiple_sample16(scene, transmits ? b->far_table : b->near_table, at, many);
    wi.z = transmits ? -wi.z : wi.z;
    smooth_event16(many, wi, out);
    alive |= many;
  }
  if (any16(once)) {
    const Vec16 h = ggx_sample_visible16(b->wo, b->alpha_x, b->alpha_y, at);
    const float16 c = dot16(b->wo, h);
    float16 cos_t;
    const float16 fresnel = fresnel_dielectric16(c, b->eta, &cos_t);
    const Mask16 reflects = reuse_above16(u_lobe, b->lobe) < fresnel;
    const Vec16 passed = refract_about16(b->wo, h, c, cos_t, b->eta);
    smooth_event16(once, where16(reflects, reflect_about16(b->wo, h), passed), out);
    alive |= once & ~(reflects ^ (out->event == 0u));
  }
  return alive;
}
