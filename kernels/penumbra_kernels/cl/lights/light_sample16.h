// What light sampling returns for sixteen lanes (lights/light_sample.h, a lane each).
#include "base/types16.h"
#include "lights/light_sample.h"

typedef struct {
  Vec16 wi;
  float16 distance;
  Vec16 radiance;
  float16 pdf;
  Vec16 p, p_error, n;
} LightSample16;

static inline void set_lane_light_sample(LightSample16 *out, const uint k, const LightSample *sample) {
  set_lane3(&out->wi, k, sample->wi);
  LANE_F(out->distance, k) = sample->distance;
  set_lane3(&out->radiance, k, sample->radiance);
  LANE_F(out->pdf, k) = sample->pdf;
  set_lane3(&out->p, k, sample->p);
  set_lane3(&out->p_error, k, sample->p_error);
  set_lane3(&out->n, k, sample->n);
}

// `sample` in the lanes of `on`.
static inline void choose_samples16(const Mask16 on, const LightSample16 *sample, LightSample16 *out) {
  out->wi = where16(on, sample->wi, out->wi);
  out->distance = on ? sample->distance : out->distance;
  out->radiance = where16(on, sample->radiance, out->radiance);
  out->pdf = on ? sample->pdf : out->pdf;
  out->p = where16(on, sample->p, out->p);
  out->p_error = where16(on, sample->p_error, out->p_error);
  out->n = where16(on, sample->n, out->n);
}

static inline float16 flat_area_pdf16(const float16 distance, const float16 height, const float16 area) {
  return sqr16(distance) / area * (distance / height);
}

// The lanes in which the light is not at the lit point itself.
static inline Mask16 aim16(const Vec16 p, LightSample16 *out) {
  const Vec16 d = sub16(out->p, p);
  out->distance = length16(d);
  out->wi = scale16(d, 1.0f / out->distance);
  return (out->distance > 0.0f) & is_finite16(out->distance);
}

static inline Mask16 usable16(const float16 pdf) { return (pdf > 0.0f) & is_finite16(pdf); }
