// Point light: radiant intensity, W / sr, from one point. World frame, metres.
#include "lights/light_sample.h"
#include "lights/placement.cl"

// Aims at the light's position at `time`; false at the position itself.
static inline bool point_aim(const SceneData *scene, const __global Light *light, const float3 p, const float time,
                             LightSample *out) {
  float m[3][4];
  const float3 position = load3(light->position);
  out->p = delta_light_matrix(scene, light, time, m) ? transform_point(m, position) : position;
  out->p_error = (float3)(0.0f);  // nothing is there to be hit
  out->n = (float3)(0.0f);
  out->pdf = 1.0f;
  out->delta = true;
  return aim(p, out);
}

static inline bool point_light_sample(const SceneData *scene, const __global Light *light, const float3 p,
                                      const float time, LightSample *out) {
  if (!point_aim(scene, light, p, time, out)) return false;
  out->radiance = load3(light->radiance) / out->distance / out->distance;
  return true;
}
