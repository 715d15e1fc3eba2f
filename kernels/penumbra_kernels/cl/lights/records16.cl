// Light records of sixteen lanes, field by field: read once where all lanes have the same light.
#include "base/types16.h"

typedef struct {
  const __global Light *records;
  uint16 number;
  bool one;       // the lanes that are on have one light,
  uint which;     // this
} Lights16;

static inline Lights16 lights16(const SceneData *scene, const uint16 light, const Mask16 on) {
  Lights16 lights;
  lights.records = scene->lights;
  lights.number = light;
  lights.which = any16(on) ? LANE_U(light, CTZ(mask16(on))) : 0u;
  lights.one = !any16(on & (light != lights.which));
  return lights;
}

// A field, by where the first record has it.
static inline float16 light_numbers_of16(const Lights16 *lights, const __global float *field, const Mask16 on) {
  if (lights->one) return (float16)(field[lights->which * WORDS(Light)]);
  return gather16(field, lights->number * WORDS(Light), on);
}
static inline uint16 light_words16(const Lights16 *lights, const __global uint *field, const Mask16 on) {
  if (lights->one) return (uint16)(field[lights->which * WORDS(Light)]);
  return gather_u16(field, lights->number * WORDS(Light), on);
}
static inline Vec16 light_vectors16(const Lights16 *lights, const __global float *field, const Mask16 on) {
  if (lights->one) return all16(load3(field + lights->which * WORDS(Light)));
  return gather3_16(field, lights->number * WORDS(Light), on);
}

static inline Mask16 two_sided16(const Lights16 *lights, const Mask16 on) {
  return (light_words16(lights, &lights->records->flags, on) & LIGHT_TWO_SIDED) != 0u;
}
