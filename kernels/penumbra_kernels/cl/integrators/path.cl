// Path tracing: next-event estimation and lobe sampling joined by multiple importance sampling, Russian roulette.
// Reads the scene, draws the bounce's dimensions, writes nothing but what it returns.
#include "integrators/direct.cl"
#include "base/effects.h"

// What one path brings back.
typedef struct {
  float3 radiance;
  float alpha;       // 1 where the camera ray met a surface
  float3 albedo;     // of the first hit
  float3 normal;     // its shading normal
  float depth;       // its distance along the ray, in units of |d|
  uint object_id;    // 1 + index of the shape, 0 for none
  uint effects;      // EFFECT_* bits met on the way
  uint rays;         // traced, shadow rays included
} PathSample;

static inline PathSample no_path(void) {
  PathSample none;
  none.radiance = (float3)(0.0f);
  none.alpha = 0.0f;
  none.albedo = (float3)(0.0f);
  none.normal = (float3)(0.0f);
  none.depth = 0.0f;
  none.object_id = 0u;
  none.effects = 0u;
  none.rays = 0u;
  return none;
}

// Weight of light met by a lobe's ray: against the light samples of the hit before, whose expected number is `chance`.
static inline float hit_weight(const __global Params *params, const bool delta, const float lobe_pdf, const float light_pdf,
                               const float chance) {
  if (delta) return 1.0f;
  if (params->options & OPTION_NO_MIS) return 0.0f;
  return power_heuristic(lobe_pdf, chance * light_pdf);
}

// Expected number of light samples that the receiver spends on this light.
static inline float light_chance(const SceneData *scene, const __global Params *params, const Receiver *receiver,
                                 const uint light) {
  const float picks = (float)params->shadow_rays;
  return params->options & OPTION_ALL_LIGHTS ? picks : picks * light_pmf(scene, receiver, light);
}

static inline Receiver receiver_of(const Surface *surface, const Bsdf *bsdf) {
  Receiver receiver;
  receiver.p = surface->p;
  receiver.n = bsdf_transmits(bsdf) ? (float3)(0.0f) : bsdf->n;
  return receiver;
}

// Whether light samples alone serve the last hit that max_bounces allows. Narrow lobes share the work even there: a light
// sample that falls into one of them would count for far more than its share, and seldom.
static inline bool lights_alone(const __global Params *params, const Bsdf *bsdf) {
  return bsdf_is_wide(bsdf) || (params->options & (OPTION_LIGHTS_TO_MEET | OPTION_NO_MIS)) != OPTION_LIGHTS_TO_MEET;
}

static inline uint object_of(const SceneData *scene, const Surface *surface) {
#if PENUMBRA_INSTANCING
  if (surface->instance != NONE) return scene->instances[surface->instance].object_id;
#endif
  return scene->shapes[surface->shape].object_id;
}

// Survival is min(1, throughput), not capped: a cap below the albedo would give infinite variance.
static inline bool roulette(const __global Params *params, const Sampler *sampler, const uint bounce, float3 *beta) {
  if (bounce < params->roulette_start) return true;
  const float survival = max3(*beta);
  if (survival >= 1.0f) return true;
  if (!(sample_1d(sampler, DIM_BOUNCE(bounce, SLOT_ROULETTE)) < survival)) return false;
  *beta *= 1.0f / survival;
  return true;
}

static inline PathSample trace_path(const SceneData *scene, const __global Params *params, const Sampler *sampler,
                                    Ray ray) {
  PathSample result = no_path();
  const bool mis = (params->options & OPTION_NO_MIS) == 0u;

  float3 beta = (float3)(1.0f);
  Receiver from;            // the hit that the ray left, for light densities
  from.p = from.n = (float3)(0.0f);
  float lobe_pdf = 0.0f;
  bool delta = true;        // the camera's ray counts as one: nothing else samples what it sees
  for (uint bounce = 0;; bounce++) {
    Hit hit;
    result.rays++;
    if (!intersect(scene, ray, &hit)) {
#if PENUMBRA_ENVIRONMENT
      if (scene->environment_light != NONE) {
        const float3 wi = normalize3(ray.d);
        const float weight = delta ? 1.0f
                                   : hit_weight(params, false, lobe_pdf, environment_pdf(scene, wi),
                                                light_chance(scene, params, &from, scene->environment_light));
        result.effects |= EFFECT_ENVIRONMENT;
        result.radiance += beta * environment_radiance(scene, wi) * weight;
      }
#endif
      break;
    }
    Surface surface;
    surface_to_shade(scene, ray, hit, &surface);
    const float3 wo = -normalize3(ray.d);
#if PENUMBRA_AREA_LIGHTS
    const uint light = scene->shapes[surface.shape].light;
    if (light != NONE) {
      const float3 emitted = light_emitted(scene, &surface, wo);
      if (max3(emitted) > 0.0f) {
        float weight = 1.0f;
        if (!delta) {
          const float pdf = light_hit_pdf(scene, light, from.p, &surface, -wo, hit.t * length3(ray.d), ray.time);
          weight = hit_weight(params, false, lobe_pdf, pdf, light_chance(scene, params, &from, light));
        }
        result.effects |= EFFECT_AREA_LIGHT;
        result.radiance += beta * emitted * weight;
      }
    }
#endif
    Bsdf bsdf;
    const bool last = bounce >= params->max_bounces;
    if (bounce > params->max_bounces) break;  // the ray before only looked for light
    bsdf_start(scene, &surface, wo, &bsdf);
    const bool alone = last && lights_alone(params, &bsdf);
    if (bounce == 0) {
      result.alpha = 1.0f;
#if PENUMBRA_LAYERS
      result.albedo = bsdf_albedo(&bsdf);
      result.normal = surface.ns;
      result.depth = hit.t;
      result.object_id = object_of(scene, &surface);
#endif
    }
    from = receiver_of(&surface, &bsdf);
    if (bsdf_has_smooth(&bsdf)) {
      result.radiance += beta * direct_light(scene, params, sampler, &surface, &bsdf, &from, bounce, ray.time,
                                             mis && !alone, &result.effects, &result.rays);
    }
#if PENUMBRA_INDIRECT
    // Where nothing could come of a direction no number is drawn for it.
    if (bsdf.type == MATERIAL_BLACK || (alone && bsdf_is_wide(&bsdf))) break;
    float3 wi, weight;
    uint event;
    const float u_lobe = bsdf_has_lobes(&bsdf) ? sample_1d(sampler, DIM_BOUNCE(bounce, SLOT_LOBE)) : 0.0f;
    const SquarePoint at = bsdf_has_spread(&bsdf) ? sample_direction(sampler, bounce) : square_point((float2)(0.5f));
    if (!bsdf_sample(&bsdf, u_lobe, at, &wi, &weight, &lobe_pdf, &event)) break;
    delta = (event & BSDF_EVENT_DELTA) != 0u;
    // Where light samples are alone they had full weight; mirrors still look for lights, where there are any.
    if (last && (delta ? light_entries(scene) == 0u : alone)) break;
    beta *= weight;
    result.effects |= (event & BSDF_EVENT_TRANSMIT) ? EFFECT_TRANSMISSION : (delta ? EFFECT_GLOSS : EFFECT_DIFFUSE);
    const float throughput = beta.x + beta.y + beta.z;
    if (!(throughput > 0.0f)) {
      if (throughput != throughput) result.radiance = beta;  // a NaN must be counted, not lost
      break;
    }
    if (!roulette(params, sampler, bounce, &beta)) break;
    ray = spawn_ray(&surface, wi, ray.time);
#else
    break;
#endif
  }
  return result;
}
