// Rays that leave a surface, sixteen at once (spawn.cl). Metres, world frame.
#include "base/types16.h"

static inline float16 next_towards16(const float16 x, const float16 side) {
  const int16 bits = as_int16(x);
  const int16 sign = bits >> 31;
  const int16 order = (bits ^ (sign & 0x7fffffff)) - sign + ((side < 0.0f) - (side > 0.0f));
  const int16 below = order >> 31;
  return as_float16((order + below) ^ (below & 0x7fffffff));
}

static inline Vec16 offset_point16(const Vec16 p, const Vec16 p_error, const Vec16 n, const Vec16 towards) {
  const float16 distance = dot16(abs3_16(n), p_error);
  const Vec16 offset = where16(dot16(towards, n) < 0.0f, scale16(n, -distance), scale16(n, distance));
  return vec16(next_towards16(p.x + offset.x, offset.x), next_towards16(p.y + offset.y, offset.y),
               next_towards16(p.z + offset.z, offset.z));
}

static inline Ray16 spawn_ray16(const Surface16 *surface, const Vec16 direction, const float16 time) {
  Ray16 ray;
  ray.o = offset_point16(surface->p, surface->p_error, surface->ng, direction);
  ray.d = direction;
  ray.tmax = INF_F;
  ray.time = time;
  return ray;
}

static inline Ray16 spawn_ray_to16(const Surface16 *surface, const Vec16 target, const Vec16 target_error,
                                   const Vec16 target_normal, const float16 time) {
  Ray16 ray;
  ray.o = offset_point16(surface->p, surface->p_error, surface->ng, sub16(target, surface->p));
  const Vec16 end = offset_point16(target, target_error, target_normal, sub16(ray.o, target));
  ray.d = sub16(end, ray.o);
  ray.tmax = 1.0f - 0x1p-19f;
  ray.time = time;
  return ray;
}
