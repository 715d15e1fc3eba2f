// thin_dielectric.cl in sixteen lanes. Its start is that of dielectric16.cl.
#include "materials/compensation16.cl"
#include "materials/fresnel16.cl"
#include "materials/microfacet16.cl"

static inline float16 sheet_reflectance16(const Bsdf16 *b, const float16 c) {
  float16 cos_t;
  const float16 r = fresnel_dielectric16(c, b->eta, &cos_t);
  return 2.0f * r / (1.0f + r);
}

// The lanes that are not `on` get 0.
static inline Vec16 thin_dielectric_eval16(const SceneData *scene, const Bsdf16 *b, const Vec16 wi, const Mask16 on,
                                           float16 *pdf) {
  const float16 zero = 0.0f, one = 1.0f;
  const Mask16 reflects = wi.z > 0.0f;
  const Vec16 up = vec16(wi.x, wi.y, abs16(wi.z));
  Vec16 h;
  const Mask16 lit = on & half_vector16(b->wo, up, &h);
  const float16 reflectance = sheet_reflectance16(b, dot16(b->wo, h));
  const float16 part = reflects ? reflectance : 1.0f - reflectance;
  float16 density;
  float16 value = part * ggx_reflect16(b, up, h, &density);
  density *= part;
  const Mask16 many = lit & (b->lobe > 0.0f);
  if (any16(many)) {
    const float16 transmitted = table_entry16(scene, b->near_table, 2u, many);
    const float16 share = reflects ? 1.0f - transmitted : transmitted;
    const float16 broad = multiple_pdf16(scene, b->near_table, up.z, many);
    value = many ? value + share * multiple_eval16(scene, b, b->near_table, up, many) : value;
    density = many ? (1.0f - b->lobe) * density + b->lobe * share * broad : density;
  }
  *pdf = lit ? density : zero;
  return scale16(where16(reflects, vec16(one, one, one), b->color1), lit ? value : zero);
}

static inline void thin_dielectric_sample_delta16(const Bsdf16 *b, const float16 u_lobe, const Mask16 on, BsdfSample16 *out) {
  const float16 reflectance = sheet_reflectance16(b, b->wo.z), one = 1.0f;
  const Mask16 reflects = u_lobe < reflectance;
  delta_event16(on & reflects, mirror_of16(b->wo), vec16(one, one, one), reflectance, 0u, out);
  delta_event16(on & ~reflects, neg16(b->wo), b->color1, 1.0f - reflectance, BSDF_EVENT_TRANSMIT, out);
}

static inline Mask16 thin_dielectric_sample16(const SceneData *scene, const Bsdf16 *b, const float16 u_lobe,
                                              const Point16 *at, const Mask16 on, BsdfSample16 *out) {
  const Mask16 delta = on & (b->alpha_x == 0.0f), rough = on & ~delta;
  if (any16(delta)) thin_dielectric_sample_delta16(b, u_lobe, delta, out);
  const Mask16 many = rough & (u_lobe < b->lobe), once = rough & ~many;
  Mask16 alive = delta | many;
  if (any16(many)) {
    Vec16 wi = multiple_sample16(scene, b->near_table, at, many);
    const Mask16 transmits = reuse_below16(u_lobe, b->lobe) < table_entry16(scene, b->near_table, 2u, many);
    wi.z = transmits ? -wi.z : wi.z;
    smooth_event16(many, wi, out);
  }
  if (any16(once)) {
    const Vec16 h = ggx_sample_visible16(b->wo, b->alpha_x, b->alpha_y, at);
    Vec16 wi = reflect_about16(b->wo, h);
    alive |= once & ~(wi.z <= 0.0f);
    const Mask16 transmits = reuse_above16(u_lobe, b->lobe) >= sheet_reflectance16(b, dot16(b->wo, h));
    wi.z = transmits ? -wi.z : wi.z;
    smooth_event16(once, wi, out);
  }
  return alive;
}
