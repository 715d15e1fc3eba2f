// The environment: light from infinitely far away, by direction. World frame, unit directions; W / (m^2 sr).
//
// Constant: sampled by the cosine to the receiver's normal, as a diffuse surface sees it; uniformly over the sphere where light
// counts from any side. Image: latitude-longitude, looked up bilinearly, columns wrapping around; in
// its own frame +Y is the top row, -Z the centre column, u grows towards +X there. Sampled by row, then column, then
// uniformly in (u, v) within the texel; a texel's probability is proportional to the mean of the bilinear image over it
// times its solid angle, so that no direction with light has a density of zero (compile/environment.py builds it in float64).
//
// The `environment` buffer: width * height texels (radiance, density over the unit square of (u, v)), rows from the top; then
// floats: the rows' CDF (height + 1), and for each row its columns' CDF (width + 1). CDF entries are multiples of 2^-24, so
// that a texel's probability is exactly the share of the 24-bit uniform numbers that choose it.
#include "lights/light_sample.h"
#include "base/transcendental.cl"
#include "sampling/warp.cl"

#define UNIFORM_STEP 0x1p-24f
#define INV_2PI2_F 0.0506605918211689f  // 1 / (2 pi^2): (u, v) covers 2 pi times pi

static inline const __global Light *environment_of(const SceneData *scene) { return scene->lights + scene->environment_light; }

static inline bool environment_is_image(const __global Light *light) {
#if PENUMBRA_ENVIRONMENT_IMAGE
  return light->width > 0u;
#else
  return false;
#endif
}

static inline float3 environment_from_world(const __global Light *light, const float3 d) {
  return (float3)(dot3(load3(light->position), d), dot3(load3(light->direction), d), dot3(load3(light->axis_v), d));
}

static inline float3 world_from_environment(const __global Light *light, const float3 d) {
  return load3(light->position) * d.x + load3(light->direction) * d.y + load3(light->axis_v) * d.z;
}

// (u, v) in [0, 1]^2 of a unit direction in the environment's frame, and the sine of its angle from the pole.
static inline float2 environment_uv(const float3 d, float *sin_theta) {
  *sin_theta = SQRT(d.x * d.x + d.z * d.z);
  return (float2)(CLAMP01(0.5f + atan2_f(d.x, -d.z) * INV_2PI_F), CLAMP01(atan2_f(*sin_theta, d.y) * INV_PI_F));
}

static inline float3 environment_direction(const float2 uv, float *sin_theta) {
  float sin_phi, cos_phi, cos_theta;
  sincos_2pi(uv.x, &sin_phi, &cos_phi);  // of the azimuth from +Z, which is the image's edge
  sincos_2pi(0.5f * uv.y, sin_theta, &cos_theta);
  return (float3)(-*sin_theta * sin_phi, cos_theta, *sin_theta * cos_phi);
}

static inline float3 environment_texel(const SceneData *scene, const __global Light *light, const uint x, const uint y) {
  return scene->environment[(ulong)y * light->width + x].xyz;
}

static inline float3 environment_lookup(const SceneData *scene, const __global Light *light, const float2 uv) {
  const float x = uv.x * (float)light->width + 0.5f;
  const float y = uv.y * (float)light->height + 0.5f;
  const uint right = (uint)x;
  const uint below = (uint)y;
  const float fx = x - (float)right;
  const float fy = y - (float)below;
  const uint x0 = right == 0u ? light->width - 1u : right - 1u;
  const uint x1 = right >= light->width ? 0u : right;
  const uint y0 = below == 0u ? 0u : below - 1u;
  const uint y1 = MIN(below, light->height - 1u);
  const float3 top = environment_texel(scene, light, x0, y0) * (1.0f - fx) + environment_texel(scene, light, x1, y0) * fx;
  const float3 low = environment_texel(scene, light, x0, y1) * (1.0f - fx) + environment_texel(scene, light, x1, y1) * fx;
  return top * (1.0f - fy) + low * fy;
}

