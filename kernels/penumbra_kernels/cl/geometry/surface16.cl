// Hits as points to shade, sixteen at once: all of a kind together, in the world or in instances; meshes that deform, planes that
// move and triangles without area one by one. Each lane gets what surface.cl gives it, bit for bit. Metres, world frame.
#include "base/types16.h"
#include "geometry/surface.cl"
#if PENUMBRA_ROUND && PENUMBRA_TEXTURES
#include "base/transcendental16.cl"
#endif
#if PENUMBRA_INSTANCING
#include "geometry/motion16.cl"
#endif

#define GRAIN (PENUMBRA_GLOSS || PENUMBRA_TRANSMISSION)  // whether materials may tell directions around the normal apart

// Four words of each lane's shape, from `word` on.
static inline Rows16 shape_rows16(const SceneData *scene, const uint16 shape, const uint word, const Mask16 on) {
  return gather_rows16(scene->shapes, shape * WORDS(ShapeData) + word, on);
}
#define SHAPE_MATERIAL 0u  // material, light, flags, object_id
#define SHAPE_OFFSETS 4u   // normal_offset, uv_offset, first_triangle, triangle_count
#define SHAPE_DEFORMING 8u // deform_stride, deform_count, deform_first_time

// shape_has_grain, shape_has_texture.
#if GRAIN
static inline Mask16 grained16(const SceneData *scene, const uint16 material, const Mask16 on) {
  const Rows16 gloss = gather_rows16(&scene->materials->alpha_x, material * WORDS(Material), on);
  return on & (gloss.x != gloss.y);
}
#endif

#if PENUMBRA_TEXTURES
static inline Mask16 textured16(const SceneData *scene, const uint16 material, const Mask16 on) {
  const uint16 at = material * WORDS(Material);
  const Rows16 first = gather_rows16(scene->materials->color0, at, on), second = gather_rows16(scene->materials->color1, at, on);
  return on & ((as_uint16(first.w) & as_uint16(second.w)) != NONE);
}
#endif

// The lanes with normals of vertices, and those whose material has a grain.
typedef struct {
  Mask16 smooth, grained;
} Extra16;

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

// Packets beyond which gathers do not reach (lanes16.cl): their triangles go one by one.
#define GATHERED_PACKETS (0x7fffffffu / WORDS(Packet8))

// The corners of each lane's triangle, which is lane `lane` of the packets.
static inline Vec16 triangle_corner16(const __global float *from, const uint16 at, const Mask16 on, const bool one, const uint which) {
  if (one) return vec16(from[which], from[which + 8u], from[which + 16u]);
  return vec16(gather16(from, at, on), gather16(from + 8, at, on), gather16(from + 16, at, on));
}

