// Sixteen rays at once through a small tree, one box or primitive after the other: where all of them are near everything, no ray
// waits for its own branches. Each ray meets what traverse.cl finds for it, bit for bit. Still triangles, spheres and discs in the
// world's tree; metres in the world frame.
#include "base/types16.h"
#include "geometry/intersect.cl"

// The first hit of each ray. key: kind and primitive in the order in which equal t are decided; meaningless where `found` is not.
typedef struct {
  float16 t, u, v;
  uint16 key, lane;
  Mask16 found;
} Best16;

#define KEY_KIND_SHIFT 30u

// Prepared as wide_ray prepares one.
typedef struct {
  float16 near_ox, near_oy, near_oz, far_ox, far_oy, far_oz;
  float16 near_rx, near_ry, near_rz, far_rx, far_ry, far_rz;
  Mask16 back_x, back_y, back_z;  // towards smaller coordinates: the near planes are the high ones
  Mask16 last_x, last_y;          // the axis of the direction's largest component, z otherwise
  float16 okx, oky, okz, sx, sy, sz;
  Mask16 is_ray;
} WideRay16;

// Of x, y, z the one along the axis, the next and the one after it.
#define ALONG(w, x, y, z) ((w)->last_x ? (x) : (w)->last_y ? (y) : (z))
#define NEXT(w, x, y, z) ((w)->last_x ? (y) : (w)->last_y ? (z) : (x))
#define AFTER(w, x, y, z) ((w)->last_x ? (z) : (w)->last_y ? (x) : (y))

static inline void wide_ray16(const Ray16 *r, WideRay16 *w) {
  const float16 ax = abs16(r->d.x), ay = abs16(r->d.y), az = abs16(r->d.z);
  const float16 largest = MAX16(MAX16(ax, ay), az);
  const float16 reach = MAX16(MAX16(abs16(r->o.x), abs16(r->o.y)), abs16(r->o.z));
  w->is_ray = (largest >= 0x1p-126f) & is_finite16(ax + ay + az) & is_finite16(r->o.x + r->o.y + r->o.z + reach);
  const float16 rx = 1.0f / r->d.x, ry = 1.0f / r->d.y, rz = 1.0f / r->d.z;
  const float16 e = BOX_SLACK * reach;
  const float16 ex = copy_sign16(e, rx), ey = copy_sign16(e, ry), ez = copy_sign16(e, rz);
  w->back_x = as_int16(rx) < 0;
  w->back_y = as_int16(ry) < 0;
  w->back_z = as_int16(rz) < 0;
  w->near_ox = r->o.x + ex;
  w->near_oy = r->o.y + ey;
  w->near_oz = r->o.z + ez;
  w->far_ox = r->o.x - ex;
  w->far_oy = r->o.y - ey;
  w->far_oz = r->o.z - ez;
  w->near_rx = rx;
  w->near_ry = ry;
  w->near_rz = rz;
  w->far_rx = rx * FAR_FACTOR;
  w->far_ry = ry * FAR_FACTOR;
  w->far_rz = rz * FAR_FACTOR;
  w->last_x = (ax > ay) & (ax > az);
  w->last_y = !(ax > ay) & (ay > az);
  w->okx = NEXT(w, r->o.x, r->o.y, r->o.z);
  w->oky = AFTER(w, r->o.x, r->o.y, r->o.z);
  w->okz = ALONG(w, r->o.x, r->o.y, r->o.z);
  w->sz = ALONG(w, rx, ry, rz);
  w->sx = NEXT(w, r->d.x, r->d.y, r->d.z) * w->sz;
  w->sy = AFTER(w, r->d.x, r->d.y, r->d.z) * w->sz;
}

