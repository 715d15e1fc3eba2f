// Sixteen lanes at once: the same operation on sixteen rays or paths. Each lane gives the bits that the function of one gives, so
// every operation here is IEEE's and stands in the order of its scalar twin. Where a lane is off its values mean nothing.
#include "base/types.h"

#define LANES 16u
#define LANE_LEVELS 4u  // log2(LANES)
#define VECTORS 8u      // of lanes, that are traced together: four lose a twentieth under an open sky, sixteen win nothing
#define BATCH (VECTORS * LANES)
typedef float16 __attribute__((aligned(4))) LooseFloat16;  // anywhere in an array of floats
typedef int16 Mask16;  // a lane's condition: all bits set, or none

// Lets a compiler use registers of 512 bits where the processor has them; left alone, LLVM halves such vectors. For kernels, and for
// functions that are kept out of them.
#if PENUMBRA_X86 && defined(__AVX512F__)
#define PENUMBRA_512 1
#define PENUMBRA_WIDE __attribute__((min_vector_width(512)))
#else
#define PENUMBRA_512 0
#define PENUMBRA_WIDE
#endif

// The k-th lane of a variable, to read or to write.
#define LANE_F(v, k) (((float *)&(v))[k])
#define LANE_U(v, k) (((uint *)&(v))[k])
#define LANE_I(v, k) (((int *)&(v))[k])
// k runs over the lanes of a mask: for (LANES_OF(k, mask)).
#define LANES_OF(k, mask) uint bits_ = mask16(mask), k = bits_ ? CTZ(bits_) : 0u; bits_; bits_ &= bits_ - 1u, k = bits_ ? CTZ(bits_) : 0u

#if PENUMBRA_X86 && defined(__AVX512F__) && defined(__AVX512DQ__)
static inline float16 fma16(const float16 a, const float16 b, const float16 c) {
  return __builtin_ia32_vfmaddps512_mask(a, b, c, (ushort)-1, 4);
}
static inline float16 sqrt16(const float16 a) { return __builtin_ia32_sqrtps512(a, 4); }
static inline uint mask16(const Mask16 m) { return __builtin_ia32_cvtd2mask512(m); }
#elif PENUMBRA_X86 && defined(__AVX__) && defined(__FMA__)
static inline float16 fma16(const float16 a, const float16 b, const float16 c) {
  return (float16)(__builtin_ia32_vfmaddps256(a.lo, b.lo, c.lo), __builtin_ia32_vfmaddps256(a.hi, b.hi, c.hi));
}
static inline float16 sqrt16(const float16 a) { return (float16)(__builtin_ia32_sqrtps256(a.lo), __builtin_ia32_sqrtps256(a.hi)); }
static inline uint mask16(const Mask16 m) {
  return (uint)__builtin_ia32_movmskps256(as_float8(m.lo)) | (uint)__builtin_ia32_movmskps256(as_float8(m.hi)) << 8;
}
#else
static inline float16 fma16(const float16 a, const float16 b, const float16 c) {
  float16 out;
  for (uint i = 0u; i < LANES; i++) LANE_F(out, i) = FMA(LANE_F(a, i), LANE_F(b, i), LANE_F(c, i));
  return out;
}
static inline float16 sqrt16(const float16 a) {
  float16 out;
  for (uint i = 0u; i < LANES; i++) LANE_F(out, i) = SQRT(LANE_F(a, i));
  return out;
}
static inline uint mask16(const Mask16 m) {
  uint bits = 0u;
  for (uint i = 0u; i < LANES; i++) bits |= (LANE_U(m, i) & 1u) << i;
  return bits;
}
#endif

#if PENUMBRA_BUILTINS
static inline uint16 multiply_high16(const uint16 a, const uint b) {  // the upper 32 bits of each product
  return __builtin_convertvector(__builtin_convertvector(a, ulong16) * (ulong)b >> 32u, uint16);
}
static inline int16 to_int16(const float16 x) { return __builtin_convertvector(x, int16); }      // towards zero
static inline float16 to_float16(const int16 x) { return __builtin_convertvector(x, float16); }
static inline uint16 to_uint16(const ulong16 x) { return __builtin_convertvector(x, uint16); }  // the low half
static inline ulong16 to_ulong16(const uint16 x) { return __builtin_convertvector(x, ulong16); }
#else
static inline uint16 multiply_high16(const uint16 a, const uint b) { return mul_hi(a, (uint16)(b)); }
static inline int16 to_int16(const float16 x) { return convert_int16_rtz(x); }
static inline float16 to_float16(const int16 x) { return convert_float16(x); }
static inline uint16 to_uint16(const ulong16 x) { return convert_uint16(x); }
static inline ulong16 to_ulong16(const uint16 x) { return convert_ulong16(x); }
#endif

