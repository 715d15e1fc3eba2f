// Mesh light: triangles that emit on the side where they wind counter-clockwise (and behind where two-sided). A triangle is
// chosen with a probability proportional to its area in the mesh's own frame, through `emitter_cdf`; then a point on it,
// uniform in the solid angle that it subtends, or, where it looks small, by area (see quad.cl; Arvo 1995).
// World frame, metres; densities per solid angle at the lit point p.
//
// CDF entries are multiples of 2^-24, so that the probability of a triangle is exactly the share of the 24-bit uniform
// numbers that choose it (compile/alias.py).
#include "lights/light_sample.h"
#include "lights/placement.cl"
#include "lights/spherical_triangle.cl"

// A triangle relative to p.
typedef struct {
  float3 a, b, c;
  float3 n;          // unit, on p's side
  float3 p_error;    // of any point on it, as the intersector sees it
  float height;      // of p above the plane, > 0
  float area;
  bool by_area;
  SphericalTriangle sphere;  // of a b c, where it is not sampled by area
} EmitterView;

static inline float emitter_probability(const SceneData *scene, const __global Light *light, const uint i) {
  const __global float *cdf = scene->emitter_cdf + light->first_cdf;
  return cdf[i + 1u] - cdf[i];
}

// Index i of the triangle with cdf[i] <= u < cdf[i + 1].
static inline uint emitter_choose(const SceneData *scene, const __global Light *light, const float u) {
  const __global float *cdf = scene->emitter_cdf + light->first_cdf;
  uint low = 0u;
  uint high = light->triangle_count;
  while (high - low > 1u) {
    const uint middle = (low + high) >> 1;
    if (cdf[middle] <= u) low = middle; else high = middle;
  }
  return low;
}

// False where p sees no emitting side of triangle i of the light.
static inline bool emitter_view(const SceneData *scene, const __global Light *light, const uint i, const float3 p,
                                const float time, EmitterView *view) {
  const __global TriangleData *triangle = scene->triangles + light->first_triangle + i;
  float3 a = load3(scene->positions + 3ul * triangle->vertex[0]);
  float3 b = load3(scene->positions + 3ul * triangle->vertex[1]);
  float3 c = load3(scene->positions + 3ul * triangle->vertex[2]);
  float3 reach = abs3(a) + abs3(b) + abs3(c);
  bool flip = (scene->shapes[light->shape].flags & SHAPE_FLIP) != 0u;
  float m[3][4], inverse[3][4];
  if (area_light_placement(scene, light, time, m, inverse)) {
    flip = flip != (determinant(m) < 0.0f);
    reach = transform_magnitude(m, reach);
    a = transform_point(m, a);
    b = transform_point(m, b);
    c = transform_point(m, c);
  }
  view->p_error = reach * PLACED_ERROR;
  const float3 cross = cross3(b - a, c - a) * (flip ? -1.0f : 1.0f);
  const float size = length3(cross);
  if (!(size > 0.0f)) return false;
  view->area = 0.5f * size;
  view->a = a - p;
  view->b = b - p;
  view->c = c - p;
  const float3 n = cross * (1.0f / size);
  const float signed_height = -dot3(view->b, n);
  view->height = FABS(signed_height);
  if (!(view->height > dot3(abs3(n), view->p_error + abs3(p) * GAMMA(2)))) return false;
  if (signed_height < 0.0f && (light->flags & LIGHT_TWO_SIDED) == 0u) return false;
  view->n = signed_height < 0.0f ? -n : n;
#if PENUMBRA_LIGHT_AREA_SAMPLING
  view->by_area = true;
#else
  const float3 center = (view->a + view->b + view->c) * (1.0f / 3.0f);
  const float3 ra = view->a - center;
  const float3 rb = view->b - center;
  const float3 rc = view->c - center;
  const float reach2 = MAX(MAX(dot3(ra, ra), dot3(rb, rb)), dot3(rc, rc));
  view->by_area = reach2 < FLAT_FAR * dot3(center, center);
  if (!view->by_area) view->sphere = spherical_triangle(view->a, view->b, view->c, 2.0f * view->height * view->area);
#endif
  return true;
}

static inline float emitter_pdf(const EmitterView *view, const float distance) {
  return view->by_area ? flat_area_pdf(distance, view->height, view->area) : 0.5f / view->sphere.half_angle;
}

// A point relative to p, from the apex b across the edge a c; both ways agree for triangles that look small.
static inline float3 emitter_point(const EmitterView *view, const float2 u) {
  const float cut = view->by_area ? u.x : spherical_triangle_cut(&view->sphere, u.x * view->sphere.half_angle);
  const float3 e = view->a + cut * (view->c - view->a);
  const float out = view->by_area ? SQRT(u.y) : spherical_triangle_reach(&view->sphere, view->b, e, u.y);
  return view->b + out * (e - view->b);
}

static inline bool mesh_light_sample(const SceneData *scene, const __global Light *light, const float3 p,
                                     const float time, const float u_triangle, const float2 u, LightSample *out) {
  const uint i = emitter_choose(scene, light, u_triangle);
  EmitterView view;
  if (!emitter_view(scene, light, i, p, time, &view)) return false;
  out->p = p + emitter_point(&view, u);
  out->p_error = view.p_error + abs3(p) * GAMMA(2);
  out->n = view.n;
  if (!aim(p, out)) return false;
  out->pdf = emitter_probability(scene, light, i) * emitter_pdf(&view, out->distance);
  return usable(out->pdf);
}

// triangle: index of the hit among all triangles.
static inline float mesh_light_hit_pdf(const SceneData *scene, const __global Light *light, const float3 p,
                                       const uint triangle, const float distance, const float time) {
  const uint i = triangle - light->first_triangle;
  EmitterView view;
  if (i >= light->triangle_count || !emitter_view(scene, light, i, p, time, &view)) return 0.0f;
  const float pdf = emitter_probability(scene, light, i) * emitter_pdf(&view, distance);
  return usable(pdf) ? pdf : 0.0f;
}
