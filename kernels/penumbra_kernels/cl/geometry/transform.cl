// Where an instance stands at a time. Matrices are 3x4 rows, world-from-object; metres relative to the scene's anchor.
#include "geometry/motion.cl"

// A normal (or any gradient) by the inverse's transpose: it keeps pointing outside, even where the matrix mirrors.
static inline float3 transform_normal(const float object_from_world[3][4], const float3 n) {
  return (float3)(object_from_world[0][0] * n.x + object_from_world[1][0] * n.y + object_from_world[2][0] * n.z,
                  object_from_world[0][1] * n.x + object_from_world[1][1] * n.y + object_from_world[2][1] * n.z,
                  object_from_world[0][2] * n.x + object_from_world[1][2] * n.y + object_from_world[2][2] * n.z);
}

// |m| |p| + |translation|: what the rounding errors of m p are relative to.
static inline float3 transform_magnitude(const float m[3][4], const float3 p) {
  float out[3];
  for (int i = 0; i < 3; i++)
    out[i] = FABS(m[i][0] * p.x) + FABS(m[i][1] * p.y) + FABS(m[i][2] * p.z) + FABS(m[i][3]);
  return (float3)(out[0], out[1], out[2]);
}

// |m| e: a bound on an error e after m.
static inline float3 transform_error(const float m[3][4], const float3 e) {
  float out[3];
  for (int i = 0; i < 3; i++) out[i] = FABS(m[i][0]) * e.x + FABS(m[i][1]) * e.y + FABS(m[i][2]) * e.z;
  return (float3)(out[0], out[1], out[2]);
}

static inline void multiply_affine(const float a[3][4], const float b[3][4], float out[3][4]) {
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 4; j++)
      out[i][j] = a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j] + (j == 3 ? a[i][3] : 0.0f);
}

static inline void load_affine(const __global float *from, float m[3][4]) {
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 4; j++) m[i][j] = from[4 * i + j];
}

// Completes an inverse whose linear part is known.
static inline void untranslate(const float m[3][4], float inverse[3][4]) {
  for (int i = 0; i < 3; i++)
    inverse[i][3] = -(inverse[i][0] * m[0][3] + inverse[i][1] * m[1][3] + inverse[i][2] * m[2][3]);
}

// World-from-object, then object-from-world. A moving instance may hold another motion within its prototype.
static inline void instance_matrices(const SceneData *scene, const uint index, const float time,
                                     float world_from_object[3][4], float object_from_world[3][4]) {
  const __global Instance *instance = scene->instances + index;
  load_affine(&instance->world_from_object[0][0], world_from_object);
#if PENUMBRA_MOTION
  if (instance->slides) {
    load_affine(&instance->object_from_world[0][0], object_from_world);
    const Segment s = segment_at(scene->keyframes, instance->first_keyframe, instance->keyframe_count, time);
    segment_translation(&s, world_from_object);
    untranslate(world_from_object, object_from_world);
    return;
  }
  if (instance->keyframe_count | instance->inner_keyframe_count) {
    if (instance->keyframe_count)
      keyframe_matrix(scene->keyframes, instance->first_keyframe, instance->keyframe_count, time, world_from_object);
    if (instance->inner_keyframe_count) {
      float inner[3][4], outer[3][4];
      for (int i = 0; i < 3; i++)
        for (int j = 0; j < 4; j++) outer[i][j] = world_from_object[i][j];
      keyframe_matrix(scene->keyframes, instance->inner_first_keyframe, instance->inner_keyframe_count, time, inner);
      multiply_affine(outer, inner, world_from_object);
    }
    invert_affine(world_from_object, object_from_world);
    return;
  }
#endif
  load_affine(&instance->object_from_world[0][0], object_from_world);
}
