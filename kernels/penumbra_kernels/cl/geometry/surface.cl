// A hit as a point to shade: position with its error bound, normals, uv, tangent, in the world frame. Metres relative to
// the scene's anchor.
#include "geometry/surface_triangle.cl"
#include "geometry/transform.cl"
#if PENUMBRA_ROUND
#include "geometry/surface_round.cl"
#endif
#include "geometry/spawn.cl"

// The kinds of primitive that these functions meet, a bit each: the code of the others is not there. In lanes, surface16.cl leaves
// them triangles, and planes that move.
#if !PENUMBRA_LANES
#define SURFACE_KINDS 0xffu
#else
#define SURFACE_KINDS (1u << PRIMITIVE_TRIANGLE | (uint)PENUMBRA_MOTION << PRIMITIVE_PLANE)
#endif
#define SURFACE_IS(hit, which) ((SURFACE_KINDS >> (which) & 1u) != 0u && (hit)->kind == (which))

static inline void local_surface(const SceneData *scene, const Ray *ray, const Hit *hit, const bool tangent,
                                 LocalSurface *s) {
#if PENUMBRA_ROUND
  if (SURFACE_IS(hit, PRIMITIVE_SPHERE)) {
    sphere_surface(scene, ray, hit, tangent, s);
    return;
  }
  if (SURFACE_IS(hit, PRIMITIVE_DISC)) {
    disc_surface(scene, hit, s);
    return;
  }
  if (SURFACE_IS(hit, PRIMITIVE_PLANE)) {
    plane_surface(scene, ray, hit, s);
    return;
  }
#endif
  triangle_surface(scene, hit, ray->time, tangent, s);
}

#if PENUMBRA_INSTANCING
// Object to world. The error grows by the rounding of the transform, by what comes back differently when the next ray
// is brought into the object's frame (the two matrices are inverse only up to rounding), and by that ray's own rounding.
static inline void place_surface(const float world_from_object[3][4], const float object_from_world[3][4], LocalSurface *s) {
  const float3 p = s->p;
  s->p = transform_point(world_from_object, p);
  const float3 round_trip = abs3(transform_point(object_from_world, s->p) - p) +
                            GAMMA(4) * transform_magnitude(object_from_world, s->p) + s->p_error;
  s->p_error = transform_error(world_from_object, round_trip) * (1.0f + GAMMA(4)) +
               GAMMA(4) * transform_magnitude(world_from_object, p);
  s->ng = normalize3(transform_normal(object_from_world, s->ng));
  s->ns = transform_normal(object_from_world, s->ns);
  s->tangent = transform_vector(world_from_object, s->tangent);
}
#endif

// A vector of any length, to unit length; `otherwise` where it has none.
static inline float3 unit_or(const float3 v, const float3 otherwise) {
  const float size = max3(abs3(v));
  if (!(size > 0.0f && size < INF_F)) return otherwise;
  return normalize3(v * (1.0f / size));
}

// The tangent made orthogonal to a unit normal; any, where it is along the normal or there is none.
static inline float3 unit_tangent(const float3 tangent, const float3 n) {
  const float3 t = unit_or(tangent, n);
  const float3 across = t - n * dot3(t, n);
  if (dot3(across, across) > 1e-6f) return normalize3(across);  // otherwise its direction is mostly rounding
  float3 s, unused;
  make_frame(n, &s, &unused);
  return s;
}

// `hit` is a hit (not a miss) of `ray`. tangent: whether tangents and uv are asked for on materials without use for them too; where
// not, the tangent is any vector orthogonal to ns there.
static inline void surface_with(const SceneData *scene, const Ray ray, const Hit hit, const bool tangent,
                                Surface *surface) {
  LocalSurface s;
  Ray own = ray;
#if PENUMBRA_INSTANCING
  float world_from_object[3][4], object_from_world[3][4];
  if (hit.instance != NONE) {
    instance_matrices(scene, hit.instance, ray.time, world_from_object, object_from_world);
    own.o = transform_point(object_from_world, ray.o);
    own.d = transform_vector(object_from_world, ray.d);
  }
#endif
  local_surface(scene, &own, &hit, tangent, &s);
#if PENUMBRA_INSTANCING
  if (hit.instance != NONE) place_surface(world_from_object, object_from_world, &s);
#endif
  surface->p = s.p;
  surface->p_error = s.p_error;
  surface->ng = s.ng;
  const float3 ns = unit_or(s.ns, s.ng);
  surface->ns = dot3(ns, s.ng) < 0.0f ? -ns : ns;
  if (tangent || shape_has_grain(scene, s.shape)) {
    surface->tangent = unit_tangent(s.tangent, surface->ns);
  } else {
    float3 unused;
    make_frame(surface->ns, &surface->tangent, &unused);
  }
  surface->uv = s.uv;
  surface->shape = s.shape;
  surface->instance = hit.instance;
  surface->kind = hit.kind;
  surface->primitive = hit.primitive;
}

static inline void surface_at(const SceneData *scene, const Ray ray, const Hit hit, Surface *surface) {
  surface_with(scene, ray, hit, true, surface);
}

// What shading needs.
static inline void surface_to_shade(const SceneData *scene, const Ray ray, const Hit hit, Surface *surface) {
  surface_with(scene, ray, hit, false, surface);
}
