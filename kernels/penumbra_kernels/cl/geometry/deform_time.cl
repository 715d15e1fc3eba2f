// When a deforming mesh is looked at. Seconds from the frame's time.
#include "base/types.h"

// Between which two keyframes a time falls, and how far from the first; before the first and after the last it stands still.
typedef struct {
  uint first;
  float fraction;
} DeformTime;

static inline DeformTime deform_time(const SceneData *scene, const __global ShapeData *shape, const float time) {
  const __global float *times = scene->times + shape->deform_first_time;
  uint low = 0u, high = shape->deform_count - 1u;
  while (high - low > 1u) {
    const uint middle = (low + high) >> 1;
    if (times[middle] <= time) low = middle; else high = middle;
  }
  const float raw = (time - times[low]) / (times[low + 1u] - times[low]);
  DeformTime at;
  at.first = low;
  at.fraction = CLAMP01(raw);
  return at;
}
