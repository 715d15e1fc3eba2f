// The constant environment for sixteen lanes; images are looked up lane by lane. Directions in the world frame, W / (m^2 sr).
#include "lights/environment.cl"
#include "lights/light_sample16.h"
#include "sampling/warp16.cl"

static inline Mask16 has_plane16(const Vec16 n) { return (n.x != 0.0f) | (n.y != 0.0f) | (n.z != 0.0f); }

static inline Vec16 constant_sample16(const Vec16 n, const float16 ux, const float16 uy, const Mask16 on, float16 *pdf) {
  const Mask16 plane = has_plane16(n);
  Vec16 s, t;
  make_frame16(n, &s, &t);
  const Vec16 d = square_to_cosine_hemisphere16(ux, uy, pdf);
  const Vec16 above = add16(add16(scale16(s, d.x), scale16(t, d.y)), scale16(n, d.z));
  if (!any16(on & ~plane)) return above;
  *pdf = plane ? *pdf : (float16)(UNIFORM_SPHERE_PDF);
  return where16(plane, above, square_to_sphere16(ux, uy));
}

// Not for images.
static inline Mask16 environment_sample16(const __global Light *light, const Vec16 n, const float16 ux, const float16 uy,
                                          const Mask16 on, LightSample16 *out) {
  out->distance = INF_F;
  out->p = out->p_error = out->n = all16((float3)(0.0f));
  out->wi = constant_sample16(n, ux, uy, on, &out->pdf);
  out->radiance = all16(load3(light->radiance));
  return on;
}

#if PENUMBRA_ENVIRONMENT_IMAGE
static PENUMBRA_NOINLINE PENUMBRA_WIDE void image_radiance_each(const SceneData *scene, const Vec16 *d, const Mask16 *on,
                                                                Vec16 *out) {
  for (LANES_OF(k, *on)) set_lane3(out, k, environment_radiance(scene, lane3(d, k)));
}

static PENUMBRA_NOINLINE PENUMBRA_WIDE void image_pdf_each(const SceneData *scene, const Vec16 *n, const Vec16 *d,
                                                           const Mask16 *on, float16 *out) {
  for (LANES_OF(k, *on)) LANE_F(*out, k) = environment_pdf(scene, lane3(n, k), lane3(d, k));
}
#endif

static inline Vec16 environment_radiance16(const SceneData *scene, const Vec16 d, const Mask16 on) {
  const __global Light *light = environment_of(scene);
  Vec16 radiance = all16(load3(light->radiance));
#if PENUMBRA_ENVIRONMENT_IMAGE
  if (environment_is_image(light)) image_radiance_each(scene, &d, &on, &radiance);
#endif
  return radiance;
}

static inline float16 environment_pdf16(const SceneData *scene, const Vec16 n, const Vec16 d, const Mask16 on) {
  const float16 uniform = UNIFORM_SPHERE_PDF;
  float16 pdf = has_plane16(n) ? cosine_hemisphere_pdf16(dot16(n, d)) : uniform;
#if PENUMBRA_ENVIRONMENT_IMAGE
  if (environment_is_image(environment_of(scene))) image_pdf_each(scene, &n, &d, &on, &pdf);
#endif
  return pdf;
}
