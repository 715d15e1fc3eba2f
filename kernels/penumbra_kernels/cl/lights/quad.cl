// Quad light: the parallelogram origin + a u + b v, a and b in [0, 1], emitting towards u x v (and back where two-sided).
// World frame, metres; densities per solid angle at the lit point p.
//
// Three ways to sample it, chosen by p and the quad alone, so that the density of a hit is that of a sample:
//   area       where it looks small: the density per solid angle hardly differs over it, and (a, b) = u keeps any grid a grid.
//              Always with PENUMBRA_LIGHT_AREA_SAMPLING.
//   rectangle  near rectangles: Urena, Fajardo, King 2013, "An Area-Preserving Parametrization for Spherical Rectangles".
//   fan        near parallelograms, and rectangles that are near but subtend little (edge-on, thin), where Urena's sums of
//              angles cancel: two spherical triangles about the origin's corner.
#include "lights/light_sample.h"
#include "lights/placement.cl"
#include "lights/spherical_triangle.cl"

#define QUAD_BY_AREA 0u
#define QUAD_BY_RECTANGLE 1u
#define QUAD_BY_FAN 2u

// Rounding of the angles in it, some 2^-21, is then at most 2^-15 of the solid angle: a shift of a sample by 3e-5 of it.
#define RECTANGLE_SOLID_ANGLE 0.03125f
// |cos| between edges that counts as a right angle: the rounding of two rotated edges.
#define RIGHT_ANGLE_COSINE 0x1p-20f

typedef struct {
  float3 o, u, v;
  float3 p_error;   // of any point on it, as the intersector sees it
} Quad;

// The quad as seen from p.
typedef struct {
  float3 o;             // relative to p
  float3 n;             // unit, on p's side
  float height;         // of p above the plane, > 0
  float area;
  uint strategy;        // QUAD_BY_*
  float solid_angle;    // rectangle, fan
  float distance0, distance3;  // rectangle, fan: of corners 0 and 3
} QuadView;

static inline float3 quad_reach(const Quad *q) { return abs3(q->o) + abs3(q->u) + abs3(q->v); }

// The quad as its record has it.
static inline Quad still_quad(const __global Light *light) {
  Quad q;
  q.o = load3(light->position);
  q.u = load3(light->direction);
  q.v = load3(light->axis_v);
  q.p_error = quad_reach(&q) * PLACED_ERROR;
  return q;
}

static inline Quad quad_at(const SceneData *scene, const __global Light *light, const float time) {
  Quad q = still_quad(light);
  float m[3][4], inverse[3][4];
  if (area_light_placement(scene, light, time, m, inverse)) {
    const bool mirrored = determinant(m) < 0.0f;  // outside stays outside: swapped edges turn the normal back
    const float3 u = transform_vector(m, q.u);
    const float3 v = transform_vector(m, q.v);
    q.p_error = transform_magnitude(m, quad_reach(&q)) * PLACED_ERROR;
    q.o = transform_point(m, q.o);
    q.u = mirrored ? v : u;
    q.v = mirrored ? u : v;
  }
  return q;
}

// Square of half its longer diagonal.
static inline float quad_size(const Quad *q) {
  const float3 half_u = 0.5f * q->u;
  const float3 half_v = 0.5f * q->v;
  return dot3(half_u, half_u) + dot3(half_v, half_v) + 2.0f * FABS(dot3(half_u, half_v));
}

// Corner i of the quad relative to p, counter-clockwise from its origin.
static inline float3 quad_corner(const Quad *q, const QuadView *view, const uint i) {
  if (i == 0u) return view->o;
  if (i == 1u) return view->o + q->u;
  if (i == 2u) return view->o + q->u + q->v;
  return view->o + q->v;
}

// Triangle 0 1 2 or 0 2 3 with the origin's corner as its apex.
static inline SphericalTriangle quad_triangle(const Quad *q, const QuadView *view, const uint second) {
  return spherical_triangle(quad_corner(q, view, 1u + second), view->o, quad_corner(q, view, 2u + second),
                            view->height * view->area);
}

static inline bool quad_is_rectangle(const Quad *q) {
  return sqr(dot3(q->u, q->v)) <= sqr(RIGHT_ANGLE_COSINE) * dot3(q->u, q->u) * dot3(q->v, q->v);
}

