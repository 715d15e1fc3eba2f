// A hit on a triangle as a point on a surface, in the frame of its tree. Metres.
#include "geometry/surface_local.cl"
#if PENUMBRA_COMPACT_TREE
#include "geometry/compact.cl"
#else
#include "geometry/triangle.cl"
#endif
#if PENUMBRA_DEFORMATION
#include "geometry/deform_time.cl"

static inline float3 vertex_at(const __global float *positions, const uint index) {
  return load3(positions + 3ul * index);
}
#endif

// Those that stand still are read where the traversal has just read them: large scenes wait for memory.
static inline void triangle_vertices(const SceneData *scene, const Hit *hit, const __global TriangleData *triangle,
                                     const __global ShapeData *shape, const float time, float3 v[3]) {
  lane_vertices(scene, hit->lane, v);
#if PENUMBRA_DEFORMATION
  if (shape->deform_count) {
    const DeformTime at = deform_time(scene, shape, time);
    for (int i = 0; i < 3; i++) {
      const uint first = triangle->vertex[i] + at.first * shape->deform_stride;
      const float3 a = vertex_at(scene->positions, first);
      v[i] = a + at.fraction * (vertex_at(scene->positions, first + shape->deform_stride) - a);
    }
  }
#endif
}

// Unit normal by the winding. Edges are scaled first, so that triangles of any size have one; where rounding leaves
// no area, any normal of the longest edge.
static inline float3 winding_normal(const float3 v[3]) {
  const float3 e1 = v[1] - v[0], e2 = v[2] - v[0];
  const float size = MAX(max3(abs3(e1)), max3(abs3(e2)));
  const float scale = as_float(0x7f000000u - (as_uint(size) & 0x7f800000u));  // a power of two: nothing is rounded
  const float3 n = cross3(e1 * scale, e2 * scale);
  const float length = length3(n);
  if (length > 0.0f) return n * (1.0f / length);
  const float3 e = dot3(e1, e1) > dot3(e2, e2) ? e1 : e2;
  float3 s, t;
  make_frame(normalize3(e * scale), &s, &t);
  return s;
}

static inline float3 interpolate(const float3 a, const float3 b, const float3 c, const float3 weight) {
  return a * weight.x + b * weight.y + c * weight.z;
}

// uv of the three corners: the mesh's own, a quad's (a, b), or barycentrics.
static inline void corner_uvs(const SceneData *scene, const uint primitive, const __global TriangleData *triangle,
                              const __global ShapeData *shape, float2 uv[3]) {
  if (shape->flags & SHAPE_HAS_UVS) {
    for (int i = 0; i < 3; i++) {
      const __global float *p = scene->uvs + 2l * ((long)triangle->vertex[i] + shape->uv_offset);
      uv[i] = (float2)(p[0], p[1]);
    }
    return;
  }
  uv[0] = (float2)(0.0f, 0.0f);
  uv[1] = (float2)(1.0f, 0.0f);
  uv[2] = (float2)(0.0f, 1.0f);
  if (shape->flags & SHAPE_QUAD) {  // (origin, +u, +u+v), then (origin, +u+v, +v)
    const bool second = primitive != shape->first_triangle;
    uv[1] = second ? (float2)(1.0f, 1.0f) : (float2)(1.0f, 0.0f);
    uv[2] = second ? (float2)(0.0f, 1.0f) : (float2)(1.0f, 1.0f);
  }
}

// dp/du, or 0 where uv do not tell.
static inline float3 triangle_tangent(const float3 v[3], const float2 uv[3]) {
  const float2 d1 = uv[1] - uv[0], d2 = uv[2] - uv[0];
  const float det = difference_of_products(d1.x, d2.y, d1.y, d2.x);
  if (det == 0.0f) return (float3)(0.0f);
  const float3 t = (v[1] - v[0]) * d2.y - (v[2] - v[0]) * d1.y;
  return det < 0.0f ? -t : t;
}

// Interpolated vertex normal, or 0.
static inline float3 vertex_normal(const SceneData *scene, const __global TriangleData *triangle,
                                   const __global ShapeData *shape, const float time, const float3 weight) {
  if (!(shape->flags & SHAPE_HAS_NORMALS)) return (float3)(0.0f);
  float3 n[3];
  for (int i = 0; i < 3; i++) n[i] = load3(scene->normals + 3l * ((long)triangle->vertex[i] + shape->normal_offset));
#if PENUMBRA_DEFORMATION
  if (shape->deform_count) {
    const DeformTime at = deform_time(scene, shape, time);
    for (int i = 0; i < 3; i++) {
      const long index = (long)triangle->vertex[i] + shape->normal_offset + (long)at.first * shape->deform_stride;
      const float3 a = load3(scene->normals + 3l * index);
      n[i] = a + at.fraction * (load3(scene->normals + 3l * (index + shape->deform_stride)) - a);
    }
  }
#endif
  return interpolate(n[0], n[1], n[2], weight);
}

// Towards the centroid by twice its rounding: that near to an edge, rounding may have put the point beyond the wall
// that stands there, and a ray from it would leave the room. In the triangle's plane, so the error across it stays.
static inline float3 pulled_inside(const float3 p, const float3 rounding, const float3 v[3]) {
  const float3 inwards = (v[0] + v[1] + v[2]) * (1.0f / 3.0f) - p;
  const float away = max3(abs3(inwards));
  const float error = 2.0f * max3(rounding);
  return error < away ? p + inwards * (error / away) : p + inwards;
}

static inline void triangle_surface(const SceneData *scene, const Hit *hit, const float time, const bool tangent,
                                    LocalSurface *s) {
  const __global TriangleData *triangle = scene->triangles + hit->primitive;
  const __global ShapeData *shape = scene->shapes + triangle->shape;
  const float3 weight = (float3)(1.0f - hit->u - hit->v, hit->u, hit->v);
  float3 v[3];
  triangle_vertices(scene, hit, triangle, shape, time, v);
  s->shape = triangle->shape;
  s->p = interpolate(v[0], v[1], v[2], weight);
  // Interpolation errs by gamma(7) of its terms (pbrt-v4, 6.8.4), pulled_inside by 3 more. The test of a ray that starts here errs in its distance
  // to the plane by less than 16 roundings of the distance to the farthest corner: sides of the triangle do not depend
  // on position, hence its own term in every direction.
  const float3 terms = interpolate(abs3(v[0]), abs3(v[1]), abs3(v[2]), abs3(weight));
  const float3 reach = MAX(MAX(abs3(v[0] - s->p), abs3(v[1] - s->p)), abs3(v[2] - s->p));
  const float3 rounding = GAMMA(10) * terms;
  s->p_error = rounding + (float3)(GAMMA(16) * max3(reach));
  s->p = pulled_inside(s->p, rounding, v);
  const float3 n = winding_normal(v);
  s->ng = shape->flags & SHAPE_FLIP ? -n : n;
  s->ns = vertex_normal(scene, triangle, shape, time, weight);
  s->uv = (float2)(0.0f);
  s->tangent = (float3)(0.0f);
  const bool grain = tangent || shape_has_grain(scene, s->shape);
  if (!grain && !shape_has_texture(scene, s->shape)) return;
  float2 uv[3];
  corner_uvs(scene, hit->primitive, triangle, shape, uv);
  s->uv = uv[0] * weight.x + uv[1] * weight.y + uv[2] * weight.z;
  if (grain) s->tangent = triangle_tangent(v, uv);
}
