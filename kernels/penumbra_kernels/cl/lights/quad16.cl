// A still quad light (lights/quad.cl) seen from sixteen lit points, each with the bits of the scalar functions. What all of them
// share is computed once. World frame, metres; densities per solid angle at the lit points.
#include "lights/quad.cl"
#include "lights/light_sample16.h"
#include "lights/spherical_triangle16.cl"

// What does not depend on the lit point.
typedef struct {
  Quad quad;
  float3 n;         // unit, along u x v
  float area;
  float size;       // square of the half diameter
  bool two_sided, is_rectangle;
} StillQuad;

typedef struct {
  Vec16 o, n;
  float16 height, solid_angle, distance0, distance3;
  Mask16 by_rectangle, by_fan;
} QuadView16;

// False where the quad has no area.
static inline bool still_quad_at(const __global Light *light, StillQuad *still) {
  still->quad = still_quad(light);
  const Quad *q = &still->quad;
  const float3 cross = cross3(q->u, q->v);
  still->area = length3(cross);
  still->n = cross * (1.0f / still->area);
  still->size = quad_size(q);
  still->two_sided = (light->flags & LIGHT_TWO_SIDED) != 0u;
  still->is_rectangle = quad_is_rectangle(q);
  return still->area > 0.0f;
}

// quad_corner of each lane.
static inline Vec16 quad_corner16(const StillQuad *still, const QuadView16 *view, const uint i) {
  const Vec16 u = all16(still->quad.u), v = all16(still->quad.v);
  if (i == 0u) return view->o;
  if (i == 1u) return add16(view->o, u);
  if (i == 2u) return add16(add16(view->o, u), v);
  return add16(view->o, v);
}

static inline void quad_solid_angle16(const StillQuad *still, QuadView16 *view) {
  const Vec16 r1 = quad_corner16(still, view, 1u), r2 = quad_corner16(still, view, 2u), r3 = quad_corner16(still, view, 3u);
  view->distance0 = length16(view->o);
  view->distance3 = length16(r3);
  const float16 i0 = 1.0f / view->distance0, i1 = 1.0f / length16(r1), i2 = 1.0f / length16(r2), i3 = 1.0f / view->distance3;
  const Vec16 d0 = scale16(view->o, i0), d1 = scale16(r1, i1), d2 = scale16(r2, i2), d3 = scale16(r3, i3);
  const float16 cos01 = dot16(d0, d1), cos12 = dot16(d1, d2), cos23 = dot16(d2, d3);
  const float16 cos03 = dot16(d0, d3), cos02 = dot16(d0, d2);
  const float16 volume = view->height * i0 * still->area * i2;
  const float16 v1 = volume * i1, v2 = volume * i3;
  const float16 g1 = 1.0f + cos01 + cos12 + cos02, g2 = 1.0f + cos02 + cos23 + cos03;
  view->solid_angle = 2.0f * atan2_16(g1 * v2 + g2 * v1, g1 * g2 - v1 * v2);
}

// How each lane samples the quad.
static inline void quad_strategy16(const StillQuad *still, const Mask16 seen, QuadView16 *view) {
  view->by_rectangle = view->by_fan = 0;
#if !PENUMBRA_LIGHT_AREA_SAMPLING
  const Vec16 center = add16(add16(view->o, all16(0.5f * still->quad.u)), all16(0.5f * still->quad.v));
  const Mask16 near = still->size >= FLAT_FAR * dot16(center, center);
  if (!any16(near & seen)) return;
  quad_solid_angle16(still, view);
  const Mask16 wide = view->solid_angle >= RECTANGLE_SOLID_ANGLE;
  view->by_rectangle = still->is_rectangle ? near & wide : (Mask16)(0);
  view->by_fan = near & ~view->by_rectangle;
#endif
}

