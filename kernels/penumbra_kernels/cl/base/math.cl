// Scalar and vector arithmetic for hot code. PoCL turns fabs, min, max, sqrt ... into real calls, so these are
// ternaries or clang builtins, with a standard branch for other compilers (PENUMBRA_BUILTINS 0).
// Angles in radians. IEEE division and square root, no contraction; fma only where written out.

#ifndef PENUMBRA_BUILTINS
#define PENUMBRA_BUILTINS 0
#endif

#if PENUMBRA_BUILTINS
#define SQRT(x) __builtin_sqrtf(x)
#define FABS(x) __builtin_fabsf(x)
#define FMA(a, b, c) __builtin_fmaf(a, b, c)
#define CTZ(x) ((uint)__builtin_ctz(x))
#define POPCOUNT(x) ((uint)__builtin_popcount(x))
#define CLZ(x) ((uint)__builtin_clz(x))      // of a uint that is not 0
#define CLZ64(x) ((uint)__builtin_clzl(x))   // of a ulong that is not 0
#define PREFETCH(p) __builtin_prefetch((const void *)(ulong)(p))  // of any address space
#else
#define SQRT(x) sqrt(x)
#define FABS(x) fabs(x)
#define FMA(a, b, c) fma(a, b, c)
#define CTZ(x) (31u - clz((x) & (0u - (x))))
#define POPCOUNT(x) popcount((uint)(x))
#define CLZ(x) ((uint)clz((uint)(x)))
#define CLZ64(x) ((uint)clz((ulong)(x)))
#define PREFETCH(p)
#endif

// Keeps a large function out of its callers, where a compiler would multiply it (PoCL makes three copies of every kernel).
// GPUs have no use for calls.
#if PENUMBRA_BUILTINS
#define PENUMBRA_NOINLINE __attribute__((noinline))
#else
#define PENUMBRA_NOINLINE inline
#endif

#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))
#define CLAMP01(x) MIN(MAX(x, 0.0f), 1.0f)

#define PI_F 3.14159265358979f
#define INV_PI_F 0.318309886183791f
#define INV_2PI_F 0.159154943091895f
#define INF_F as_float(0x7f800000u)
#define ONE_MINUS_EPSILON 0x1.fffffep-1f

// Relative error of n rounded operations: n u / (1 - n u), u = 2^-24 (Higham 2002, Lemma 3.1).
#define GAMMA(n) (((float)(n) * 0x1p-24f) / (1.0f - (float)(n) * 0x1p-24f))

static inline float sqr(const float x) { return x * x; }
static inline float safe_sqrt(const float x) { return SQRT(MAX(x, 0.0f)); }
static inline bool is_finite(const float x) { return (as_uint(x) & 0x7f800000u) != 0x7f800000u; }
static inline float copy_sign(const float magnitude, const float sign) {
  return as_float((as_uint(magnitude) & 0x7fffffffu) | (as_uint(sign) & 0x80000000u));
}

static inline float dot3(const float3 a, const float3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static inline float length3(const float3 a) { return SQRT(dot3(a, a)); }
static inline float3 normalize3(const float3 a) { return a * (1.0f / SQRT(dot3(a, a))); }
static inline float3 abs3(const float3 a) { return (float3)(FABS(a.x), FABS(a.y), FABS(a.z)); }
static inline float max3(const float3 a) { return MAX(MAX(a.x, a.y), a.z); }
static inline float luminance(const float3 c) { return 0.2126f * c.x + 0.7152f * c.y + 0.0722f * c.z; }
static inline float3 load3(const __global float *p) { return (float3)(p[0], p[1], p[2]); }

// a b - c d with an error of at most 1.5 ulp of the result (Kahan; Jeannerod, Louvet, Muller 2013).
static inline float difference_of_products(const float a, const float b, const float c, const float d) {
  const float cd = c * d;
  const float error = FMA(-c, d, cd);
  return FMA(a, b, -cd) + error;
}

static inline float3 cross3(const float3 a, const float3 b) {
  return (float3)(difference_of_products(a.y, b.z, a.z, b.y), difference_of_products(a.z, b.x, a.x, b.z),
                  difference_of_products(a.x, b.y, a.y, b.x));
}

// Orthonormal frame about a unit normal (Duff et al. 2017, "Building an Orthonormal Basis, Revisited", listing 3).
static inline void make_frame(const float3 n, float3 *s, float3 *t) {
  const float sign = n.z < 0.0f ? -1.0f : 1.0f;
  const float a = -1.0f / (sign + n.z);
  const float b = n.x * n.y * a;
  *s = (float3)(1.0f + sign * n.x * n.x * a, sign * b, -sign * n.x);
  *t = (float3)(b, sign + n.y * n.y * a, -n.y);
}

// sin and cos of x quarter turns for x in [-1/2, 1/2]: minimax polynomials; absolute error below 2^-22.
static inline void sincos_near(const float x, float *s, float *c) {
  const float r = x * 1.57079632679f;
  const float r2 = r * r;
  *s = r * (1.0f + r2 * (-1.6666667e-1f + r2 * (8.3333310e-3f + r2 * (-1.98409e-4f + r2 * 2.7526e-6f))));
  *c = 1.0f + r2 * (-0.5f + r2 * (4.16666418e-2f + r2 * (-1.3888397e-3f + r2 * 2.4760495e-5f)));
}

// sin and cos of 2 pi u for u in [0, 1]: the same after an exact reduction to a quadrant.
static inline void sincos_2pi(const float u, float *s, float *c) {
  const float x = u * 4.0f;
  const int q = (int)(x + 0.5f);
  float ps, pc;
  sincos_near(x - (float)q, &ps, &pc);
  const uint a = as_uint((q & 1) ? pc : ps);
  const uint b = as_uint((q & 1) ? ps : pc);
  *s = as_float(a ^ ((uint)(q & 2) << 30));
  *c = as_float(b ^ ((uint)((q + 1) & 2) << 30));
}
