// All lights behind one interface: choosing one, sampling directions to it, and the density of a direction that met it.
// World frame, metres relative to the anchor; directions leave the lit point; densities per solid angle there.
// Flags: PENUMBRA_AREA_LIGHTS, _DELTA_LIGHTS, _ENVIRONMENT (_IMAGE), _MANY_LIGHTS, _INSTANCING, _MOTION,
// _LIGHT_AREA_SAMPLING.
#include "lights/light_sample.h"
#include "lights/choice.cl"
#include "lights/quad.cl"
#include "lights/disc.cl"
#include "lights/sphere.cl"
#include "lights/mesh.cl"
#include "lights/point.cl"
#include "lights/spot.cl"
#include "lights/directional.cl"
#include "lights/environment.cl"

static inline bool area_light_sample(const SceneData *scene, const __global Light *light, const float3 p,
                                     const float time, const float u_triangle, const float2 u, LightSample *out) {
  out->delta = false;
  out->radiance = load3(light->radiance);
  if (light->type == LIGHT_QUAD) return quad_light_sample(scene, light, p, time, u, out);
  if (light->type == LIGHT_DISC) return disc_light_sample(scene, light, p, time, u, out);
  if (light->type == LIGHT_SPHERE) return sphere_light_sample(scene, light, p, time, u, out);
  return light->type == LIGHT_MESH && mesh_light_sample(scene, light, p, time, u_triangle, u, out);
}

// Whether light_sample asks for u_triangle.
static inline bool light_has_triangles(const SceneData *scene, const uint light) {
#if PENUMBRA_AREA_LIGHTS
  return scene->lights[light].type == LIGHT_MESH;
#else
  return false;
#endif
}

// Whether light_sample asks for u: point, spot and directional lights have one direction alone.
static inline bool light_has_extent(const SceneData *scene, const uint light) {
#if PENUMBRA_DELTA_LIGHTS && (PENUMBRA_AREA_LIGHTS || PENUMBRA_ENVIRONMENT)
  const uint type = scene->lights[light].type;
  return type != LIGHT_POINT && type != LIGHT_SPOT && type != LIGHT_DIRECTIONAL;
#elif PENUMBRA_AREA_LIGHTS || PENUMBRA_ENVIRONMENT
  return true;
#else
  return false;
#endif
}

// Samples a direction to a light for a receiver. u_triangle and u in [0, 1); time in seconds from the frame's. False where nothing arrives:
// behind the light, edge-on, at the light itself. *out is whole only where it returns true.
static inline bool light_sample(const SceneData *scene, const uint light, const Receiver *receiver, const float time,
                                const float u_triangle, const float2 u, LightSample *out) {
#if PENUMBRA_AREA_LIGHTS || PENUMBRA_DELTA_LIGHTS
  const float3 p = receiver->p;
#endif
#if PENUMBRA_AREA_LIGHTS || PENUMBRA_DELTA_LIGHTS || PENUMBRA_ENVIRONMENT
  const __global Light *record = scene->lights + light;
#endif
#if PENUMBRA_ENVIRONMENT
  if (record->type == LIGHT_ENVIRONMENT) {
    out->delta = false;
    return environment_sample(scene, record, receiver->n, u, out);
  }
#endif
#if PENUMBRA_DELTA_LIGHTS
  if (record->type == LIGHT_POINT) return point_light_sample(scene, record, p, time, out);
  if (record->type == LIGHT_SPOT) return spot_light_sample(scene, record, p, time, out);
  if (record->type == LIGHT_DIRECTIONAL) return directional_light_sample(scene, record, time, out);
#endif
#if PENUMBRA_AREA_LIGHTS
  return area_light_sample(scene, record, p, time, u_triangle, u, out);
#else
  return false;
#endif
}

// Radiance that a surface emits towards wo: on its front alone, unless it is two-sided.
static inline float3 light_emitted(const SceneData *scene, const Surface *surface, const float3 wo) {
#if PENUMBRA_AREA_LIGHTS
  const uint light = scene->shapes[surface->shape].light;
  if (light == NONE) return (float3)(0.0f);
  const __global Light *record = scene->lights + light;
  if ((record->flags & LIGHT_TWO_SIDED) == 0u && !(dot3(surface->ng, wo) > 0.0f)) return (float3)(0.0f);
  return load3(record->radiance);
#else
  return (float3)(0.0f);
#endif
}

// Density with which light_sample at p finds the direction wi that met `light` at `hit`, `distance` away. 0 where it never
// does: behind, edge-on.
static inline float light_hit_pdf(const SceneData *scene, const uint light, const float3 p, const Surface *hit,
                                  const float3 wi, const float distance, const float time) {
#if PENUMBRA_AREA_LIGHTS
  const __global Light *record = scene->lights + light;
  if (record->type == LIGHT_QUAD) return quad_light_hit_pdf(scene, record, p, distance, time);
  if (record->type == LIGHT_DISC) return disc_light_hit_pdf(scene, record, p, distance, time);
  if (record->type == LIGHT_SPHERE) return sphere_light_hit_pdf(scene, record, p, hit->ng, wi, distance, time);
  return mesh_light_hit_pdf(scene, record, p, hit->primitive, distance, time);
#else
  return 0.0f;
#endif
}
