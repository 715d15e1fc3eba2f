// Sixteen paths of a pixel at once, a lane each: every step of a bounce (path.cl) is taken for all lanes that it concerns before the
// next one. Lanes never meet: each gives the bits that trace_path gives. For CPUs, whose vector units do sixteen lanes in the time of
// one; a GPU's threads are lanes already.
#include "integrators/path.cl"
#include "geometry/rays16.cl"
#include "geometry/surface16.cl"
#include "geometry/spawn16.cl"
#include "lights/lights16.cl"
#include "materials/bsdf16.cl"
#include "integrators/numbers16.cl"

// PathSample of each lane.
typedef struct {
  Vec16 radiance;
  float16 alpha;
#if PENUMBRA_LAYERS
  Vec16 albedo, normal;
  float16 depth;
  uint16 object_id;
#endif
  uint16 effects, rays;
} PathSamples16;

// Path of each lane.
typedef struct {
  PathSamples16 result;
  Ray16 ray;
  Vec16 beta;
  Receiver16 from;
  float16 lobe_pdf;
  Mask16 delta;
  uint16 number;  // of the path's sample in its batch
  Hit16 hit;      // of the ray
} Paths16;

// All but their numbers.
static inline void paths_start16(Paths16 *p, const Ray16 ray) {
  const Vec16 zero = all16((float3)(0.0f));
  p->result.radiance = zero;
  p->result.alpha = 0.0f;
#if PENUMBRA_LAYERS
  p->result.albedo = p->result.normal = zero;
  p->result.depth = 0.0f;
  p->result.object_id = 0u;
#endif
  p->result.effects = p->result.rays = 0u;
  p->ray = ray;
  p->beta = all16((float3)(1.0f));
  p->from.p = p->from.n = zero;
  p->lobe_pdf = 0.0f;
  p->delta = -1;
}

static inline PathSample lane_sample(const PathSamples16 *p, const uint k) {
  PathSample s;
  s.radiance = lane3(&p->radiance, k);
  s.alpha = LANE_F(p->alpha, k);
#if PENUMBRA_LAYERS
  s.albedo = lane3(&p->albedo, k);
  s.normal = lane3(&p->normal, k);
  s.depth = LANE_F(p->depth, k);
  s.object_id = LANE_U(p->object_id, k);
#else
  s.albedo = s.normal = (float3)(0.0f);
  s.depth = 0.0f;
  s.object_id = 0u;
#endif
  s.effects = LANE_U(p->effects, k);
  s.rays = LANE_U(p->rays, k);
  return s;
}

static inline float16 power_heuristic16(const float16 a, const float16 b) {
  const float16 r = b / a, zero = 0.0f;
  return a <= 0.0f ? zero : 1.0f / (1.0f + r * r);
}

// hit_weight of the lanes' last lobes, which are no mirrors.
static inline float16 hit_weight16(const __global Params *params, const float16 lobe_pdf, const float16 light_pdf,
                                   const float16 chance) {
  if (params->options & OPTION_NO_MIS) return (float16)(0.0f);
  return power_heuristic16(lobe_pdf, chance * light_pdf);
}

static inline float16 light_chance16(const SceneData *scene, const __global Params *params, const Receiver16 *receiver,
                                     const uint16 light, const Mask16 on) {
  const float16 picks = (float)params->shadow_rays;
  return params->options & OPTION_ALL_LIGHTS ? picks : picks * light_pmf16(scene, receiver, light, on);
}

static inline void add_where16(const Mask16 on, const Vec16 value, Vec16 *sum) { *sum = where16(on, add16(*sum, value), *sum); }

// What lanes that left the scene bring from the environment.
static inline void leave16(const SceneData *scene, const __global Params *params, const Mask16 on, Paths16 *p) {
#if PENUMBRA_ENVIRONMENT
  if (scene->environment_light == NONE || !any16(on)) return;
  const Vec16 wi = normalize16(p->ray.d);
  float16 weight = 1.0f;
  const Mask16 shared = on & ~p->delta;
  if (any16(shared)) {
    const float16 chance = light_chance16(scene, params, &p->from, (uint16)(scene->environment_light), shared);
    const float16 pdf = environment_pdf16(scene, p->from.n, wi, shared);
    weight = shared ? hit_weight16(params, p->lobe_pdf, pdf, chance) : weight;
  }
  p->result.effects |= on ? (uint16)(EFFECT_ENVIRONMENT) : (uint16)(0u);
  add_where16(on, scale16(mul16(p->beta, environment_radiance16(scene, wi, on)), weight), &p->result.radiance);
#endif
}

