// Rigid and stretching motion: keyframes to a matrix at a time, and the inverse of an affine matrix.
// Matrices are world-from-object, 3x4 rows, metres relative to the scene's anchor; times in seconds from the frame's.
#include "base/types.h"

// sin(a) / a for a^2 in [0, (pi/2)^2]; absolute error below 2^-23. One polynomial serves the whole slerp, without a
// division that could be 0 / 0 where the rotation stands still.
static inline float sinc_of_square(const float x) {
  const float high = FMA(FMA(x, -2.38892170e-8f, 2.75252698e-6f), x, -1.98408612e-4f);
  return FMA(FMA(FMA(high, x, 8.33333097e-3f), x, -1.66666666e-1f), x, 1.0f);
}

// Weight of a keyframe's rotation at a fraction t of the way to it: sin(t a) / sin(a) (Shoemake 1985), written
// t * sinc(t a) / sinc(a). angle_squared and angle_by_sine are what the host left in the keyframe (compile/transforms.py).
static inline float slerp_weight(const float t, const float angle_squared, const float angle_by_sine) {
  return t * sinc_of_square(t * t * angle_squared) * angle_by_sine;
}

// Index in [first, first + count - 2] of the keyframe that begins the segment holding `time`; count >= 2.
static inline uint keyframe_segment(const __global Keyframe *keys, const uint first, const uint count, const float time) {
  uint low = first;
  uint high = first + count - 1u;
  while (high - low > 1u) {
    const uint middle = (low + high) >> 1;
    if (keys[middle].time <= time) low = middle; else high = middle;
  }
  return low;
}

// Rows of R(q) S for a quaternion that need not have unit length: the factor 2 / |q|^2 makes R orthogonal to rounding
// without a square root.
static inline void rotate_stretch(const float q[4], const float stretch[3][3], float out[3][4]) {
  const float s = 2.0f / (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  const float xs = q[0] * s, ys = q[1] * s, zs = q[2] * s;
  const float wx = q[3] * xs, wy = q[3] * ys, wz = q[3] * zs;
  const float xx = q[0] * xs, xy = q[0] * ys, xz = q[0] * zs;
  const float yy = q[1] * ys, yz = q[1] * zs, zz = q[2] * zs;
  const float r[3][3] = {{1.0f - (yy + zz), xy - wz, xz + wy},
                         {xy + wz, 1.0f - (xx + zz), yz - wx},
                         {xz - wy, yz + wx, 1.0f - (xx + yy)}};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      out[i][j] = r[i][0] * stretch[0][j] + r[i][1] * stretch[1][j] + r[i][2] * stretch[2][j];
}

// The keyframes around a time, and what fraction of the way from the one to the other has passed; before the first keyframe and
// after the last it stands still. count >= 1.
typedef struct {
  const __global Keyframe *a, *b;
  float fraction;
} Segment;

static inline Segment segment_at(const __global Keyframe *keys, const uint first, const uint count, const float time) {
  const uint begin = count > 1u ? keyframe_segment(keys, first, count, time) : first;
  Segment s;
  s.a = keys + begin;
  s.b = keys + (count > 1u ? begin + 1u : first);
  const float span = s.b->time - s.a->time;
  const float raw = span > 0.0f ? (time - s.a->time) / span : 0.0f;
  s.fraction = CLAMP01(raw);
  return s;
}

// The translation alone, linear between keyframes, into the matrix's last column.
static inline void segment_translation(const Segment *s, float world_from_object[3][4]) {
  const float t = s->fraction;
  for (int i = 0; i < 3; ++i) world_from_object[i][3] = (1.0f - t) * s->a->translation[i] + t * s->b->translation[i];
}

// World-from-object matrix at a time: translation and stretch linear between keyframes, rotation by slerp along the
// arc that the host chose.
static inline void keyframe_matrix(const __global Keyframe *keys, const uint first, const uint count, const float time,
                                   float world_from_object[3][4]) {
  const Segment s = segment_at(keys, first, count, time);
  const __global Keyframe *a = s.a;
  const __global Keyframe *b = s.b;
  const float t = s.fraction;
  const float wa = slerp_weight(1.0f - t, a->stretch[0][3], a->stretch[1][3]);
  const float wb = slerp_weight(t, a->stretch[0][3], a->stretch[1][3]);
  float q[4], stretch[3][3];
  for (int i = 0; i < 4; ++i) q[i] = wa * a->rotation[i] + wb * b->rotation[i];
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) stretch[i][j] = (1.0f - t) * a->stretch[i][j] + t * b->stretch[i][j];
  rotate_stretch(q, stretch, world_from_object);
  segment_translation(&s, world_from_object);
}

static inline float3 transform_point(const float m[3][4], const float3 p) {
  return (float3)(m[0][0] * p.x + m[0][1] * p.y + m[0][2] * p.z + m[0][3],
                  m[1][0] * p.x + m[1][1] * p.y + m[1][2] * p.z + m[1][3],
                  m[2][0] * p.x + m[2][1] * p.y + m[2][2] * p.z + m[2][3]);
}

static inline float3 transform_vector(const float m[3][4], const float3 v) {
  return (float3)(m[0][0] * v.x + m[0][1] * v.y + m[0][2] * v.z, m[1][0] * v.x + m[1][1] * v.y + m[1][2] * v.z,
                  m[2][0] * v.x + m[2][1] * v.y + m[2][2] * v.z);
}

// Inverse of an affine matrix by cofactors. The linear part is scaled to a largest element of 1 first, so that neither
// tiny nor huge matrices leave the range of float; cofactors are good to 1.5 ulp each (difference_of_products).
static inline void invert_affine(const float m[3][4], float out[3][4]) {
  float largest = 0.0f;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) largest = MAX(largest, FABS(m[i][j]));
  const float scale = 1.0f / largest;
  const float3 c0 = (float3)(m[0][0], m[1][0], m[2][0]) * scale;
  const float3 c1 = (float3)(m[0][1], m[1][1], m[2][1]) * scale;
  const float3 c2 = (float3)(m[0][2], m[1][2], m[2][2]) * scale;
  const float3 r0 = cross3(c1, c2);
  const float inverse_det = scale / dot3(c0, r0);
  const float3 rows[3] = {r0 * inverse_det, cross3(c2, c0) * inverse_det, cross3(c0, c1) * inverse_det};
  const float3 t = (float3)(m[0][3], m[1][3], m[2][3]);
  for (int i = 0; i < 3; ++i) {
    out[i][0] = rows[i].x;
    out[i][1] = rows[i].y;
    out[i][2] = rows[i].z;
    out[i][3] = -dot3(rows[i], t);
  }
}
