// Cameras: from a point of the film, of the lens and of the shutter interval to a ray in the world.
// Film coordinates run from 0 to 1 over the full frame, x to the right, y down. The camera looks along its -Z, X right, Y up.
// Effects: PENUMBRA_LENS, PENUMBRA_CAMERA_MOTION; a program that has them gives a camera without them the same bits.
#include "base/types.h"
#include "geometry/motion.cl"
#include "sampling/warp.cl"

#define CAMERA_PERSPECTIVE 0u
#define CAMERA_ORTHOGRAPHIC 1u

// The instant for a uniform u, seconds from the frame's time, by the shutter's curve; where the shutter opens and closes
// at once exactly that instant.
static inline float camera_time(const __global Camera *c, const __global float *shutter_table, const float u) {
  float sign;
  const float at = sample_table(shutter_table, u, &sign);
  const float time = c->shutter_open + (c->shutter_close - c->shutter_open) * at;
  return MIN(time, c->shutter_close);
}

// A point on the aperture in camera space, metres (its z is 0). A call: inlined, sixteen lanes that wait for it one by one keep
// their other values in memory (4 % of `depth_of_field`).
static PENUMBRA_NOINLINE float2 lens_point(const __global Camera *c, const float2 u) {
  const float2 p = c->blades >= 3u ? square_to_polygon(u, c->blades, c->blade_rotation) : square_to_disc(u);
  return p * c->aperture_radius;
}

// World-from-camera rows at a time.
static inline void camera_matrix(const __global Camera *c, const __global Keyframe *keys, const float time,
                                 float m[3][4]) {
#if PENUMBRA_CAMERA_MOTION
  if (c->keyframe_count > 0u) {
    keyframe_matrix(keys, c->first_keyframe, c->keyframe_count, time, m);
    return;
  }
#endif
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 4; ++j) m[i][j] = c->world_from_camera[i][j];
}

// Where it looks at the shutter's opening, in the world.
static inline float3 camera_axis(const __global Camera *c) {
  return (float3)(-c->world_from_camera[0][2], -c->world_from_camera[1][2], -c->world_from_camera[2][2]);
}

// The ray through a film point. Its direction has length 1 along the optical axis. A thin lens bends every ray from the
// film point to one point of the plane in focus, which is perpendicular to the axis (Cook, Porter, Carpenter 1984): from a
// lens point l to p f at distance f that is the direction p - l / f, free of cancellation however far the plane is, and
// with an aperture of 0 bit for bit the pinhole's.
static inline Ray camera_ray(const __global Camera *c, const __global Keyframe *keys, const float2 film01,
                             const float2 lens_u, const float time) {
  const float x = (2.0f * film01.x - 1.0f) * c->scale_x;
  const float y = (1.0f - 2.0f * film01.y) * c->scale_y;
#if PENUMBRA_LENS
  const float2 lens = lens_point(c, lens_u);
  const float2 tilt = lens * (1.0f / c->focus_distance);
#else
  const float2 lens = (float2)(0.0f);
  const float2 tilt = (float2)(0.0f);
#endif
  const bool parallel = c->kind == CAMERA_ORTHOGRAPHIC;
  const float3 origin = parallel ? (float3)(x + lens.x, y + lens.y, 0.0f) : (float3)(lens.x, lens.y, 0.0f);
  const float3 direction = parallel ? (float3)(-tilt.x, -tilt.y, -1.0f) : (float3)(x - tilt.x, y - tilt.y, -1.0f);
  float m[3][4];
  camera_matrix(c, keys, time, m);
  Ray ray;
  ray.o = transform_point(m, origin);
  ray.d = transform_vector(m, direction);
  ray.tmax = INF_F;
  ray.time = time;
  return ray;
}