// Half the solid angle of a triangle is the argument of 1 + A.B + B.C + C.A + i D (spherical_triangle.cl). Those of 0 1 2 and
// 0 2 3 are multiplied, so that one arc tangent gives their sum, which is below pi.
static inline void quad_solid_angle(const Quad *q, QuadView *view) {
  const float3 r1 = quad_corner(q, view, 1u), r2 = quad_corner(q, view, 2u), r3 = quad_corner(q, view, 3u);
  view->distance0 = length3(view->o);
  view->distance3 = length3(r3);
  const float i0 = 1.0f / view->distance0, i1 = 1.0f / length3(r1), i2 = 1.0f / length3(r2), i3 = 1.0f / view->distance3;
  const float cos01 = dot3(view->o * i0, r1 * i1), cos12 = dot3(r1 * i1, r2 * i2), cos23 = dot3(r2 * i2, r3 * i3);
  const float cos03 = dot3(view->o * i0, r3 * i3), cos02 = dot3(view->o * i0, r2 * i2);
  const float volume = view->height * i0 * view->area * i2;
  const float d1 = volume * i1, d2 = volume * i3;
  const float g1 = 1.0f + cos01 + cos12 + cos02, g2 = 1.0f + cos02 + cos23 + cos03;
  view->solid_angle = 2.0f * atan2_f(g1 * d2 + g2 * d1, g1 * g2 - d1 * d2);
}

// False where p sees no emitting side: behind, in the plane (to rounding), or the quad has no area.
static inline bool quad_view(const Quad *q, const float3 p, const bool two_sided, QuadView *view) {
  const float3 cross = cross3(q->u, q->v);
  view->area = length3(cross);
  if (!(view->area > 0.0f)) return false;
  view->o = q->o - p;
  const float3 n = cross * (1.0f / view->area);
  const float signed_height = -dot3(view->o, n);
  view->height = FABS(signed_height);
  if (!(view->height > dot3(abs3(n), q->p_error + abs3(p) * GAMMA(2)))) return false;
  if (signed_height < 0.0f && !two_sided) return false;
  view->n = signed_height < 0.0f ? -n : n;

  view->strategy = QUAD_BY_AREA;
  view->solid_angle = 0.0f;
  view->distance0 = view->distance3 = 0.0f;
#if !PENUMBRA_LIGHT_AREA_SAMPLING
  const float3 center = view->o + 0.5f * q->u + 0.5f * q->v;
  if (quad_size(q) >= FLAT_FAR * dot3(center, center)) {
    quad_solid_angle(q, view);
    view->strategy = view->solid_angle >= RECTANGLE_SOLID_ANGLE && quad_is_rectangle(q) ? QUAD_BY_RECTANGLE : QUAD_BY_FAN;
  }
#endif
  return true;
}

static inline float quad_pdf(const QuadView *view, const float distance) {
  return view->strategy == QUAD_BY_AREA ? flat_area_pdf(distance, view->height, view->area) : 1.0f / view->solid_angle;
}

// The plane at z = -height in the frame of the edges. A point (x, y) of it is seen at the elevation whose sine and cosine are
// y and height over their reach, the distance to (0, y).
typedef struct {
  float inverse_reach, sine, cosine;
} Elevation;

static inline Elevation elevation(const float y, const float height) {
  Elevation e;
  e.inverse_reach = 1.0f / SQRT(y * y + height * height);
  e.sine = y * e.inverse_reach;
  e.cosine = height * e.inverse_reach;
  return e;
}

static inline float sine(const float angle) {  // for |angle| <= 2 pi
  float s, c;
  sincos_2pi(FABS(angle) * INV_2PI_F, &s, &c);
  return copy_sign(1.0f, angle) * s;
}

// x at which a strip, of elevations e0 to e1 at x = 0 and reaching from x = 0, has the solid angle of the given sine and
// cosine (with x's sign). Urena et al. 2013, figure 2: cu = sign(fu) / sqrt(fu^2 + b0^2), xu = height cu / sqrt(1 - cu^2), with
// fu = (cosine b0 + b1) / sine, b0 = -e0.sine, b1 = e1.sine. With b0^2 = 1 - e0.cosine^2 that is
// (height / xu)^2 = (fu - e0.cosine) (fu + e0.cosine).
static inline float strip_end(const float sine, const float cosine, const Elevation e0, const Elevation e1,
                              const float height) {
  const float f = e1.sine - cosine * e0.sine;
  const float g = sine * e0.cosine;
  return height * sine / SQRT(MAX((f - g) * (f + g), 0x1p-100f));
}

// The same where the plane is so near that the differences cancel: as a product, (height / x)^2 =
// 4 sin((d + a) / 2) sin((d - a) / 2) cos((e + a) / 2) cos((e - a) / 2) / sin(a)^2 with a the solid angle, d the difference and
// e the sum of the elevations.
static inline float strip_end_grazing(const float swept, const Elevation e0, const Elevation e1, const float height) {
  const float a = FABS(swept);
  const float beta0 = atan2_f(e0.sine, e0.cosine);
  const float beta1 = atan2_f(e1.sine, e1.cosine);
  const float d = 0.5f * (beta1 - beta0);
  const float e = 0.5f * (beta1 + beta0);
  const float product = 4.0f * sine(d + 0.5f * a) * sine(d - 0.5f * a) * sine(HALF_PI_F - (e + 0.5f * a)) *
                        sine(HALF_PI_F - (e - 0.5f * a));
  return copy_sign(height * sine(a) / SQRT(MAX(product, 0.0f)), swept);
}