// The lanes of `on` that see an emitting side.
static inline Mask16 quad_view16(const StillQuad *still, const Vec16 p, const Mask16 on, QuadView16 *view) {
  const Vec16 n = all16(still->n);
  view->o = sub16(all16(still->quad.o), p);
  const float16 signed_height = -dot16(view->o, n);
  view->height = abs16(signed_height);
  const Vec16 slack = add16(all16(still->quad.p_error), scale16(abs3_16(p), GAMMA(2)));
  const Mask16 behind = signed_height < 0.0f;
  Mask16 seen = on & (view->height > dot16(all16(abs3(still->n)), slack));
  if (!still->two_sided) seen &= ~behind;
  view->n = where16(behind, neg16(n), n);
  quad_strategy16(still, seen, view);
  return seen;
}

static inline float16 quad_pdf16(const StillQuad *still, const QuadView16 *view, const float16 distance) {
  const float16 by_area = flat_area_pdf16(distance, view->height, still->area);
  const Mask16 by_angle = view->by_rectangle | view->by_fan;
  return any16(by_angle) ? (by_angle ? 1.0f / view->solid_angle : by_area) : by_area;
}

typedef struct {
  float16 inverse_reach, sine, cosine;
} Elevation16;

static inline Elevation16 elevation16(const float16 y, const float16 height) {
  Elevation16 e;
  e.inverse_reach = 1.0f / sqrt16(y * y + height * height);
  e.sine = y * e.inverse_reach;
  e.cosine = height * e.inverse_reach;
  return e;
}

static inline float16 strip_end16(const float16 sine, const float16 cosine, const Elevation16 *e0, const Elevation16 *e1,
                                  const float16 height) {
  const float16 least = 0x1p-100f;
  const float16 f = e1->sine - cosine * e0->sine;
  const float16 g = sine * e0->cosine;
  const float16 product = (f - g) * (f + g);
  return height * sine / sqrt16(MAX16(product, least));
}

static inline float16 strip_end_grazing16(const float16 swept, const Elevation16 *e0, const Elevation16 *e1,
                                          const float16 height) {
  const float16 zero = 0.0f;
  const float16 a = abs16(swept);
  const float16 beta0 = atan2_16(e0->sine, e0->cosine);
  const float16 beta1 = atan2_16(e1->sine, e1->cosine);
  const float16 d = 0.5f * (beta1 - beta0);
  const float16 e = 0.5f * (beta1 + beta0);
  const float16 product = 4.0f * sine16(d + 0.5f * a) * sine16(d - 0.5f * a) * sine16(HALF_PI_F - (e + 0.5f * a)) *
                          sine16(HALF_PI_F - (e - 0.5f * a));
  return copy_sign16(height * sine16(a) / sqrt16(MAX16(product, zero)), swept);
}

static inline float16 rectangle_x16(const QuadView16 *view, const float16 x0, const float16 x1, const float16 y0,
                                    const float16 y1, const float16 u, const Mask16 on) {
  const float16 z = view->height;
  const Elevation16 e0 = elevation16(y0, z), e1 = elevation16(y1, z), ex = elevation16(x0, z);
  const float16 sine0 = ex.sine * e0.sine, cosine0 = ex.cosine * (view->distance0 * e0.inverse_reach);
  const float16 sine1 = ex.sine * e1.sine, cosine1 = ex.cosine * (view->distance3 * e1.inverse_reach);
  const float16 sine_before = sine1 * cosine0 - cosine1 * sine0;
  const float16 cosine_before = cosine1 * cosine0 + sine1 * sine0;
  const float16 ax0 = abs16(x0), ax1 = abs16(x1);
  const Mask16 steep = MAX16(ax0, ax1) <= GRAZING * z;
  float16 s, c;
  sincos_2pi16(u * view->solid_angle * INV_2PI_F, &s, &c);
  const float16 x = strip_end16(s * cosine_before + c * sine_before, c * cosine_before - s * sine_before, &e0, &e1, z);
  if (!any16(on & ~steep)) return x;
  const float16 swept = u * view->solid_angle + (atan2_16(sine1, cosine1) - atan2_16(sine0, cosine0));
  return steep ? x : strip_end_grazing16(swept, &e0, &e1, z);
}

