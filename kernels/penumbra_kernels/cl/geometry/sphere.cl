// Spheres against one ray, precise near and far. Haines, Gunther, Akenine-Moller 2019, "Precision Improvements for
// Ray/Sphere Intersection", with compensated dot products where the origin is near. Metres in the tree's frame.
#include "geometry/hit.cl"

// Sum of a high and a low part.
typedef struct {
  float high, low;
} Pair;

static inline Pair two_sum(const float a, const float b) {  // Knuth, TAOCP 2, 4.2.2, theorem B
  Pair s;
  s.high = a + b;
  const float c = s.high - a;
  s.low = (a - (s.high - c)) + (b - c);
  return s;
}

static inline void add_product(Pair *sum, const float a, const float b) {
  const float product = a * b;
  const float error = FMA(a, b, -product);
  const Pair s = two_sum(sum->high, product);
  sum->high = s.high;
  sum->low += s.low + error;
}

// Dot product as if in twice the precision (Ogita, Rump, Oishi 2005, algorithm 5.3).
static inline float dot3_precise(const float3 a, const float3 b, const float start_high, const float start_low) {
  Pair sum = {start_high, start_low};
  add_product(&sum, a.x, b.x);
  add_product(&sum, a.y, b.y);
  add_product(&sum, a.z, b.z);
  return sum.high + sum.low;
}

// First t > 0 on the sphere, INF_F where there is none. d need not be of unit length.
static inline float sphere_distance(const float3 center, const float radius, const float3 o, const float3 d) {
  const Pair x = two_sum(o.x, -center.x), y = two_sum(o.y, -center.y), z = two_sum(o.z, -center.z);
  const float3 f = (float3)(x.high, y.high, z.high);
  const float3 f_low = (float3)(x.low, y.low, z.low);
  const float a = dot3(d, d);
  const float b = -dot3_precise(f, d, 0.0f, dot3(f_low, d));
  const float r2 = radius * radius;
  // |f|^2 - r^2: positive outside, and exact enough to tell the sides of a point that spawn_ray moved off the surface.
  const float c = dot3_precise(f, f, -r2, FMA(-radius, radius, r2) + 2.0f * dot3(f, f_low));
  float room;  // r^2 - (distance of the line from the center)^2
  if (b * b < a * r2) {
    room = difference_of_products(b, b, a, c) / a;
  } else {
    const float3 l = f + (b / a) * d;
    room = r2 - dot3(l, l);
  }
  if (room < 0.0f) {
    if (c >= 0.0f) return INF_F;
    room = 0.0f;  // from inside there is always a way out
  }
  const float root = SQRT(a * room);
  const float q = b + copy_sign(root, b);
  const float t0 = c / q, t1 = q / a;  // NaN only where the ray touches the surface at its very origin
  const float near = MIN(t0, t1), far = MAX(t0, t1);
  return near > 0.0f ? near : far > 0.0f ? far : INF_F;
}
