// Maps from the unit square to other domains, each with its density. Points of the square are in [0, 1)^2; directions
// are in a local frame with the normal along +Z. Continuous and low in distortion, so that stratification survives.
#include "base/math.cl"

// 2 u - 1, moved by half of u's spacing: uniform numbers are k 2^-24, and this keeps their image symmetric and off the ends.
static inline float centered(const float u) { return FMA(2.0f, u, -1.0f + 0x1p-24f); }

// Uniform on the unit disc, never on its rim; density 1 / pi (Shirley and Chiu 1997, concentric map).
static inline float2 square_to_disc(const float2 u) {
  const float a = centered(u.x);
  const float b = centered(u.y);
  const bool wide = FABS(a) > FABS(b);
  const float r = wide ? a : b;
  float s, c;
  sincos_near(0.5f * ((wide ? b : a) / r), &s, &c);  // an angle in [-pi / 4, pi / 4]; r is never 0
  const float along = r * c, across = r * s;
  return (float2)(wide ? along : across, wide ? across : along);
}

// Cosine-weighted on the upper hemisphere; pdf = cos / pi per solid angle, always positive (Malley's method).
static inline float3 square_to_cosine_hemisphere(const float2 u, float *pdf) {
  const float a = centered(u.x);
  const float b = centered(u.y);
  const float2 d = square_to_disc(u);
  const float r = MAX(FABS(a), FABS(b));
  const float z = SQRT((1.0f - r) * (1.0f + r));
  *pdf = z * INV_PI_F;
  return (float3)(d.x, d.y, z);
}
static inline float cosine_hemisphere_pdf(const float cos_theta) { return MAX(cos_theta, 0.0f) * INV_PI_F; }

// Uniform on the unit sphere; density 1 / (4 pi). z and its sine come from the same factors: no cancellation at the poles.
static inline float3 square_to_sphere(const float2 u) {
  const float z = centered(u.x);
  const float sine = SQRT((1.0f - z) * (1.0f + z));
  float s, c;
  sincos_2pi(u.y, &s, &c);
  return (float3)(sine * c, sine * s, z);
}

// Uniform in the cone about +Z with 1 - cos(half angle) = `one_minus_cos`; density 1 / (2 pi one_minus_cos). The caller
// computes one_minus_cos as sin^2 / (1 + cos), so that narrow cones keep their size.
static inline float3 square_to_cone(const float2 u, const float one_minus_cos) {
  const float h = u.x * one_minus_cos;
  const float sine = SQRT(h * (2.0f - h));
  float s, c;
  sincos_2pi(u.y, &s, &c);
  return (float3)(sine * c, sine * s, 1.0f - h);
}

// Barycentric weights of vertices 0 and 1 of a triangle (vertex 2 has the rest), uniform by area (Heitz 2019, "A
// Low-Distortion Map Between Triangle and Square"): halves the square along a diagonal.
static inline float2 square_to_triangle(const float2 u) {
  if (u.y > u.x) {
    const float x = 0.5f * u.x;
    return (float2)(x, u.y - x);
  }
  const float y = 0.5f * u.y;
  return (float2)(u.x - y, y);
}

// Uniform on a regular polygon with `blades` >= 3 corners at distance 1 from the origin, the first one at the angle
// `rotation` (radians) from +X; density 1 / (blades / 2 sin(2 pi / blades)).
static inline float2 square_to_polygon(const float2 u, const uint blades, const float rotation) {
  const float scaled = u.x * (float)blades;
  const uint side = MIN((uint)scaled, blades - 1u);
  const float2 w = square_to_triangle((float2)(MIN(scaled - (float)side, ONE_MINUS_EPSILON), u.y));
  const float turns = rotation * INV_2PI_F;
  const float base = turns - (float)(int)turns;
  const float start = base < 0.0f ? base + 1.0f : base;
  const float step = 1.0f / (float)blades;
  const float first = start + (float)side * step;
  const float second = start + (float)(side + 1u) * step;
  float s0, c0, s1, c1;
  sincos_2pi(first > 1.0f ? first - 1.0f : first, &s0, &c0);
  sincos_2pi(second > 1.0f ? second - 1.0f : second, &s1, &c1);
  return (float2)(w.x * c0 + w.y * c1, w.x * s0 + w.y * s1);
}
static inline float polygon_area(const uint blades) {
  float s, c;
  sincos_2pi(1.0f / (float)blades, &s, &c);
  return 0.5f * (float)blades * s;
}

// First index i in [0, count) with u < cdf[i + 1], for a table of count + 1 rising values from 0 to 1 whose entries may
// repeat: an outcome of chance 0 is never picked. `remapped` is u's place within the outcome, in [0, 1).
static inline uint sample_cdf(const __global float *cdf, const uint count, const float u, float *remapped) {
  uint low = 0u;
  uint high = count;  // the answer lies in [low, high)
  while (high - low > 1u) {
    const uint middle = (low + high) >> 1;
    if (cdf[middle] <= u) low = middle; else high = middle;
  }
  const float below = cdf[low];
  *remapped = MIN((u - below) / (cdf[low + 1u] - below), ONE_MINUS_EPSILON);
  return low;
}

// A density that is linear within each cell of a partition of an interval, as compile/tables.py lays it out: the number
// of cells, the weight that goes with a sample, then TABLE_STRIDE floats a cell; where there are several, bounds to search by.
#define TABLE_HEADER 2u
#define TABLE_STRIDE 6u
#define TABLE_LEFT 0u     // where the cell begins
#define TABLE_WIDTH 1u
#define TABLE_CDF 2u      // probability to the left of the cell
#define TABLE_DENSITY 3u  // probability per unit of the cell's own coordinate, at its left end and at its right end
#define TABLE_SIGN 5u     // +1, or -1 where the tabulated function is negative

// The last cell that begins at v or before.
static inline uint find_cell(const __global float *table, const float v) {
  const __global float *cells = table + TABLE_HEADER;
  uint low = 0u;
  uint high = (uint)table[0];
  while (high - low > 1u) {
    const uint middle = (low + high) >> 1;
    if (cells[middle * TABLE_STRIDE + TABLE_CDF] <= v) low = middle; else high = middle;
  }
  return low;
}

// A point with the table's density, for v in [0, 1], and the sign of the function there. The inverse of a quadratic CDF in
// the form without cancellation: x = 2 r / (d0 + sqrt(d0^2 + 2 (d1 - d0) r)).
static inline float sample_table(const __global float *table, const float v, float *sign) {
  const __global float *cell = table + TABLE_HEADER + find_cell(table, v) * TABLE_STRIDE;
  const float d0 = cell[TABLE_DENSITY];
  const float d1 = cell[TABLE_DENSITY + 1u];
  const float r = v - cell[TABLE_CDF];
  const float root = d0 + safe_sqrt(d0 * d0 + 2.0f * (d1 - d0) * r);
  const float x = r > 0.0f ? MIN(2.0f * r / root, 1.0f) : 0.0f;
  *sign = cell[TABLE_SIGN];
  return cell[TABLE_LEFT] + x * cell[TABLE_WIDTH];
}
