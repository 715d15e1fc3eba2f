// Where instances stand at the times of sixteen rays (motion.cl, transform.cl), bit for bit as at each alone. Matrices are 3x4
// rows, metres relative to the scene's anchor; times in seconds from the frame's.
#include "base/types16.h"
#include "geometry/transform.cl"

typedef struct {
  float16 m[3][4];
} Affine16;

// World-from-object and its inverse.
typedef struct {
  Affine16 world_from_object, object_from_world;
} Placement16;

static inline Vec16 transform_point16(const Affine16 *a, const Vec16 p) {
  return vec16(a->m[0][0] * p.x + a->m[0][1] * p.y + a->m[0][2] * p.z + a->m[0][3],
               a->m[1][0] * p.x + a->m[1][1] * p.y + a->m[1][2] * p.z + a->m[1][3],
               a->m[2][0] * p.x + a->m[2][1] * p.y + a->m[2][2] * p.z + a->m[2][3]);
}

static inline Vec16 transform_vector16(const Affine16 *a, const Vec16 v) {
  return vec16(a->m[0][0] * v.x + a->m[0][1] * v.y + a->m[0][2] * v.z, a->m[1][0] * v.x + a->m[1][1] * v.y + a->m[1][2] * v.z,
               a->m[2][0] * v.x + a->m[2][1] * v.y + a->m[2][2] * v.z);
}

static inline Vec16 transform_normal16(const Affine16 *inverse, const Vec16 n) {
  return vec16(inverse->m[0][0] * n.x + inverse->m[1][0] * n.y + inverse->m[2][0] * n.z,
               inverse->m[0][1] * n.x + inverse->m[1][1] * n.y + inverse->m[2][1] * n.z,
               inverse->m[0][2] * n.x + inverse->m[1][2] * n.y + inverse->m[2][2] * n.z);
}

static inline float16 row_magnitude16(const float16 row[4], const Vec16 p) {
  return abs16(row[0] * p.x) + abs16(row[1] * p.y) + abs16(row[2] * p.z) + abs16(row[3]);
}

static inline Vec16 transform_magnitude16(const Affine16 *a, const Vec16 p) {
  return vec16(row_magnitude16(a->m[0], p), row_magnitude16(a->m[1], p), row_magnitude16(a->m[2], p));
}

static inline float16 row_error16(const float16 row[4], const Vec16 e) {
  return abs16(row[0]) * e.x + abs16(row[1]) * e.y + abs16(row[2]) * e.z;
}

static inline Vec16 transform_error16(const Affine16 *a, const Vec16 e) {
  return vec16(row_error16(a->m[0], e), row_error16(a->m[1], e), row_error16(a->m[2], e));
}

// The same matrix in every lane.
static inline void load_affine16(const __global float *from, Affine16 *to) {
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 4; j++) to->m[i][j] = from[4 * i + j];
}

// Takes the lanes of `on` over.
static inline void put_affine16(const Mask16 on, const Affine16 *from, Affine16 *to) {
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 4; j++) to->m[i][j] = on ? from->m[i][j] : to->m[i][j];
}

#if PENUMBRA_MOTION
// The segment of the first lane that is left; the lanes whose times lie in it leave `left`, and are returned.
static inline Mask16 next_segment16(const __global Keyframe *keys, const uint first, const uint count, const float16 time,
                                    Mask16 *left, Segment *s, float16 *fraction) {
  *s = segment_at(keys, first, count, LANE_F(time, CTZ(mask16(*left))));
  Mask16 same = *left;
  if (s->a != keys + first) same &= s->a->time <= time;
  if (count > 2u && s->b != keys + (first + count - 1u)) same &= !(s->b->time <= time);
  *left &= ~same;
  const float span = s->b->time - s->a->time;
  const float16 zero = 0.0f, raw = (time - s->a->time) / span;
  *fraction = span > 0.0f ? clamp01_16(raw) : zero;
  return same;
}

static inline float16 sinc_of_square16(const float16 x) {
  const float16 high = fma16(fma16(x, -2.38892170e-8f, 2.75252698e-6f), x, -1.98408612e-4f);
  return fma16(fma16(fma16(high, x, 8.33333097e-3f), x, -1.66666666e-1f), x, 1.0f);
}

static inline float16 slerp_weight16(const float16 t, const float angle_squared, const float angle_by_sine) {
  return t * sinc_of_square16(t * t * angle_squared) * angle_by_sine;
}

static inline void rotate_stretch16(const float16 q[4], const float16 stretch[3][3], Affine16 *out) {
  const float16 s = 2.0f / (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  const float16 xs = q[0] * s, ys = q[1] * s, zs = q[2] * s;
  const float16 wx = q[3] * xs, wy = q[3] * ys, wz = q[3] * zs;
  const float16 xx = q[0] * xs, xy = q[0] * ys, xz = q[0] * zs;
  const float16 yy = q[1] * ys, yz = q[1] * zs, zz = q[2] * zs;
  const float16 r[3][3] = {{1.0f - (yy + zz), xy - wz, xz + wy},
                           {xy + wz, 1.0f - (xx + zz), yz - wx},
                           {xz - wy, yz + wx, 1.0f - (xx + yy)}};
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++)
      out->m[i][j] = r[i][0] * stretch[0][j] + r[i][1] * stretch[1][j] + r[i][2] * stretch[2][j];
}

