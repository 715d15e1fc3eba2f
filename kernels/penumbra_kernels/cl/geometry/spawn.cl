// Rays that leave a surface: moved off it by the bound on its point's error, so that they neither meet it again nor need
// an epsilon (pbrt-v4, 6.8.6). Metres, world frame.
#include "base/types.h"

// The next floats in the directions of `side`, one ulp beyond rounding. Floats are mapped to integers in their order, which
// has no branches: signs are as good as random.
static inline float3 next_towards(const float3 x, const float3 side) {
  const int3 bits = as_int3(x);
  const int3 sign = bits >> 31;
  const int3 order = (bits ^ (sign & 0x7fffffff)) - sign + ((side < 0.0f) - (side > 0.0f));
  const int3 below = order >> 31;
  return as_float3((order + below) ^ (below & 0x7fffffff));
}

// p, moved along +-n (the side that `towards` is on) out of the box of its error.
static inline float3 offset_point(const float3 p, const float3 p_error, const float3 n, const float3 towards) {
  const float distance = dot3(abs3(n), p_error);
  const float3 offset = dot3(towards, n) < 0.0f ? -distance * n : distance * n;
  return next_towards(p + offset, offset);
}

static inline Ray spawn_ray(const Surface *surface, const float3 direction, const float time) {
  Ray ray;
  ray.o = offset_point(surface->p, surface->p_error, surface->ng, direction);
  ray.d = direction;
  ray.tmax = INF_F;
  ray.time = time;
  return ray;
}

// A ray from the surface to a point that may lie on another (target_normal 0 where it does not): d = target - o, so that
// t = 1 is there, and it ends short of it.
static inline Ray spawn_ray_to(const Surface *surface, const float3 target, const float3 target_error,
                               const float3 target_normal, const float time) {
  Ray ray;
  ray.o = offset_point(surface->p, surface->p_error, surface->ng, target - surface->p);
  const float3 end = offset_point(target, target_error, target_normal, ray.o - target);
  ray.d = end - ray.o;
  // What the test of a primitive at the far end errs in t, relative to its distance: see BOX_SLACK.
  ray.tmax = 1.0f - 0x1p-19f;
  ray.time = time;
  return ray;
}
