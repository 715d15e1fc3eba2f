// Infinite planes against one ray: few, so they stand in a list instead of a tree. Metres, world frame.
#include "geometry/hit.cl"
#include "geometry/transform.cl"

// A still plane, or a moving one at one time.
typedef struct {
  float3 point, normal, tangent_u, tangent_v;
} PlaneAt;

static inline PlaneAt plane_at(const SceneData *scene, const __global PlaneData *plane, const float time) {
  PlaneAt at;
  at.point = load3(plane->point);
  at.normal = load3(plane->normal);
  at.tangent_u = load3(plane->tangent_u);
  at.tangent_v = load3(plane->tangent_v);
#if PENUMBRA_MOTION
  if (plane->keyframe_count) {
    float m[3][4], inverse[3][4];
    keyframe_matrix(scene->keyframes, plane->first_keyframe, plane->keyframe_count, time, m);
    invert_affine(m, inverse);
    at.point = transform_point(m, at.point);
    at.normal = normalize3(transform_normal(inverse, at.normal));
    at.tangent_u = transform_normal(inverse, at.tangent_u);  // gradients of uv transform as normals do
    at.tangent_v = transform_normal(inverse, at.tangent_v);
  }
#endif
  return at;
}

// Offers every plane that is hit; true where there is one.
static inline bool hit_planes(const SceneData *scene, const Ray *ray, const bool any, Hit *best) {
  bool found = false;
  for (uint i = 0; i < scene->plane_count; i++) {
    const PlaneAt plane = plane_at(scene, scene->planes + i, ray->time);
    const float t = dot3(plane.point - ray->o, plane.normal) / dot3(ray->d, plane.normal);
    if (!(t > 0.0f && t < INF_F && (any ? t < best->t : t <= best->t))) continue;
    if (any) return true;
    found = true;
    hit_offer(t, 0.0f, 0.0f, PRIMITIVE_PLANE, i, NONE, best);
  }
  return found;
}