// Radiance that comes from the direction d.
static inline float3 environment_radiance(const SceneData *scene, const float3 d) {
  const __global Light *light = environment_of(scene);
  if (!environment_is_image(light)) return load3(light->radiance);
  float sin_theta;
  return environment_lookup(scene, light, environment_uv(environment_from_world(light, d), &sin_theta));
}

static inline float environment_density(const SceneData *scene, const __global Light *light, const uint x, const uint y,
                                        const float sin_theta) {
  const float pdf = scene->environment[(ulong)y * light->width + x].w * INV_2PI2_F / sin_theta;
  return usable(pdf) ? pdf : 0.0f;
}

static inline bool has_plane(const float3 n) { return n.x != 0.0f || n.y != 0.0f || n.z != 0.0f; }

// Density per solid angle with which environment_sample finds the direction d for a receiver of normal n.
static inline float environment_pdf(const SceneData *scene, const float3 n, const float3 d) {
  const __global Light *light = environment_of(scene);
  if (!environment_is_image(light)) return has_plane(n) ? cosine_hemisphere_pdf(dot3(n, d)) : UNIFORM_SPHERE_PDF;
  float sin_theta;
  const float2 uv = environment_uv(environment_from_world(light, d), &sin_theta);
  const uint x = MIN((uint)(uv.x * (float)light->width), light->width - 1u);
  const uint y = MIN((uint)(uv.y * (float)light->height), light->height - 1u);
  return environment_density(scene, light, x, y, sin_theta);
}

// Index i with cdf[i] <= u < cdf[i + 1]; rest: where u lies between the two, in (0, 1).
static inline uint cdf_choose(const __global float *cdf, const uint count, const float u, float *rest) {
  uint low = 0u;
  uint high = count;
  while (high - low > 1u) {
    const uint middle = (low + high) >> 1;
    if (cdf[middle] <= u) low = middle; else high = middle;
  }
  // u stands for the interval of one step: its middle, so that few steps between the two leave no bias
  *rest = MIN((u - cdf[low] + 0.5f * UNIFORM_STEP) / (cdf[low + 1u] - cdf[low]), ONE_MINUS_EPSILON);
  return low;
}

static inline bool environment_image_sample(const SceneData *scene, const __global Light *light, const float2 u,
                                            LightSample *out) {
  const __global float *rows = (const __global float *)scene->environment + light->first_cdf;
  float rest_x, rest_y, sin_theta;
  const uint y = cdf_choose(rows, light->height, u.y, &rest_y);
  const __global float *columns = rows + light->height + 1u + (ulong)y * (light->width + 1u);
  const uint x = cdf_choose(columns, light->width, u.x, &rest_x);
  const float2 uv = (float2)(((float)x + rest_x) / (float)light->width, ((float)y + rest_y) / (float)light->height);
  out->wi = world_from_environment(light, environment_direction(uv, &sin_theta));
  out->radiance = environment_lookup(scene, light, uv);
  out->pdf = environment_density(scene, light, x, y, sin_theta);
  return out->pdf > 0.0f;
}

// A direction of the constant environment, and its density.
static inline float3 constant_sample(const float3 n, const float2 u, float *pdf) {
  if (!has_plane(n)) {
    *pdf = UNIFORM_SPHERE_PDF;
    return square_to_sphere(u);
  }
  float3 s, t;
  make_frame(n, &s, &t);
  const float3 d = square_to_cosine_hemisphere(u, pdf);
  return s * d.x + t * d.y + n * d.z;
}

static inline bool environment_sample(const SceneData *scene, const __global Light *light, const float3 n, const float2 u,
                                      LightSample *out) {
  out->distance = INF_F;
  out->p = (float3)(0.0f);
  out->p_error = (float3)(0.0f);
  out->n = (float3)(0.0f);
  if (environment_is_image(light)) return environment_image_sample(scene, light, u, out);
  out->wi = constant_sample(n, u, &out->pdf);
  out->radiance = load3(light->radiance);
  return true;
}
