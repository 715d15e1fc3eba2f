// Spheres, discs and planes against sixteen rays, with the bits of sphere.cl, disc.cl and plane.cl. Metres; spheres and discs in the
// tree's frame, planes in the world's.
#include "geometry/wide16.cl"
#include "geometry/sphere.cl"
#include "geometry/disc.cl"
#include "geometry/plane.cl"

typedef struct {
  float16 high, low;
} Pair16;

static inline Pair16 two_sum16(const float16 a, const float16 b) {
  Pair16 s;
  s.high = a + b;
  const float16 c = s.high - a;
  s.low = (a - (s.high - c)) + (b - c);
  return s;
}

static inline void add_product16(Pair16 *sum, const float16 a, const float16 b) {
  const float16 product = a * b;
  const float16 error = fma16(a, b, -product);
  const Pair16 s = two_sum16(sum->high, product);
  sum->high = s.high;
  sum->low += s.low + error;
}

// sphere_distance of each ray.
static inline float16 sphere_distance16(const __global SphereData *sphere, const Vec16 *o, const Vec16 *d) {
  const float radius = sphere->radius;
  const Pair16 x = two_sum16(o->x, -sphere->center[0]), y = two_sum16(o->y, -sphere->center[1]),
               z = two_sum16(o->z, -sphere->center[2]);
  const float16 a = d->x * d->x + d->y * d->y + d->z * d->z;
  Pair16 along = {0.0f, x.low * d->x + y.low * d->y + z.low * d->z};
  add_product16(&along, x.high, d->x);
  add_product16(&along, y.high, d->y);
  add_product16(&along, z.high, d->z);
  const float16 b = -(along.high + along.low);
  const float r2 = radius * radius;
  Pair16 outside = {-r2, FMA(-radius, radius, r2) + 2.0f * (x.high * x.low + y.high * y.low + z.high * z.low)};
  add_product16(&outside, x.high, x.high);
  add_product16(&outside, y.high, y.high);
  add_product16(&outside, z.high, z.high);
  const float16 c = outside.high + outside.low;
  const float16 k = b / a;
  const float16 lx = x.high + k * d->x, ly = y.high + k * d->y, lz = z.high + k * d->z;
  const float16 room_far = r2 - (lx * lx + ly * ly + lz * lz);
  const float16 room_near = difference_of_products16(b, b, a, c) / a;
  const float16 signed_room = b * b < a * r2 ? room_near : room_far;
  const Mask16 misses = (signed_room < 0.0f) & (c >= 0.0f);
  const float16 room = signed_room < 0.0f ? (float16)(0.0f) : signed_room;
  const float16 q = b + copy_sign16(sqrt16(a * room), b);
  const float16 t0 = c / q, t1 = q / a;
  const float16 near = MIN16(t0, t1), far = MAX16(t0, t1);
  const float16 none = INF_F;
  return misses ? none : near > 0.0f ? near : far > 0.0f ? far : none;
}

static inline float16 dot_all16(const Vec16 a, const float3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// disc_distance of each ray.
static inline float16 disc_distance16(const __global DiscData *disc, const Vec16 *o, const Vec16 *d, float16 *a, float16 *b) {
  const float3 u = load3(disc->u), v = load3(disc->v), n = disc_normal(disc);
  const Vec16 f = sub16(all16(load3(disc->center)), *o);
  const float16 none = INF_F, t = dot_all16(f, n) / dot_all16(*d, n);
  const Vec16 q = sub16(scale16(*d, t), f);
  *a = dot_all16(q, u) / dot3(u, u);
  *b = dot_all16(q, v) / dot3(v, v);
  const Mask16 inside = *a * *a + *b * *b <= 1.0f;
  return ((t > 0.0f) & (t < INF_F) & inside) ? t : none;
}

static inline void hit_round16(const SceneData *scene, const uint word, const Rays16 *r, const Mask16 on, Best16 *h) {
  const uint index = word & LEAF_ROUND_MASK;
  const bool is_disc = (word >> LEAF_DISC_SHIFT) & 1u;
  float16 a = 0.0f, b = 0.0f;
  const float16 t = is_disc ? disc_distance16(scene->discs + index, r->o, r->d, &a, &b)
                            : sphere_distance16(scene->spheres + index, r->o, r->d);
  const uint kind = is_disc ? PRIMITIVE_DISC : PRIMITIVE_SPHERE;
  offer16(on & (t < INF_F), t, a, b, (kind << KEY_KIND_SHIFT) | index, NONE, r->instance, h);
}

// hit_planes of each ray. Moving planes stand elsewhere for each.
static inline void hit_planes16(const SceneData *scene, const Ray16 *ray, const Mask16 on, Best16 *h) {
  for (uint i = 0u; i < scene->plane_count; i++) {
    const __global PlaneData *record = scene->planes + i;
    Vec16 point = all16(load3(record->point)), normal = all16(load3(record->normal));
#if PENUMBRA_MOTION
    if (record->keyframe_count) {
      for (LANES_OF(k, on)) {
        const PlaneAt plane = plane_at(scene, record, LANE_F(ray->time, k));
        set_lane3(&point, k, plane.point);
        set_lane3(&normal, k, plane.normal);
      }
    }
#endif
    const float16 zero = 0.0f, t = dot16(sub16(point, ray->o), normal) / dot16(ray->d, normal);
    offer16(on & (t < INF_F), t, zero, zero, (PRIMITIVE_PLANE << KEY_KIND_SHIFT) | i, NONE, NONE, h);
  }
}