// (a, b) in the lanes of `on`.
static inline void quad_rectangle_point16(const StillQuad *still, const QuadView16 *view, const Mask16 on, float16 *a,
                                          float16 *b) {
  const Quad *q = &still->quad;
  const float width = length3(q->u), depth = length3(q->v);
  const float inverse_width = 1.0f / width, inverse_depth = 1.0f / depth;
  const float16 least = 0x1p-100f;
  const float16 z = view->height;
  const float16 x0 = dot16(view->o, all16(q->u)) * inverse_width;
  const float16 y0 = dot16(view->o, all16(q->v)) * inverse_depth;
  const float16 y1 = y0 + depth;
  const float16 across = clamp01_16((rectangle_x16(view, x0, x0 + width, y0, y1, *a, on) - x0) * inverse_width);
  const float16 x = across * width + x0;
  const float16 d2 = x * x + z * z;
  const float16 h0 = y0 / sqrt16(d2 + y0 * y0);
  const float16 h1 = y1 / sqrt16(d2 + y1 * y1);
  const float16 h = h0 + *b * (h1 - h0);
  const float16 square = (1.0f - h) * (1.0f + h);
  const float16 y = h * sqrt16(d2 / MAX16(square, least));
  *a = on ? across : *a;
  *b = on ? clamp01_16((y - y0) * inverse_depth) : *b;
}

// (a, b) in the lanes of `on`.
static inline void quad_fan_point16(const StillQuad *still, const QuadView16 *view, const Mask16 on, float16 *a, float16 *b) {
  const Vec16 u = all16(still->quad.u), v = all16(still->quad.v);
  const float16 volume = view->height * still->area;
  const Vec16 r1 = quad_corner16(still, view, 1u), r2 = quad_corner16(still, view, 2u), r3 = quad_corner16(still, view, 3u);
  const float16 swept = *a * 0.5f * view->solid_angle;
  SphericalTriangle16 t = spherical_triangle16(r1, view->o, r2, volume);
  const float16 first_half_angle = t.half_angle;
  const Mask16 second = swept >= first_half_angle;
  const Vec16 from = where16(second, r2, r1);
  if (any16(on & second)) t = spherical_triangle16(from, view->o, where16(second, r3, r2), volume);
  const float16 e = spherical_triangle_cut16(&t, second ? swept - first_half_angle : swept);
  const Vec16 edge = where16(second, neg16(u), v);
  const float16 f = spherical_triangle_reach16(&t, view->o, add16(from, scale16(edge, e)), *b);
  *a = on ? (second ? f * (1.0f - e) : f) : *a;
  *b = on ? (second ? f : f * e) : *b;
}

// quad_light_sample where no instance carries the light.
static inline Mask16 quad_light_sample16(const __global Light *light, const Vec16 p, const float16 ux, const float16 uy,
                                         const Mask16 on, LightSample16 *out) {
  StillQuad still;
  QuadView16 view;
  if (!still_quad_at(light, &still)) return (Mask16)(0);
  const Quad *q = &still.quad;
  const Mask16 seen = quad_view16(&still, p, on, &view);
  float16 a = ux, b = uy;
  if (any16(seen & view.by_rectangle)) quad_rectangle_point16(&still, &view, seen & view.by_rectangle, &a, &b);
  if (any16(seen & view.by_fan)) quad_fan_point16(&still, &view, seen & view.by_fan, &a, &b);
  out->p = add16(all16(q->o), add16(scale16(all16(q->u), a), scale16(all16(q->v), b)));
  out->p_error = all16(q->p_error);
  out->n = view.n;
  const Mask16 aimed = seen & aim16(p, out);
  out->pdf = quad_pdf16(&still, &view, out->distance);
  return aimed & usable16(out->pdf);
}

static inline float16 quad_light_hit_pdf16(const __global Light *light, const Vec16 p, const float16 distance,
                                           const Mask16 on) {
  const float16 none = 0.0f;
  StillQuad still;
  QuadView16 view;
  if (!still_quad_at(light, &still)) return none;
  const Mask16 seen = quad_view16(&still, p, on, &view);
  const float16 pdf = quad_pdf16(&still, &view, distance);
  return seen & usable16(pdf) ? pdf : none;
}
