// Still quad lights (lights/quad.cl), each seen from its lane's lit point, with the bits of the scalar functions. World frame, metres;
// densities per solid angle at the lit points.
#include "lights/quad.cl"
#include "lights/light_sample16.h"
#include "lights/records16.cl"
#include "lights/spherical_triangle16.cl"

// Quad of each lane, and what else does not depend on the lit point.
typedef struct {
  Vec16 o, u, v, p_error;
  Vec16 n;           // unit, along u x v
  float16 area;
  Mask16 two_sided;
} Quad16;

typedef struct {
  Vec16 o, n;
  float16 height, solid_angle, distance0, distance3;
  Mask16 by_rectangle, by_fan;
} QuadView16;

static PENUMBRA_NOINLINE PENUMBRA_WIDE void quads16(const Lights16 *lights, const Mask16 *on, Quad16 *q) {
  const Rows16 o = light_rows16(lights, lights->records->position, *on), u = light_rows16(lights, lights->records->direction, *on),
               v = light_rows16(lights, lights->records->axis_v, *on);
  q->o = xyz16(&o);
  q->u = xyz16(&u);
  q->v = xyz16(&v);
  q->p_error = scale16(add16(add16(abs3_16(q->o), abs3_16(q->u)), abs3_16(q->v)), PLACED_ERROR);
  q->two_sided = two_sided16(lights);
  const Vec16 cross = cross16(q->u, q->v);
  q->area = length16(cross);
  q->n = scale16(cross, 1.0f / q->area);
}

// quad_size and quad_is_rectangle of each lane.
static inline float16 quad_size16(const Quad16 *q) {
  const Vec16 half_u = scale16(q->u, 0.5f), half_v = scale16(q->v, 0.5f);
  return dot16(half_u, half_u) + dot16(half_v, half_v) + 2.0f * abs16(dot16(half_u, half_v));
}
static inline Mask16 quad_is_rectangle16(const Quad16 *q) {
  return sqr16(dot16(q->u, q->v)) <= sqr(RIGHT_ANGLE_COSINE) * dot16(q->u, q->u) * dot16(q->v, q->v);
}

// quad_corner of each lane.
static inline Vec16 quad_corner16(const Quad16 *q, const QuadView16 *view, const uint i) {
  if (i == 0u) return view->o;
  if (i == 1u) return add16(view->o, q->u);
  if (i == 2u) return add16(add16(view->o, q->u), q->v);
  return add16(view->o, q->v);
}

static inline void quad_solid_angle16(const Quad16 *q, QuadView16 *view) {
  const Vec16 r1 = quad_corner16(q, view, 1u), r2 = quad_corner16(q, view, 2u), r3 = quad_corner16(q, view, 3u);
  view->distance0 = length16(view->o);
  view->distance3 = length16(r3);
  const float16 i0 = 1.0f / view->distance0, i1 = 1.0f / length16(r1), i2 = 1.0f / length16(r2), i3 = 1.0f / view->distance3;
  const Vec16 d0 = scale16(view->o, i0), d1 = scale16(r1, i1), d2 = scale16(r2, i2), d3 = scale16(r3, i3);
  const float16 cos01 = dot16(d0, d1), cos12 = dot16(d1, d2), cos23 = dot16(d2, d3);
  const float16 cos03 = dot16(d0, d3), cos02 = dot16(d0, d2);
  const float16 volume = view->height * i0 * q->area * i2;
  const float16 v1 = volume * i1, v2 = volume * i3;
  const float16 g1 = 1.0f + cos01 + cos12 + cos02, g2 = 1.0f + cos02 + cos23 + cos03;
  view->solid_angle = 2.0f * atan2_16(g1 * v2 + g2 * v1, g1 * g2 - v1 * v2);
}

// How each lane samples the quad.
static inline void quad_strategy16(const Quad16 *q, const Mask16 seen, QuadView16 *view) {
  view->by_rectangle = view->by_fan = 0;
#if !PENUMBRA_LIGHT_AREA_SAMPLING
  const Vec16 center = add16(add16(view->o, scale16(q->u, 0.5f)), scale16(q->v, 0.5f));
  const Mask16 near = quad_size16(q) >= FLAT_FAR * dot16(center, center);
  if (!any16(near & seen)) return;
  quad_solid_angle16(q, view);
  const Mask16 wide = view->solid_angle >= RECTANGLE_SOLID_ANGLE;
  view->by_rectangle = near & wide & quad_is_rectangle16(q);
  view->by_fan = near & ~view->by_rectangle;
#endif
}