// What the lanes of `on` that met lights bring from them.
static inline void meet_lights16(const SceneData *scene, const __global Params *params, const Hit16 *hit,
                                 const Surface16 *surface, const Vec16 wo, Mask16 on, Paths16 *p) {
#if PENUMBRA_AREA_LIGHTS
  const uint16 light = as_uint16(shape_rows16(scene, surface->shape, SHAPE_MATERIAL, on).y);
  on &= (light != NONE);
  if (!any16(on)) return;
  const Lights16 lights = lights16(scene, light, on);
  const Vec16 emitted = light_emitted16(&lights, surface->ng, wo, on);
  const Mask16 shines = on & (max3_16(emitted) > 0.0f);
  if (!any16(shines)) return;
  float16 weight = 1.0f;
  const Mask16 shared = shines & ~p->delta;
  if (any16(shared)) {
    const float16 distance = hit->t * length16(p->ray.d);
    const float16 pdf = light_hit_pdf16(scene, &lights, p->from.p, surface->ng, surface->primitive, neg16(wo), distance,
                                        p->ray.time, shared);
    const float16 chance = light_chance16(scene, params, &p->from, light, shared);
    weight = shared ? hit_weight16(params, p->lobe_pdf, pdf, chance) : weight;
  }
  p->result.effects |= shines ? (uint16)(EFFECT_AREA_LIGHT) : (uint16)(0u);
  add_where16(shines, scale16(mul16(p->beta, emitted), weight), &p->result.radiance);
#endif
}

#if PENUMBRA_LAYERS
static inline void layers16(const SceneData *scene, const __global Params *params, const Hit16 *hit, const Surface16 *surface,
                            const Bsdf16 *bsdf, const Mask16 on, Paths16 *p) {
  const float3 axis = camera_axis(&params->camera);
  p->result.albedo = where16(on, bsdf_albedo16(scene, bsdf, on), p->result.albedo);
  p->result.normal = where16(on, surface->ns, p->result.normal);
  p->result.depth = on ? hit->t * dot16(p->ray.d, all16(axis)) : p->result.depth;
  for (LANES_OF(k, on)) {
    const Surface s = lane_surface(surface, k);
    LANE_U(p->result.object_id, k) = object_of(scene, &s);
  }
}
#endif

// path_look: the lanes that go on.
static inline Mask16 look16(const SceneData *scene, const __global Params *params, const uint bounce, const Hit16 *hit,
                            const Mask16 on, Paths16 *p, Surface16 *surface, Bsdf16 *bsdf) {
  surfaces16(scene, &p->ray, hit, on, surface);
  const Vec16 wo = neg16(normalize16(p->ray.d));
  meet_lights16(scene, params, hit, surface, wo, on, p);
  if (bounce > params->max_bounces) return (Mask16)(0);
  bsdf_start16(scene, surface, wo, on, bsdf);
  if (bounce == 0u) {
    p->result.alpha = on ? (float16)(1.0f) : p->result.alpha;
#if PENUMBRA_LAYERS
    layers16(scene, params, hit, surface, bsdf, on, p);
#endif
  }
  const Vec16 zero = all16((float3)(0.0f));
  p->from.p = surface->p;
  p->from.n = where16(bsdf_transmits16(bsdf), zero, bsdf->n);
  return on;
}

static inline Mask16 lights_alone16(const __global Params *params, const Bsdf16 *bsdf) {
  const bool all = (params->options & (OPTION_LIGHTS_TO_MEET | OPTION_NO_MIS)) != OPTION_LIGHTS_TO_MEET;
  return all ? (Mask16)(-1) : bsdf_is_wide16(bsdf);
}

// Rays to lights, and what they bring unless something is in between.
typedef struct {
  Ray16 ray;
  Vec16 value;
  uint16 effect;
} LightRay16;

// Numbers for a sample of each lane's light: only of those that ask for them.
typedef struct {
  Point16 u;
  float16 triangle;
} LightNumbers16;

