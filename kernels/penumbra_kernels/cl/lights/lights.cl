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

// The kinds of light that these functions meet, a bit each: the code of the others is not there. In lanes, lights16.cl takes
// quads and spheres itself, unless instances carry them.
#define EVERY_KIND 0xffu
#if !PENUMBRA_LANES || PENUMBRA_INSTANCING
#define LIGHT_KINDS EVERY_KIND
#elif PENUMBRA_LIGHT_AREA_SAMPLING
#define LIGHT_KINDS (EVERY_KIND & ~(1u << LIGHT_QUAD))
#else
#define LIGHT_KINDS (EVERY_KIND & ~(1u << LIGHT_QUAD) & ~(1u << LIGHT_SPHERE))
#endif
#define LIGHT_IS(light, kind) ((LIGHT_KINDS >> (kind) & 1u) != 0u && (light)->type == (kind))

static inline bool area_light_sample(const SceneData *scene, const __global Light *light, const float3 p, const float time,
                                     const float u_triangle, const float2 u, LightSample *out) {
  out->delta = false;
  out->radiance = load3(light->radiance);
  if (LIGHT_IS(light, LIGHT_QUAD)) return quad_light_sample(scene, light, p, time, u, out);
  if (LIGHT_IS(light, LIGHT_DISC)) return disc_light_sample(scene, light, p, time, u, out);
  if (LIGHT_IS(light, LIGHT_SPHERE)) return sphere_light_sample(scene, light, p, time, u, out);
  return LIGHT_IS(light, LIGHT_MESH) && mesh_light_sample(scene, light, p, time, u_triangle, u, out);
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

// Samples a direction to a light for a receiver. u_triangle and u in [0, 1); time in seconds from the frame's. False where nothing
// arrives: behind the light, edge-on, at the light itself. *out is whole only where it returns true.
static inline bool light_sample(const SceneData *scene, const uint light, const Receiver *receiver, const float time,
                                const float u_triangle, const float2 u, LightSample *out) {
#if PENUMBRA_AREA_LIGHTS || PENUMBRA_DELTA_LIGHTS
  const float3 p = receiver->p;
#endif
#if PENUMBRA_AREA_LIGHTS || PENUMBRA_DELTA_LIGHTS || PENUMBRA_ENVIRONMENT
  const __global Light *record = scene->lights + light;
#endif
#if PENUMBRA_ENVIRONMENT
  if (LIGHT_IS(record, LIGHT_ENVIRONMENT)) {
    out->delta = false;
    return environment_sample(scene, record, receiver->n, u, out);
  }
#endif
#if PENUMBRA_DELTA_LIGHTS
  if (LIGHT_IS(record, LIGHT_POINT)) return point_light_sample(scene, record, p, time, out);
  if (LIGHT_IS(record, LIGHT_SPOT)) return spot_light_sample(scene, record, p, time, out);
  if (LIGHT_IS(record, LIGHT_DIRECTIONAL)) return directional_light_sample(scene, record, time, out);
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

// light_hit_pdf by the hit's geometric normal and primitive.
static inline float light_hit_pdf_at(const SceneData *scene, const uint light, const float3 p, const float3 ng,
                                     const uint primitive, const float3 wi, const float distance, const float time) {
#if PENUMBRA_AREA_LIGHTS
  const __global Light *record = scene->lights + light;
  if (LIGHT_IS(record, LIGHT_QUAD)) return quad_light_hit_pdf(scene, record, p, distance, time);
  if (LIGHT_IS(record, LIGHT_DISC)) return disc_light_hit_pdf(scene, record, p, distance, time);
  if (LIGHT_IS(record, LIGHT_SPHERE)) return sphere_light_hit_pdf(scene, record, p, ng, wi, distance, time);
  return mesh_light_hit_pdf(scene, record, p, primitive, distance, time);
#else
  return 0.0f;
#endif
}

// Density with which light_sample at p finds the direction wi that met `light` at `hit`, `distance` away. 0 where it never
// does: behind, edge-on.
static inline float light_hit_pdf(const SceneData *scene, const uint light, const float3 p, const Surface *hit,
                                  const float3 wi, const float distance, const float time) {
  return light_hit_pdf_at(scene, light, p, hit->ng, hit->primitive, wi, distance, time);
}