// segment_translation in the lanes of `on`.
static inline void segment_translation16(const Segment *s, const float16 t, const Mask16 on, Affine16 *out) {
  for (int i = 0; i < 3; i++) {
    const float16 at = (1.0f - t) * s->a->translation[i] + t * s->b->translation[i];
    out->m[i][3] = on ? at : out->m[i][3];
  }
}

// keyframe_matrix in the lanes of `on`.
static PENUMBRA_NOINLINE PENUMBRA_WIDE void keyframe_matrix16(const __global Keyframe *keys, const uint first, const uint count,
                                                              const float16 *time, const Mask16 *on, Affine16 *out) {
  Mask16 left = *on;
  while (any16(left)) {
    Segment s;
    float16 t;
    const Mask16 same = next_segment16(keys, first, count, *time, &left, &s, &t);
    const __global Keyframe *a = s.a, *b = s.b;
    const float16 wa = slerp_weight16(1.0f - t, a->stretch[0][3], a->stretch[1][3]);
    const float16 wb = slerp_weight16(t, a->stretch[0][3], a->stretch[1][3]);
    float16 q[4], stretch[3][3];
    for (int i = 0; i < 4; i++) q[i] = wa * a->rotation[i] + wb * b->rotation[i];
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++) stretch[i][j] = (1.0f - t) * a->stretch[i][j] + t * b->stretch[i][j];
    Affine16 its;
    rotate_stretch16(q, stretch, &its);
    for (int i = 0; i < 3; i++) its.m[i][3] = 0.0f;
    segment_translation16(&s, t, same, &its);
    put_affine16(same, &its, out);
  }
}

static inline Vec16 column16(const Affine16 *a, const int j, const float16 scale) {
  return scale16(vec16(a->m[0][j], a->m[1][j], a->m[2][j]), scale);
}

static PENUMBRA_NOINLINE PENUMBRA_WIDE void invert_affine16(const Affine16 *a, Affine16 *out) {
  float16 largest = 0.0f;
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) {
      const float16 size = abs16(a->m[i][j]);
      largest = MAX16(largest, size);
    }
  const float16 scale = 1.0f / largest;
  const Vec16 c0 = column16(a, 0, scale), c1 = column16(a, 1, scale), c2 = column16(a, 2, scale);
  const Vec16 r0 = cross16(c1, c2);
  const float16 inverse_det = scale / dot16(c0, r0);
  const Vec16 rows[3] = {scale16(r0, inverse_det), scale16(cross16(c2, c0), inverse_det), scale16(cross16(c0, c1), inverse_det)};
  const Vec16 t = vec16(a->m[0][3], a->m[1][3], a->m[2][3]);
  for (int i = 0; i < 3; i++) {
    out->m[i][0] = rows[i].x;
    out->m[i][1] = rows[i].y;
    out->m[i][2] = rows[i].z;
    out->m[i][3] = -dot16(rows[i], t);
  }
}

static inline void multiply_affine16(const Affine16 *a, const Affine16 *b, Affine16 *out) {
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 4; j++) {
      const float16 linear = a->m[i][0] * b->m[0][j] + a->m[i][1] * b->m[1][j] + a->m[i][2] * b->m[2][j];
      out->m[i][j] = linear + (j == 3 ? a->m[i][3] : (float16)(0.0f));
    }
}

// What slides: its linear parts hold at all times.
static inline void slide16(const SceneData *scene, const __global Instance *instance, const float16 time, const Mask16 on,
                           Placement16 *at) {
  Affine16 *inverse = &at->object_from_world;
  Mask16 left = on;
  while (any16(left)) {
    Segment s;
    float16 t;
    const Mask16 same =
        next_segment16(scene->keyframes, instance->first_keyframe, instance->keyframe_count, time, &left, &s, &t);
    segment_translation16(&s, t, same, &at->world_from_object);
  }
  const Affine16 *m = &at->world_from_object;
  for (int i = 0; i < 3; i++)
    inverse->m[i][3] = -(inverse->m[i][0] * m->m[0][3] + inverse->m[i][1] * m->m[1][3] + inverse->m[i][2] * m->m[2][3]);
}

// What turns or stretches, around a motion within its prototype where there is one. `at` holds the matrices of no motion.
static inline void turn16(const SceneData *scene, const __global Instance *instance, const float16 time, const Mask16 on,
                          Placement16 *at) {
  if (instance->keyframe_count) {
    keyframe_matrix16(scene->keyframes, instance->first_keyframe, instance->keyframe_count, &time, &on, &at->world_from_object);
  }
  if (instance->inner_keyframe_count) {
    const Affine16 outer = at->world_from_object;
    Affine16 inner = outer;
    keyframe_matrix16(scene->keyframes, instance->inner_first_keyframe, instance->inner_keyframe_count, &time, &on, &inner);
    multiply_affine16(&outer, &inner, &at->world_from_object);
  }
  invert_affine16(&at->world_from_object, &at->object_from_world);
}
#endif

// instance_matrices at the times of the lanes of `on`; the others' mean nothing.
static inline void instance_matrices16(const SceneData *scene, const uint index, const float16 time, const Mask16 on,
                                       Placement16 *at) {
  const __global Instance *instance = scene->instances + index;
  load_affine16(&instance->world_from_object[0][0], &at->world_from_object);
  load_affine16(&instance->object_from_world[0][0], &at->object_from_world);
#if PENUMBRA_MOTION
  if (instance->slides) slide16(scene, instance, time, on, at);
  else if (instance->keyframe_count | instance->inner_keyframe_count) turn16(scene, instance, time, on, at);
#endif
}
