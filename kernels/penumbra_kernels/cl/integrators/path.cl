// Path tracing: next-event estimation and lobe sampling joined by multiple importance sampling, Russian roulette.
// Reads the scene, draws the bounce's dimensions, writes nothing but the path. A bounce is a row of steps, which trace_path takes
// for one path; paths16.cl takes each for sixteen.
#include "integrators/direct.cl"
#include "integrators/path_sample.h"

// Weight of light met by a lobe's ray: against the light samples of the hit before, whose expected number is `chance`.
static inline float hit_weight(const __global Params *params, const float lobe_pdf, const float light_pdf, const float chance) {
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

// A path on its way.
typedef struct {
  PathSample result;
  Ray ray;
  float3 beta;
  Receiver from;    // the hit that the ray left, for light densities
  float lobe_pdf;
  bool delta;       // the camera's ray counts as one: nothing else samples what it sees
  float3 direct;    // sum over the light samples of the hit that it is at
} Path;

// A path at a hit.
typedef struct {
  Hit hit;
  Surface surface;
  Bsdf bsdf;
} Vertex;

static inline void path_start(Path *path, const Ray ray) {
  path->result = no_path();
  path->ray = ray;
  path->beta = (float3)(1.0f);
  path->from.p = path->from.n = (float3)(0.0f);
  path->lobe_pdf = 0.0f;
  path->delta = true;
}

// Once the ray has been followed; false where it left the scene.
static inline bool path_met(const SceneData *scene, const __global Params *params, Path *path, Vertex *at) {
  path->result.rays++;
  if (at->hit.kind != NONE) return true;
#if PENUMBRA_ENVIRONMENT
  if (scene->environment_light != NONE) {
    const float3 wi = normalize3(path->ray.d);
    const float weight = path->delta ? 1.0f
                                     : hit_weight(params, path->lobe_pdf, environment_pdf(scene, path->from.n, wi),
                                                  light_chance(scene, params, &path->from, scene->environment_light));
    path->result.effects |= EFFECT_ENVIRONMENT;
    path->result.radiance += path->beta * environment_radiance(scene, wi) * weight;
  }
#endif
  return false;
}

// Follows the ray; false where it leaves the scene.
static inline bool path_meet(const SceneData *scene, const __global Params *params, Path *path, Vertex *at) {
  intersect(scene, path->ray, &at->hit);
  return path_met(scene, params, path, at);
}

// Looks at what the ray met; false where the path ends there.
static inline bool path_look(const SceneData *scene, const __global Params *params, const uint bounce, Path *path,
                             Vertex *at) {
  surface_to_shade(scene, path->ray, at->hit, &at->surface);
  const float3 wo = -normalize3(path->ray.d);
#if PENUMBRA_AREA_LIGHTS
  const uint light = scene->shapes[at->surface.shape].light;
  if (light != NONE) {
    const float3 emitted = light_emitted(scene, &at->surface, wo);
    if (max3(emitted) > 0.0f) {
      float weight = 1.0f;
      if (!path->delta) {
        const float pdf = light_hit_pdf(scene, light, path->from.p, &at->surface, -wo, at->hit.t * length3(path->ray.d),
                                        path->ray.time);
        weight = hit_weight(params, path->lobe_pdf, pdf, light_chance(scene, params, &path->from, light));
      }
      path->result.effects |= EFFECT_AREA_LIGHT;
      path->result.radiance += path->beta * emitted * weight;
    }
  }
#endif
  if (bounce > params->max_bounces) return false;  // the ray before only looked for light
  bsdf_start(scene, &at->surface, wo, &at->bsdf);
  if (bounce == 0) {
    path->result.alpha = 1.0f;
#if PENUMBRA_LAYERS
    path->result.albedo = bsdf_albedo(&at->bsdf);
    path->result.normal = at->surface.ns;
    path->result.depth = at->hit.t * dot3(path->ray.d, camera_axis(&params->camera));
    path->result.object_id = object_of(scene, &at->surface);
#endif
  }
  path->from = receiver_of(&at->surface, &at->bsdf);
  path->direct = (float3)(0.0f);
  return true;
}

// Sample number n of the lights; false where nothing comes that way.
static inline bool path_aim(const SceneData *scene, const __global Params *params, const Sampler *sampler, const uint bounce,
                            const uint n, const Path *path, const Vertex *at, LightRay *out) {
  if (!bsdf_has_smooth(&at->bsdf)) return false;
  const bool alone = bounce >= params->max_bounces && lights_alone(params, &at->bsdf);
  const bool use_mis = (params->options & OPTION_NO_MIS) == 0u && !alone;
  return direct_ray(scene, params, sampler, &at->surface, &at->bsdf, &path->from, bounce, n, path->ray.time, use_mis, out);
}

// Follows a ray to a light.
static inline void path_shine(const SceneData *scene, const LightRay *ray, Path *path) {
  path->result.rays++;
  if (occluded(scene, ray->ray)) return;
  path->result.effects |= ray->effect;
  path->direct += ray->value;
}

// Takes what the lights brought.
static inline void path_gather(const __global Params *params, Path *path, const Vertex *at) {
  if (!bsdf_has_smooth(&at->bsdf)) return;
  path->result.radiance += path->beta * (path->direct * (1.0f / (float)params->shadow_rays));
}

// Draws the next ray; false where the path ends.
static inline bool path_scatter(const SceneData *scene, const __global Params *params, const Sampler *sampler,
                                const uint bounce, Path *path, const Vertex *at) {
#if PENUMBRA_INDIRECT
  const Bsdf *bsdf = &at->bsdf;
  const bool last = bounce >= params->max_bounces;
  const bool alone = last && lights_alone(params, bsdf);
  // Where nothing could come of a direction no number is drawn for it.
  if (bsdf->type == MATERIAL_BLACK || (last && bsdf_is_wide(bsdf))) return false;
  float3 wi, weight;
  uint event;
  const float u_lobe = bsdf_has_lobes(bsdf) ? sample_1d(sampler, DIM_BOUNCE(bounce, SLOT_LOBE)) : 0.0f;
  const float2 u =
      bsdf_has_spread(bsdf) ? sample_2d(sampler, DIM_BOUNCE(bounce, SLOT_DIRECTION)) : (float2)(0.5f);
  if (!bsdf_sample(bsdf, u_lobe, u, &wi, &weight, &path->lobe_pdf, &event)) return false;
  path->delta = (event & BSDF_EVENT_DELTA) != 0u;
  // Where light samples are alone they had full weight; mirrors still look for lights, where there are any.
  if (last && (path->delta ? light_entries(scene) == 0u : alone)) return false;
  path->beta *= weight;
  path->result.effects |=
      (event & BSDF_EVENT_TRANSMIT) ? EFFECT_TRANSMISSION : (path->delta ? EFFECT_GLOSS : EFFECT_DIFFUSE);
  const float throughput = path->beta.x + path->beta.y + path->beta.z;
  if (!(throughput > 0.0f)) {
    if (throughput != throughput) path->result.radiance = path->beta;  // a NaN must be counted, not lost
    return false;
  }
  if (!roulette(params, sampler, bounce, &path->beta)) return false;
  path->ray = spawn_ray(&at->surface, wi, path->ray.time);
  return true;
#else
  return false;
#endif
}

// One path from its camera ray to its end.
static inline void trace_path(const SceneData *scene, const __global Params *params, const Sampler *sampler, Path *path) {
  const uint lights = direct_count(scene, params);
  Vertex at;
  for (uint bounce = 0u; path_meet(scene, params, path, &at); bounce++) {
    if (!path_look(scene, params, bounce, path, &at)) return;
    for (uint n = 0u; n < lights; n++) {
      LightRay ray;
      if (path_aim(scene, params, sampler, bounce, n, path, &at, &ray)) path_shine(scene, &ray, path);
    }
    path_gather(params, path, &at);
    if (!path_scatter(scene, params, sampler, bounce, path, &at)) return;
  }
}
