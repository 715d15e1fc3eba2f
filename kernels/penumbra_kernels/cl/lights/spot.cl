// Spot light: a point light whose intensity falls from the inner cone to nothing at the outer one. World frame, metres.
#include "lights/point.cl"

// Hermite's smooth step in the cosine (as pbrt-v4, section 12.2.1): 1 within the inner cone, 0 beyond the outer.
static inline float spot_falloff(const __global Light *light, const float cosine) {
  if (cosine >= light->cos_inner) return 1.0f;
  if (cosine <= light->cos_outer) return 0.0f;
  const float x = (cosine - light->cos_outer) / (light->cos_inner - light->cos_outer);
  return x * x * (3.0f - 2.0f * x);
}

static inline bool spot_light_sample(const SceneData *scene, const __global Light *light, const float3 p,
                                     const float time, LightSample *out) {
  if (!point_light_sample(scene, light, p, time, out)) return false;
  float m[3][4];
  float3 axis = load3(light->direction);
  if (delta_light_matrix(scene, light, time, m)) axis = normalize3(transform_vector(m, axis));
  const float falloff = spot_falloff(light, -dot3(out->wi, axis));
  out->radiance *= falloff;
  return falloff > 0.0f;
}
