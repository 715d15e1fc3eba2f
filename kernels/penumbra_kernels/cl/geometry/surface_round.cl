// Hits on spheres, discs and planes as points on surfaces, in the frame of their tree. Metres.
#include "base/transcendental.cl"
#include "geometry/surface_local.cl"
#include "geometry/disc.cl"
#include "geometry/plane.cl"

static inline float3 rotate_by(const float4 q, const float3 v) {
  const float3 t = 2.0f * cross3(q.xyz, v);
  return v + q.w * t + cross3(q.xyz, t);
}

// Longitude from +Z towards +X and latitude from -Y to +Y, both in [0, 1], of a unit vector in the sphere's own frame.
static inline float2 sphere_uv(const float3 n) {
  const float longitude = atan2_f(n.x, n.z) * INV_2PI_F;
  const float horizontal = SQRT(n.x * n.x + n.z * n.z);
  return (float2)(longitude < 0.0f ? longitude + 1.0f : longitude, 0.5f + atan2_f(n.y, horizontal) * INV_PI_F);
}

static inline void sphere_surface(const SceneData *scene, const Ray *ray, const Hit *hit, const bool tangent,
                                  LocalSurface *s) {
  const __global SphereData *sphere = scene->spheres + hit->primitive;
  const float3 center = load3(sphere->center);
  const float3 n = normalize3((ray->o - center) + hit->t * ray->d);
  s->shape = sphere->shape;
  s->p = center + sphere->radius * n;
  // Radius times a unit vector (5 roundings), the sum with the center, and again the difference from it when a ray that
  // starts here is tested; the sides that it then tells apart are good to 4 roundings of the radius.
  s->p_error = GAMMA(10) * sphere->radius * abs3(n) + GAMMA(2) * abs3(center);
  s->ng = n;
  s->ns = (float3)(0.0f);
  s->uv = (float2)(0.0f);
  s->tangent = (float3)(0.0f);
  if (!tangent && !shape_has_grain(scene, s->shape) && !shape_has_texture(scene, s->shape)) return;
  const float3 q = load3(sphere->frame);
  const float4 frame = (float4)(q, safe_sqrt(1.0f - dot3(q, q)));
  // A mirrored sphere: its frame is a rotation after x was mirrored.
  const float mirror = scene->shapes[sphere->shape].flags & SHAPE_FLIP ? -1.0f : 1.0f;
  float3 own = rotate_by((float4)(-frame.xyz, frame.w), n);
  own.x *= mirror;
  s->tangent = rotate_by(frame, (float3)(mirror * own.z, 0.0f, -own.x));
#if PENUMBRA_TEXTURES
  s->uv = sphere_uv(own);
#endif
}

static inline void disc_surface(const SceneData *scene, const Hit *hit, LocalSurface *s) {
  const __global DiscData *disc = scene->discs + hit->primitive;
  const float3 center = load3(disc->center), u = load3(disc->u), v = load3(disc->v);
  s->shape = disc->shape;
  s->p = center + hit->u * u + hit->v * v;
  const float3 terms = abs3(center) + abs3(hit->u * u) + abs3(hit->v * v);
  s->p_error = GAMMA(4) * terms + (float3)(GAMMA(16) * max3(abs3(u) + abs3(v)));
  s->ng = disc_normal(disc);
  s->ns = (float3)(0.0f);
  // Stretching turns the half axes in the disc; uv stay those of the disc as it was (w: cosine and sine of the turn).
  const float c = disc->u[3], t = disc->v[3];
  const float a = c * hit->u - t * hit->v, b = t * hit->u + c * hit->v;
  s->uv = 0.5f + 0.5f * (float2)(a, scene->shapes[disc->shape].flags & SHAPE_FLIP ? -b : b);
  s->tangent = c * u - t * v;
}

static inline void plane_surface(const SceneData *scene, const Ray *ray, const Hit *hit, LocalSurface *s) {
  const __global PlaneData *record = scene->planes + hit->primitive;
  const PlaneAt plane = plane_at(scene, record, ray->time);
  const float3 start = ray->o + hit->t * ray->d;
  const float3 p = start - plane.normal * dot3(start - plane.point, plane.normal);  // off by less than the ray's rounding
  const float3 from_point = p - plane.point;
  s->shape = record->shape;
  s->p = p;
  // After reprojection what is left are the roundings of the two differences and of the dot products here and in the next
  // test, all relative to the components of p and of p - point.
  s->p_error = (float3)(GAMMA(8) * (max3(abs3(p)) + max3(abs3(from_point))));
  s->ng = plane.normal;
  s->ns = (float3)(0.0f);
  s->uv = (float2)(dot3(from_point, plane.tangent_u) + record->tangent_u[3],
                   dot3(from_point, plane.tangent_v) + record->tangent_v[3]);
  s->tangent = cross3(plane.tangent_v, plane.normal);  // where v stands still
}
