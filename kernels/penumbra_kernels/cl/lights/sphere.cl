// Sphere light, emitting outwards (and inwards where two-sided). Metres; densities per solid angle at the lit point p.
//
// Seen from outside it is sampled uniformly in the cone that it subtends, from inside uniformly in all directions; with
// PENUMBRA_LIGHT_AREA_SAMPLING uniformly by area, so that half of the samples lie on the far side and carry nothing.
//
// A sphere that an instance carries is sampled in the instance's frame, where it is round whatever the matrix M does; the
// linear map takes a solid angle d omega to d omega |det M| / |M omega|^3.
#include "lights/light_sample.h"
#include "lights/placement.cl"
#include "sampling/warp.cl"

typedef struct {
  float3 center;
  float radius;
  bool placed;                   // in an instance's frame
  float world_from_object[3][4];
  float object_from_world[3][4];
  float volume;                  // |det| of world_from_object
} Sphere;

// The lit point's view of a round sphere.
typedef struct {
  float3 to_center;              // from the lit point
  float distance;                // to the center
  bool inside;
  float pdf;                     // of a direction, in the sphere's frame
  float one_minus_cos;           // of the cone
} SphereView;

static inline Sphere sphere_at(const SceneData *scene, const __global Light *light, const float time) {
  Sphere s;
  s.center = load3(light->position);
  s.radius = light->inner;
  s.volume = 1.0f;
  s.placed = area_light_placement(scene, light, time, s.world_from_object, s.object_from_world);
  if (s.placed) s.volume = FABS(determinant(s.world_from_object));
  return s;
}

// What rounding may put a point of the sphere's own surface off it by, in the sphere's frame (geometry/surface_round.cl). The lit
// point p is in the world.
static inline float own_slack(const Sphere *s, const float3 p) {
  const float slack = GAMMA(16) * s->radius + GAMMA(8) * max3(abs3(s->center));
  return s->placed ? slack + GAMMA(16) * max3(transform_magnitude(s->object_from_world, p)) : slack;
}

// False where p sees no emitting side: inside a one-sided sphere. Its own points, which rounding may have put outside, count as
// inside: else it would light itself there. What lies as near from outside is lit by directions of the lobe alone.
static inline bool sphere_view(const Sphere *s, const float3 p, const bool two_sided, SphereView *view) {
  view->to_center = s->center - (s->placed ? transform_point(s->object_from_world, p) : p);
  view->distance = length3(view->to_center);
  view->inside = !(view->distance > s->radius);
  if (!two_sided && !(view->distance > s->radius + own_slack(s, p))) return false;
  // 1 - cos = sin^2 / (1 + cos): keeps its digits however small the sphere looks
  const float ratio = s->radius / view->distance;
  const float cosine = SQRT(MAX((1.0f - ratio) * (1.0f + ratio), 0.0f));
  view->one_minus_cos = view->inside ? 2.0f : ratio * ratio / (1.0f + cosine);
  view->pdf = INV_2PI_F / view->one_minus_cos;
  return true;
}

// Unit normal, outside, where a direction in the cone meets the sphere first. w: unit, to the center; the direction
// makes the angle theta with it, at the azimuth of the unit vector t. The angle alpha at the center follows from the sine rule
// without subtracting distances (pbrt-v4, section 6.2.4), so that it stays exact for spheres that look tiny.
static inline float3 cone_normal(const SphereView *view, const float radius, const float3 w, const float3 t,
                                 const float one_minus_cos, const float sin2) {
  const float sin_max = radius / view->distance;
  const float cos_theta = 1.0f - one_minus_cos;
  const float s = MIN(SQRT(sin2) / sin_max, 1.0f);  // sine of the angle of incidence
  const float c = SQRT(MAX((1.0f - s) * (1.0f + s), 0.0f));
  const float cos_alpha = MIN(s * SQRT(sin2) + cos_theta * c, 1.0f);
  const float sin_alpha = MAX(s * cos_theta - SQRT(sin2) * c, 0.0f);
  return t * sin_alpha - w * cos_alpha;
}

