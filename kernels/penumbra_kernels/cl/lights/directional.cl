// Directional light: parallel light with a given irradiance on what faces it, W / m^2. World frame.
#include "lights/light_sample.h"
#include "lights/placement.cl"

static inline bool directional_light_sample(const SceneData *scene, const __global Light *light, const float time,
                                            LightSample *out) {
  float m[3][4];
  float3 direction = load3(light->direction);
  if (delta_light_matrix(scene, light, time, m)) direction = normalize3(transform_vector(m, direction));
  out->wi = -direction;
  out->distance = INF_F;
  out->radiance = load3(light->radiance);
  out->pdf = 1.0f;
  out->delta = true;
  out->p = (float3)(0.0f);
  out->p_error = (float3)(0.0f);
  out->n = (float3)(0.0f);
  return true;
}
