// Sixteen rays in the frame that an instance has at the time of each. Metres, seconds.
#include "geometry/wide16.cl"
#include "geometry/motion16.cl"

#if PENUMBRA_MOTION
// meets_moving of the lanes of `on`. w: the rays in the world.
static inline Mask16 meets_moving16(const SceneData *scene, const __global Instance *instance, const float16 time,
                                    const WideRay16 *w, const float16 end, const Mask16 on) {
  const bool outer = instance->keyframe_count > 0u;
  const uint first = outer ? instance->first_keyframe : instance->inner_first_keyframe;
  const uint count = outer ? instance->keyframe_count : instance->inner_keyframe_count;
  if (count < 2u) return on;
  const float begin = scene->keyframes[first].time;
  const float16 part = (time - begin) * ((float)MOTION_BOXES / (scene->keyframes[first + count - 1u].time - begin));
  const float16 zero = 0.0f, last = (float)(MOTION_BOXES - 1u);
  const float16 box = part > 0.0f ? MIN16(part, last) : zero;
  const __global float *node = (const __global float *)(scene->nodes + instance->motion_node);
  const uint16 at = as_uint16(to_int16(box));
  const Vec16 lo = vec16(gather16(node, at, on), gather16(node + 16, at, on), gather16(node + 32, at, on));
  const Vec16 hi = vec16(gather16(node + 8, at, on), gather16(node + 24, at, on), gather16(node + 40, at, on));
  float16 enter;
  return on & meet_planes16(lo, hi, w, end, &enter);
}
#endif

// Rays in an instance's frame.
typedef struct {
  Vec16 o, d;
  WideRay16 wide;
} InsideRays16;

// enter_instance of the lanes of `on`: those that go on in the instance's tree. world: the rays there; end: how far they go.
static PENUMBRA_NOINLINE PENUMBRA_WIDE void enter_instance16(const SceneData *scene, const uint index, const Ray16 *ray,
                                                             const WideRay16 *world, const float16 *end, Mask16 *on,
                                                             InsideRays16 *inside) {
#if PENUMBRA_MOTION
  if (!any16(*on)) return;
  *on = meets_moving16(scene, scene->instances + index, ray->time, world, *end, *on);
#endif
  if (!any16(*on)) return;
  Placement16 at;
  instance_matrices16(scene, index, ray->time, *on, &at);
  inside->o = transform_point16(&at.object_from_world, ray->o);
  inside->d = transform_vector16(&at.object_from_world, ray->d);
  wide_ray16(&inside->o, &inside->d, &inside->wide);
  *on &= inside->wide.is_ray;
}