// Which numbers of a sampler those are: number j of `count`, in two dimensions.
typedef struct {
  ulong point, triangle;
  uint j, count;
} LightDimensions;

// Number j of the points that lanes choose lights by, and places on them.
static inline Point16 light_point16(const Numbers16 *numbers, const LightDimensions *dims, const Mask16 on) {
  if (numbers->light) return *numbers->light;
  Point16 none;
  none.x = none.y = 0.0f;
  return any16(on) ? sample_2d_of16(numbers->samples, dims->point, dims->j, dims->count, on) : none;
}

static inline float16 light_triangle16(const Numbers16 *numbers, const Lights16 *lights, const LightDimensions *dims,
                                       const Mask16 on) {
  const Mask16 triangles = on & lights_have_triangles16(lights, on);
  const float16 none = 0.0f;
  return any16(triangles) ? sample_1d_of16(numbers->samples, dims->triangle, dims->j, dims->count, triangles) : none;
}

// light_ray of the lanes of `on`: those to which something may come.
static inline Mask16 light_rays16(const SceneData *scene, const Surface16 *surface, const Bsdf16 *bsdf, const Receiver16 *receiver,
                                  const Lights16 *lights, const float16 time, const LightNumbers16 *u, const float16 chance,
                                  const Mask16 use_mis, const Mask16 on, LightRay16 *out) {
  LightSample16 sample;
  Mask16 come = light_sample16(scene, lights, receiver, time, u->triangle, u->u.x, u->u.y, on, &sample);
  if (!any16(come)) return come;
  const Mask16 delta = ~lights_have_extent16(lights, come);
  float16 lobe_pdf;
  const Vec16 value = mul16(bsdf_eval16(scene, bsdf, sample.wi, come, &lobe_pdf), sample.radiance);
  come &= !(value.x + value.y + value.z == 0.0f);
  if (!any16(come)) return come;
  const float16 one = 1.0f;
  const float16 weight = use_mis & ~delta ? power_heuristic16(chance * sample.pdf, lobe_pdf) : one;
  const Mask16 near = come & (sample.distance < INF_F);
  if (any16(near)) out->ray = spawn_ray_to16(surface, sample.p, sample.p_error, sample.n, time);
  if (any16(come & ~near)) {
    const Ray16 away = spawn_ray16(surface, sample.wi, time);
    out->ray.o = where16(near, out->ray.o, away.o);
    out->ray.d = where16(near, out->ray.d, away.d);
    out->ray.tmax = near ? out->ray.tmax : away.tmax;
    out->ray.time = time;
  }
  out->value = scale16(value, weight / sample.pdf);
  out->effect = delta ? (uint16)(EFFECT_DELTA_LIGHT) : (uint16)(EFFECT_AREA_LIGHT);
  return come;
}

// direct_ray: the lanes to which something may come.
static inline Mask16 direct_rays16(const SceneData *scene, const __global Params *params, const Numbers16 *numbers,
                                   const Surface16 *surface, const Bsdf16 *bsdf, const Receiver16 *receiver, const uint bounce,
                                   const uint n, const float16 time, const Mask16 use_mis, const Mask16 on, LightRay16 *out) {
  const uint picks = params->shadow_rays;
  const bool all = (params->options & OPTION_ALL_LIGHTS) != 0u;
  const uint each = n / picks;  // the light, where all are asked
  LightDimensions dims;
  dims.point = all ? DIM_LIGHT(bounce, SLOT_LIGHT, each) : DIM_BOUNCE(bounce, SLOT_LIGHT);
  dims.triangle = all ? DIM_LIGHT(bounce, SLOT_LIGHT_TRIANGLE, each) : DIM_BOUNCE(bounce, SLOT_LIGHT_TRIANGLE);
  dims.j = all ? n - each * picks : n;
  dims.count = picks;
  const bool chooses = !all && light_entries(scene) > 1u;
  LightNumbers16 u;
  u.u = light_point16(numbers, &dims, chooses || light_has_extent(scene, each) ? on : (Mask16)(0));
  float16 pmf = 1.0f;
  uint16 light = each;
  if (!all) light = light_choose16(scene, receiver, on, &u.u, &pmf);
  const Mask16 asks = on & (pmf > 0.0f);
  if (!any16(asks)) return asks;
  const Lights16 lights = lights16(scene, light, asks);
  u.triangle = light_triangle16(numbers, &lights, &dims, asks);
  const Mask16 come = light_rays16(scene, surface, bsdf, receiver, &lights, time, &u, (float)picks * pmf, use_mis, asks, out);
  out->value = scale16(out->value, 1.0f / pmf);
  return come;
}

