// What light sampling returns. World frame, metres relative to the anchor; densities per solid angle at the lit point.
#include "base/types.h"

typedef struct {
  float3 wi;        // unit, from the lit point to the light
  float distance;   // to p; infinite for directional lights and the environment
  float3 radiance;  // arriving; for delta lights irradiance on a surface that faces wi, with pdf 1
  float pdf;
  bool delta;       // a lobe's ray cannot meet this light
  float3 p;         // where a shadow ray goes
  float3 p_error;   // bound on the absolute error of p, by component
  float3 n;         // unit normal of the light at p, on the lit point's side; 0 for lights without a surface
} LightSample;

// Density per solid angle of a direction that may be any.
#define UNIFORM_SPHERE_PDF 0.0795774715459477f

// Density per solid angle, at a distance, of a density 1 / area over a flat light whose plane is `height` away:
// distance^2 / (cos area), cos = height / distance. The lecture's L A cos / r^2 is radiance over this.
static inline float flat_area_pdf(const float distance, const float height, const float area) {
  return sqr(distance) / area * (distance / height);
}

// Fills in direction and distance to out->p; false where the light is at the lit point itself.
static inline bool aim(const float3 p, LightSample *out) {
  const float3 d = out->p - p;
  out->distance = length3(d);
  out->wi = d * (1.0f / out->distance);
  return out->distance > 0.0f && is_finite(out->distance);
}

// Whether a density can be divided by: positive and finite.
static inline bool usable(const float pdf) { return pdf > 0.0f && is_finite(pdf); }
