// Functions of base/transcendental.cl for sixteen lanes, each with the bits of its scalar twin. Radians.
#include "base/lanes16.cl"
#include "base/transcendental.cl"

static inline float16 exp16(const float16 x) {
  const float16 most = EXP_MAX_F, least = EXP_MIN_F;
  const float16 below = x > EXP_MAX_F ? most : x;
  const float16 clamped = below < EXP_MIN_F ? least : below;
  const float16 biased = clamped * LOG2_E_F + ROUND_BIAS_F;
  const int16 k = as_int16(as_uint16(biased) - as_uint(ROUND_BIAS_F));
  const float16 kf = biased - ROUND_BIAS_F;
  const float16 r = fma16(-kf, LN2_LO_F, fma16(-kf, LN2_HI_F, clamped));
  const float16 q =
      fma16(fma16(fma16(fma16(1.39504911e-3f, r, 8.36888936e-3f), r, 4.16662058e-2f), r, 1.66665188e-1f), r, 5.00000010e-1f);
  const float16 p = 1.0f + fma16(q, r * r, r);
  const int16 half_k = k >> 1;
  return p * as_float16(as_uint16(half_k + 127) << 23u) * as_float16(as_uint16(k - half_k + 127) << 23u);
}

static inline float16 log_parts16(const float16 x, float16 *lo) {
  const Mask16 tiny = x < 0x1p-126f;
  const uint16 bits = as_uint16(tiny ? x * 0x1p24f : x);
  const int16 shift = as_int16(bits - 0x3f3504f3u) >> 23;
  const float16 m = as_float16(bits - (as_uint16(shift) << 23u));
  const float16 e = to_float16(shift - (tiny & 24));
  const float16 f = m - 1.0f;
  const float16 d = m + 1.0f;
  const float16 d_lo = m - (d - 1.0f);
  const float16 inverse = 1.0f / d;
  const float16 s = f * inverse;
  const float16 s_lo = (fma16(-s, d, f) - s * d_lo) * inverse;
  const float16 z = s * s;
  const float16 p = fma16(fma16(fma16(2.35835689e-1f, z, 2.85372383e-1f), z, 4.00003362e-1f), z, 6.66666656e-1f);
  const float16 a = 2.0f * s;
  const float16 h = e * LN2_HI_F;
  const float16 sum = h + a;
  const float16 tail = (a - (sum - h)) + (fma16(e, LN2_LO_F, fma16(s * z, p, 2.0f * s_lo)));
  const float16 hi = sum + tail;
  *lo = tail - (hi - sum);
  return hi;
}

static inline float16 log16(const float16 x) {
  const float16 infinity = INF_F, none = as_float(0x7fc00000u);
  float16 lo;
  const float16 inner = log_parts16(x, &lo);
  const float16 outer = x == 0.0f ? -infinity : none;
  return x > 0.0f ? (x == INF_F ? x : inner) : outer;
}

static inline float16 atan2_16(const float16 y, const float16 x) {
  const float16 zero = 0.0f;
  const float16 ax = abs16(x), ay = abs16(y);
  const float16 large = MAX16(ax, ay);
  const float16 t = large > 0.0f ? MIN16(ax, ay) / large : zero;
  const Mask16 far = t > 0.414213562f;
  const float16 u = far ? (t - 1.0f) / (t + 1.0f) : t;
  const float16 z = u * u;
  const float16 p = fma16(fma16(fma16(fma16(-6.08175121e-2f, z, 1.05953632e-1f), z, -1.42437673e-1f), z, 1.99984854e-1f), z,
                          -3.33333154e-1f);
  const float16 small = fma16(u * z, p, u);
  const float16 octant = far ? 0.785398163f + small : small;
  const float16 quadrant = ay > ax ? HALF_PI_F - octant : octant;
  return copy_sign16(as_int16(x) < 0 ? PI_F - quadrant : quadrant, y);
}

// Sine of an angle in [-2 pi, 2 pi].
static inline float16 sine16(const float16 angle) {
  float16 s, c;
  sincos_2pi16(abs16(angle) * INV_2PI_F, &s, &c);
  return copy_sign16(1.0f, angle) * s;
}
