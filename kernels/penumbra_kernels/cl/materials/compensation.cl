// Light that bounces several times between microfacets, which the single-scattering formula loses: a second, broad lobe
// returns just that (Kulla and Conty 2017, "Revisiting Physically Based Shading at Imageworks"), so that a rough
// surface in a white furnace is white, and the sum stays reciprocal.
//
// A table (compile/albedo.py makes one for each roughness that a scene has) holds missing(w) = 1 - the albedo of single
// scattering from direction w, over t = z (1 + k) / (z + k), which puts its nodes where the losses are for every roughness,
// and over the squared cosine of the azimuth where the roughness is anisotropic:
//   [0] k   [1] 1 / (cosine-weighted mean of missing)   [2] share of the losses that leaves on the far side
//   [3] mean albedo   then ALBEDO_NODES each: distribution function over cells, density of cells, rows of missing.
// Density 1 means that of the cosine, z / pi.
#include "materials/bsdf.h"

#define ALBEDO_HEADER 4u
#define ALBEDO_ROWS (ALBEDO_HEADER + 2u * ALBEDO_NODES)

static inline float table_position(const __global float *table, const float z) {
  const float k = table[0];
  return MIN(z * (1.0f + k) / (z + k), 1.0f) * (float)(ALBEDO_NODES - 1u);
}

static inline uint table_cell(const float position) {
  const uint cell = (uint)position;
  return MIN(cell, ALBEDO_NODES - 2u);
}

static inline float table_row(const __global float *row, const uint cell, const float fraction) {
  return row[cell] + (row[cell + 1u] - row[cell]) * fraction;
}

// Interpolates rows that start at `rows`, for direction w; |w.z| counts.
static inline float table_lookup(const __global float *table, const __global float *rows, const bool anisotropic,
                                 const float3 w) {
  const float position = table_position(table, FABS(w.z));
  const uint cell = table_cell(position);
  const float fraction = position - (float)cell;
  if (!anisotropic) return table_row(rows, cell, fraction);
  const float xx = w.x * w.x;
  const float sine2 = xx + w.y * w.y;
  const float azimuth = (sine2 > 0.0f ? MIN(xx / sine2, 1.0f) : 0.0f) * (float)(ALBEDO_AZIMUTHS - 1u);
  const uint first = MIN((uint)azimuth, ALBEDO_AZIMUTHS - 2u);
  const __global float *row = rows + first * ALBEDO_NODES;
  const float a = table_row(row, cell, fraction);
  const float b = table_row(row + ALBEDO_NODES, cell, fraction);
  return a + (b - a) * (azimuth - (float)first);
}

static inline bool is_anisotropic(const Bsdf *b) { return b->alpha_x != b->alpha_y; }

// Floats in one table: a dielectric has a second one after the first, for its inner side.
static inline uint table_size(const Bsdf *b) {
  return ALBEDO_ROWS + (is_anisotropic(b) ? ALBEDO_AZIMUTHS : 1u) * ALBEDO_NODES;
}

static inline float table_missing(const Bsdf *b, const __global float *table, const float3 w) {
  return table_lookup(table, table + ALBEDO_ROWS, is_anisotropic(b), w);
}

// The broad lobe towards wi on the side that `table` describes, times its cosine; integrates to `missing` over that side.
static inline float multiple_eval(const Bsdf *b, const __global float *table, const float3 wi) {
  return b->missing * table_missing(b, table, wi) * table[1] * (FABS(wi.z) * INV_PI_F);
}

// Density with which multiple_sample draws a direction of this height.
static inline float multiple_pdf(const __global float *table, const float z) {
  return table[ALBEDO_HEADER + ALBEDO_NODES + table_cell(table_position(table, z))] * (z * INV_PI_F);
}

// Height where a cell begins: the inverse of table_position.
static inline float cell_height(const float k, const uint cell) {
  const float t = (float)cell * (1.0f / (float)(ALBEDO_NODES - 1u));
  return t * k / (1.0f + k - t);
}

// A direction above the surface: a cell by its losses, in it by the cosine, any azimuth.
static inline float3 multiple_sample(const __global float *table, const float2 u) {
  const __global float *cdf = table + ALBEDO_HEADER;
  uint low = 0u, high = ALBEDO_NODES - 1u;
  while (high - low > 1u) {
    const uint middle = (low + high) / 2u;
    if (cdf[middle] <= u.x) low = middle;
    else high = middle;
  }
  const float fraction = CLAMP01((u.x - cdf[low]) / (cdf[low + 1u] - cdf[low]));
  const float a = cell_height(table[0], low), b = cell_height(table[0], low + 1u);
  const float z2 = MIN(a * a + (b * b - a * a) * fraction, 1.0f);
  float s, c;
  sincos_2pi(u.y, &s, &c);
  const float r = SQRT(1.0f - z2);
  return (float3)(r * c, r * s, SQRT(z2));
}
