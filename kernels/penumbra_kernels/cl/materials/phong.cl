// Lambertian base with a Phong cone about the mirror direction: color0 / pi + color1 (n + 2) / (2 pi) cos^n, the cosine
// being that between wi and the mirror direction of wo (Lafortune and Willems 1994). Conserves energy where
// color0 + color1 <= 1: where they ask for more, both are scaled down. `lobe` is the probability of the cone.
#include "base/transcendental.cl"
#include "materials/bsdf.h"

// log(1 + x) and exp(x) - 1 without the cancellation near 0: the rounding of 1 + x, or of exp(x), is divided out again
// (Kahan; Higham 2002, section 1.14.1). Some 4 ulp, given log_f and exp_f to 1 ulp. x > -1, and x <= 0.
static inline float log1p_below(const float x) {
  const float y = 1.0f + x;
  return y == 1.0f ? x : log_f(y) * (x / (y - 1.0f));
}

static inline float expm1_below(const float x) {
  const float y = exp_f(x);
  if (y == 1.0f) return x;
  return y > 0.0f ? (y - 1.0f) * (x / log_f(y)) : -1.0f;
}

static inline void phong_start(Bsdf *b) {
  const float3 sum = b->color0 + b->color1;
  const float3 scale = (float3)(1.0f / MAX(sum.x, 1.0f), 1.0f / MAX(sum.y, 1.0f), 1.0f / MAX(sum.z, 1.0f));
  b->color0 *= scale;
  b->color1 *= scale;
  const float base = max3(b->color0), cone = max3(b->color1);
  b->lobe = base + cone > 0.0f ? cone / (base + cone) : 0.0f;
}

// cos^n of the angle to the mirror direction. 1 - cos is taken as half the squared distance of the two unit vectors: exact
// to some 2^-22 of itself plus 2^-23 of its root, where a difference from 1 would be useless for large n.
static inline float phong_power(const Bsdf *b, const float3 wi) {
  const float3 d = wi - mirror_of(b->wo);
  const float below = 0.5f * dot3(d, d);
  if (below >= 1.0f) return 0.0f;
  return exp_f(b->exponent * log1p_below(-below));
}

static inline float3 phong_eval(const Bsdf *b, const float3 wi, float *pdf) {
  if (wi.z <= 0.0f) return (float3)(0.0f);
  const float power = phong_power(b, wi) * INV_2PI_F;
  const float cosine = wi.z * INV_PI_F;
  *pdf = (1.0f - b->lobe) * cosine + b->lobe * ((b->exponent + 1.0f) * power);
  return b->color0 * cosine + b->color1 * ((b->exponent + 2.0f) * power * wi.z);
}

// A direction of the cone: cos = (1 - u)^(1 / (n + 1)), with 1 - cos by expm1 so that narrow cones keep their shape.
static inline float3 phong_cone(const Bsdf *b, const float2 u) {
  const float below = -expm1_below(log1p_below(-u.x) / (b->exponent + 1.0f));
  const float sine = safe_sqrt(below * (2.0f - below));
  float s, c;
  sincos_2pi(u.y, &s, &c);
  const float3 axis = mirror_of(b->wo);
  float3 x, y;
  make_frame(axis, &x, &y);
  return x * (sine * c) + y * (sine * s) + axis * (1.0f - below);
}

static inline bool phong_sample(const Bsdf *b, float2 u, BsdfSample *out) {
  smooth_event(out, takes_lobe(b->lobe, &u) ? phong_cone(b, u) : cosine_direction(u));
  return out->event == 0u;
}
