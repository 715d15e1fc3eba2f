// Direct light at a surface point by next-event estimation: shadow rays to points on the lights.
// Reads the scene; draws SLOT_LIGHT and SLOT_LIGHT_TRIANGLE of the bounce's dimensions.
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

// A sample of a light: the ray to it, and what it brings to the viewer unless something is in between.
typedef struct {
  Ray ray;
  float3 value;
  uint effect;  // EFFECT_*_LIGHT
} LightRay;

// A sample of light `light`. `chance` is how many such samples this light expects per hit: picks times pmf. The value is not
// yet divided by `chance`. use_mis: weigh against the lobe's own density. False where nothing comes that way.
static inline bool light_ray(const SceneData *scene, const Surface *surface, const Bsdf *bsdf, const Receiver *receiver,
                             const uint light, const float time, const float u_triangle, const float2 u,
                             const float chance, const bool use_mis, LightRay *out) {
  LightSample sample;
  if (!light_sample(scene, light, receiver, time, u_triangle, u, &sample)) return false;
  float lobe_pdf;
  const float3 f = bsdf_eval(bsdf, sample.wi, &lobe_pdf);
  const float3 value = f * sample.radiance;
  if (value.x + value.y + value.z == 0.0f) return false;  // a NaN goes on, to be counted
  out->ray = sample.distance < INF_F ? spawn_ray_to(surface, sample.p, sample.p_error, sample.n, time)
                                     : spawn_ray(surface, sample.wi, time);
  out->effect = sample.delta ? EFFECT_DELTA_LIGHT : EFFECT_AREA_LIGHT;
  const float weight = use_mis && !sample.delta ? power_heuristic(chance * sample.pdf, lobe_pdf) : 1.0f;
  out->value = value * (weight / sample.pdf);
  return true;
}

// How many samples of lights a hit takes.
static inline uint direct_count(const SceneData *scene, const __global Params *params) {
  const uint total = light_entries(scene);
  return params->options & OPTION_ALL_LIGHTS ? total * params->shadow_rays : (total ? params->shadow_rays : 0u);
}

// Sample number n of a hit: of every light in turn, or of one that is chosen. The sum of their values is yet to be divided by
// the number of shadow rays.
static inline bool direct_ray(const SceneData *scene, const __global Params *params, const Sampler *sampler,
                              const Surface *surface, const Bsdf *bsdf, const Receiver *receiver, const uint bounce,
                              const uint n, const float time, const bool use_mis, LightRay *out) {
  const uint picks = params->shadow_rays;
  if (params->options & OPTION_ALL_LIGHTS) {
    const uint light = n / picks, j = n - light * picks;
    const float2 u = light_has_extent(scene, light)
                         ? sample_2d_of(sampler, DIM_LIGHT(bounce, SLOT_LIGHT, light), j, picks)
                         : (float2)(0.0f);
    const float ut = light_has_triangles(scene, light)
                         ? sample_1d_of(sampler, DIM_LIGHT(bounce, SLOT_LIGHT_TRIANGLE, light), j, picks)
                         : 0.0f;
    return light_ray(scene, surface, bsdf, receiver, light, time, ut, u, (float)picks, use_mis, out);
  }
  // One point chooses the light, and what is left of it the place there.
  const bool asks = light_entries(scene) > 1u || light_has_extent(scene, 0u);
  float2 u = asks ? sample_2d_of(sampler, DIM_BOUNCE(bounce, SLOT_LIGHT), n, picks) : (float2)(0.0f);
  float pmf;
  const uint light = light_choose(scene, receiver, &u, &pmf);
  if (!(pmf > 0.0f)) return false;
  const float ut = light_has_triangles(scene, light)
                       ? sample_1d_of(sampler, DIM_BOUNCE(bounce, SLOT_LIGHT_TRIANGLE), n, picks)
                       : 0.0f;
  if (!light_ray(scene, surface, bsdf, receiver, light, time, ut, u, (float)picks * pmf, use_mis, out)) return false;
  out->value *= 1.0f / pmf;
  return true;
}