// The lanes of `on` that see an emitting side.
static inline Mask16 quad_view16(const Quad16 *q, const Vec16 p, const Mask16 on, QuadView16 *view) {
  view->o = sub16(q->o, p);
  const float16 signed_height = -dot16(view->o, q->n);
  view->height = abs16(signed_height);
  const Vec16 slack = add16(q->p_error, scale16(abs3_16(p), GAMMA(2)));
  const Mask16 behind = signed_height < 0.0f;
  const Mask16 seen = on & (q->area > 0.0f) & (view->height > dot16(abs3_16(q->n), slack)) & (q->two_sided | ~behind);
  view->n = where16(behind, neg16(q->n), q->n);
  quad_strategy16(q, seen, view);
  return seen;
}

static inline float16 quad_pdf16(const Quad16 *q, const QuadView16 *view, const float16 distance) {
  const float16 by_area = flat_area_pdf16(distance, view->height, q->area);
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
static inline void quad_rectangle_point16(const Quad16 *q, const QuadView16 *view, const Mask16 on, float16 *a,
                                          float16 *b) {
  const float16 width = length16(q->u), depth = length16(q->v);
  const float16 inverse_width = 1.0f / width, inverse_depth = 1.0f / depth;
  const float16 least = 0x1p-100f;
  const float16 z = view->height;
  const float16 x0 = dot16(view->o, q->u) * inverse_width;
  const float16 y0 = dot16(view->o, q->v) * inverse_depth;
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
static inline void quad_fan_point16(const Quad16 *q, const QuadView16 *view, const Mask16 on, float16 *a, float16 *b) {
  const float16 volume = view->height * q->area;
  const Vec16 r1 = quad_corner16(q, view, 1u), r2 = quad_corner16(q, view, 2u), r3 = quad_corner16(q, view, 3u);
  const float16 swept = *a * 0.5f * view->solid_angle;
  SphericalTriangle16 t = spherical_triangle16(r1, view->o, r2, volume);
  const float16 first_half_angle = t.half_angle;
  const Mask16 second = swept >= first_half_angle;
  const Vec16 from = where16(second, r2, r1);
  if (any16(on & second)) t = spherical_triangle16(from, view->o, where16(second, r3, r2), volume);
  const float16 e = spherical_triangle_cut16(&t, second ? swept - first_half_angle : swept);
  const Vec16 edge = where16(second, neg16(q->u), q->v);
  const float16 f = spherical_triangle_reach16(&t, view->o, add16(from, scale16(edge, e)), *b);
  *a = on ? (second ? f * (1.0f - e) : f) : *a;
  *b = on ? (second ? f : f * e) : *b;
}

// quad_light_sample of the lanes of `on`, whose lights are quads that no instance carries. Fills in all but the radiance.
static inline Mask16 quad_light_sample16(const Lights16 *lights, const Vec16 p, const float16 ux, const float16 uy,
                                         const Mask16 on, LightSample16 *out) {
  Quad16 q;
  quads16(lights, &on, &q);
  QuadView16 view;
  const Mask16 seen = quad_view16(&q, p, on, &view);
  float16 a = ux, b = uy;
  if (any16(seen & view.by_rectangle)) quad_rectangle_point16(&q, &view, seen & view.by_rectangle, &a, &b);
  if (any16(seen & view.by_fan)) quad_fan_point16(&q, &view, seen & view.by_fan, &a, &b);
  out->p = add16(q.o, add16(scale16(q.u, a), scale16(q.v, b)));
  out->p_error = q.p_error;
  out->n = view.n;
  const Mask16 aimed = seen & aim16(p, out);
  out->pdf = quad_pdf16(&q, &view, out->distance);
  return aimed & usable16(out->pdf);
}

static inline float16 quad_light_hit_pdf16(const Lights16 *lights, const Vec16 p, const float16 distance, const Mask16 on) {
  const float16 none = 0.0f;
  Quad16 q;
  quads16(lights, &on, &q);
  QuadView16 view;
  const Mask16 seen = quad_view16(&q, p, on, &view);
  const float16 pdf = quad_pdf16(&q, &view, distance);
  return seen & usable16(pdf) ? pdf : none;
}
