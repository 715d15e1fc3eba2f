// Which of two hits counts.
#include "base/types.h"

// Whether a hit at t beats the best one so far (or, where there is none, the ray's end): nearer, or as near and of lower
// (kind, primitive, instance), so that the order of visits never shows.
static inline bool hit_beats(const float t, const uint kind, const uint primitive, const uint instance, const Hit *best) {
  if (t != best->t) return t < best->t;
  if (best->kind == NONE || kind != best->kind) return best->kind != NONE && kind < best->kind;
  if (primitive != best->primitive) return primitive < best->primitive;
  return instance < best->instance;
}

// True where it is the best one now.
static inline bool hit_offer(const float t, const float u, const float v, const uint kind, const uint primitive,
                             const uint instance, Hit *best) {
  if (!hit_beats(t, kind, primitive, instance, best)) return false;
  best->t = t;
  best->u = u;
  best->v = v;
  best->kind = kind;
  best->primitive = primitive;
  best->instance = instance;
  return true;
}
