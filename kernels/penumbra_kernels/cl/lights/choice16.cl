// Which light to ask (lights/choice.cl), for sixteen lanes, each with the bits of the scalar functions.
#include "base/types16.h"
#include "lights/choice.cl"
#include "lights/rest16.h"
#if PENUMBRA_LIGHT_TREE
#include "lights/tree16.cl"
#endif

#if PENUMBRA_MANY_LIGHTS
static inline float16 table_pmf16(const SceneData *scene, const uint16 light, const Mask16 on) {
  return gather_rows16(scene->light_table, light * WORDS(Alias), on).z;
}

static inline uint16 table_choose16(const SceneData *scene, const Mask16 on, Point16 *u, float16 *pmf) {
  const uint count = light_entries(scene);
  *pmf = count ? 1.0f : 0.0f;
  if (count < 2u) return (uint16)(0u);
  const uint16 number = as_uint16(to_int16(u->x * 0x1p24f));
  const uint16 entry = multiply_high16(number << 8u, count);
  const float16 rest = to_float16(as_int16(number * count & 0xffffffu)) * 0x1p-24f;
  const Rows16 alias = gather_rows16(scene->light_table, entry * WORDS(Alias), on);
  const Mask16 keeps = rest < alias.x;
  const uint16 light = keeps ? entry : as_uint16(alias.y);
  const float16 step = (float)count * 0x1p-24f, begin = keeps ? alias.w : alias.x, one = 1.0f;
  const float16 steps = ((keeps ? alias.x : one) - begin) / step, whole = to_float16(to_int16(steps));
  u->x = place_among16((rest - begin) / step, steps > whole ? whole + 1.0f : whole, digits_behind16(u->y));
  *pmf = table_pmf16(scene, light, on);
  return light;
}
#endif

// light_choose of the lanes of `on`.
static inline uint16 light_choose16(const SceneData *scene, const Receiver16 *receiver, const Mask16 on, Point16 *u,
                                    float16 *pmf) {
  *pmf = 1.0f;
#if PENUMBRA_LIGHT_TREE
  if (scene->light_tree) return light_tree_choose16(scene, receiver, on, u, pmf);
#endif
#if PENUMBRA_MANY_LIGHTS
  return table_choose16(scene, on, u, pmf);
#else
  return (uint16)(0u);
#endif
}

// light_pmf of the lanes of `on`.
static inline float16 light_pmf16(const SceneData *scene, const Receiver16 *receiver, const uint16 light, const Mask16 on) {
#if PENUMBRA_LIGHT_TREE
  if (scene->light_tree) return light_tree_pmf16(scene, receiver, light, on);
#endif
#if PENUMBRA_MANY_LIGHTS
  return table_pmf16(scene, light, on);
#else
  return (float16)(1.0f);
#endif
}
