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

// A corner relative to the rays, sheared so that they go along z.
static inline void turn_corner16(const float4 p, const WideRay16 *w, Corner16 *c) {
  c->z = component_of16(p, w->kz) - w->okz;
  c->x = (component_of16(p, w->kx) - w->okx) - w->sx * c->z;
  c->y = (component_of16(p, w->ky) - w->oky) - w->sy * c->z;
}

#define CORNERS 24u  // of eight triangles

// Those of a packet of `count` triangles, for each ray. own: where each of them stands once; else they come in the packet's order.
static inline void turn_corners16(const __global Packet8 *p, const __global PacketCorners *own, const uint count, const WideRay16 *w,
                                  Corner16 *c) {
  if (own) {
    const __global float4 *corner = (const __global float4 *)own->corner;
    for (uint i = 0u; i < own->corners; i++) turn_corner16(corner[i], w, c + i);
    return;
  }
  const __global float *v = (const __global float *)p;
  for (uint i = 0u; i < count; i++, v++) {
    for (uint k = 0u; k < 3u; k++) turn_corner16((float4)(v[24u * k], v[24u * k + 8u], v[24u * k + 16u], 0.0f), w, c + (3u * i + k));
  }
}

// A triangle against all rays. early: look first whether any of them is inside.
static inline void hit_triangle16(const Corner16 *a, const Corner16 *b, const Corner16 *c, const uint primitive, const uint lane,
                                  const Rays16 *r, const bool early, Best16 *h) {
  const float16 u = difference_of_products16(c->x, b->y, c->y, b->x);
  const float16 v = difference_of_products16(a->x, c->y, a->y, c->x);
  const float16 q = difference_of_products16(b->x, a->y, b->y, a->x);
  const float16 low = MIN16(MIN16(u, v), q), high = MAX16(MAX16(u, v), q);
  const float16 det = u + v + q;
  const Mask16 inside = ((low >= 0.0f) | (high <= 0.0f)) & (det != 0.0f);
  if (early && !any16(inside)) return;
  const float16 inverse = 1.0f / det;
  const float16 b0 = u * inverse, b1 = v * inverse, b2 = q * inverse;
  const float16 t = (b0 * a->z + b1 * b->z + b2 * c->z) * r->wide->sz;
  offer16(inside, t, b1, b2, (PRIMITIVE_TRIANGLE << KEY_KIND_SHIFT) | primitive, lane, r->instance, h);
}

// Where a triangle of eight is hit nearest by the k-th ray, it goes into that lane.
static inline void offer_lane16(uint mask, const __global Packet8 *p, const uint packet, const uint instance, const uint k,
                                const float8 t8, const float8 u8, const float8 v8, Best16 *h) {
  const float8 t[1] = {t8}, u[1] = {u8}, v[1] = {v8};
  float best = LANE_F(h->t, k);
  uint key = LANE_U(h->key, k), found = 8u;
#if PENUMBRA_INSTANCING
  if (instance < LANE_U(h->instance, k)) key++;  // the same in a later instance
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
  r.kx = LANE_U(w->kx, k);
  r.ky = LANE_U(w->ky, k);
  r.kz = LANE_U(w->kz, k);
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
  const uint mask = meet_triangles(e, axes, LANE_F(h->t, k), any, !PENUMBRA_512, &t, &b1, &b2);
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

// All rays against one triangle after the other.
static inline void hit_packet_together(const SceneData *scene, const uint packet, const uint count, const Rays16 *r, const Mask16 on,
                                       Best16 *h) {
  const __global Packet8 *p = scene->packets + packet;
  const __global PacketCorners *own = scene->corners ? scene->corners + packet : 0;
  // In a small tree half of the triangles are hit by some ray: where all that follows are a few instructions, guessing which costs more.
  const bool early = PENUMBRA_512 ? !own : true;
  const float16 never = -1.0f;
  Best16 best = *h;
  best.t = on ? best.t : never;  // no hit counts there
  Corner16 corner[CORNERS];
  turn_corners16(p, own, count, r->wide, corner);
  for (uint i = 0u; i < count; i++) {
    const uint at = 3u * i;
    const uint a = own ? own->index[at] : at, b = own ? own->index[at + 1u] : at + 1u, c = own ? own->index[at + 2u] : at + 2u;
    hit_triangle16(corner + a, corner + b, corner + c, p->primitive[i], 8u * packet + i, r, early, &best);
  }
  best.t = on ? best.t : h->t;
  *h = best;
}

// Where twice the triangles are more than so many times the rays, each ray meets the packet alone. Measured.
#define RAYS_A_PACKET (PENUMBRA_512 ? 5u : 3u)

static inline void hit_packets16(const SceneData *scene, const uint word, const Rays16 *r, const Mask16 on, const bool any,
                                 Best16 *h) {
  uint packet = word & LEAF_PACKET_MASK;
  for (uint n = (word >> LEAF_COUNT_SHIFT) & 3u; n; n--, packet++) {
    const uint count = scene->corners ? scene->corners[packet].triangles : triangles_in(scene->packets + packet);
    if (RAYS_A_PACKET * POPCOUNT(mask16(on)) < 2u * count) hit_packet_apart(scene, packet, r, on, any, h);
    else hit_packet_together(scene, packet, count, r, on, h);
  }
}