static inline bool any16(const Mask16 m) { return mask16(m) != 0u; }
#define LANE_NUMBERS (int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)
static inline Mask16 lanes_of_bits(const uint bits) { return (((int16)((int)bits) >> LANE_NUMBERS) & 1) != 0; }
static inline Mask16 lanes_from(const uint first, const uint count) {
  const int16 lane = LANE_NUMBERS;
  return (lane >= (int)first) & (lane < (int)(first + count));
}

#define MIN16(a, b) ((a) < (b) ? (a) : (b))
#define MAX16(a, b) ((a) > (b) ? (a) : (b))
static inline float16 abs16(const float16 x) { return as_float16(as_uint16(x) & 0x7fffffffu); }
static inline Mask16 is_finite16(const float16 x) { return (as_uint16(x) & 0x7f800000u) != 0x7f800000u; }
static inline float16 copy_sign16(const float16 magnitude, const float16 sign) {
  return as_float16((as_uint16(magnitude) & 0x7fffffffu) | (as_uint16(sign) & 0x80000000u));
}
static inline float16 clamp01_16(const float16 x) {
  const float16 low = MAX16(x, (float16)(0.0f));
  return MIN16(low, (float16)(1.0f));
}
static inline float16 sqr16(const float16 x) { return x * x; }
static inline float16 safe_sqrt16(const float16 x) { return sqrt16(MAX16(x, (float16)(0.0f))); }
static inline float16 difference_of_products16(const float16 a, const float16 b, const float16 c, const float16 d) {
  const float16 cd = c * d;
  const float16 error = fma16(-c, d, cd);
  return fma16(a, b, -cd) + error;
}

#define WORDS(type) ((uint)(sizeof(type) / sizeof(uint)))  // of a record

// What lanes read from memory: entry index[k] < 2^31 of an array. Lanes that are off read nothing, or entry 0.
#if PENUMBRA_X86 && defined(__AVX512F__) && defined(__AVX512DQ__)
static inline float16 gather16(const __global float *from, const uint16 index, const Mask16 on) {
  return __builtin_ia32_gathersiv16sf((float16)(0.0f), (const void *)(ulong)from, as_int16(index), (ushort)mask16(on), 4);
}
static inline uint16 gather_u16(const __global uint *from, const uint16 index, const Mask16 on) {
  return as_uint16(__builtin_ia32_gathersiv16si((int16)(0), (const void *)(ulong)from, as_int16(index), (ushort)mask16(on), 4));
}
#else
static inline float16 gather16(const __global float *from, const uint16 index, const Mask16 on) {
  const uint16 at = on ? index : (uint16)(0u);
  float16 out;
  for (uint i = 0u; i < LANES; i++) LANE_F(out, i) = from[LANE_U(at, i)];
  return out;
}
static inline uint16 gather_u16(const __global uint *from, const uint16 index, const Mask16 on) {
  const uint16 at = on ? index : (uint16)(0u);
  uint16 out;
  for (uint i = 0u; i < LANES; i++) LANE_U(out, i) = from[LANE_U(at, i)];
  return out;
}
#endif

// Word index[k] % 16 of sixteen, in each lane.
#if PENUMBRA_512
static inline uint16 words_of16(const uint16 words, const uint16 index) {
  return as_uint16(__builtin_ia32_permvarsi512(as_int16(words), as_int16(index)));
}
#else
static inline uint16 words_of16(const uint16 words, const uint16 index) {
  uint16 out;
  for (uint i = 0u; i < LANES; i++) LANE_U(out, i) = LANE_U(words, LANE_U(index, i) % LANES);
  return out;
}
#endif

// Four words in a row, one row a lane.
typedef struct {
  float16 x, y, z, w;
} Rows16;

// Rows of lanes k, k + 4, k + 8 and k + 12 in turn, for k from 0 to 3 (four_rows), become a lane's word each.
#if PENUMBRA_BUILTINS
#define UNPACK16(a, b, i, j, k, l)                                                                                    \
  __builtin_shufflevector(a, b, i, j, k, l, i + 4, j + 4, k + 4, l + 4, i + 8, j + 8, k + 8, l + 8, i + 12, j + 12, \
                          k + 12, l + 12)
