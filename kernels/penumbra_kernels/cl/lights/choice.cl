// Which light to ask: by the light tree (lights/tree.cl), or by Walker's alias method over `light_table` (Walker 1977), an
// entry a light, the environment last.
// What is lit is passed for the tree, whose choice depends on it; the table's does not.
//
// Uniform numbers have 24 bits. The table is built for just these (compile/alias.py), so that a light's pmf is exactly the
// share of them that chooses it, for a million lights of any powers; lights without power are never chosen.
#include "base/types.h"
#include "lights/receiver.h"
#include "lights/rest.h"
#if PENUMBRA_LIGHT_TREE
#include "lights/tree.cl"
#endif

// Lights that can be asked, the environment included.
static inline uint light_entries(const SceneData *scene) {
  return scene->light_count + (scene->environment_light != NONE ? 1u : 0u);
}

// A light by u.x of a point u of [0, 1)^2, and the probability of choosing it: 0 where there is none to choose. u becomes a
// point for a sample of that light (lights/rest.h).
static inline uint light_choose(const SceneData *scene, const Receiver *receiver, float2 *u, float *pmf) {
#if PENUMBRA_LIGHT_TREE
  if (scene->light_tree) return light_tree_choose(scene, receiver, u, pmf);
#endif
#if PENUMBRA_MANY_LIGHTS
  const uint count = light_entries(scene);
  *pmf = count ? 1.0f : 0.0f;
  if (count < 2u) return 0u;  // u stays as programs without a choice have it
  const ulong scaled = (ulong)(uint)(u->x * 0x1p24f) * count;
  const uint number = (uint)(scaled >> 24);
  const float rest = (float)((uint)scaled & 0xffffffu) * 0x1p-24f;
  const __global Alias *entry = scene->light_table + number;
  const bool keeps = rest < entry->threshold;
  const uint light = keeps ? number : entry->other;
  const float step = (float)count * 0x1p-24f, begin = keeps ? entry->first : entry->threshold;
  const float steps = ((keeps ? entry->threshold : 1.0f) - begin) / step, whole = (float)(int)steps;
  u->x = place_among((rest - begin) / step, steps > whole ? whole + 1.0f : whole, digits_behind(u->y));
  *pmf = scene->light_table[light].pmf;
  return light;
#else
  *pmf = 1.0f;
  return 0u;
#endif
}

// The probability with which light_choose finds a light.
static inline float light_pmf(const SceneData *scene, const Receiver *receiver, const uint light) {
#if PENUMBRA_LIGHT_TREE
  if (scene->light_tree) return light_tree_pmf(scene, receiver, light);
#endif
#if PENUMBRA_MANY_LIGHTS
  return scene->light_table[light].pmf;
#else
  return 1.0f;
#endif
}