// The plane counts as near where the rectangle reaches beyond this many heights from the eye's foot along x. Before, the
// differences cancel to 1 / (1 + GRAZING^2) at worst.
#define GRAZING 4.0f

// Where along x the strip from x0 on has the share u of the rectangle's solid angle. Between the eye's foot and (x, y) a
// rectangle has the solid angle A with sin A = sine(x) sine(y): sums of A stand for Urena's internal angles, whose acos lose
// digits where p is near the plane.
static inline float rectangle_x(const QuadView *view, const float x0, const float x1, const float y0, const float y1,
                                const float u) {
  const float z = view->height;
  const Elevation e0 = elevation(y0, z), e1 = elevation(y1, z), ex = elevation(x0, z);
  const float sine0 = ex.sine * e0.sine, cosine0 = ex.cosine * (view->distance0 * e0.inverse_reach);
  const float sine1 = ex.sine * e1.sine, cosine1 = ex.cosine * (view->distance3 * e1.inverse_reach);
  const float sine_before = sine1 * cosine0 - cosine1 * sine0;
  const float cosine_before = cosine1 * cosine0 + sine1 * sine0;
  float s, c;
  if (MAX(FABS(x0), FABS(x1)) <= GRAZING * z) {
    sincos_2pi(u * view->solid_angle * INV_2PI_F, &s, &c);
    return strip_end(s * cosine_before + c * sine_before, c * cosine_before - s * sine_before, e0, e1, z);
  }
  return strip_end_grazing(u * view->solid_angle + (atan2_f(sine1, cosine1) - atan2_f(sine0, cosine0)), e0, e1, z);
}

// Urena et al. 2013, section 4. Returns (a, b).
static inline float2 quad_rectangle_point(const Quad *q, const QuadView *view, const float2 u) {
  const float width = length3(q->u);
  const float depth = length3(q->v);
  const float z = view->height;
  const float inverse_width = 1.0f / width;
  const float inverse_depth = 1.0f / depth;
  const float x0 = dot3(view->o, q->u) * inverse_width;
  const float y0 = dot3(view->o, q->v) * inverse_depth;
  const float y1 = y0 + depth;
  const float a = CLAMP01((rectangle_x(view, x0, x0 + width, y0, y1, u.x) - x0) * inverse_width);
  // Along v the sine of the elevation is uniform between its ends.
  const float x = a * width + x0;
  const float d2 = x * x + z * z;
  const float h0 = y0 / SQRT(d2 + y0 * y0);
  const float h1 = y1 / SQRT(d2 + y1 * y1);
  const float h = h0 + u.y * (h1 - h0);
  const float y = h * SQRT(d2 / MAX((1.0f - h) * (1.0f + h), 0x1p-100f));
  return (float2)(a, CLAMP01((y - y0) * inverse_depth));
}

// u.x sweeps the arc from corner 1 over 2 to 3, u.y goes out from corner 0. Returns (a, b).
static inline float2 quad_fan_point(const Quad *q, const QuadView *view, const float2 u) {
  const float swept = u.x * 0.5f * view->solid_angle;
  SphericalTriangle t = quad_triangle(q, view, 0u);
  const float first_half_angle = t.half_angle;
  const uint second = swept >= first_half_angle ? 1u : 0u;
  if (second) t = quad_triangle(q, view, 1u);
  const float e = spherical_triangle_cut(&t, second ? swept - first_half_angle : swept);
  const float3 edge = second ? -q->u : q->v;
  const float f = spherical_triangle_reach(&t, view->o, quad_corner(q, view, 1u + second) + e * edge, u.y);
  return second ? (float2)(f * (1.0f - e), f) : (float2)(f, f * e);
}

static inline bool quad_light_sample(const SceneData *scene, const __global Light *light, const float3 p,
                                     const float time, const float2 u, LightSample *out) {
  const Quad q = quad_at(scene, light, time);
  QuadView view;
  if (!quad_view(&q, p, (light->flags & LIGHT_TWO_SIDED) != 0u, &view)) return false;
  float2 ab = u;
  if (view.strategy == QUAD_BY_RECTANGLE) ab = quad_rectangle_point(&q, &view, u);
  if (view.strategy == QUAD_BY_FAN) ab = quad_fan_point(&q, &view, u);
  out->p = q.o + (ab.x * q.u + ab.y * q.v);
  out->p_error = q.p_error;
  out->n = view.n;
  if (!aim(p, out)) return false;
  out->pdf = quad_pdf(&view, out->distance);
  return usable(out->pdf);
}

static inline float quad_light_hit_pdf(const SceneData *scene, const __global Light *light, const float3 p,
                                       const float distance, const float time) {
  const Quad q = quad_at(scene, light, time);
  QuadView view;
  if (!quad_view(&q, p, (light->flags & LIGHT_TWO_SIDED) != 0u, &view)) return 0.0f;
  const float pdf = quad_pdf(&view, distance);
  return usable(pdf) ? pdf : 0.0f;
}
