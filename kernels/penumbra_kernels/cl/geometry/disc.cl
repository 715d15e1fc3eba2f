// Discs, and the ellipses that stretching makes of them, against one ray. Metres in the tree's frame.
#include "geometry/hit.cl"

// Unit normal; the half axes are orthogonal.
static inline float3 disc_normal(const __global DiscData *disc) {
  return normalize3(cross3(normalize3(load3(disc->u)), normalize3(load3(disc->v))));
}

// t > 0 on the disc, INF_F where there is none; a, b: its half-axis coordinates.
static inline float disc_distance(const __global DiscData *disc, const float3 o, const float3 d, float *a, float *b) {
  const float3 u = load3(disc->u), v = load3(disc->v);
  const float3 n = disc_normal(disc);
  const float3 f = load3(disc->center) - o;
  const float t = dot3(f, n) / dot3(d, n);
  if (!(t > 0.0f && t < INF_F)) return INF_F;
  const float3 q = t * d - f;
  *a = dot3(q, u) / dot3(u, u);
  *b = dot3(q, v) / dot3(v, v);
  return *a * *a + *b * *b <= 1.0f ? t : INF_F;
}