// A direction in the cone (or all around) and the normal at its first hit, in the sphere's frame.
static inline float3 sphere_direction(const SphereView *view, const float radius, const float2 u, float3 *n) {
  if (view->inside) {
    const float3 d = square_to_sphere(u);
    const float along = dot3(view->to_center, d);
    const float room = (radius - view->distance) * (radius + view->distance);
    *n = (d * (along + SQRT(MAX(along * along + room, 0.0f))) - view->to_center) * (1.0f / radius);
    return d;
  }
  const float3 w = view->to_center * (1.0f / view->distance);
  float3 s, t;
  make_frame(w, &s, &t);
  const float one_minus_cos = u.x * view->one_minus_cos;
  const float sin2 = one_minus_cos * (2.0f - one_minus_cos);
  float sine_phi, cosine_phi;
  sincos_2pi(u.y, &sine_phi, &cosine_phi);
  const float3 azimuth = s * cosine_phi + t * sine_phi;
  *n = cone_normal(view, radius, w, azimuth, one_minus_cos, sin2);
  return w * (1.0f - one_minus_cos) + azimuth * SQRT(sin2);
}

// Puts the point with the object-space normal n into the sample.
static inline void sphere_target(const Sphere *s, const float3 n, LightSample *out) {
  const float3 reach = abs3(s->center) + s->radius;
  out->p = s->center + s->radius * n;
  out->n = normalize3(n);
  if (s->placed) {
    out->p = transform_point(s->world_from_object, out->p);
    out->n = normalize3(transform_normal(s->object_from_world, n));
  }
  out->p_error = (s->placed ? transform_magnitude(s->world_from_object, reach) : reach) * PLACED_ERROR;
}

#if PENUMBRA_LIGHT_AREA_SAMPLING
// Density per area in the world at a unit normal n of the object's frame: uniform over the round sphere, and so over any
// similar to it. M^-T n takes normals to the world; areas grow by its length times the volume factor.
static inline float sphere_density(const Sphere *s, const float3 n) {
  const float density = 0.25f * INV_PI_F / sqr(s->radius);
  return s->placed ? density / (s->volume * length3(transform_normal(s->object_from_world, n))) : density;
}
#endif

static inline bool sphere_light_sample(const SceneData *scene, const __global Light *light, const float3 p,
                                       const float time, const float2 u, LightSample *out) {
  const bool two_sided = (light->flags & LIGHT_TWO_SIDED) != 0u;
  const Sphere s = sphere_at(scene, light, time);
  SphereView view;
  if (!sphere_view(&s, p, two_sided, &view)) return false;
#if PENUMBRA_LIGHT_AREA_SAMPLING
  const float3 n = square_to_sphere(u);
  sphere_target(&s, n, out);
  if (!aim(p, out)) return false;
  const float cosine = -dot3(out->n, out->wi);
  if (cosine < 0.0f && !two_sided) return false;
  out->pdf = sqr(out->distance) * sphere_density(&s, n) / FABS(cosine);
  if (cosine < 0.0f) out->n = -out->n;
#else
  float3 n;
  const float3 direction = sphere_direction(&view, s.radius, u, &n);
  sphere_target(&s, n, out);
  if (!aim(p, out)) return false;
  out->wi = direction;
  out->pdf = view.pdf;
  if (s.placed) {
    const float3 d = transform_vector(s.world_from_object, direction);
    const float stretch = length3(d);
    out->wi = d * (1.0f / stretch);
    out->pdf = view.pdf * stretch * stretch * stretch / s.volume;
  }
  if (view.inside) out->n = -out->n;
#endif
  return usable(out->pdf);
}

// ng: unit normal at the hit, outside, world frame.
static inline float sphere_light_hit_pdf(const SceneData *scene, const __global Light *light, const float3 p,
                                         const float3 ng, const float3 wi, const float distance, const float time) {
  const bool two_sided = (light->flags & LIGHT_TWO_SIDED) != 0u;
  const Sphere s = sphere_at(scene, light, time);
  SphereView view;
  if (!sphere_view(&s, p, two_sided, &view)) return 0.0f;
#if PENUMBRA_LIGHT_AREA_SAMPLING
  const float cosine = -dot3(ng, wi);
  if (cosine < 0.0f && !two_sided) return 0.0f;
  const float3 n = s.placed ? transform_normal(s.world_from_object, ng) : ng;
  const float pdf = sqr(distance) * sphere_density(&s, normalize3(n)) / FABS(cosine);
#else
  float pdf = view.pdf;
  if (s.placed) {
    const float shrink = length3(transform_vector(s.object_from_world, wi));
    pdf = view.pdf / (shrink * shrink * shrink * s.volume);
  }
#endif
  return usable(pdf) ? pdf : 0.0f;
}
