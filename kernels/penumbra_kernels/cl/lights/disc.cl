// Disc light: center + a u + b v with a^2 + b^2 <= 1 (an ellipse where a transform stretches it), emitting towards u x v
// (and back where two-sided). Sampled uniformly by area. World frame, metres; densities per solid angle at the lit point p.
#include "lights/light_sample.h"
#include "lights/placement.cl"
#include "sampling/warp.cl"

typedef struct {
  float3 center, u, v;
  float3 p_error;   // of any point on it, as the intersector sees it
} Disc;

static inline Disc disc_at(const SceneData *scene, const __global Light *light, const float time) {
  Disc d;
  d.center = load3(light->position);
  d.u = load3(light->direction);
  d.v = load3(light->axis_v);
  float3 reach = abs3(d.center) + abs3(d.u) + abs3(d.v);
  float m[3][4], inverse[3][4];
  if (area_light_placement(scene, light, time, m, inverse)) {
    const bool mirrored = determinant(m) < 0.0f;
    const float3 u = transform_vector(m, d.u);
    const float3 v = transform_vector(m, d.v);
    reach = transform_magnitude(m, reach);
    d.center = transform_point(m, d.center);
    d.u = mirrored ? v : u;
    d.v = mirrored ? u : v;
  }
  d.p_error = reach * PLACED_ERROR;
  return d;
}

// Height of p above the emitting side's plane, 0 where it sees none; n: unit normal on p's side.
static inline float disc_height(const Disc *d, const float3 p, const bool two_sided, float3 *n, float *area) {
  const float3 cross = cross3(d->u, d->v);
  const float size = length3(cross);
  *area = PI_F * size;
  if (!(size > 0.0f)) return 0.0f;
  *n = cross * (1.0f / size);
  const float height = dot3(p - d->center, *n);
  if (!(FABS(height) > dot3(abs3(*n), d->p_error + abs3(p) * GAMMA(2)))) return 0.0f;
  if (height > 0.0f) return height;
  *n = -*n;
  return two_sided ? -height : 0.0f;
}

static inline bool disc_light_sample(const SceneData *scene, const __global Light *light, const float3 p,
                                     const float time, const float2 u, LightSample *out) {
  const Disc d = disc_at(scene, light, time);
  float area;
  const float height = disc_height(&d, p, (light->flags & LIGHT_TWO_SIDED) != 0u, &out->n, &area);
  if (!(height > 0.0f)) return false;
  const float2 ab = square_to_disc(u);
  out->p = d.center + (ab.x * d.u + ab.y * d.v);
  out->p_error = d.p_error;
  if (!aim(p, out)) return false;
  out->pdf = flat_area_pdf(out->distance, height, area);
  return usable(out->pdf);
}

static inline float disc_light_hit_pdf(const SceneData *scene, const __global Light *light, const float3 p,
                                       const float distance, const float time) {
  const Disc d = disc_at(scene, light, time);
  float3 n;
  float area;
  const float height = disc_height(&d, p, (light->flags & LIGHT_TWO_SIDED) != 0u, &n, &area);
  if (!(height > 0.0f)) return 0.0f;
  const float pdf = flat_area_pdf(distance, height, area);
  return usable(pdf) ? pdf : 0.0f;
}