// Whether rays go through the trees together: alike ones always, any where the trees are small.
static inline bool any_together16(const __global Params *params) {
#if PENUMBRA_LARGE_TREES
  return (params->options & OPTION_TOGETHER) != 0u;
#else
  return true;
#endif
}
static inline bool together16(const __global Params *params, const bool alike) { return alike || any_together16(params); }

// Rays of one pixel's hits to lights are alike, but for those to the environment, which go anywhere.
static inline bool alike_to_lights16(const LightRay16 *rays, const uint bounce, const Mask16 on) {
  return bounce == 0u && !any16(on & (rays->ray.tmax == INF_F) & (rays->effect != EFFECT_DELTA_LIGHT));
}

// Light that vectors of paths wait for: their hits' last rays to lights, which are followed when those of all vectors are known.
typedef struct {
  LightRay16 rays;
  Mask16 lit;          // the lanes that wait
  Mask16 smooth;       // and those that gather light here
  Vec16 direct, beta;  // what they have of it so far, and the path's weight
} Waiting16;

// The rays of the lanes of `arrive` met nothing. direct: the sum over the samples.
static inline void arrive16(const LightRay16 *rays, const Mask16 arrive, Paths16 *p, Vec16 *direct) {
  p->result.effects |= arrive ? rays->effect : (uint16)(0u);
  add_where16(arrive, rays->value, direct);
}

// Asks the lights, number n of the samples, and follows the rays to them, but for the last: these wait, unless they are alike and all
// others fly.
static inline void shine16(const SceneData *scene, const __global Params *params, const Numbers16 *numbers, const uint bounce,
                           const uint n, const bool last, const Surface16 *surface, const Bsdf16 *bsdf, const Mask16 smooth,
                           Paths16 *p, Waiting16 *waiting) {
  Mask16 use_mis = (params->options & OPTION_NO_MIS) ? (Mask16)(0) : (Mask16)(-1);
  if (bounce >= params->max_bounces) use_mis &= ~lights_alone16(params, bsdf);
  LightRay16 *rays = &waiting->rays;
  const Mask16 lit = direct_rays16(scene, params, numbers, surface, bsdf, &p->from, bounce, n, p->ray.time, use_mis, smooth, rays);
  if (!any16(lit)) return;
  p->result.rays += lit ? (uint16)(1u) : (uint16)(0u);
  const bool packed = any_together16(params), together = packed || alike_to_lights16(rays, bounce, lit);
  if (last && (packed || !together)) waiting->lit = lit;
  else arrive16(rays, lit & ~occluded16(scene, together, &rays->ray, lit), p, &waiting->direct);
}

static inline void gather_light16(const __global Params *params, const Waiting16 *w, Paths16 *p) {
  const float16 share = 1.0f / (float)params->shadow_rays;
  add_where16(w->smooth, mul16(w->beta, scale16(w->direct, share)), &p->result.radiance);
}

// Light from all samples of the lanes' hits: what is known of it waits for the rest.
static inline void ask_lights16(const SceneData *scene, const __global Params *params, const Numbers16 *numbers, const uint bounce,
                                const uint lights, const Surface16 *surface, const Bsdf16 *bsdf, const Mask16 on, Paths16 *p,
                                Waiting16 *waiting) {
  waiting->smooth = on & bsdf_has_smooth16(bsdf);
  waiting->direct = all16((float3)(0.0f));
  waiting->beta = p->beta;
  if (!any16(waiting->smooth)) return;
  for (uint n = 0u; n < lights; n++)
    shine16(scene, params, numbers, bounce, n, n + 1u == lights, surface, bsdf, waiting->smooth, p, waiting);
}

