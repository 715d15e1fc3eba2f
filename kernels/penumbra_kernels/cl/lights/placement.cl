// Where a light is at a time: the matrix of the instance that carries it, or of its own keyframes.
// Matrices are world-from-object, 3x4 rows, metres relative to the anchor; time in seconds from the frame's.
#include "base/types.h"
#include "geometry/transform.cl"

// Rounding of a transformed point: three products and three sums on each of two transforms in a row.
#define PLACED_ERROR GAMMA(8)

// Matrices of the instance that carries an area light; false where the light is in the world already.
static inline bool area_light_placement(const SceneData *scene, const __global Light *light, const float time,
                                        float world_from_object[3][4], float object_from_world[3][4]) {
#if PENUMBRA_INSTANCING
  if (light->instance == NONE) return false;
  instance_matrices(scene, light->instance, time, world_from_object, object_from_world);
  return true;
#else
  return false;
#endif
}

// World-from-object matrix of a point, spot or directional light that moves; false where it stands still.
static inline bool delta_light_matrix(const SceneData *scene, const __global Light *light, const float time,
                                      float m[3][4]) {
#if PENUMBRA_MOTION
  if (light->keyframe_count == 0u) return false;
  keyframe_matrix(scene->keyframes, light->first_keyframe, light->keyframe_count, time, m);
  return true;
#else
  return false;
#endif
}

static inline float3 column(const float m[3][4], const int j) { return (float3)(m[0][j], m[1][j], m[2][j]); }

// |det| of the linear part is the volume factor; its sign tells whether the matrix mirrors.
static inline float determinant(const float m[3][4]) { return dot3(column(m, 0), cross3(column(m, 1), column(m, 2))); }
