// Rays of sixteen samples of a pixel (camera.cl, film/filter.cl), bit for bit as each alone. What moves, and apertures with blades,
// go one by one.
#include "base/types16.h"
#include "camera/camera.cl"
#include "film/filter.cl"
#include "sampling/warp16.cl"

static inline float16 filter_axis16(const __global float *table, const float16 u, const Mask16 on, float16 *sign) {
  const float16 side = 2.0f * u - 1.0f;
  return copy_sign16(sample_table16(table, abs16(side), on, sign), side);
}

// Offsets from the pixel's centre.
static inline void filter_sample16(const __global float *filter_table, const float radius, const float16 ux, const float16 uy,
                                   const Mask16 on, float16 *x, float16 *y, float16 *weight) {
  float16 sign_x, sign_y;
  *x = filter_axis16(filter_table, ux, on, &sign_x) * radius;
  *y = filter_axis16(filter_table, uy, on, &sign_y) * radius;
  *weight = sign_x * sign_y * filter_table[1];
}

static inline float16 camera_time16(const __global Camera *c, const __global float *shutter_table, const float16 u, const Mask16 on) {
  float16 sign;
  const float16 time = c->shutter_open + (c->shutter_close - c->shutter_open) * sample_table16(shutter_table, u, on, &sign);
  const float16 close = c->shutter_close;
  return MIN16(time, close);
}

#if PENUMBRA_LENS
static inline void lens_point16(const __global Camera *c, const float16 ux, const float16 uy, const Mask16 on, float16 *x,
                                float16 *y) {
  if (c->blades >= 3u) {
    for (LANES_OF(k, on)) {
      const float2 p = lens_point(c, (float2)(LANE_F(ux, k), LANE_F(uy, k)));
      LANE_F(*x, k) = p.x;
      LANE_F(*y, k) = p.y;
    }
    return;
  }
  square_to_disc16(ux, uy, x, y);
  *x *= c->aperture_radius;
  *y *= c->aperture_radius;
}
#endif

static inline float16 row_of_matrix16(const float row[4], const Vec16 p) { return row[0] * p.x + row[1] * p.y + row[2] * p.z; }

// Film coordinates from 0 to 1; lens: uniform numbers.
static inline Ray16 camera_rays16(const __global Camera *c, const __global Keyframe *keys, const float16 film_x, const float16 film_y,
                                  const float16 lens_x, const float16 lens_y, const float16 time, const Mask16 on) {
  Ray16 ray;
#if PENUMBRA_CAMERA_MOTION
  if (c->keyframe_count > 0u) {
    for (LANES_OF(k, on)) {
      set_lane_ray(&ray, k, camera_ray(c, keys, (float2)(LANE_F(film_x, k), LANE_F(film_y, k)),
                                       (float2)(LANE_F(lens_x, k), LANE_F(lens_y, k)), LANE_F(time, k)));
    }
    return ray;
  }
#endif
  const float16 zero = 0.0f, minus_one = -1.0f;
  const float16 x = (2.0f * film_x - 1.0f) * c->scale_x;
  const float16 y = (1.0f - 2.0f * film_y) * c->scale_y;
  float16 at_x = 0.0f, at_y = 0.0f, tilt_x = 0.0f, tilt_y = 0.0f;
#if PENUMBRA_LENS
  lens_point16(c, lens_x, lens_y, on, &at_x, &at_y);
  tilt_x = at_x * (1.0f / c->focus_distance);
  tilt_y = at_y * (1.0f / c->focus_distance);
#endif
  const bool parallel = c->kind == CAMERA_ORTHOGRAPHIC;
  const Vec16 origin = parallel ? vec16(x + at_x, y + at_y, zero) : vec16(at_x, at_y, zero);
  const Vec16 direction = parallel ? vec16(-tilt_x, -tilt_y, minus_one) : vec16(x - tilt_x, y - tilt_y, minus_one);
  float m[3][4];
  camera_matrix(c, keys, 0.0f, m);
  ray.o = vec16(row_of_matrix16(m[0], origin) + m[0][3], row_of_matrix16(m[1], origin) + m[1][3],
                row_of_matrix16(m[2], origin) + m[2][3]);
  ray.d = vec16(row_of_matrix16(m[0], direction), row_of_matrix16(m[1], direction), row_of_matrix16(m[2], direction));
  ray.tmax = INF_F;
  ray.time = time;
  return ray;
}