static inline Rows16 turn_rows16(const float16 r0, const float16 r1, const float16 r2, const float16 r3) {
  const float16 a = UNPACK16(r0, r1, 0, 16, 1, 17), b = UNPACK16(r2, r3, 0, 16, 1, 17);
  const float16 c = UNPACK16(r0, r1, 2, 18, 3, 19), d = UNPACK16(r2, r3, 2, 18, 3, 19);
  Rows16 rows;
  rows.x = UNPACK16(a, b, 0, 1, 16, 17);
  rows.y = UNPACK16(a, b, 2, 3, 18, 19);
  rows.z = UNPACK16(c, d, 0, 1, 16, 17);
  rows.w = UNPACK16(c, d, 2, 3, 18, 19);
  return rows;
}
#else
static inline Rows16 turn_rows16(const float16 r0, const float16 r1, const float16 r2, const float16 r3) {
  const float16 r[4] = {r0, r1, r2, r3};
  Rows16 rows;
  for (uint k = 0u; k < LANES; k++) {
    const float *row = (const float *)(r + k % 4u) + k / 4u * 4u;
    LANE_F(rows.x, k) = row[0];
    LANE_F(rows.y, k) = row[1];
    LANE_F(rows.z, k) = row[2];
    LANE_F(rows.w, k) = row[3];
  }
  return rows;
}
#endif

// Four words from word index[0], index[4], index[8] and index[12] of a record or array on.
#if PENUMBRA_BUILTINS
typedef float4 __attribute__((aligned(4))) LooseFloat4;  // anywhere in an array of floats
static inline float16 four_rows(const __global float *from, const uint *index) {
  float16 r;
  r.s0123 = *(const __global LooseFloat4 *)(from + index[0]);
  r.s4567 = *(const __global LooseFloat4 *)(from + index[4]);
  r.s89ab = *(const __global LooseFloat4 *)(from + index[8]);
  r.scdef = *(const __global LooseFloat4 *)(from + index[12]);
  return r;
}
#else
static inline float16 four_rows(const __global float *from, const uint *index) {
  return (float16)(vload4(0, from + index[0]), vload4(0, from + index[4]), vload4(0, from + index[8]), vload4(0, from + index[12]));
}
#endif

// What lanes k, k + 4, k + 8 and k + 12 have, k < 4, in four lanes each.
#if PENUMBRA_512
static inline float16 four_of16(const float16 v, const uint k) { return __builtin_ia32_vpermilvarps512(v, (int16)((int)k)); }
#else
static inline float16 four_of16(const float16 v, const uint k) {
  return (float16)((float4)(LANE_F(v, k)), (float4)(LANE_F(v, k + 4u)), (float4)(LANE_F(v, k + 8u)), (float4)(LANE_F(v, k + 12u)));
}
#endif

// Four words from word index[k] of a record or array on, in each lane, all of which are there to read: seven times as fast as four
// gathers. Lanes that are off read from word 0 on.
static inline Rows16 gather_rows16(const __global void *from, const uint16 index, const Mask16 on) {
  const uint16 each = on ? index : (uint16)(0u);
  const __global float *words = (const __global float *)from;
  const uint *at = (const uint *)&each;
  return turn_rows16(four_rows(words, at), four_rows(words, at + 1), four_rows(words, at + 2), four_rows(words, at + 3));
}

// Stores the lanes of `bits` from `to` on, in their order, and behind them what means nothing: LANES numbers in all.
#if PENUMBRA_X86 && defined(__AVX512F__) && defined(__AVX512DQ__)
static inline void store_lanes16(const float16 v, const uint bits, float *to) {
  *(LooseFloat16 *)to = __builtin_ia32_compresssf512_mask(v, v, (ushort)bits);
}
#else
static inline void store_lanes16(const float16 v, const uint bits, float *to) {
  for (uint left = bits; left; left &= left - 1u) *to++ = LANE_F(v, CTZ(left));
}
#endif

// The lowest bits of `from`, in their order, where `mask` has bits.
#if PENUMBRA_X86 && defined(__BMI2__)
static inline uint deposit_bits(const uint from, const uint mask) { return __builtin_ia32_pdep_si(from, mask); }
#else
static inline uint deposit_bits(uint from, const uint mask) {
  uint out = 0u;
  for (uint left = mask; left; left &= left - 1u, from >>= 1u) out |= from & 1u ? left & -left : 0u;
  return out;
}
#endif

// float2 and float3 of each lane.
typedef struct {
  float16 x, y;
} Point16;

