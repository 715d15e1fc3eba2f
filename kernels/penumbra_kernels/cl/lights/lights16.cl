// The functions of lights/lights.cl for sixteen lanes, each with the bits of the scalar function. A light is the same in all lanes
// of a call: callers go through the distinct ones. Still quads and spheres and the constant environment are taken together; every
// other kind of light, and those that instances carry, lane by lane.
#include "lights/lights.cl"
#include "lights/quad16.cl"
#include "lights/sphere16.cl"
#include "lights/environment16.cl"

#if PENUMBRA_AREA_LIGHTS
static inline bool light_is_carried(const __global Light *light) {
#if PENUMBRA_INSTANCING
  return light->instance != NONE;
#else
  return false;
#endif
}

// Whether the type's functions of sixteen lanes serve a light.
static inline bool is_quad16(const __global Light *light) { return light->type == LIGHT_QUAD && !light_is_carried(light); }
static inline bool is_sphere16(const __global Light *light) {
#if PENUMBRA_LIGHT_AREA_SAMPLING
  return false;
#else
  return light->type == LIGHT_SPHERE && !light_is_carried(light);
#endif
}
#endif

// Kinds of light that are taken lane by lane.
#if PENUMBRA_INSTANCING
#define LONE_KINDS EVERY_KIND
#elif PENUMBRA_LIGHT_AREA_SAMPLING
#define LONE_KINDS (EVERY_KIND & ~(1u << LIGHT_QUAD))
#else
#define LONE_KINDS (EVERY_KIND & ~(1u << LIGHT_QUAD) & ~(1u << LIGHT_SPHERE))
#endif

#if PENUMBRA_AREA_LIGHTS || PENUMBRA_DELTA_LIGHTS || PENUMBRA_ENVIRONMENT_IMAGE
static PENUMBRA_NOINLINE PENUMBRA_WIDE Mask16 light_sample_each(const SceneData *scene, const uint light,
                                                                const Receiver16 *receiver, const float16 *time,
                                                                const float16 *u_triangle, const float16 *ux,
                                                                const float16 *uy, const Mask16 *on, LightSample16 *out) {
  Mask16 given = 0;
  for (LANES_OF(k, *on)) {
    const Receiver lit = lane_receiver(receiver, k);
    const float2 u = (float2)(LANE_F(*ux, k), LANE_F(*uy, k));
    LightSample sample;
    if (!light_sample_of(scene, light, LONE_KINDS, &lit, LANE_F(*time, k), LANE_F(*u_triangle, k), u, &sample)) continue;
    LANE_I(given, k) = -1;
    set_lane_light_sample(out, k, &sample);
  }
  return given;
}
#endif

// light_sample of the lanes of `on`. The lanes in which it returns true: only these are whole in *out. *delta is LightSample's,
// which is the same in all of them.
static inline Mask16 light_sample16(const SceneData *scene, const uint light, const Receiver16 *receiver, const float16 time,
                                    const float16 u_triangle, const float16 ux, const float16 uy, const Mask16 on,
                                    LightSample16 *out, bool *delta) {
  *delta = !light_has_extent(scene, light);
#if PENUMBRA_AREA_LIGHTS || PENUMBRA_DELTA_LIGHTS || PENUMBRA_ENVIRONMENT
  const __global Light *record = scene->lights + light;
#endif
#if PENUMBRA_ENVIRONMENT
  if (record->type == LIGHT_ENVIRONMENT && !environment_is_image(record))
    return environment_sample16(record, receiver->n, ux, uy, on, out);
#endif
#if PENUMBRA_AREA_LIGHTS
  if (is_quad16(record) || is_sphere16(record)) out->radiance = all16(load3(record->radiance));
  if (is_quad16(record)) return quad_light_sample16(record, receiver->p, ux, uy, on, out);
  if (is_sphere16(record)) return sphere_light_sample16(record, receiver->p, ux, uy, on, out);
#endif
#if PENUMBRA_AREA_LIGHTS || PENUMBRA_DELTA_LIGHTS || PENUMBRA_ENVIRONMENT_IMAGE
  return light_sample_each(scene, light, receiver, &time, &u_triangle, &ux, &uy, &on, out);
#else
  return (Mask16)(0);
#endif
}

// light_emitted of lanes on surfaces of a light.
static inline Vec16 light_emitted16(const SceneData *scene, const uint light, const Vec16 ng, const Vec16 wo, const Mask16 on) {
#if PENUMBRA_AREA_LIGHTS
  const __global Light *record = scene->lights + light;
  const Vec16 radiance = all16(load3(record->radiance));
  if (record->flags & LIGHT_TWO_SIDED) return radiance;
  return where16(dot16(ng, wo) > 0.0f, radiance, all16((float3)(0.0f)));
#else
  return all16((float3)(0.0f));
#endif
}

