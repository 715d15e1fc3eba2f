// The functions of lights/lights.cl for sixteen lanes, each with the bits of the scalar function and a light of its own. Quads,
// spheres and the constant environment are taken kind by kind; every other kind of light, and those that instances carry, lane by
// lane.
#include "lights/lights.cl"
#include "lights/choice16.cl"
#include "lights/records16.cl"
#include "lights/quad16.cl"
#include "lights/sphere16.cl"
#include "lights/environment16.cl"

#if PENUMBRA_AREA_LIGHTS
static inline Mask16 in_place16(const Lights16 *lights, const Mask16 on) {
#if PENUMBRA_INSTANCING
  return on & (lights->instance == NONE);
#else
  return on;
#endif
}

// The lanes of `on` whose lights the functions of quads and of spheres serve.
static inline void shapes16(const Lights16 *lights, const Mask16 on, Mask16 *quads, Mask16 *spheres) {
  const uint16 type = lights->type;
  const Mask16 here = in_place16(lights, on);
  *quads = here & (type == LIGHT_QUAD);
#if PENUMBRA_LIGHT_AREA_SAMPLING
  *spheres = 0;
#else
  *spheres = here & (type == LIGHT_SPHERE);
#endif
}
#endif

// light_has_extent and light_has_triangles of each lane's light.
static inline Mask16 lights_have_extent16(const Lights16 *lights, const Mask16 on) {
#if PENUMBRA_DELTA_LIGHTS && (PENUMBRA_AREA_LIGHTS || PENUMBRA_ENVIRONMENT)
  const uint16 type = lights->type;
  return (type != LIGHT_POINT) & (type != LIGHT_SPOT) & (type != LIGHT_DIRECTIONAL);
#elif PENUMBRA_AREA_LIGHTS || PENUMBRA_ENVIRONMENT
  return (Mask16)(-1);
#else
  return (Mask16)(0);
#endif
}

static inline Mask16 lights_have_triangles16(const Lights16 *lights, const Mask16 on) {
#if PENUMBRA_AREA_LIGHTS
  return lights->type == LIGHT_MESH;
#else
  return (Mask16)(0);
#endif
}

#if PENUMBRA_AREA_LIGHTS || PENUMBRA_DELTA_LIGHTS || PENUMBRA_ENVIRONMENT_IMAGE
static PENUMBRA_NOINLINE PENUMBRA_WIDE Mask16 light_sample_each(const SceneData *scene, const uint16 *light,
                                                                const Receiver16 *receiver, const float16 *time,
                                                                const float16 *u_triangle, const float16 *ux,
                                                                const float16 *uy, const Mask16 *on, LightSample16 *out) {
  Mask16 given = 0;
  for (LANES_OF(k, *on)) {
    const Receiver lit = lane_receiver(receiver, k);
    const float2 u = (float2)(LANE_F(*ux, k), LANE_F(*uy, k));
    LightSample sample;
    if (!light_sample(scene, LANE_U(*light, k), &lit, LANE_F(*time, k), LANE_F(*u_triangle, k), u, &sample))
      continue;
    LANE_I(given, k) = -1;
    set_lane_light_sample(out, k, &sample);
  }
  return given;
}
#endif

// light_sample of the lanes of `on`. The lanes in which it returns true: only these are whole in *out.
static inline Mask16 light_sample16(const SceneData *scene, const Lights16 *lights, const Receiver16 *receiver,
                                    const float16 time, const float16 u_triangle, const float16 ux, const float16 uy,
                                    const Mask16 on, LightSample16 *out) {
  Mask16 left = on, given = 0;
#if PENUMBRA_AREA_LIGHTS
  Mask16 quads, spheres;
  shapes16(lights, on, &quads, &spheres);
  if (any16(quads)) given = quad_light_sample16(lights, receiver->p, ux, uy, quads, out);
  if (any16(spheres)) {
    LightSample16 sample;
    given |= sphere_light_sample16(lights, receiver->p, ux, uy, spheres, &sample);
    choose_samples16(spheres, &sample, out);
  }
  left &= ~(quads | spheres);
  if (any16(on & ~left)) out->radiance = radiance16(lights, on);
#endif
#if PENUMBRA_ENVIRONMENT
  const Mask16 sky = left & (lights->number == scene->environment_light);
  if (any16(sky) && !environment_is_image(environment_of(scene))) {
    LightSample16 sample;
    given |= environment_sample16(environment_of(scene), receiver->n, ux, uy, sky, &sample);
    choose_samples16(sky, &sample, out);
    left &= ~sky;
  }
#endif
#if PENUMBRA_AREA_LIGHTS || PENUMBRA_DELTA_LIGHTS || PENUMBRA_ENVIRONMENT_IMAGE
  if (any16(left)) given |= light_sample_each(scene, &lights->number, receiver, &time, &u_triangle, &ux, &uy, &left, out);
#endif
  return given;
}

// light_emitted of lanes on surfaces of lights.
static inline Vec16 light_emitted16(const Lights16 *lights, const Vec16 ng, const Vec16 wo, const Mask16 on) {
#if PENUMBRA_AREA_LIGHTS
  const Mask16 shines = two_sided16(lights) | (dot16(ng, wo) > 0.0f);
  return where16(shines, radiance16(lights, on), all16((float3)(0.0f)));
#else
  return all16((float3)(0.0f));
#endif
}

#if PENUMBRA_AREA_LIGHTS
static PENUMBRA_NOINLINE PENUMBRA_WIDE void light_hit_pdf_each(const SceneData *scene, const uint16 *light, const Vec16 *p,
                                                               const Vec16 *ng, const uint16 *primitive, const Vec16 *wi,
                                                               const float16 *distance, const float16 *time,
                                                               const Mask16 *on, float16 *pdf) {
  for (LANES_OF(k, *on))
    LANE_F(*pdf, k) = light_hit_pdf_at(scene, LANE_U(*light, k), lane3(p, k), lane3(ng, k), LANE_U(*primitive, k), lane3(wi, k),
                                       LANE_F(*distance, k), LANE_F(*time, k));
}
#endif

// light_hit_pdf of the lanes of `on`, by the hits' geometric normals and primitives.
static inline float16 light_hit_pdf16(const SceneData *scene, const Lights16 *lights, const Vec16 p, const Vec16 ng,
                                      const uint16 primitive, const Vec16 wi, const float16 distance, const float16 time,
                                      const Mask16 on) {
  float16 pdf = 0.0f;
#if PENUMBRA_AREA_LIGHTS
  Mask16 quads, spheres;
  shapes16(lights, on, &quads, &spheres);
  if (any16(quads)) pdf = quad_light_hit_pdf16(lights, p, distance, quads);
  if (any16(spheres)) pdf = spheres ? sphere_light_hit_pdf16(lights, p, spheres) : pdf;
  const Mask16 left = on & ~(quads | spheres);
  if (any16(left)) light_hit_pdf_each(scene, &lights->number, &p, &ng, &primitive, &wi, &distance, &time, &left, &pdf);
#endif
  return pdf;
}
