// Hits as points to shade, sixteen at once: still triangles and spheres of the world's tree together, what is rarer one by one. Each
// lane gets what surface.cl gives it, bit for bit. Metres, world frame.
#include "base/types16.h"
#include "geometry/surface.cl"

#define WORDS(type) ((uint)(sizeof(type) / sizeof(uint)))  // of a record

// A field of each lane's shape, by where the first shape has it.
static inline uint16 shape_field16(const __global uint *first, const uint16 shape, const Mask16 on) {
  return gather_u16(first, shape * WORDS(ShapeData), on);
}

// Those that one lane cannot share with others: they wait for surface_to_shade.
static PENUMBRA_NOINLINE PENUMBRA_WIDE void surfaces_apart(const SceneData *scene, const Ray16 *ray, const Hit16 *hit,
                                                           const Mask16 apart, Surface16 *s) {
  for (LANES_OF(k, apart)) {
    Surface surface;
    surface_to_shade(scene, lane_ray(ray, k), lane_hit(hit, k), &surface);
    set_lane_surface(s, k, &surface);
  }
}

static inline Vec16 interpolate16(const Vec16 a, const Vec16 b, const Vec16 c, const Vec16 weight) {
  return add16(add16(scale16(a, weight.x), scale16(b, weight.y)), scale16(c, weight.z));
}

static inline Vec16 max_of16(const Vec16 a, const Vec16 b) { return vec16(MAX16(a.x, b.x), MAX16(a.y, b.y), MAX16(a.z, b.z)); }

static inline Vec16 packet_corner16(const SceneData *scene, const uint16 lane, const uint corner, const Mask16 on) {
  const __global float *packets = (const __global float *)scene->packets;
  const uint16 at = (lane >> 3u) * WORDS(Packet8) + (lane & 7u) + 24u * corner;
  return vec16(gather16(packets, at, on), gather16(packets, at + 8u, on), gather16(packets, at + 16u, on));
}

// winding_normal of the lanes that have an area.
static inline Vec16 winding_normal16(const Vec16 a, const Vec16 b, const Vec16 c, Mask16 *has_area) {
  const Vec16 e1 = sub16(b, a), e2 = sub16(c, a);
  const float16 s1 = max3_16(abs3_16(e1)), s2 = max3_16(abs3_16(e2));
  const float16 size = MAX16(s1, s2);
  const float16 scale = as_float16(0x7f000000u - (as_uint16(size) & 0x7f800000u));
  const Vec16 n = cross16(scale16(e1, scale), scale16(e2, scale));
  const float16 length = length16(n);
  *has_area = length > 0.0f;
  return scale16(n, 1.0f / length);
}

static inline Vec16 pulled_inside16(const Vec16 p, const Vec16 rounding, const Vec16 a, const Vec16 b, const Vec16 c) {
  const Vec16 inwards = sub16(scale16(add16(add16(a, b), c), (float16)(1.0f / 3.0f)), p);
  const float16 away = max3_16(abs3_16(inwards));
  const float16 error = 2.0f * max3_16(rounding);
  return where16(error < away, add16(p, scale16(inwards, error / away)), add16(p, inwards));
}

// The shading normal: `normal` made unit and turned to ng's side, or ng where there is none.
static inline Vec16 shading_normal16(const Vec16 normal, const Vec16 ng) {
  const float16 size = max3_16(abs3_16(normal));
  const Mask16 has = (size > 0.0f) & (size < INF_F);
  const Vec16 ns = where16(has, normalize16(scale16(normal, 1.0f / size)), ng);
  return where16(dot16(ns, ng) < 0.0f, neg16(ns), ns);
}

static inline Vec16 vertex_normals16(const SceneData *scene, const Hit16 *hit, const uint16 shape, const Vec16 weight,
                                     const Mask16 on) {
  const uint16 offset = shape_field16((const __global uint *)&scene->shapes->normal_offset, shape, on);
  Vec16 n[3];
  for (uint i = 0u; i < 3u; i++) {
    const uint16 vertex = gather_u16(&scene->triangles->vertex[i], hit->primitive * WORDS(TriangleData), on);
    n[i] = gather3_16(scene->normals, (vertex + offset) * 3u, on);
  }
  return interpolate16(n[0], n[1], n[2], weight);
}

#if PENUMBRA_TEXTURES
static inline void triangle_uvs16(const SceneData *scene, const Hit16 *hit, const uint16 shape, const uint16 flags,
                                  const Vec16 weight, const Mask16 on, Surface16 *s) {
  const float16 zero = 0.0f, one = 1.0f;
  const Mask16 quad = (flags & SHAPE_QUAD) != 0u;
  const Mask16 second = quad & (hit->primitive != shape_field16(&scene->shapes->first_triangle, shape, on));
  float16 u[3] = {zero, one, quad & !second ? one : zero};
  float16 v[3] = {zero, second ? one : zero, one};
  const Mask16 own = on & ((flags & SHAPE_HAS_UVS) != 0u);
  if (any16(own)) {
    const uint16 offset = shape_field16((const __global uint *)&scene->shapes->uv_offset, shape, own);
    for (uint i = 0u; i < 3u; i++) {
      const uint16 vertex = gather_u16(&scene->triangles->vertex[i], hit->primitive * WORDS(TriangleData), own);
      const uint16 at = (vertex + offset) * 2u;
      u[i] = own ? gather16(scene->uvs, at, own) : u[i];
      v[i] = own ? gather16(scene->uvs, at + 1u, own) : v[i];
    }
  }
  s->u = on ? u[0] * weight.x + u[1] * weight.y + u[2] * weight.z : s->u;
  s->v = on ? v[0] * weight.x + v[1] * weight.y + v[2] * weight.z : s->v;
}
#endif

