// Eight triangles against one ray, watertight: a ray through an edge or vertex that triangles share never slips between.
// Woop, Benthin, Wald 2013, "Watertight Ray/Triangle Intersection", with edge functions whose sign is exact. Lengths in
// metres in the tree's frame.
#include "geometry/wide.cl"
#include "geometry/hit.cl"

// Vertices of eight triangles along the ray's permuted axes.
typedef struct {
  float8 ax, ay, az, bx, by, bz, cx, cy, cz;
} EightTriangles;

static inline void load_triangles(const __global Packet8 *packet, const RayAxes *r, EightTriangles *e) {
  const __global float8 *p = (const __global float8 *)packet;
  e->ax = p[r->kx];
  e->ay = p[r->ky];
  e->az = p[r->kz];
  e->bx = p[3u + r->kx];
  e->by = p[3u + r->ky];
  e->bz = p[3u + r->kz];
  e->cx = p[6u + r->kx];
  e->cy = p[6u + r->ky];
  e->cz = p[6u + r->kz];
}

// The three vertices of a lane.
static inline void lane_vertices(const SceneData *scene, const uint lane, float3 v[3]) {
  const __global float *p = (const __global float *)(scene->packets + (lane >> 3)) + (lane & 7u);
  for (int i = 0; i < 3; i++, p += 24) v[i] = (float3)(p[0], p[8], p[16]);
}

// The ray against the triangles: t and the weights of vertices 1 and 2 and a bit for each whose t is in (0, end), or,
// where the closest hit is asked for, in (0, end]. early: whether a ray that misses all of them is told before the division, for a
// branch that a processor may guess wrong.
static inline uint meet_triangles(const EightTriangles *e, const RayAxes *r, const float end, const bool any, const bool early,
                                  float8 *t, float8 *b1, float8 *b2) {
  const float8 az = e->az - r->oz, bz = e->bz - r->oz, cz = e->cz - r->oz;
  const float8 ax = (e->ax - r->ox) - r->sx * az, ay = (e->ay - r->oy) - r->sy * az;
  const float8 bx = (e->bx - r->ox) - r->sx * bz, by = (e->by - r->oy) - r->sy * bz;
  const float8 cx = (e->cx - r->ox) - r->sx * cz, cy = (e->cy - r->oy) - r->sy * cz;
  const float8 u = difference_of_products8(cx, by, cy, bx);
  const float8 v = difference_of_products8(ax, cy, ay, cx);
  const float8 q = difference_of_products8(bx, ay, by, ax);
  const float8 low = MIN8(MIN8(u, v), q), high = MAX8(MAX8(u, v), q);
  const float8 det = u + v + q;
  const int8 inside = ((low >= 0.0f) | (high <= 0.0f)) & (det != 0.0f);
  if (early && !lane_mask(inside)) return 0u;
  const float8 inverse = 1.0f / det;
  *b1 = v * inverse;
  *b2 = q * inverse;
  *t = (u * inverse * az + *b1 * bz + *b2 * cz) * r->sz;
  return lane_mask(inside & (*t > 0.0f) & (any ? *t < end : *t <= end));
}

// Offers the triangles of the mask, which is not 0. packet: its index; t, b1, b2: as meet_triangles gives them.
static inline void offer_triangles(uint mask, const SceneData *scene, const uint packet, const uint instance, const float8 *t,
                                   const float8 *b1, const float8 *b2, Hit *best) {
  const __global uint *primitive = scene->packets[packet].primitive;
  do {
    const uint i = CTZ(mask);
    mask &= mask - 1u;
    if (hit_offer(((const float *)t)[i], ((const float *)b1)[i], ((const float *)b2)[i], PRIMITIVE_TRIANGLE, primitive[i], instance,
                  best)) {
      best->lane = 8u * packet + i;
    }
  } while (mask);
}

// Offers the triangles that are hit; true where there is one (the caller of an any-hit query stops there).
static inline bool hit_triangles(const EightTriangles *e, const SceneData *scene, const uint packet, const WideRay *w,
                                 const uint instance, const bool any, Hit *best) {
  float8 t, b1, b2;
  const uint mask = meet_triangles(e, &w->axes, best->t, any, true, &t, &b1, &b2);
  if (!mask) return false;
  if (any) return true;
  const float8 ts[1] = {t}, us[1] = {b1}, vs[1] = {b2};
  offer_triangles(mask, scene, packet, instance, ts, us, vs, best);
  return true;
}

// A leaf's packets, one after the other.
static inline bool hit_packets(const SceneData *scene, const uint word, const WideRay *w, const uint instance,
                               const bool any, Hit *best) {
  uint packet = word & LEAF_PACKET_MASK;
  bool found = false;
  for (uint n = (word >> LEAF_COUNT_SHIFT) & 3u; n; n--, packet++) {
    EightTriangles e;
    load_triangles(scene->packets + packet, &w->axes, &e);
    found |= hit_triangles(&e, scene, packet, w, instance, any, best);
    if (any && found) return true;
  }
  return found;
}
