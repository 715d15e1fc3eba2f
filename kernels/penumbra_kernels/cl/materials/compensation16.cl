// compensation.cl in sixteen lanes. Tables are places in scene->albedo_table; lanes that are not `on` read nothing.
#include "materials/bsdf16.h"
#include "materials/compensation.cl"

static inline float16 table_entry16(const SceneData *scene, const uint16 table, const uint entry, const Mask16 on) {
  return gather16(scene->albedo_table + entry, table, on);
}

static inline float16 table_position16(const float16 k, const float16 z) {
  const float16 t = z * (1.0f + k) / (z + k), one = 1.0f;
  return MIN16(t, one) * (float)(ALBEDO_NODES - 1u);
}

static inline uint16 table_cell16(const float16 position) {
  const uint16 cell = as_uint16(to_int16(position)), last = ALBEDO_NODES - 2u;
  return MIN16(cell, last);
}

static inline float16 table_row16(const SceneData *scene, const uint16 at, const float16 fraction, const Mask16 on) {
  const float16 left = gather16(scene->albedo_table, at, on);
  return left + (gather16(scene->albedo_table, at + 1u, on) - left) * fraction;
}

static inline Mask16 is_anisotropic16(const Bsdf16 *b) { return b->alpha_x != b->alpha_y; }

// table_lookup of rows that start `first` entries into the table.
static inline float16 table_lookup16(const SceneData *scene, const Bsdf16 *b, const uint16 table, const uint first, const Vec16 w,
                                     const Mask16 on) {
  const float16 position = table_position16(table_entry16(scene, table, 0u, on), abs16(w.z));
  const uint16 cell = table_cell16(position);
  const float16 fraction = position - to_float16(as_int16(cell));
  const uint16 at = table + first + cell;
  const Mask16 turned = on & is_anisotropic16(b);
  if (!any16(turned)) return table_row16(scene, at, fraction, on);
  const float16 xx = w.x * w.x;
  const float16 sine2 = xx + w.y * w.y;
  const float16 share = xx / sine2, one = 1.0f;
  const float16 azimuth = (sine2 > 0.0f ? MIN16(share, one) : (float16)(0.0f)) * (float)(ALBEDO_AZIMUTHS - 1u);
  const uint16 sector = as_uint16(to_int16(azimuth)), last = ALBEDO_AZIMUTHS - 2u;
  const uint16 row = turned ? MIN16(sector, last) : (uint16)(0u);
  const float16 a0 = table_row16(scene, at + row * ALBEDO_NODES, fraction, on);
  const float16 a1 = table_row16(scene, at + (row + 1u) * ALBEDO_NODES, fraction, turned);
  return turned ? a0 + (a1 - a0) * (azimuth - to_float16(as_int16(row))) : a0;
}

static inline float16 table_missing16(const SceneData *scene, const Bsdf16 *b, const uint16 table, const Vec16 w,
                                      const Mask16 on) {
  return table_lookup16(scene, b, table, ALBEDO_ROWS, w, on);
}

static inline float16 multiple_eval16(const SceneData *scene, const Bsdf16 *b, const uint16 table, const Vec16 wi,
                                      const Mask16 on) {
  return b->missing * table_missing16(scene, b, table, wi, on) * table_entry16(scene, table, 1u, on) *
         (abs16(wi.z) * INV_PI_F);
}

static inline float16 multiple_pdf16(const SceneData *scene, const uint16 table, const float16 z, const Mask16 on) {
  const uint16 cell = table_cell16(table_position16(table_entry16(scene, table, 0u, on), z));
  return gather16(scene->albedo_table, table + (ALBEDO_HEADER + ALBEDO_NODES) + cell, on) * (z * INV_PI_F);
}

static inline float16 cell_height16(const float16 k, const uint16 cell) {
  const float16 t = to_float16(as_int16(cell)) * (1.0f / (float)(ALBEDO_NODES - 1u));
  return t * k / (1.0f + k - t);
}

static inline Vec16 multiple_sample16(const SceneData *scene, const uint16 table, const Point16 *at, const Mask16 on) {
  const __global float *cdf = scene->albedo_table + ALBEDO_HEADER;
  uint16 low = 0u, high = ALBEDO_NODES - 1u;
  for (uint width = ALBEDO_NODES - 1u; width > 1u; width -= width / 2u) {
    const Mask16 open = high - low > 1u;
    const uint16 middle = (low + high) / 2u;
    const Mask16 right = gather16(cdf, table + middle, on) <= at->x;
    low = (open & right) ? middle : low;
    high = (open & ~right) ? middle : high;
  }
  const float16 left = gather16(cdf, table + low, on);
  const float16 fraction = clamp01_16((at->x - left) / (gather16(cdf, table + low + 1u, on) - left));
  const float16 k = table_entry16(scene, table, 0u, on);
  const float16 a = cell_height16(k, low), b = cell_height16(k, low + 1u);
  const float16 z = a * a + (b * b - a * a) * fraction, one = 1.0f;
  const float16 z2 = MIN16(z, one);
  float16 s, c;
  sincos_2pi16(at->y, &s, &c);
  const float16 r = sqrt16(1.0f - z2);
  return vec16(r * c, r * s, sqrt16(z2));
}
