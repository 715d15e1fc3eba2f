// Triangles against sixteen rays, watertight as in triangle.cl and with its bits: a triangle against all rays at once, or, where few
// of them come by, each of these against eight triangles. Lengths in metres in the tree's frame.
#include "geometry/wide16.cl"
#include "geometry/triangle.cl"
#if PENUMBRA_DEFORMATION
#include "geometry/deforming.cl"
#endif

typedef struct {
  float16 x, y, z;
} Corner16;

// Corner i of a triangle relative to the rays, sheared so that they go along z. v: its coordinates in the packet.
static inline Corner16 corner16(const __global float v[3][8], const uint i, const WideRay16 *w) {
  const float16 x = v[0][i], y = v[1][i], z = v[2][i];
  Corner16 c;
  c.z = ALONG(w, x, y, z) - w->okz;
  c.x = (NEXT(w, x, y, z) - w->okx) - w->sx * c.z;
  c.y = (AFTER(w, x, y, z) - w->oky) - w->sy * c.z;
  return c;
}

static inline void hit_triangle16(const __global Packet8 *p, const uint i, const uint lane, const Rays16 *r, const Mask16 on,
                                  const bool any, Best16 *h) {
  const WideRay16 *w = r->wide;
  const Corner16 a = corner16(p->v0, i, w), b = corner16(p->v1, i, w), c = corner16(p->v2, i, w);
  const float16 u = difference_of_products16(c.x, b.y, c.y, b.x);
  const float16 v = difference_of_products16(a.x, c.y, a.y, c.x);
  const float16 q = difference_of_products16(b.x, a.y, b.y, a.x);
  const float16 low = MIN16(MIN16(u, v), q), high = MAX16(MAX16(u, v), q);
  const float16 det = u + v + q;
  const Mask16 inside = ((low >= 0.0f) | (high <= 0.0f)) & (det != 0.0f) & on;
  if (!mask16(inside)) return;
  const float16 inverse = 1.0f / det;
  const float16 b0 = u * inverse, b1 = v * inverse, b2 = q * inverse;
  const float16 t = (b0 * a.z + b1 * b.z + b2 * c.z) * w->sz;
  offer16(inside, t, b1, b2, (PRIMITIVE_TRIANGLE << KEY_KIND_SHIFT) | p->primitive[i], lane, r->instance, any, h);
}

// Where a triangle of eight is hit nearest by the k-th ray, it goes into that lane.
static inline void offer_lane16(uint mask, const __global Packet8 *p, const uint packet, const uint instance, const uint k,
                                const float8 t8, const float8 u8, const float8 v8, Best16 *h) {
  const float8 t[1] = {t8}, u[1] = {u8}, v[1] = {v8};
  float best = LANE_F(h->t, k);
  uint key = LANE_I(h->found, k) ? LANE_U(h->key, k) : 0u, found = 8u;
#if PENUMBRA_INSTANCING
  if (LANE_I(h->found, k) && instance < LANE_U(h->instance, k)) key++;  // the same in a later instance
#endif
  for (; mask; mask &= mask - 1u) {
    const uint i = CTZ(mask), its_key = (PRIMITIVE_TRIANGLE << KEY_KIND_SHIFT) | p->primitive[i];
    const float its = ((const float *)t)[i];
    if (!(its < best || (its == best && its_key < key))) continue;
    best = its;
    key = its_key;
    found = i;
  }
  if (found == 8u) return;
  const Mask16 here = LANE_NUMBERS == (int)k;
  h->found |= here;
  h->t = here ? (float16)(best) : h->t;
  h->u = here ? (float16)(((const float *)u)[found]) : h->u;
  h->v = here ? (float16)(((const float *)v)[found]) : h->v;
  h->key = here ? (uint16)(key) : h->key;
  h->lane = here ? (uint16)(8u * packet + found) : h->lane;
#if PENUMBRA_INSTANCING
  h->instance = here ? (uint16)(instance) : h->instance;
#endif
}

// Ray k, as wide_ray prepares it for triangles.
static inline RayAxes lane_axes(const WideRay16 *w, const uint k) {
  RayAxes r;
  r.kz = LANE_I(w->last_x, k) ? 0u : LANE_I(w->last_y, k) ? 1u : 2u;
  r.kx = r.kz == 2u ? 0u : r.kz + 1u;
  r.ky = r.kx == 2u ? 0u : r.kx + 1u;
  r.ox = LANE_F(w->okx, k);
  r.oy = LANE_F(w->oky, k);
  r.oz = LANE_F(w->okz, k);
  r.sx = LANE_F(w->sx, k);
  r.sy = LANE_F(w->sy, k);
  r.sz = LANE_F(w->sz, k);
  return r;
}

// Ray k against eight triangles at once. Where any hit will do, whether there is one; else it goes into h.
static inline bool hit_triangles_of(const EightTriangles *e, const RayAxes *axes, const SceneData *scene, const uint packet,
                                    const Rays16 *r, const uint k, const bool any, Best16 *h) {
  float8 t, b1, b2;
  const uint mask = meet_triangles(e, axes, LANE_F(h->t, k), any, true, &t, &b1, &b2);
  if (mask && !any) offer_lane16(mask, scene->packets + packet, packet, r->instance, k, t, b1, b2, h);
  return mask != 0u;
}

// The rays one by one.
static inline void hit_packet_apart(const SceneData *scene, const uint packet, const Rays16 *r, const Mask16 on, const bool any,
                                    Best16 *h) {
  uint hit = 0u;
  for (LANES_OF(k, on)) {
    const RayAxes axes = lane_axes(r->wide, k);
    EightTriangles e;
    load_triangles(scene->packets + packet, &axes, &e);
    hit |= (hit_triangles_of(&e, &axes, scene, packet, r, k, any, h) ? 1u : 0u) << k;
  }
  if (any && hit) h->found |= lanes_of_bits(hit);
}

#if PENUMBRA_DEFORMATION
// Each ray meets the triangles where they are at its time.
static PENUMBRA_NOINLINE PENUMBRA_WIDE void hit_deforming16(const SceneData *scene, const uint word, const Rays16 *r,
                                                            const Mask16 *on, const bool any, Best16 *h) {
  const uint first = word & LEAF_PACKET_MASK;
  uint hit = 0u;
  for (LANES_OF(k, *on)) {
    const RayAxes axes = lane_axes(r->wide, k);
    EightTriangles e;
    load_deforming(scene, scene->packets + first, &axes, LANE_F(*r->time, k), &e);
    hit |= (hit_triangles_of(&e, &axes, scene, first, r, k, any, h) ? 1u : 0u) << k;
  }
  if (any && hit) h->found |= lanes_of_bits(hit);
}
#endif

static inline uint triangles_in(const __global Packet8 *p) {
  const uint8 primitive = *(const __global uint8 *)p->primitive;
  return CTZ(lane_mask(primitive == primitive.s7)) + 1u;
}

static inline void hit_packets16(const SceneData *scene, const uint word, const Rays16 *r, const Mask16 on, const bool any,
                                 Best16 *h) {
  uint packet = word & LEAF_PACKET_MASK;
  for (uint n = (word >> LEAF_COUNT_SHIFT) & 3u; n; n--, packet++) {
    const __global Packet8 *p = scene->packets + packet;
    const uint count = triangles_in(p);
    if (3u * POPCOUNT(mask16(on)) < 2u * count) {
      hit_packet_apart(scene, packet, r, on, any, h);
      continue;
    }
    for (uint i = 0u; i < count; i++) hit_triangle16(p, i, 8u * packet + i, r, on, any, h);
  }
}