#if PENUMBRA_AREA_LIGHTS
static PENUMBRA_NOINLINE PENUMBRA_WIDE void light_hit_pdf_each(const SceneData *scene, const uint light, const Vec16 *p,
                                                               const Vec16 *ng, const uint16 *primitive, const Vec16 *wi,
                                                               const float16 *distance, const float16 *time,
                                                               const Mask16 *on, float16 *pdf) {
  for (LANES_OF(k, *on))
    LANE_F(*pdf, k) = light_hit_pdf_of(scene, light, LONE_KINDS, lane3(p, k), lane3(ng, k), LANE_U(*primitive, k), lane3(wi, k),
                                       LANE_F(*distance, k), LANE_F(*time, k));
}
#endif

// light_hit_pdf of the lanes of `on`, by the hits' geometric normals and primitives.
static inline float16 light_hit_pdf16(const SceneData *scene, const uint light, const Vec16 p, const Vec16 ng,
                                      const uint16 primitive, const Vec16 wi, const float16 distance, const float16 time,
                                      const Mask16 on) {
  float16 pdf = 0.0f;
#if PENUMBRA_AREA_LIGHTS
  const __global Light *record = scene->lights + light;
  if (is_quad16(record)) return quad_light_hit_pdf16(record, p, distance, on);
  if (is_sphere16(record)) return sphere_light_hit_pdf16(record, p, on);
  light_hit_pdf_each(scene, light, &p, &ng, &primitive, &wi, &distance, &time, &on, &pdf);
#endif
  return pdf;
}

#if PENUMBRA_MANY_LIGHTS || PENUMBRA_LIGHT_TREE
static PENUMBRA_NOINLINE PENUMBRA_WIDE void light_choose_each(const SceneData *scene, const Receiver16 *receiver,
                                                              const float16 *u, const Mask16 *on, uint16 *light,
                                                              float16 *pmf) {
  for (LANES_OF(k, *on)) {
    const Receiver lit = lane_receiver(receiver, k);
    float chance;
    LANE_U(*light, k) = light_choose(scene, &lit, LANE_F(*u, k), &chance);
    LANE_F(*pmf, k) = chance;
  }
}

static PENUMBRA_NOINLINE PENUMBRA_WIDE void light_pmf_each(const SceneData *scene, const Receiver16 *receiver,
                                                           const uint16 *light, const Mask16 *on, float16 *pmf) {
  for (LANES_OF(k, *on)) {
    const Receiver lit = lane_receiver(receiver, k);
    LANE_F(*pmf, k) = light_pmf(scene, &lit, LANE_U(*light, k));
  }
}
#endif

// light_choose of the lanes of `on`.
static inline uint16 light_choose16(const SceneData *scene, const Receiver16 *receiver, const float16 u, const Mask16 on,
                                    float16 *pmf) {
  uint16 light = 0u;
  *pmf = 1.0f;
#if PENUMBRA_MANY_LIGHTS || PENUMBRA_LIGHT_TREE
  light_choose_each(scene, receiver, &u, &on, &light, pmf);
#endif
  return light;
}

// light_pmf of the lanes of `on`.
static inline float16 light_pmf16(const SceneData *scene, const Receiver16 *receiver, const uint16 light, const Mask16 on) {
  float16 pmf = 1.0f;
#if PENUMBRA_MANY_LIGHTS || PENUMBRA_LIGHT_TREE
  light_pmf_each(scene, receiver, &light, &on, &pmf);
#endif
  return pmf;
}

#define LIGHT_WORDS ((uint)(sizeof(Light) / sizeof(uint)))

static inline uint16 light_types16(const SceneData *scene, const uint16 light, const Mask16 on) {
  if (light_entries(scene) == 1u) return (uint16)(scene->lights->type);
  return gather_u16(&scene->lights->type, light * LIGHT_WORDS, on);
}

// light_has_extent and light_has_triangles of each lane's light.
static inline Mask16 lights_have_extent16(const SceneData *scene, const uint16 light, const Mask16 on) {
#if PENUMBRA_DELTA_LIGHTS && (PENUMBRA_AREA_LIGHTS || PENUMBRA_ENVIRONMENT)
  const uint16 type = light_types16(scene, light, on);
  return (type != LIGHT_POINT) & (type != LIGHT_SPOT) & (type != LIGHT_DIRECTIONAL);
#elif PENUMBRA_AREA_LIGHTS || PENUMBRA_ENVIRONMENT
  return (Mask16)(-1);
#else
  return (Mask16)(0);
#endif
}

static inline Mask16 lights_have_triangles16(const SceneData *scene, const uint16 light, const Mask16 on) {
#if PENUMBRA_AREA_LIGHTS
  return light_types16(scene, light, on) == LIGHT_MESH;
#else
  return (Mask16)(0);
#endif
}