static inline Mask16 roulette16(const __global Params *params, const Sampler16 *samples, const uint bounce, const Mask16 on,
                                Vec16 *beta) {
  if (bounce < params->roulette_start) return on;
  const float16 survival = max3_16(*beta);
  const Mask16 played = on & !(survival >= 1.0f);
  if (!any16(played)) return on;
  const Mask16 survives = sample_1d16(samples, DIM_BOUNCE(bounce, SLOT_ROULETTE), played) < survival;
  *beta = where16(played, scale16(*beta, 1.0f / survival), *beta);
  return on & (~played | survives);
}

// path_scatter: the lanes that go on.
static inline Mask16 scatter16(const SceneData *scene, const __global Params *params, const Numbers16 *numbers, const uint bounce,
                               const Surface16 *surface, const Bsdf16 *bsdf, Mask16 on, Paths16 *p) {
#if PENUMBRA_INDIRECT
  const bool last = bounce >= params->max_bounces;
  const Mask16 alone = last ? lights_alone16(params, bsdf) : (Mask16)(0);
  on &= (bsdf->type != MATERIAL_BLACK);
  if (last) on &= ~bsdf_is_wide16(bsdf);
  if (!any16(on)) return on;
  float16 u_lobe = 0.0f;
  const Mask16 lobes = on & bsdf_has_lobes16(bsdf);
  if (any16(lobes)) u_lobe = lobes ? sample_1d16(numbers->samples, DIM_BOUNCE(bounce, SLOT_LOBE), lobes) : u_lobe;
  Point16 u;
  u.x = u.y = 0.5f;
  const Mask16 spread = on & bsdf_has_spread16(bsdf);
  if (any16(spread)) {
    Point16 drawn;
    if (numbers->direction) drawn = *numbers->direction;
    else drawn = sample_2d16(numbers->samples, DIM_BOUNCE(bounce, SLOT_DIRECTION), spread);
    u.x = spread ? drawn.x : u.x;
    u.y = spread ? drawn.y : u.y;
  }
  Vec16 wi, weight;
  float16 pdf;
  uint16 event;
  on = bsdf_sample16(scene, bsdf, u_lobe, u, on, &wi, &weight, &pdf, &event);
  p->lobe_pdf = on ? pdf : p->lobe_pdf;
  p->delta = (event & BSDF_EVENT_DELTA) != 0u;
  if (last) on &= p->delta ? (Mask16)(light_entries(scene) == 0u ? 0 : -1) : ~alone;
  p->beta = where16(on, mul16(p->beta, weight), p->beta);
  const uint16 sort = p->delta ? (uint16)(EFFECT_GLOSS) : (uint16)(EFFECT_DIFFUSE);
  const uint16 effect = (event & BSDF_EVENT_TRANSMIT) != 0u ? (uint16)(EFFECT_TRANSMISSION) : sort;
  p->result.effects |= on ? effect : (uint16)(0u);
  const float16 throughput = p->beta.x + p->beta.y + p->beta.z;
  const Mask16 dark = on & !(throughput > 0.0f);
  p->result.radiance = where16(dark & (throughput != throughput), p->beta, p->result.radiance);
  on &= ~dark;
  if (!any16(on)) return on;
  on = roulette16(params, numbers->samples, bounce, on, &p->beta);
  p->ray = spawn_ray16(surface, wi, p->ray.time);
  return on;
#else
  return (Mask16)(0);
#endif
}

// Lanes of `on` have followed their rays to p->hit, where they met anything.
static inline void meet16(const SceneData *scene, const __global Params *params, const Mask16 found, const Mask16 on, Paths16 *p) {
  p->result.rays += on ? (uint16)(1u) : (uint16)(0u);
  leave16(scene, params, on & ~found, p);
}

// What the lanes of `on` do at their hits: those that go on.
static inline Mask16 shade16(const SceneData *scene, const __global Params *params, const Numbers16 *numbers, const uint bounce,
                             const uint lights, const Mask16 on, Paths16 *p, Waiting16 *waiting) {
  Surface16 surface;
  Bsdf16 bsdf;
  waiting->lit = waiting->smooth = 0;
  if (!any16(on)) return on;
  const Mask16 shaded = look16(scene, params, bounce, &p->hit, on, p, &surface, &bsdf);
  if (!any16(shaded)) return shaded;
  ask_lights16(scene, params, numbers, bounce, lights, &surface, &bsdf, shaded, p, waiting);
  return scatter16(scene, params, numbers, bounce, &surface, &bsdf, shaded, p);
}