// Puts a point into the lanes of `on`.
static inline void put_surface16(const Mask16 on, const Vec16 p, const Vec16 p_error, const Vec16 ng, const Vec16 ns,
                                 const uint16 shape, Surface16 *s) {
  s->p = where16(on, p, s->p);
  s->p_error = where16(on, p_error, s->p_error);
  s->ng = where16(on, ng, s->ng);
  s->ns = where16(on, ns, s->ns);
  s->shape = on ? shape : s->shape;
}

// The lanes that are left to do one by one.
static inline Mask16 triangle_surfaces16(const SceneData *scene, const Hit16 *hit, const Mask16 on, Surface16 *s) {
  const uint16 shape = gather_u16(&scene->triangles->shape, hit->primitive * WORDS(TriangleData), on);
  const uint16 flags = shape_field16(&scene->shapes->flags, shape, on);
  const Vec16 weight = vec16(1.0f - hit->u - hit->v, hit->u, hit->v);
  const Vec16 a = packet_corner16(scene, hit->lane, 0u, on), b = packet_corner16(scene, hit->lane, 1u, on),
              c = packet_corner16(scene, hit->lane, 2u, on);
  const Vec16 p = interpolate16(a, b, c, weight);
  const Vec16 terms = interpolate16(abs3_16(a), abs3_16(b), abs3_16(c), abs3_16(weight));
  const Vec16 reach = max_of16(max_of16(abs3_16(sub16(a, p)), abs3_16(sub16(b, p))), abs3_16(sub16(c, p)));
  const Vec16 rounding = scale16(terms, (float16)(GAMMA(10)));
  const float16 along = GAMMA(16) * max3_16(reach);
  Mask16 has_area;
  const Vec16 n = winding_normal16(a, b, c, &has_area);
  const Vec16 ng = where16((flags & SHAPE_FLIP) != 0u, neg16(n), n);
  Vec16 ns = ng;
  const Mask16 smooth = on & ((flags & SHAPE_HAS_NORMALS) != 0u);
  if (any16(smooth)) ns = where16(smooth, shading_normal16(vertex_normals16(scene, hit, shape, weight, smooth), ng), ng);
  put_surface16(on, pulled_inside16(p, rounding, a, b, c), add16(rounding, vec16(along, along, along)), ng, ns, shape, s);
#if PENUMBRA_TEXTURES
  triangle_uvs16(scene, hit, shape, flags, weight, on, s);
#endif
  Mask16 apart = !has_area;
#if PENUMBRA_DEFORMATION
  apart |= shape_field16(&scene->shapes->deform_count, shape, on) != 0u;
#endif
  return on & apart;
}

#if PENUMBRA_ROUND
static inline void sphere_surfaces16(const SceneData *scene, const Ray16 *ray, const Hit16 *hit, const Mask16 on, Surface16 *s) {
  const uint16 at = hit->primitive * WORDS(SphereData);
  const Vec16 center = gather3_16(scene->spheres->center, at, on);
  const float16 radius = gather16(&scene->spheres->radius, at, on);
  const uint16 shape = gather_u16(&scene->spheres->shape, at, on);
  const Vec16 n = normalize16(add16(sub16(ray->o, center), scale16(ray->d, hit->t)));
  const Vec16 p_error = add16(scale16(abs3_16(n), GAMMA(10) * radius), scale16(abs3_16(center), (float16)(GAMMA(2))));
  put_surface16(on, add16(center, scale16(n, radius)), p_error, n, n, shape, s);
}
#endif

// What shading needs, in the lanes of `on`, all of which are hits.
static inline void surfaces16(const SceneData *scene, const Ray16 *ray, const Hit16 *hit, const Mask16 on, Surface16 *s) {
  Mask16 apart = 0;
#if PENUMBRA_INSTANCING
  apart = hit->instance != NONE;
#endif
  const Mask16 triangles = on & (hit->kind == PRIMITIVE_TRIANGLE) & ~apart;
  s->u = s->v = 0.0f;
  if (any16(triangles)) apart |= triangle_surfaces16(scene, hit, triangles, s);
#if PENUMBRA_ROUND
  const Mask16 spheres = on & (hit->kind == PRIMITIVE_SPHERE) & ~apart;
  if (any16(spheres)) sphere_surfaces16(scene, ray, hit, spheres, s);
  apart |= (hit->kind == PRIMITIVE_DISC) | (hit->kind == PRIMITIVE_PLANE);
#endif
  s->instance = hit->instance;
  s->kind = hit->kind;
  s->primitive = hit->primitive;
  Vec16 unused;
  make_frame16(s->ns, &s->tangent, &unused);
#if PENUMBRA_TEXTURES || PENUMBRA_GLOSS || PENUMBRA_TRANSMISSION
  const uint16 material = shape_field16(&scene->shapes->material, s->shape, on & ~apart) * WORDS(Material);
  const Mask16 sure = on & ~apart;
  apart |= gather16(&scene->materials->alpha_x, material, sure) != gather16(&scene->materials->alpha_y, material, sure);  // grain
#if PENUMBRA_ROUND && PENUMBRA_TEXTURES
  const uint16 texture0 = gather_u16(&scene->materials->texture0, material, sure);
  const uint16 texture1 = gather_u16(&scene->materials->texture1, material, sure);
  apart |= spheres & ((texture0 & texture1) != NONE);
#endif
#endif
  apart &= on;
  if (any16(apart)) surfaces_apart(scene, ray, hit, apart, s);
}
