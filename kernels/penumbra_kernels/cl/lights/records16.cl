// Light records of sixteen lanes, field by field: read once where all lanes have the same light.
#include "base/types16.h"

typedef struct {
  const __global Light *records;
  uint16 number;
  bool one;       // the lanes that are on have one light,
  uint which;     // this
  uint16 type, instance, flags;
} Lights16;

// Four words of the lanes' records, by where the first record has them.
static inline Rows16 light_rows16(const Lights16 *lights, const __global float *field, const Mask16 on) {
  if (!lights->one) return gather_rows16(field, lights->number * WORDS(Light), on);
  const __global float *its = field + lights->which * WORDS(Light);
  Rows16 rows;
  rows.x = its[0];
  rows.y = its[1];
  rows.z = its[2];
  rows.w = its[3];
  return rows;
}

static inline Lights16 lights16(const SceneData *scene, const uint16 light, const Mask16 on) {
  Lights16 lights;
  lights.records = scene->lights;
  lights.number = light;
  lights.which = any16(on) ? LANE_U(light, CTZ(mask16(on))) : 0u;
  lights.one = !any16(on & (light != lights.which));
  const Rows16 first = light_rows16(&lights, scene->lights->radiance, on);
  const Rows16 more = light_rows16(&lights, (const __global float *)&scene->lights->first_triangle, on);
  lights.type = as_uint16(first.w);
  lights.instance = as_uint16(more.y);
  lights.flags = as_uint16(more.z);
  return lights;
}

static inline Vec16 radiance16(const Lights16 *lights, const Mask16 on) {
  const Rows16 rows = light_rows16(lights, lights->records->radiance, on);
  return xyz16(&rows);
}

static inline Mask16 two_sided16(const Lights16 *lights) { return (lights->flags & LIGHT_TWO_SIDED) != 0u; }
