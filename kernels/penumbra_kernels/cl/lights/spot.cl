// Spot light: a point light whose intensity falls from the inner cone to nothing at the outer one. World frame, metres.
#include "lights/point.cl"

// Hermite's smooth step in the cosine (as pbrt-v4, section 12.2.1): 1 within the inner cone, 0 beyond the outer. Angles
// go by 1 - cos, half the squared chord, which keeps its digits for narrow beams.
static inline float spot_falloff(const __global Light *light, const float one_minus_cos) {
  if (one_minus_cos <= light->inner) return 1.0f;
  if (one_minus_cos >= light->outer) return 0.0f;
  const float x = (light->outer - one_minus_cos) / (light->outer - light->inner);
  return x * x * (3.0f - 2.0f * x);
}

static inline bool spot_light_sample(const SceneData *scene, const __global Light *light, const float3 p,
                                     const float time, LightSample *out) {
  if (!point_light_sample(scene, light, p, time, out)) return false;
  float m[3][4];
  float3 axis = load3(light->direction);
  if (delta_light_matrix(scene, light, time, m)) axis = normalize3(transform_vector(m, axis));
  const float3 chord = out->wi + axis;
  const float falloff = spot_falloff(light, 0.5f * dot3(chord, chord));
  out->radiance *= falloff;
  return falloff > 0.0f;
}
