// A point on a surface in the frame of the tree that it was found in. Metres.
#include "base/types.h"

typedef struct {
  float3 p, p_error;
  float3 ng;       // unit, outside
  float3 ns;       // any length; 0: as ng
  float3 tangent;  // dp/du, any length; 0: none
  float2 uv;
  uint shape;
} LocalSurface;

// Whether the shape's material tells directions around the normal apart. For the others any tangent will do.
static inline bool shape_has_grain(const SceneData *scene, const uint shape) {
  const __global Material *material = scene->materials + scene->shapes[shape].material;
  return material->alpha_x != material->alpha_y;
}

// Whether it asks for uv.
static inline bool shape_has_texture(const SceneData *scene, const uint shape) {
  const __global Material *material = scene->materials + scene->shapes[shape].material;
  return material->texture0 != NONE || material->texture1 != NONE;
}