// Child i of a node: the rays that meet its box no later than their best hit.
static inline Mask16 meet_box16(const __global Node8 *n, const uint i, const WideRay16 *w, const float16 end,
                                float16 *enter) {
  const float16 lx = n->lo_x[i], ly = n->lo_y[i], lz = n->lo_z[i], hx = n->hi_x[i], hy = n->hi_y[i], hz = n->hi_z[i];
  const float16 nx = ((w->back_x ? hx : lx) - w->near_ox) * w->near_rx;
  const float16 ny = ((w->back_y ? hy : ly) - w->near_oy) * w->near_ry;
  const float16 nz = ((w->back_z ? hz : lz) - w->near_oz) * w->near_rz;
  const float16 fx = ((w->back_x ? lx : hx) - w->far_ox) * w->far_rx;
  const float16 fy = ((w->back_y ? ly : hy) - w->far_oy) * w->far_ry;
  const float16 fz = ((w->back_z ? lz : hz) - w->far_oz) * w->far_rz;
  const float16 zero = 0.0f;
  *enter = MAX16(nx, MAX16(ny, MAX16(nz, zero)));
  return *enter <= MIN16(fx, MIN16(fy, MIN16(fz, end)));
}

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

// Where `on`, a hit at t counts if it is nearer than the best, or as near and before it in the order.
static inline void offer16(const Mask16 on, const float16 t, const float16 u, const float16 v, const uint key, const uint lane,
                           const bool any, Best16 *h) {
  Mask16 wins = on & (t > 0.0f);
  if (any) {
    h->found |= wins & (t < h->t);
    return;
  }
  wins &= (t < h->t) | ((t == h->t) & h->found & (h->key > key));
  h->t = wins ? t : h->t;
  h->u = wins ? u : h->u;
  h->v = wins ? v : h->v;
  h->key = wins ? (uint16)key : h->key;
  h->lane = wins ? (uint16)lane : h->lane;
  h->found |= wins;
}

static inline void hit_triangle16(const __global Packet8 *p, const uint i, const uint lane, const WideRay16 *w, const Mask16 on,
                                  const bool any, Best16 *h) {
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
  offer16(inside, t, b1, b2, (PRIMITIVE_TRIANGLE << KEY_KIND_SHIFT) | p->primitive[i], lane, any, h);
}

// Where a triangle of eight is hit nearest by the k-th ray, it goes into that lane.
static inline void offer_lane16(uint mask, const __global Packet8 *p, const uint packet, const uint k, const float8 t8,
                                const float8 u8, const float8 v8, Best16 *h) {
  const float8 t[1] = {t8}, u[1] = {u8}, v[1] = {v8};
  float best = LANE_F(h->t, k);
  uint key = LANE_I(h->found, k) ? LANE_U(h->key, k) : 0u, found = 8u;
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
}

// The rays one by one, each against the eight triangles at once, as in triangle.cl.
static inline void hit_packet_apart(const SceneData *scene, const uint packet, const WideRay16 *w, const Mask16 on, const bool any,
                                    Best16 *h) {
  const __global Packet8 *p = scene->packets + packet;
  uint hit = 0u;
  for (LANES_OF(k, on)) {
    const uint kz = LANE_I(w->last_x, k) ? 0u : LANE_I(w->last_y, k) ? 1u : 2u;
    const uint kx = kz == 2u ? 0u : kz + 1u, ky = kx == 2u ? 0u : kx + 1u;
    const __global float8 *v0 = (const __global float8 *)p->v0, *v1 = (const __global float8 *)p->v1,
                          *v2 = (const __global float8 *)p->v2;
    const float okx = LANE_F(w->okx, k), oky = LANE_F(w->oky, k), okz = LANE_F(w->okz, k);
    const float sx = LANE_F(w->sx, k), sy = LANE_F(w->sy, k);
    const float8 az = v0[kz] - okz, bz = v1[kz] - okz, cz = v2[kz] - okz;
    const float8 ax = (v0[kx] - okx) - sx * az, ay = (v0[ky] - oky) - sy * az;
    const float8 bx = (v1[kx] - okx) - sx * bz, by = (v1[ky] - oky) - sy * bz;
    const float8 cx = (v2[kx] - okx) - sx * cz, cy = (v2[ky] - oky) - sy * cz;
    const float8 u = difference_of_products8(cx, by, cy, bx);
    const float8 v = difference_of_products8(ax, cy, ay, cx);
    const float8 q = difference_of_products8(bx, ay, by, ax);
    const float8 low = MIN8(MIN8(u, v), q), high = MAX8(MAX8(u, v), q);
    const float8 det = u + v + q;
    const int8 inside = ((low >= 0.0f) | (high <= 0.0f)) & (det != 0.0f);
    if (!lane_mask(inside)) continue;
    const float8 inverse = 1.0f / det;
    const float8 b0 = u * inverse, b1 = v * inverse, b2 = q * inverse;
    const float8 t = (b0 * az + b1 * bz + b2 * cz) * LANE_F(w->sz, k);
    const float end = LANE_F(h->t, k);
    const uint mask = lane_mask(inside & (t > 0.0f) & (any ? t < end : t <= end));
    if (!mask) continue;
    if (any) hit |= 1u << k;
    else offer_lane16(mask, p, packet, k, t, b1, b2, h);
  }
  if (any && hit) h->found |= lanes_of_bits(hit);
}

