// Still sphere lights (lights/sphere.cl), each seen from its lane's lit point, with the bits of the scalar functions. World frame,
// metres; densities per solid angle at the lit points. By solid angle alone: programs that sample by area take it lane by lane.
#include "lights/sphere.cl"
#include "lights/light_sample16.h"
#include "lights/records16.cl"
#include "sampling/warp16.cl"

typedef struct {
  Vec16 center, to_center;
  float16 radius, distance, sin_max, pdf, one_minus_cos;
  Mask16 inside;
} SphereView16;

// The lanes of `on` that see an emitting side.
static inline Mask16 sphere_view16(const Lights16 *lights, const Vec16 p, const Mask16 on, SphereView16 *view) {
  const Rows16 center = light_rows16(lights, lights->records->position, on);
  const float16 radius = light_rows16(lights, lights->records->direction, on).w;
  view->radius = radius;
  view->center = xyz16(&center);
  const float16 all_around = 2.0f;
  view->to_center = sub16(view->center, p);
  view->distance = length16(view->to_center);
  view->inside = ~(view->distance > radius);
  const float16 ratio = radius / view->distance;
  const float16 cosine = safe_sqrt16((1.0f - ratio) * (1.0f + ratio));
  view->sin_max = ratio;
  view->one_minus_cos = view->inside ? all_around : ratio * ratio / (1.0f + cosine);
  view->pdf = INV_2PI_F / view->one_minus_cos;
  const float16 slack = GAMMA(16) * radius + GAMMA(8) * max3_16(abs3_16(view->center));
  return on & (two_sided16(lights) | (view->distance > radius + slack));
}

static inline Vec16 cone_normal16(const SphereView16 *view, const Vec16 w, const Vec16 t, const float16 one_minus_cos,
                                  const float16 root_sin2) {
  const float16 zero = 0.0f, one = 1.0f;
  const float16 cos_theta = 1.0f - one_minus_cos;
  const float16 incidence = root_sin2 / view->sin_max;
  const float16 s = MIN16(incidence, one);
  const float16 c = safe_sqrt16((1.0f - s) * (1.0f + s));
  const float16 cos_sum = s * root_sin2 + cos_theta * c;
  const float16 sin_sum = s * cos_theta - root_sin2 * c;
  return sub16(scale16(t, MAX16(sin_sum, zero)), scale16(w, MIN16(cos_sum, one)));
}

static inline Vec16 cone_direction16(const SphereView16 *view, const float16 ux, const float16 uy, Vec16 *n) {
  const Vec16 w = scale16(view->to_center, 1.0f / view->distance);
  Vec16 s, t;
  make_frame16(w, &s, &t);
  const float16 one_minus_cos = ux * view->one_minus_cos;
  const float16 root_sin2 = sqrt16(one_minus_cos * (2.0f - one_minus_cos));
  float16 sine_phi, cosine_phi;
  sincos_2pi16(uy, &sine_phi, &cosine_phi);
  const Vec16 azimuth = add16(scale16(s, cosine_phi), scale16(t, sine_phi));
  *n = cone_normal16(view, w, azimuth, one_minus_cos, root_sin2);
  return add16(scale16(w, 1.0f - one_minus_cos), scale16(azimuth, root_sin2));
}

static inline Vec16 inside_direction16(const SphereView16 *view, const float16 ux, const float16 uy, Vec16 *n) {
  const Vec16 d = square_to_sphere16(ux, uy);
  const float16 along = dot16(view->to_center, d);
  const float16 room = (view->radius - view->distance) * (view->radius + view->distance);
  *n = scale16(sub16(scale16(d, along + safe_sqrt16(along * along + room)), view->to_center), 1.0f / view->radius);
  return d;
}

// A direction of each lane of `on`, and the outside's normal where it meets the sphere first.
static inline Vec16 sphere_direction16(const SphereView16 *view, const float16 ux, const float16 uy, const Mask16 on,
                                       Vec16 *n) {
  Vec16 wi = cone_direction16(view, ux, uy, n);
  if (!any16(on & view->inside)) return wi;
  Vec16 inner;
  wi = where16(view->inside, inside_direction16(view, ux, uy, &inner), wi);
  *n = where16(view->inside, inner, *n);
  return wi;
}

// sphere_light_sample of the lanes of `on`, whose lights are spheres that no instance carries. Fills in all but the radiance.
static inline Mask16 sphere_light_sample16(const Lights16 *lights, const Vec16 p, const float16 ux, const float16 uy,
                                           const Mask16 on, LightSample16 *out) {
  SphereView16 view;
  Vec16 n;
  const Mask16 seen = sphere_view16(lights, p, on, &view);
  const Vec16 direction = sphere_direction16(&view, ux, uy, seen, &n);
  out->p = add16(view.center, scale16(n, view.radius));
  const Vec16 reach = abs3_16(view.center);
  out->p_error = scale16(add16(reach, vec16(view.radius, view.radius, view.radius)), PLACED_ERROR);
  const Vec16 outside = normalize16(n);
  out->n = where16(view.inside, neg16(outside), outside);
  const Mask16 aimed = seen & aim16(p, out);
  out->wi = direction;
  out->pdf = view.pdf;
  return aimed & usable16(out->pdf);
}

static inline float16 sphere_light_hit_pdf16(const Lights16 *lights, const Vec16 p, const Mask16 on) {
  const float16 none = 0.0f;
  SphereView16 view;
  const Mask16 seen = sphere_view16(lights, p, on, &view);
  return seen & usable16(view.pdf) ? view.pdf : none;
}
