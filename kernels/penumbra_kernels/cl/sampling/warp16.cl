// Maps of sampling/warp.cl for sixteen lanes, each with the bits of its scalar twin. Points (x, y) of the unit square.
#include "base/lanes16.cl"
#include "sampling/warp.cl"

static inline float16 centered16(const float16 u) { return fma16(2.0f, u, -1.0f + 0x1p-24f); }

static inline void square_to_disc16(const float16 ux, const float16 uy, float16 *x, float16 *y) {
  const float16 a = centered16(ux), b = centered16(uy);
  const Mask16 wide = abs16(a) > abs16(b);
  const float16 r = wide ? a : b;
  float16 s, c;
  sincos_near16(0.5f * ((wide ? b : a) / r), &s, &c);
  const float16 along = r * c, across = r * s;
  *x = wide ? along : across;
  *y = wide ? across : along;
}

static inline Vec16 square_to_cosine_hemisphere16(const float16 ux, const float16 uy, float16 *pdf) {
  Vec16 d;
  square_to_disc16(ux, uy, &d.x, &d.y);
  const float16 a = abs16(centered16(ux)), b = abs16(centered16(uy));
  const float16 r = MAX16(a, b);
  d.z = sqrt16((1.0f - r) * (1.0f + r));
  *pdf = d.z * INV_PI_F;
  return d;
}

static inline float16 cosine_hemisphere_pdf16(const float16 cos_theta) {
  return MAX16(cos_theta, (float16)(0.0f)) * INV_PI_F;
}

static inline Vec16 square_to_sphere16(const float16 ux, const float16 uy) {
  const float16 z = centered16(ux);
  const float16 sine = sqrt16((1.0f - z) * (1.0f + z));
  float16 s, c;
  sincos_2pi16(uy, &s, &c);
  return vec16(sine * c, sine * s, z);
}

// The cells of a table that its lanes' v fall into.
typedef struct {
  float16 left, width, cdf, d0, d1, sign;
} Cells16;

#if PENUMBRA_X86 && defined(__AVX__)
static inline uint below16(const __global float *bounds, const float v) {
  return POPCOUNT(mask16(*(const __global LooseFloat16 *)bounds <= v));
}

// For each lane sixteen bounds at once: first those of every sixteenth cell, then those from there on.
static inline uint16 find_cells16(const __global float *table, const float16 v, const Mask16 on) {
  const __global float *coarse = table + TABLE_HEADER + (uint)table[0] * TABLE_STRIDE;
  uint16 cell;
  for (uint k = 0u; k < LANES; k++) {
    const uint first = LANES * below16(coarse, LANE_F(v, k));
    LANE_U(cell, k) = first + below16(coarse + LANES + first, LANE_F(v, k));
  }
  return cell;
}
#else
static inline uint16 find_cells16(const __global float *table, const float16 v, const Mask16 on) {
  uint16 cell = 0u;
  for (LANES_OF(k, on)) LANE_U(cell, k) = find_cell(table, LANE_F(v, k));
  return cell;
}
#endif

static inline Cells16 table_cells16(const __global float *table, const float16 v, const Mask16 on) {
  const __global float *cells = table + TABLE_HEADER;
  Cells16 c;
  if ((uint)table[0] == 1u) {
    c.left = cells[TABLE_LEFT];
    c.width = cells[TABLE_WIDTH];
    c.cdf = cells[TABLE_CDF];
    c.d0 = cells[TABLE_DENSITY];
    c.d1 = cells[TABLE_DENSITY + 1u];
    c.sign = cells[TABLE_SIGN];
    return c;
  }
  const uint16 at = find_cells16(table, v, on) * TABLE_STRIDE;
  const Rows16 front = gather_rows16(cells, at, on), back = gather_rows16(cells, at + 2u, on);
  c.left = front.x;
  c.width = front.y;
  c.cdf = front.z;
  c.d0 = front.w;
  c.d1 = back.z;
  c.sign = back.w;
  return c;
}

// v in [0, 1] in lanes that are off as well.
static inline float16 sample_table16(const __global float *table, const float16 v, const Mask16 on, float16 *sign) {
  const Cells16 c = table_cells16(table, v, on);
  const float16 r = v - c.cdf;
  const float16 root = c.d0 + safe_sqrt16(c.d0 * c.d0 + 2.0f * (c.d1 - c.d0) * r);
  const float16 zero = 0.0f, one = 1.0f, part = 2.0f * r / root;
  const float16 x = r > 0.0f ? MIN16(part, one) : zero;
  *sign = c.sign;
  return c.left + x * c.width;
}