static inline uint triangles_in(const __global Packet8 *p) {
  const uint8 primitive = *(const __global uint8 *)p->primitive;
  return CTZ(lane_mask(primitive == primitive.s7)) + 1u;
}

static inline void hit_packets16(const SceneData *scene, const uint word, const WideRay16 *w, const Mask16 on, const bool any,
                                 Best16 *h) {
  uint packet = word & LEAF_PACKET_MASK;
  for (uint n = (word >> LEAF_COUNT_SHIFT) & 3u; n; n--, packet++) {
    const __global Packet8 *p = scene->packets + packet;
    const uint count = triangles_in(p);
    if (3u * POPCOUNT(mask16(on)) < 2u * count) {
      hit_packet_apart(scene, packet, w, on, any, h);
      continue;
    }
    for (uint i = 0u; i < count; i++) hit_triangle16(p, i, 8u * packet + i, w, on, any, h);
  }
}

#if PENUMBRA_ROUND
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
static inline float16 sphere_distance16(const __global SphereData *sphere, const Ray16 *r) {
  const float radius = sphere->radius;
  const Pair16 x = two_sum16(r->o.x, -sphere->center[0]), y = two_sum16(r->o.y, -sphere->center[1]),
               z = two_sum16(r->o.z, -sphere->center[2]);
  const float16 a = r->d.x * r->d.x + r->d.y * r->d.y + r->d.z * r->d.z;
  Pair16 along = {0.0f, x.low * r->d.x + y.low * r->d.y + z.low * r->d.z};
  add_product16(&along, x.high, r->d.x);
  add_product16(&along, y.high, r->d.y);
  add_product16(&along, z.high, r->d.z);
  const float16 b = -(along.high + along.low);
  const float r2 = radius * radius;
  Pair16 outside = {-r2, FMA(-radius, radius, r2) + 2.0f * (x.high * x.low + y.high * y.low + z.high * z.low)};
  add_product16(&outside, x.high, x.high);
  add_product16(&outside, y.high, y.high);
  add_product16(&outside, z.high, z.high);
  const float16 c = outside.high + outside.low;
  const float16 k = b / a;
  const float16 lx = x.high + k * r->d.x, ly = y.high + k * r->d.y, lz = z.high + k * r->d.z;
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

static inline void hit_round16(const SceneData *scene, const uint word, const Ray16 *r, const Mask16 on, const bool any, Best16 *h) {
  const uint index = word & LEAF_ROUND_MASK;
  const float16 zero = 0.0f;
  offer16(on, sphere_distance16(scene->spheres + index, r), zero, zero, (PRIMITIVE_SPHERE << KEY_KIND_SHIFT) | index, NONE, any, h);
}
#endif

static inline void hit_leaf16(const SceneData *scene, const uint word, const Ray16 *r, const WideRay16 *w, const Mask16 on,
                              const bool any, Best16 *h) {
#if PENUMBRA_ROUND
  if (((word >> LEAF_TYPE_SHIFT) & 3u) == LEAF_ROUND) {
    hit_round16(scene, word, r, on, any, h);
    return;
  }
#endif
  hit_packets16(scene, word, w, on, any, h);
}

// Where the sixteen go next: a child word, and t at which one of them enters it.
typedef struct {
  ulong entries[LEVEL_STACK + 8u];
  uint size;
} Stack16;

// Keeps the entries from `bottom` on in order, the farthest first.
static inline void push_sorted16(Stack16 *stack, const uint bottom, const ulong entry) {
  uint at = stack->size++;
  for (; at > bottom && stack->entries[at - 1u] < entry; at--) stack->entries[at] = stack->entries[at - 1u];
  stack->entries[at] = entry;
}

// Leaves that a live ray meets are done at once; every other child waits on the stack, the nearer the later.
static inline void visit_node16(const SceneData *scene, const __global Node8 *node, const Ray16 *r, const WideRay16 *w, Mask16 *live, const bool any, Best16 *h, Stack16 *stack) {
  const uint bottom = stack->size;
  for (uint i = 0u; i < 8u; i++) {
    if (node->child[i] == NO_CHILD) continue;
    float16 enter;
    const Mask16 meets = meet_box16(node, i, w, h->t, &enter) & *live;
    const uint met = mask16(meets);
    if (!met) continue;
    if (node->child[i] & LEAF_FLAG) {
      hit_leaf16(scene, node->child[i], r, w, meets, any, h);
      if (any) *live &= ~h->found;
    } else push_sorted16(stack, bottom, stack_entry(node->child[i], LANE_F(enter, CTZ(met))));
  }
}

// The lanes of `on` only: what the others give means nothing.
static PENUMBRA_NOINLINE PENUMBRA_WIDE void traverse16(const SceneData *scene, const Ray16 *r, const Mask16 on, const bool any,
                                                       Best16 *h) {
  WideRay16 w;
  wide_ray16(r, &w);
  h->t = r->tmax;
  h->u = h->v = 0.0f;
  h->key = h->lane = NONE;
  h->found = 0;
  Mask16 live = on & w.is_ray;
  Stack16 stack;
  stack.size = 0u;
  uint word = scene->root;
  for (;;) {
    if (word & LEAF_FLAG) hit_leaf16(scene, word, r, &w, live, any, h);
    else visit_node16(scene, scene->nodes + word, r, &w, &live, any, h, &stack);
    if (any) {
      live &= ~h->found;
      if (!any16(live)) return;
    }
    if (!stack.size) return;
    word = (uint)stack.entries[--stack.size];
  }
}

// The first hit of each ray, of kind NONE where there is none; the lanes of `on` that have one.
static inline Mask16 intersect16(const SceneData *scene, const bool together, const Ray16 *ray, const Mask16 on, Hit16 *hit) {
  if (!together) {
    Mask16 found = 0;
    for (LANES_OF(k, on)) {
      Hit one;
      LANE_I(found, k) = intersect(scene, lane_ray(ray, k), &one) ? -1 : 0;
      set_lane_hit(hit, k, one);
    }
    return found;
  }
  Best16 best;
  traverse16(scene, ray, on, false, &best);
  hit->t = best.t;
  hit->u = best.u;
  hit->v = best.v;
  hit->kind = best.found ? best.key >> KEY_KIND_SHIFT : (uint16)(NONE);
  hit->primitive = best.key & ((1u << KEY_KIND_SHIFT) - 1u);
  hit->instance = NONE;
  hit->lane = best.lane;
  return best.found;
}

// The lanes of `on` whose ray meets anything before its end.
static inline Mask16 occluded16(const SceneData *scene, const bool together, const Ray16 *ray, const Mask16 on) {
  if (!together) {
    Mask16 found = 0;
    for (LANES_OF(k, on)) LANE_I(found, k) = occluded(scene, lane_ray(ray, k)) ? -1 : 0;
    return found;
  }
  Best16 best;
  traverse16(scene, ray, on, true, &best);
  return best.found;
}
