#include "base/types.h"
#include "base/effects.h"

// What one path brings back.
typedef struct {
  float3 radiance;
  float alpha;       // 1 where the camera ray met a surface
  float3 albedo;     // of the first hit
  float3 normal;     // its shading normal
  float depth;       // its distance along the camera's axis
  uint object_id;    // 1 + index of the shape, 0 for none
  uint effects;      // EFFECT_* bits met on the way
  uint rays;         // traced, shadow rays included
} PathSample;

static inline PathSample no_path(void) {
  PathSample none;
  none.radiance = (float3)(0.0f);
  none.alpha = 0.0f;
  none.albedo = (float3)(0.0f);
  none.normal = (float3)(0.0f);
  none.depth = 0.0f;
  none.object_id = 0u;
  none.effects = 0u;
  none.rays = 0u;
  return none;
}
