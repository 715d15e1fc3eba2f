// A perfect mirror of color0.
#include "materials/bsdf.h"

static inline bool mirror_sample(const Bsdf *b, BsdfSample *out) {
  delta_event(out, mirror_of(b->wo), b->color0, 1.0f, 0u);
  return true;
}
