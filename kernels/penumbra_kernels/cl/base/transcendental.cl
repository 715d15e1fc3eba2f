// exp, log, pow, asin, acos, atan2 without library calls (PoCL's are real calls, and differ between drivers: equal bits
// need our own). Radians. Polynomials are minimax fits in the variable named; the bounds stated are the largest errors that
// tests/kernels/sampling/test_transcendental.py finds against float64, in units in the last place of the result.
#include "base/math.cl"

#define LN2_HI_F 0x1.62ep-1f           // 12 bits of ln 2: a multiple by an exponent is exact
#define LN2_LO_F 0x1.0bfbe8p-15f       // ln 2 - LN2_HI_F
#define LOG2_E_F 1.44269504f
#define ROUND_BIAS_F 0x1.8p23f         // adding it rounds to the nearest integer, kept in the low bits
#define EXP_MAX_F 89.0f                // beyond it exp is infinite, below EXP_MIN_F zero
#define EXP_MIN_F -104.0f
#define HALF_PI_F 1.57079633f

// e^x; 1.1 ulp, underflows gradually. NaN stays NaN.
static inline float exp_f(const float x) {
  const float below = x > EXP_MAX_F ? EXP_MAX_F : x;
  const float clamped = below < EXP_MIN_F ? EXP_MIN_F : below;
  const float biased = clamped * LOG2_E_F + ROUND_BIAS_F;
  const int k = (int)(as_uint(biased) - as_uint(ROUND_BIAS_F));
  const float kf = biased - ROUND_BIAS_F;
  const float r = FMA(-kf, LN2_LO_F, FMA(-kf, LN2_HI_F, clamped));  // in [-ln 2 / 2, ln 2 / 2]
  const float q = FMA(FMA(FMA(FMA(1.39504911e-3f, r, 8.36888936e-3f), r, 4.16662058e-2f), r, 1.66665188e-1f), r,
                      5.00000010e-1f);
  const float p = 1.0f + FMA(q, r * r, r);
  const int half_k = k >> 1;  // 2^k in two factors, since one alone would leave the range of normal numbers
  return p * as_float((uint)(half_k + 127) << 23) * as_float((uint)(k - half_k + 127) << 23);
}

// ln x as the unevaluated sum hi + lo, relative error below 2^-29; x positive and finite.
static inline float log_parts(const float x, float *lo) {
  const bool tiny = x < 0x1p-126f;
  const uint bits = as_uint(tiny ? x * 0x1p24f : x);
  const int shift = (int)(bits - 0x3f3504f3u) >> 23;  // so that m lies in [sqrt(1/2), sqrt(2))
  const float m = as_float(bits - ((uint)shift << 23));
  const float e = (float)(shift - (tiny ? 24 : 0));
  const float f = m - 1.0f;
  const float d = m + 1.0f;
  const float d_lo = m - (d - 1.0f);
  const float inverse = 1.0f / d;
  const float s = f * inverse;                                // ln m = 2 artanh(s)
  const float s_lo = (FMA(-s, d, f) - s * d_lo) * inverse;    // f / (m + 1) - s
  const float z = s * s;
  const float p = FMA(FMA(FMA(2.35835689e-1f, z, 2.85372383e-1f), z, 4.00003362e-1f), z, 6.66666656e-1f);
  const float a = 2.0f * s;
  const float h = e * LN2_HI_F;
  const float sum = h + a;
  const float tail = (a - (sum - h)) + (FMA(e, LN2_LO_F, FMA(s * z, p, 2.0f * s_lo)));
  const float hi = sum + tail;
  *lo = tail - (hi - sum);
  return hi;
}

// ln x; 1 ulp. Minus infinity at 0, NaN below.
static inline float log_f(const float x) {
  if (!(x > 0.0f)) return x == 0.0f ? -INF_F : as_float(0x7fc00000u);
  if (x == INF_F) return x;
  float lo;
  return log_parts(x, &lo);
}

// x^y for finite x >= 0; 2.2 ulp. 0^0 = 1.
static inline float pow_f(const float x, const float y) {
  if (!(x > 0.0f)) return y == 0.0f ? 1.0f : (y > 0.0f ? 0.0f : INF_F);
  float lo;
  const float hi = log_parts(x, &lo);
  const float p = y * hi;
  if (p > EXP_MAX_F) return INF_F;
  if (p < EXP_MIN_F) return 0.0f;
  const float power = exp_f(p);
  return power < INF_F ? FMA(power, FMA(y, hi, -p) + y * lo, power) : power;
}

// asin x for x in [0, 1/2]; 1 ulp.
static inline float asin_small(const float x) {
  const float z = x * x;
  const float p = FMA(FMA(FMA(FMA(4.22305516e-2f, z, 2.41409866e-2f), z, 4.54783436e-2f), z, 7.49523266e-2f), z,
                      1.66667541e-1f);
  return FMA(x * z, p, x);
}

// asin x; arguments beyond [-1, 1] count as the nearest end; 2.5 ulp.
static inline float asin_f(const float x) {
  const float a = MIN(FABS(x), 1.0f);
  const float up = a > 0.5f ? HALF_PI_F - 2.0f * asin_small(SQRT(0.5f * (1.0f - a))) : asin_small(a);
  return copy_sign(up, x);
}

// acos x; arguments beyond [-1, 1] count as the nearest end; 2 ulp, also near 1, where it goes to zero.
static inline float acos_f(const float x) {
  const float a = MIN(FABS(x), 1.0f);
  if (a <= 0.5f) return HALF_PI_F - copy_sign(asin_small(a), x);
  const float r = 2.0f * asin_small(SQRT(0.5f * (1.0f - a)));
  return x < 0.0f ? PI_F - r : r;
}

// Angle of (x, y) in [-pi, pi], counter-clockwise from +x; 3 ulp. Finite arguments; 0 at the origin for x >= 0.
static inline float atan2_f(const float y, const float x) {
  const float ax = FABS(x);
  const float ay = FABS(y);
  const float large = MAX(ax, ay);
  const float t = large > 0.0f ? MIN(ax, ay) / large : 0.0f;
  const bool far = t > 0.414213562f;  // tan(pi / 8): turn by pi / 4 to stay within the polynomial's range
  const float u = far ? (t - 1.0f) / (t + 1.0f) : t;
  const float z = u * u;
  const float p = FMA(FMA(FMA(FMA(-6.08175121e-2f, z, 1.05953632e-1f), z, -1.42437673e-1f), z, 1.99984854e-1f), z,
                      -3.33333154e-1f);
  const float small = FMA(u * z, p, u);
  const float octant = far ? 0.785398163f + small : small;
  const float quadrant = ay > ax ? HALF_PI_F - octant : octant;
  return copy_sign(as_int(x) < 0 ? PI_F - quadrant : quadrant, y);
}
