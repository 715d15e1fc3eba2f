// Solid angles of triangles, and points in them uniform in solid angle, for triangles of any size: from a hemisphere
// down to the smallest angle that a float can square. Corners are given relative to the eye, metres.
//
// Arvo 1995, "Stratified Sampling of Spherical Triangles", as rewritten with half angles by Peters 2021, "BRDF Importance
// Sampling for Polygonal Lights", section 4.1. Both measure the new corner by unit vectors, whose rounding swamps small
// triangles; here it is carried as weights of the corners, in which nothing cancels, so that no small-angle branch is needed.
#include "base/types.h"
#include "base/transcendental.cl"

// A flat light of half diameter s at distance d looks small where s^2 < d^2 / 8: seen face-on cos / r^2 = h / r^3 varies by 1.2
// over it, and by ((1 + x) / (1 - x))^3 = 9, x = sqrt(1 / 8), where it is seen edge-on and sends the least. Measured on a lamp in
// a box: a quarter less time than with d^2 / 128 for 2 % more variance (docs/performance.md).
#define FLAT_FAR 0.125f

// A spherical triangle A B C seen from the eye, prepared for sampling from its apex B across the arc A C.
typedef struct {
  float a, b, c;     // distances of the corners
  float cos_ac;      // between the directions of A and C
  float g1, g2;      // (A + B) . C and 1 + A . B of the unit directions
  float r;           // sqrt(D^2 + (g1 + g2)^2), D = |det(A, B, C)|
  float half_angle;  // half the solid angle
} SphericalTriangle;

// volume: |det(a, b, c)|, which the caller knows without cancellation as height above the plane times twice the area.
// tan(solid angle / 2) = D / (1 + A.B + B.C + C.A) (van Oosterom and Strackee 1983, eq. 8).
static inline SphericalTriangle spherical_triangle(const float3 a, const float3 b, const float3 c, const float volume) {
  SphericalTriangle t;
  t.a = length3(a);
  t.b = length3(b);
  t.c = length3(c);
  const float3 ua = a * (1.0f / t.a);
  const float3 ub = b * (1.0f / t.b);
  const float3 uc = c * (1.0f / t.c);
  t.cos_ac = dot3(ua, uc);
  t.g1 = t.cos_ac + dot3(ub, uc);
  t.g2 = 1.0f + dot3(ua, ub);
  const float d = volume / t.a / t.b / t.c;
  const float g = t.g1 + t.g2;
  t.r = SQRT(d * d + g * g);
  t.half_angle = atan2_f(d, g);
  return t;
}

// Where the arc from B meets A C so that the triangle on A's side has half the solid angle `half_part`: the fraction of the
// way from a to c. With m = alpha A + beta C on the bisector of A and the new corner, tan(half_part) = det(A, B, m) /
// ((A + B) . m) is linear in m; the new corner is A reflected at m: weights (alpha^2 - beta^2), 2 beta (alpha + beta A.C).
static inline float spherical_triangle_cut(const SphericalTriangle *t, const float half_part) {
  float s_part, c_part, s_rest, c_rest;
  sincos_2pi(half_part * INV_2PI_F, &s_part, &c_part);
  sincos_2pi(MAX(t->half_angle - half_part, 0.0f) * INV_2PI_F, &s_rest, &c_rest);
  const float rest = t->r * s_rest;  // alpha - beta
  const float beta = t->g2 * s_part;
  const float alpha = rest + beta;
  const float to_a = rest * (alpha + beta) / t->a;
  const float to_c = 2.0f * beta * MAX(alpha + beta * t->cos_ac, 0.0f) / t->c;
  const float sum = to_a + to_c;
  return sum > 0.0f ? MIN(to_c / sum, 1.0f) : 0.5f;
}

// Fraction of the way from b to e, a point of the edge a c, at which the solid angle between B and there is v times the
// whole: 1 - cos is uniform along the arc. With h = sin^2 of half the arc, g = v h, the weights' common factor
// 2 sqrt(h) is divided out, so that the limit h = 0 is the flat triangle's sqrt(v).
static inline float spherical_triangle_reach(const SphericalTriangle *t, const float3 b, const float3 e, const float v) {
  const float length_e = length3(e);
  const float3 difference = b * (1.0f / t->b) - e * (1.0f / length_e);
  const float h = MIN(0.25f * dot3(difference, difference), 1.0f);
  const float g = v * h;
  const float root = SQRT(v);
  const float near = SQRT((1.0f - h) * (1.0f - g)) + h * root;  // cos of half the rest of the arc
  const float to_b = (1.0f - v) / (SQRT(1.0f - g) + SQRT(v * (1.0f - h))) * near / t->b;
  const float to_e = root * SQRT(1.0f - g) / length_e;
  const float sum = to_b + to_e;
  return sum > 0.0f ? MIN(to_e / sum, 1.0f) : root;
}
