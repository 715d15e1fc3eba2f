// Direct light at a surface point by next-event estimation: shadow rays to points on the lights.
// Reads the scene; draws SLOT_LIGHT_SELECT, SLOT_LIGHT, SLOT_LIGHT_TRIANGLE of the bounce's dimensions.
#include "geometry/intersect.cl"
#include "geometry/surface.cl"
#include "lights/lights.cl"
#include "materials/bsdf.cl"
#include "sampling/sampler.cl"

// Power heuristic, exponent 2, of a strategy with density a against one with density b (Veach 1997, eq. 9.14);
// written so that neither square overflows.
static inline float power_heuristic(const float a, const float b) {
  if (a <= 0.0f) return 0.0f;
  const float r = b / a;
  return 1.0f / (1.0f + r * r);
}

// One shadow ray to light `light`. `chance` is how many such samples this light expects per hit: picks times pmf.
// The result is not yet divided by `chance`. use_mis: weigh against the lobe's own density. Counts the ray that it traces.
static inline float3 light_contribution(const SceneData *scene, const Surface *surface, const Bsdf *bsdf,
                                        const uint light, const float time, const float u_triangle, const float2 u,
                                        const float chance, const bool use_mis, uint *effects, uint *rays) {
  LightSample sample;
  if (!light_sample(scene, light, surface->p, time, u_triangle, u, &sample)) return (float3)(0.0f);
  float lobe_pdf;
  const float3 f = bsdf_eval(bsdf, sample.wi, &lobe_pdf);
  const float3 value = f * sample.radiance;
  if (value.x + value.y + value.z == 0.0f) return (float3)(0.0f);  // a NaN goes on, to be counted
  const Ray shadow = sample.distance < INF_F
                         ? spawn_ray_to(surface, sample.p, sample.p_error, sample.n, time)
                         : spawn_ray(surface, sample.wi, time);
  (*rays)++;
  if (occluded(scene, shadow)) return (float3)(0.0f);
  *effects |= sample.delta ? EFFECT_DELTA_LIGHT : EFFECT_AREA_LIGHT;
  const float weight = use_mis && !sample.delta ? power_heuristic(chance * sample.pdf, lobe_pdf) : 1.0f;
  return value * (weight / sample.pdf);
}

// Radiance that the lights send by way of this surface point towards the viewer.
static inline float3 direct_light(const SceneData *scene, const __global Params *params, const Sampler *sampler,
                                  const Surface *surface, const Bsdf *bsdf, const Receiver *receiver, const uint bounce,
                                  const float time, const bool use_mis, uint *effects, uint *rays) {
  const uint picks = params->shadow_rays;
  float3 sum = (float3)(0.0f);
  const uint total = light_entries(scene);
  if (total == 0u) return sum;
  if (params->options & OPTION_ALL_LIGHTS) {
    for (uint light = 0; light < total; light++) {
      for (uint j = 0; j < picks; j++) {
        const float2 u = light_has_extent(scene, light)
                             ? sample_2d_of(sampler, DIM_LIGHT(bounce, SLOT_LIGHT, light), j, picks)
                             : (float2)(0.0f);
        const float ut = light_has_triangles(scene, light)
                             ? sample_1d_of(sampler, DIM_LIGHT(bounce, SLOT_LIGHT_TRIANGLE, light), j, picks)
                             : 0.0f;
        sum += light_contribution(scene, surface, bsdf, light, time, ut, u, (float)picks, use_mis, effects, rays);
      }
    }
    return sum * (1.0f / (float)picks);
  }
  for (uint j = 0; j < picks; j++) {
    const float us = total > 1u ? sample_1d_of(sampler, DIM_BOUNCE(bounce, SLOT_LIGHT_SELECT), j, picks) : 0.0f;
    float pmf;
    const uint light = light_choose(scene, receiver, us, &pmf);
    if (!(pmf > 0.0f)) continue;
    const float2 u = light_has_extent(scene, light)
                         ? sample_2d_of(sampler, DIM_BOUNCE(bounce, SLOT_LIGHT), j, picks)
                         : (float2)(0.0f);
    const float ut = light_has_triangles(scene, light)
                         ? sample_1d_of(sampler, DIM_BOUNCE(bounce, SLOT_LIGHT_TRIANGLE), j, picks)
                         : 0.0f;
    sum += light_contribution(scene, surface, bsdf, light, time, ut, u, (float)picks * pmf, use_mis, effects,
                              rays) *
           (1.0f / pmf);
  }
  return sum * (1.0f / (float)picks);
}