typedef struct {
  float16 x, y, z;
} Vec16;

static inline Vec16 vec16(const float16 x, const float16 y, const float16 z) {
  Vec16 v;
  v.x = x;
  v.y = y;
  v.z = z;
  return v;
}
static inline Vec16 all16(const float3 v) { return vec16((float16)(v.x), (float16)(v.y), (float16)(v.z)); }
static inline float3 lane3(const Vec16 *v, const uint k) { return (float3)(LANE_F(v->x, k), LANE_F(v->y, k), LANE_F(v->z, k)); }
static inline void set_lane3(Vec16 *v, const uint k, const float3 value) {
  LANE_F(v->x, k) = value.x;
  LANE_F(v->y, k) = value.y;
  LANE_F(v->z, k) = value.z;
}
static inline Vec16 add16(const Vec16 a, const Vec16 b) { return vec16(a.x + b.x, a.y + b.y, a.z + b.z); }
static inline Vec16 sub16(const Vec16 a, const Vec16 b) { return vec16(a.x - b.x, a.y - b.y, a.z - b.z); }
static inline Vec16 mul16(const Vec16 a, const Vec16 b) { return vec16(a.x * b.x, a.y * b.y, a.z * b.z); }
static inline Vec16 scale16(const Vec16 a, const float16 s) { return vec16(a.x * s, a.y * s, a.z * s); }
static inline Vec16 neg16(const Vec16 a) { return vec16(-a.x, -a.y, -a.z); }
static inline Vec16 abs3_16(const Vec16 a) { return vec16(abs16(a.x), abs16(a.y), abs16(a.z)); }
static inline Vec16 where16(const Mask16 m, const Vec16 a, const Vec16 b) {
  return vec16(m ? a.x : b.x, m ? a.y : b.y, m ? a.z : b.z);
}
static inline float16 dot16(const Vec16 a, const Vec16 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static inline float16 length16(const Vec16 a) { return sqrt16(dot16(a, a)); }
static inline Vec16 normalize16(const Vec16 a) { return scale16(a, 1.0f / sqrt16(dot16(a, a))); }
static inline float16 max3_16(const Vec16 a) {
  const float16 xy = MAX16(a.x, a.y);
  return MAX16(xy, a.z);
}
static inline Vec16 cross16(const Vec16 a, const Vec16 b) {
  return vec16(difference_of_products16(a.y, b.z, a.z, b.y), difference_of_products16(a.z, b.x, a.x, b.z),
               difference_of_products16(a.x, b.y, a.y, b.x));
}
static inline Vec16 xyz16(const Rows16 *rows) { return vec16(rows->x, rows->y, rows->z); }
static inline Vec16 gather3_16(const __global float *from, const uint16 index, const Mask16 on) {
  return vec16(gather16(from, index, on), gather16(from, index + 1u, on), gather16(from, index + 2u, on));
}

// make_frame of each lane.
static inline void make_frame16(const Vec16 n, Vec16 *s, Vec16 *t) {
  const float16 one = 1.0f;
  const float16 sign = n.z < 0.0f ? -one : one;
  const float16 a = -1.0f / (sign + n.z);
  const float16 b = n.x * n.y * a;
  *s = vec16(1.0f + sign * n.x * n.x * a, sign * b, -sign * n.x);
  *t = vec16(b, sign + n.y * n.y * a, -n.y);
}

static inline void sincos_near16(const float16 x, float16 *s, float16 *c) {
  const float16 r = x * 1.57079632679f;
  const float16 r2 = r * r;
  *s = r * (1.0f + r2 * (-1.6666667e-1f + r2 * (8.3333310e-3f + r2 * (-1.98409e-4f + r2 * 2.7526e-6f))));
  *c = 1.0f + r2 * (-0.5f + r2 * (4.16666418e-2f + r2 * (-1.3888397e-3f + r2 * 2.4760495e-5f)));
}

static inline void sincos_2pi16(const float16 u, float16 *s, float16 *c) {
  const float16 x = u * 4.0f;
  const int16 q = to_int16(x + 0.5f);
  float16 ps, pc;
  sincos_near16(x - to_float16(q), &ps, &pc);
  const Mask16 odd = (q & 1) != 0;
  const uint16 a = as_uint16(odd ? pc : ps);
  const uint16 b = as_uint16(odd ? ps : pc);
  *s = as_float16(a ^ (as_uint16(q & 2) << 30u));
  *c = as_float16(b ^ (as_uint16((q + 1) & 2) << 30u));
}