static inline void corners16(const SceneData *scene, const uint16 lane, const Mask16 on, Vec16 *a, Vec16 *b, Vec16 *c) {
  const __global float *packets = (const __global float *)scene->packets;
  const uint16 at = (lane >> 3u) * WORDS(Packet8) + (lane & 7u);
  const uint which = LANE_U(at, CTZ(mask16(on) | 0x8000u));
  const bool one = !any16(on & (at != which));
  *a = triangle_corner16(packets, at, on, one, which);
  *b = triangle_corner16(packets + 24, at, on, one, which);
  *c = triangle_corner16(packets + 48, at, on, one, which);
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

static inline Vec16 unit_or16(const Vec16 v, const Vec16 otherwise) {
  const float16 size = max3_16(abs3_16(v));
  return where16((size > 0.0f) & (size < INF_F), normalize16(scale16(v, 1.0f / size)), otherwise);
}

// The shading normal: `normal` made unit and turned to ng's side, or ng where there is none.
static inline Vec16 shading_normal16(const Vec16 normal, const Vec16 ng) {
  const Vec16 ns = unit_or16(normal, ng);
  return where16(dot16(ns, ng) < 0.0f, neg16(ns), ns);
}

static inline Vec16 vertex_normals16(const SceneData *scene, const Rows16 *triangle, const uint16 shape, const Vec16 weight,
                                     const Mask16 on) {
  const uint16 offset = as_uint16(shape_rows16(scene, shape, SHAPE_OFFSETS, on).x);
  const Vec16 a = gather3_16(scene->normals, (as_uint16(triangle->x) + offset) * 3u, on);
  const Vec16 b = gather3_16(scene->normals, (as_uint16(triangle->y) + offset) * 3u, on);
  const Vec16 c = gather3_16(scene->normals, (as_uint16(triangle->z) + offset) * 3u, on);
  return interpolate16(a, b, c, weight);
}

// Puts a point into the lanes of `on`.
static inline void put_surface16(const Mask16 on, const Vec16 p, const Vec16 p_error, const Vec16 ng, const uint16 shape,
                                 Surface16 *s) {
  s->p = where16(on, p, s->p);
  s->p_error = where16(on, p_error, s->p_error);
  s->ng = where16(on, ng, s->ng);
  s->shape = on ? shape : s->shape;
}

static inline void put_uv16(const Mask16 on, const float16 u, const float16 v, Surface16 *s) {
  s->u = on ? u : s->u;
  s->v = on ? v : s->v;
}

#if PENUMBRA_TEXTURES || GRAIN
static inline void corner_uvs16(const SceneData *scene, const Hit16 *hit, const Rows16 *triangle, const uint16 flags, const Mask16 on,
                                float16 u[3], float16 v[3]) {
  const Rows16 offsets = shape_rows16(scene, as_uint16(triangle->w), SHAPE_OFFSETS, on);
  const float16 zero = 0.0f, one = 1.0f;
  const Mask16 quad = (flags & SHAPE_QUAD) != 0u;
  const Mask16 second = quad & (hit->primitive != as_uint16(offsets.z));
  u[0] = v[0] = zero;
  u[1] = v[2] = one;
  u[2] = (quad & ~second) ? one : zero;
  v[1] = second ? one : zero;
  const Mask16 own = on & ((flags & SHAPE_HAS_UVS) != 0u);
  if (any16(own)) {
    const float16 *vertices = &triangle->x;
    for (uint i = 0u; i < 3u; i++) {
      const uint16 at = (as_uint16(vertices[i]) + as_uint16(offsets.y)) * 2u;
      u[i] = own ? gather16(scene->uvs, at, own) : u[i];
      v[i] = own ? gather16(scene->uvs, at + 1u, own) : v[i];
    }
  }
}

static inline Vec16 triangle_tangent16(const Vec16 a, const Vec16 b, const Vec16 c, const float16 u[3], const float16 v[3]) {
  const float16 d1x = u[1] - u[0], d1y = v[1] - v[0], d2x = u[2] - u[0], d2y = v[2] - v[0];
  const float16 det = difference_of_products16(d1x, d2y, d1y, d2x);
  const Vec16 t = sub16(scale16(sub16(b, a), d2y), scale16(sub16(c, a), d1y));
  return where16(det == 0.0f, all16((float3)(0.0f)), where16(det < 0.0f, neg16(t), t));
}
#endif

// In the frame of their tree, with normals and tangents of any length. Returns the lanes that are left to do one by one.
static inline Mask16 triangle_surfaces16(const SceneData *scene, const Hit16 *hit, const Mask16 all, Surface16 *s, Extra16 *extra) {
  const Mask16 on = all & (hit->lane >> 3u < GATHERED_PACKETS);
  const Rows16 triangle = gather_rows16(scene->triangles, hit->primitive * WORDS(TriangleData), on);
  const uint16 shape = as_uint16(triangle.w);
  const Rows16 its = shape_rows16(scene, shape, SHAPE_MATERIAL, on);
  const uint16 flags = as_uint16(its.z);
  const Vec16 weight = vec16(1.0f - hit->u - hit->v, hit->u, hit->v);
  Vec16 a, b, c;
  corners16(scene, hit->lane, on, &a, &b, &c);
  const Vec16 p = interpolate16(a, b, c, weight);
  const Vec16 terms = interpolate16(abs3_16(a), abs3_16(b), abs3_16(c), abs3_16(weight));
  const Vec16 reach = max_of16(max_of16(abs3_16(sub16(a, p)), abs3_16(sub16(b, p))), abs3_16(sub16(c, p)));
  const Vec16 rounding = scale16(terms, (float16)(GAMMA(10)));
  const float16 along = GAMMA(16) * max3_16(reach);
  Mask16 has_area;
  const Vec16 n = winding_normal16(a, b, c, &has_area);
  const Vec16 ng = where16((flags & SHAPE_FLIP) != 0u, neg16(n), n);
  extra->smooth = on & ((flags & SHAPE_HAS_NORMALS) != 0u);
  if (any16(extra->smooth)) s->ns = vertex_normals16(scene, &triangle, shape, weight, extra->smooth);
  put_surface16(on, pulled_inside16(p, rounding, a, b, c), add16(rounding, vec16(along, along, along)), ng, shape, s);
#if PENUMBRA_TEXTURES || GRAIN
  Mask16 ask = 0;
#if PENUMBRA_TEXTURES
  ask |= textured16(scene, as_uint16(its.x), on);
#endif
#if GRAIN
  extra->grained = grained16(scene, as_uint16(its.x), on);
  ask |= extra->grained;
#endif
  if (any16(ask)) {
    float16 u[3], v[3];
    corner_uvs16(scene, hit, &triangle, flags, ask, u, v);
    put_uv16(ask, u[0] * weight.x + u[1] * weight.y + u[2] * weight.z, v[0] * weight.x + v[1] * weight.y + v[2] * weight.z, s);
#if GRAIN
    s->tangent = where16(extra->grained, triangle_tangent16(a, b, c, u, v), s->tangent);
#endif
  }
#endif
  Mask16 apart = ~on | !has_area;
#if PENUMBRA_DEFORMATION
  apart |= as_uint16(shape_rows16(scene, shape, SHAPE_DEFORMING, on).y) != 0u;
#endif
  return all & apart;
}

#if PENUMBRA_ROUND
#if PENUMBRA_TEXTURES || GRAIN
static inline Vec16 rotate_by16(const Vec16 axis, const float16 w, const Vec16 v) {
  const Vec16 c = cross16(axis, v), t = scale16(c, (float16)(2.0f));
  return add16(add16(v, scale16(t, w)), cross16(axis, t));
}

// Tangents and uv where they are asked for. q: the spheres' frames; n: unit normals.
static inline void sphere_directions16(const Vec16 q, const uint16 flags, const Vec16 n, const Mask16 ask, Surface16 *s) {
  const float16 one = 1.0f, zero = 0.0f;
  const float16 w = safe_sqrt16(1.0f - dot16(q, q));
  const float16 mirror = (flags & SHAPE_FLIP) != 0u ? -one : one;
  Vec16 own = rotate_by16(neg16(q), w, n);
  own.x *= mirror;
  s->tangent = where16(ask, rotate_by16(q, w, vec16(mirror * own.z, zero, -own.x)), s->tangent);
#if PENUMBRA_TEXTURES
  const float16 longitude = atan2_16(own.x, own.z) * INV_2PI_F;
  const float16 horizontal = sqrt16(own.x * own.x + own.z * own.z);
  put_uv16(ask, longitude < 0.0f ? longitude + 1.0f : longitude, 0.5f + atan2_16(own.y, horizontal) * INV_PI_F, s);
#endif
}
#endif

// o, d: the rays in the frame of their tree.
static inline void sphere_surfaces16(const SceneData *scene, const Vec16 *o, const Vec16 *d, const Hit16 *hit, const Mask16 on,
                                     Surface16 *s, Extra16 *extra) {
  const uint16 at = hit->primitive * WORDS(SphereData);
  const Rows16 ball = gather_rows16(scene->spheres, at, on), frame = gather_rows16(scene->spheres->frame, at, on);
  const Vec16 center = xyz16(&ball);
  const float16 radius = ball.w;
  const uint16 shape = as_uint16(frame.w);
  const Vec16 n = normalize16(add16(sub16(*o, center), scale16(*d, hit->t)));
  const Vec16 p_error = add16(scale16(abs3_16(n), GAMMA(10) * radius), scale16(abs3_16(center), (float16)(GAMMA(2))));
  put_surface16(on, add16(center, scale16(n, radius)), p_error, n, shape, s);
#if PENUMBRA_TEXTURES || GRAIN
  const Rows16 its = shape_rows16(scene, shape, SHAPE_MATERIAL, on);
  Mask16 ask = 0;
#if PENUMBRA_TEXTURES
  ask |= textured16(scene, as_uint16(its.x), on);
#endif
#if GRAIN
  const Mask16 grained = grained16(scene, as_uint16(its.x), on);
  extra->grained |= grained;
  ask |= grained;
#endif
  if (any16(ask)) sphere_directions16(xyz16(&frame), as_uint16(its.z), n, ask, s);
#endif
}

static inline Vec16 along_axes16(const Vec16 start, const Vec16 u, const float16 a, const Vec16 v, const float16 b) {
  return add16(add16(start, scale16(u, a)), scale16(v, b));
}

static inline void disc_surfaces16(const SceneData *scene, const Hit16 *hit, const Mask16 on, Surface16 *s, Extra16 *extra) {
  const uint16 at = hit->primitive * WORDS(DiscData);
  const Rows16 middle = gather_rows16(scene->discs, at, on);
  const Rows16 first = gather_rows16(scene->discs->u, at, on), second = gather_rows16(scene->discs->v, at, on);
  const Vec16 center = xyz16(&middle), u = xyz16(&first), v = xyz16(&second);
  const uint16 shape = as_uint16(middle.w);
  const Vec16 terms = add16(add16(abs3_16(center), abs3_16(scale16(u, hit->u))), abs3_16(scale16(v, hit->v)));
  const float16 along = GAMMA(16) * max3_16(add16(abs3_16(u), abs3_16(v)));
  const Vec16 n = normalize16(cross16(normalize16(u), normalize16(v)));
  put_surface16(on, along_axes16(center, u, hit->u, v, hit->v),
                add16(scale16(terms, (float16)(GAMMA(4))), vec16(along, along, along)), n, shape, s);
#if PENUMBRA_TEXTURES || GRAIN
  const float16 c = first.w, t = second.w;
  const Rows16 its = shape_rows16(scene, shape, SHAPE_MATERIAL, on);
#endif
#if PENUMBRA_TEXTURES
  const float16 a = c * hit->u - t * hit->v, b = t * hit->u + c * hit->v;
  const Mask16 flip = (as_uint16(its.z) & SHAPE_FLIP) != 0u;
  put_uv16(on, 0.5f + 0.5f * a, 0.5f + 0.5f * (flip ? -b : b), s);
#endif
#if GRAIN
  extra->grained |= grained16(scene, as_uint16(its.x), on);
  s->tangent = where16(on, sub16(scale16(u, c), scale16(v, t)), s->tangent);
#endif
}

// Returns the lanes that are left to do one by one: planes that move.
static inline Mask16 plane_surfaces16(const SceneData *scene, const Ray16 *ray, const Hit16 *hit, const Mask16 on, Surface16 *s,
                                      Extra16 *extra) {
  const uint16 at = hit->primitive * WORDS(PlaneData);
  const Rows16 origin = gather_rows16(scene->planes, at, on), upright = gather_rows16(scene->planes->normal, at, on);
  const Vec16 point = xyz16(&origin), normal = xyz16(&upright);
  const uint16 shape = as_uint16(origin.w);
  const Vec16 start = add16(ray->o, scale16(ray->d, hit->t));
  const Vec16 p = sub16(start, scale16(normal, dot16(sub16(start, point), normal)));
  const Vec16 from_point = sub16(p, point);
  const float16 error = GAMMA(8) * (max3_16(abs3_16(p)) + max3_16(abs3_16(from_point)));
  put_surface16(on, p, vec16(error, error, error), normal, shape, s);
#if PENUMBRA_TEXTURES || GRAIN
  const Rows16 up = gather_rows16(scene->planes->tangent_v, at, on);
  const Vec16 v = xyz16(&up);
#endif
#if PENUMBRA_TEXTURES
  const Rows16 along = gather_rows16(scene->planes->tangent_u, at, on);
  put_uv16(on, dot16(from_point, xyz16(&along)) + along.w, dot16(from_point, v) + up.w, s);
#endif
#if GRAIN
  extra->grained |= grained16(scene, as_uint16(shape_rows16(scene, shape, SHAPE_MATERIAL, on).x), on);
  s->tangent = where16(on, cross16(v, normal), s->tangent);
#endif
#if PENUMBRA_MOTION
  return on & (gather_u16(&scene->planes->keyframe_count, at, on) != 0u);
#else
  return (Mask16)(0);
#endif
}

// Returns the lanes that are left to do one by one.
static inline Mask16 round_surfaces16(const SceneData *scene, const Ray16 *ray, const Vec16 *o, const Vec16 *d, const Hit16 *hit,
                                      const Mask16 on, Surface16 *s, Extra16 *extra) {
  const Mask16 spheres = on & (hit->kind == PRIMITIVE_SPHERE), discs = on & (hit->kind == PRIMITIVE_DISC),
               planes = on & (hit->kind == PRIMITIVE_PLANE);
  if (any16(spheres)) sphere_surfaces16(scene, o, d, hit, spheres, s, extra);
  if (any16(discs)) disc_surfaces16(scene, hit, discs, s, extra);
  return any16(planes) ? plane_surfaces16(scene, ray, hit, planes, s, extra) : (Mask16)(0);
}
#endif

#if PENUMBRA_INSTANCING
// The matrices of each lane's instance.
static inline void placements16(const SceneData *scene, const Hit16 *hit, const float16 time, const Mask16 placed,
                                Placement16 *at) {
  Mask16 left = placed;
  while (any16(left)) {
    const uint instance = LANE_U(hit->instance, CTZ(mask16(left)));
    const Mask16 same = left & (hit->instance == instance);
    Placement16 its;
    instance_matrices16(scene, instance, time, same, &its);
    put_affine16(same, &its.world_from_object, &at->world_from_object);
    put_affine16(same, &its.object_from_world, &at->object_from_world);
    left &= ~same;
  }
}

// place_surface of the lanes of `placed`.
static inline void place_surfaces16(const Placement16 *at, const Mask16 placed, Surface16 *s) {
  const Affine16 *out = &at->world_from_object, *in = &at->object_from_world;
  const Vec16 p = transform_point16(out, s->p);
  const float16 four = GAMMA(4);
  const Vec16 round_trip = add16(add16(abs3_16(sub16(transform_point16(in, p), s->p)), scale16(transform_magnitude16(in, p), four)),
                                 s->p_error);
  const Vec16 carried = scale16(transform_error16(out, round_trip), 1.0f + four);
  const Vec16 p_error = add16(carried, scale16(transform_magnitude16(out, s->p), four));
  s->p = where16(placed, p, s->p);
  s->p_error = where16(placed, p_error, s->p_error);
  s->ng = where16(placed, normalize16(transform_normal16(in, s->ng)), s->ng);
  s->ns = where16(placed, transform_normal16(in, s->ns), s->ns);
#if GRAIN
  s->tangent = where16(placed, transform_vector16(out, s->tangent), s->tangent);
#endif
}
#endif

// unit_tangent of the lanes with a grain; any vector across ns in the others.
static inline Vec16 tangents16(const Vec16 tangent, const Vec16 ns, const Mask16 grained) {
  Vec16 any, unused;
  make_frame16(ns, &any, &unused);
  if (!any16(grained)) return any;
  const Vec16 t = unit_or16(tangent, ns);
  const Vec16 across = sub16(t, scale16(ns, dot16(t, ns)));
  return where16(grained & (dot16(across, across) > 1e-6f), normalize16(across), any);
}

// Points in the world. Returns the lanes that are left to do one by one.
static inline Mask16 placed_surfaces16(const SceneData *scene, const Ray16 *ray, const Hit16 *hit, const Mask16 on, Surface16 *s) {
  Vec16 o = ray->o, d = ray->d;
#if PENUMBRA_INSTANCING
  const Mask16 placed = on & (hit->instance != NONE);
  Placement16 at;
  if (any16(placed)) {
    placements16(scene, hit, ray->time, placed, &at);
    o = where16(placed, transform_point16(&at.object_from_world, o), o);
    d = where16(placed, transform_vector16(&at.object_from_world, d), d);
  }
#endif
  Mask16 apart = 0;
  Extra16 extra;
  extra.smooth = extra.grained = 0;
  const Mask16 triangles = on & (hit->kind == PRIMITIVE_TRIANGLE);
  s->u = s->v = 0.0f;
#if GRAIN
  s->tangent = all16((float3)(0.0f));
#endif
  if (any16(triangles)) apart = triangle_surfaces16(scene, hit, triangles, s, &extra);
#if PENUMBRA_ROUND
  apart |= round_surfaces16(scene, ray, &o, &d, hit, on, s, &extra);
#endif
#if PENUMBRA_INSTANCING
  if (any16(placed)) place_surfaces16(&at, placed, s);
#endif
  s->ns = any16(extra.smooth) ? where16(extra.smooth, shading_normal16(s->ns, s->ng), s->ng) : s->ng;
  s->tangent = tangents16(s->tangent, s->ns, extra.grained);
  return apart;
}

// What shading needs, in the lanes of `on`, all of which are hits.
static inline void surfaces16(const SceneData *scene, const Ray16 *ray, const Hit16 *hit, const Mask16 on, Surface16 *s) {
  const Mask16 apart = on & placed_surfaces16(scene, ray, hit, on, s);
  s->instance = hit->instance;
  s->kind = hit->kind;
  s->primitive = hit->primitive;
  if (any16(apart)) surfaces_apart(scene, ray, hit, apart, s);
}
