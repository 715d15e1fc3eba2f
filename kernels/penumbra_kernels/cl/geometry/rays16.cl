// Sixteen rays at once through a small tree, one box or primitive after the other: where all of them are near everything, no ray
// waits for its own branches. Each ray meets what traverse.cl finds for it, bit for bit. An instance is a leaf of the world's tree:
// the rays that meet it go on in its own tree, each in the frame that the instance has at its time. Metres, seconds.
#include "base/types16.h"
#include "geometry/intersect.cl"
#if PENUMBRA_INSTANCING
#include "geometry/motion16.cl"
#endif

// The first hit of each ray. Equal t are decided by the key, kind and primitive, then by the instance; both mean nothing where
// `found` is not.
typedef struct {
  float16 t, u, v;
  uint16 key, lane;
#if PENUMBRA_INSTANCING
  uint16 instance;
#endif
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

// Sixteen rays in the frame of the tree that they are in: the world's, or an instance's.
typedef struct {
  const Vec16 *o, *d;
  const WideRay16 *wide;
  const float16 *time;
  uint instance;  // or NONE
} Rays16;

// Of x, y, z the one along the axis, the next and the one after it.
#define ALONG(w, x, y, z) ((w)->last_x ? (x) : (w)->last_y ? (y) : (z))
#define NEXT(w, x, y, z) ((w)->last_x ? (y) : (w)->last_y ? (z) : (x))
#define AFTER(w, x, y, z) ((w)->last_x ? (z) : (w)->last_y ? (x) : (y))

static inline void wide_ray16(const Vec16 *o, const Vec16 *d, WideRay16 *w) {
  const float16 ax = abs16(d->x), ay = abs16(d->y), az = abs16(d->z);
  const float16 largest = MAX16(MAX16(ax, ay), az);
  const float16 reach = MAX16(MAX16(abs16(o->x), abs16(o->y)), abs16(o->z));
  w->is_ray = (largest >= 0x1p-126f) & is_finite16(ax + ay + az) & is_finite16(o->x + o->y + o->z + reach);
  const float16 rx = 1.0f / d->x, ry = 1.0f / d->y, rz = 1.0f / d->z;
  const float16 e = BOX_SLACK * reach;
  const float16 ex = copy_sign16(e, rx), ey = copy_sign16(e, ry), ez = copy_sign16(e, rz);
  w->back_x = as_int16(rx) < 0;
  w->back_y = as_int16(ry) < 0;
  w->back_z = as_int16(rz) < 0;
  w->near_ox = o->x + ex;
  w->near_oy = o->y + ey;
  w->near_oz = o->z + ez;
  w->far_ox = o->x - ex;
  w->far_oy = o->y - ey;
  w->far_oz = o->z - ez;
  w->near_rx = rx;
  w->near_ry = ry;
  w->near_rz = rz;
  w->far_rx = rx * FAR_FACTOR;
  w->far_ry = ry * FAR_FACTOR;
  w->far_rz = rz * FAR_FACTOR;
  w->last_x = (ax > ay) & (ax > az);
  w->last_y = !(ax > ay) & (ay > az);
  w->okx = NEXT(w, o->x, o->y, o->z);
  w->oky = AFTER(w, o->x, o->y, o->z);
  w->okz = ALONG(w, o->x, o->y, o->z);
  w->sz = ALONG(w, rx, ry, rz);
  w->sx = NEXT(w, d->x, d->y, d->z) * w->sz;
  w->sy = AFTER(w, d->x, d->y, d->z) * w->sz;
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
                           const uint instance, const bool any, Best16 *h) {
  Mask16 wins = on & (t > 0.0f);
  if (any) {
    h->found |= wins & (t < h->t);
    return;
  }
  Mask16 first = h->key > key;
#if PENUMBRA_INSTANCING
  first |= (h->key == key) & (h->instance > instance);
#endif
  wins &= (t < h->t) | ((t == h->t) & h->found & first);
  h->t = wins ? t : h->t;
  h->u = wins ? u : h->u;
  h->v = wins ? v : h->v;
  h->key = wins ? (uint16)key : h->key;
  h->lane = wins ? (uint16)lane : h->lane;
#if PENUMBRA_INSTANCING
  h->instance = wins ? (uint16)instance : h->instance;
#endif
  h->found |= wins;
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

// The vertices of a packet along the axes that ray k has last, as load_triangles gives them.
static inline void load_triangles_of(const __global Packet8 *packet, const WideRay16 *w, const uint k, EightTriangles *e) {
  const uint kz = LANE_I(w->last_x, k) ? 0u : LANE_I(w->last_y, k) ? 1u : 2u;
  const uint kx = kz == 2u ? 0u : kz + 1u, ky = kx == 2u ? 0u : kx + 1u;
  const __global float8 *p = (const __global float8 *)packet;
  e->ax = p[kx];
  e->ay = p[ky];
  e->az = p[kz];
  e->bx = p[3u + kx];
  e->by = p[3u + ky];
  e->bz = p[3u + kz];
  e->cx = p[6u + kx];
  e->cy = p[6u + ky];
  e->cz = p[6u + kz];
}

// Ray k against eight triangles at once, as in triangle.cl. Where any hit will do, whether there is one; else it goes into h.
static inline bool hit_triangles_of(const EightTriangles *e, const SceneData *scene, const uint packet, const Rays16 *r,
                                    const uint k, const bool any, Best16 *h) {
  const WideRay16 *w = r->wide;
  const float okx = LANE_F(w->okx, k), oky = LANE_F(w->oky, k), okz = LANE_F(w->okz, k);
  const float sx = LANE_F(w->sx, k), sy = LANE_F(w->sy, k);
  const float8 az = e->az - okz, bz = e->bz - okz, cz = e->cz - okz;
  const float8 ax = (e->ax - okx) - sx * az, ay = (e->ay - oky) - sy * az;
  const float8 bx = (e->bx - okx) - sx * bz, by = (e->by - oky) - sy * bz;
  const float8 cx = (e->cx - okx) - sx * cz, cy = (e->cy - oky) - sy * cz;
  const float8 u = difference_of_products8(cx, by, cy, bx);
  const float8 v = difference_of_products8(ax, cy, ay, cx);
  const float8 q = difference_of_products8(bx, ay, by, ax);
  const float8 low = MIN8(MIN8(u, v), q), high = MAX8(MAX8(u, v), q);
  const float8 det = u + v + q;
  const int8 inside = ((low >= 0.0f) | (high <= 0.0f)) & (det != 0.0f);
  if (!lane_mask(inside)) return false;
  const float8 inverse = 1.0f / det;
  const float8 b0 = u * inverse, b1 = v * inverse, b2 = q * inverse;
  const float8 t = (b0 * az + b1 * bz + b2 * cz) * LANE_F(w->sz, k);
  const float end = LANE_F(h->t, k);
  const uint mask = lane_mask(inside & (t > 0.0f) & (any ? t < end : t <= end));
  if (mask && !any) offer_lane16(mask, scene->packets + packet, packet, r->instance, k, t, b1, b2, h);
  return mask != 0u;
}

// The rays one by one.
static inline void hit_packet_apart(const SceneData *scene, const uint packet, const Rays16 *r, const Mask16 on, const bool any,
                                    Best16 *h) {
  uint hit = 0u;
  for (LANES_OF(k, on)) {
    EightTriangles e;
    load_triangles_of(scene->packets + packet, r->wide, k, &e);
    hit |= (hit_triangles_of(&e, scene, packet, r, k, any, h) ? 1u : 0u) << k;
  }
  if (any && hit) h->found |= lanes_of_bits(hit);
}

#if PENUMBRA_DEFORMATION
// Each ray meets the triangles where they are at its time.
static PENUMBRA_NOINLINE PENUMBRA_WIDE void hit_deforming16(const SceneData *scene, const uint word, const Rays16 *r,
                                                            const Mask16 *on, const bool any, Best16 *h) {
  const uint first = word & LEAF_PACKET_MASK;
  const __global Packet8 *packet = scene->packets + first;
  const __global ShapeData *shape = scene->shapes + scene->triangles[packet->primitive[0]].shape;
  uint hit = 0u;
  for (LANES_OF(k, *on)) {
    const DeformTime at = deform_time(scene, shape, LANE_F(*r->time, k));
    EightTriangles a, b;
    load_triangles_of(packet + at.first, r->wide, k, &a);
    load_triangles_of(packet + at.first + 1u, r->wide, k, &b);
    deform_triangles(at.fraction, &b, &a);
    hit |= (hit_triangles_of(&a, scene, first, r, k, any, h) ? 1u : 0u) << k;
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

static inline void hit_round16(const SceneData *scene, const uint word, const Rays16 *r, const Mask16 on, const bool any,
                               Best16 *h) {
  const uint index = word & LEAF_ROUND_MASK;
  const bool is_disc = (word >> LEAF_DISC_SHIFT) & 1u;
  float16 a = 0.0f, b = 0.0f;
  const float16 t = is_disc ? disc_distance16(scene->discs + index, r->o, r->d, &a, &b)
                            : sphere_distance16(scene->spheres + index, r->o, r->d);
  const uint kind = is_disc ? PRIMITIVE_DISC : PRIMITIVE_SPHERE;
  offer16(on, t, a, b, (kind << KEY_KIND_SHIFT) | index, NONE, r->instance, any, h);
}

// hit_planes of each ray. Moving planes stand elsewhere for each.
static inline void hit_planes16(const SceneData *scene, const Ray16 *ray, const Mask16 on, const bool any, Best16 *h) {
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
    offer16(on & (t < INF_F), t, zero, zero, (PRIMITIVE_PLANE << KEY_KIND_SHIFT) | i, NONE, NONE, any, h);
  }
}
#endif

// A leaf that is not an instance.
static inline void hit_leaf16(const SceneData *scene, const uint word, const Rays16 *r, const Mask16 on, const bool any,
                              Best16 *h) {
#if PENUMBRA_ROUND || PENUMBRA_DEFORMATION
  const uint type = (word >> LEAF_TYPE_SHIFT) & 3u;
#endif
#if PENUMBRA_ROUND
  if (type == LEAF_ROUND) {
    hit_round16(scene, word, r, on, any, h);
    return;
  }
#endif
#if PENUMBRA_DEFORMATION
  if (type == LEAF_DEFORMING) {
    hit_deforming16(scene, word, r, &on, any, h);
    return;
  }
#endif
  hit_packets16(scene, word, r, on, any, h);
}

#define CHILDREN 8u
#if PENUMBRA_INSTANCING
#define STACK_SIZE16 (2u * (LEVEL_STACK + CHILDREN) + 1u)
#else
#define STACK_SIZE16 (LEVEL_STACK + CHILDREN)
#endif

// Where the sixteen go next: a child word, and t at which one of them enters it; the rays that meet it.
typedef struct {
  ulong entries[STACK_SIZE16];
  uint met[STACK_SIZE16];
  uint size;
} Stack16;

// Keeps the entries from `bottom` on in order, the farthest first.
static inline void push_sorted16(Stack16 *stack, const uint bottom, const ulong entry, const uint met) {
  uint at = stack->size++;
  for (; at > bottom && stack->entries[at - 1u] < entry; at--) {
    stack->entries[at] = stack->entries[at - 1u];
    stack->met[at] = stack->met[at - 1u];
  }
  stack->entries[at] = entry;
  stack->met[at] = met;
}

static inline bool is_instance(const uint word) {
#if PENUMBRA_INSTANCING
  return ((word >> LEAF_TYPE_SHIFT) & 3u) == LEAF_INSTANCE;
#else
  return false;
#endif
}

// Leaves that a live ray meets are done at once; every other child waits on the stack, the nearer the later.
static inline void visit_node16(const SceneData *scene, const __global Node8 *node, const Rays16 *r, Mask16 live, const bool any,
                                Best16 *h, Stack16 *stack) {
  const uint bottom = stack->size;
  for (uint i = 0u; i < CHILDREN; i++) {
    const uint word = node->child[i];
    if (word == NO_CHILD) continue;
    float16 enter;
    const Mask16 meets = meet_box16(node, i, r->wide, h->t, &enter) & live;
    const uint met = mask16(meets);
    if (!met) continue;
    if ((word & LEAF_FLAG) && !is_instance(word)) {
      hit_leaf16(scene, word, r, meets, any, h);
      if (any) live &= ~h->found;
    } else push_sorted16(stack, bottom, stack_entry(word, LANE_F(enter, CTZ(met))), met);
  }
}

#if PENUMBRA_MOTION
// meets_moving of the lanes of `on`. w: the rays in the world.
static inline Mask16 meets_moving16(const SceneData *scene, const __global Instance *instance, const float16 time,
                                    const WideRay16 *w, const float16 end, const Mask16 on) {
  const bool outer = instance->keyframe_count > 0u;
  const uint first = outer ? instance->first_keyframe : instance->inner_first_keyframe;
  const uint count = outer ? instance->keyframe_count : instance->inner_keyframe_count;
  if (count < 2u) return on;
  const float begin = scene->keyframes[first].time;
  const float16 part = (time - begin) * ((float)MOTION_BOXES / (scene->keyframes[first + count - 1u].time - begin));
  const float16 zero = 0.0f, last = (float)(MOTION_BOXES - 1u);
  const float16 box = part > 0.0f ? MIN16(part, last) : zero;
  const __global float *node = (const __global float *)(scene->nodes + instance->motion_node);
  const uint16 at = as_uint16(to_int16(box));
  const uint16 x = at + as_uint16(w->back_x & 8), y = at + as_uint16(w->back_y & 8), z = at + as_uint16(w->back_z & 8);
  const float16 nx = (gather16(node, x, on) - w->near_ox) * w->near_rx;
  const float16 ny = (gather16(node + 16, y, on) - w->near_oy) * w->near_ry;
  const float16 nz = (gather16(node + 32, z, on) - w->near_oz) * w->near_rz;
  const float16 fx = (gather16(node, x ^ 8u, on) - w->far_ox) * w->far_rx;
  const float16 fy = (gather16(node + 16, y ^ 8u, on) - w->far_oy) * w->far_ry;
  const float16 fz = (gather16(node + 32, z ^ 8u, on) - w->far_oz) * w->far_rz;
  const float16 enter = MAX16(nx, MAX16(ny, MAX16(nz, zero)));
  return on & (enter <= MIN16(fx, MIN16(fy, MIN16(fz, end))));
}
#endif

#if PENUMBRA_INSTANCING
// Rays in an instance's frame.
typedef struct {
  Vec16 o, d;
  WideRay16 wide;
} InsideRays16;

// enter_instance of the lanes of `on`: those that go on in the instance's tree. world: the rays there; end: how far they go.
static PENUMBRA_NOINLINE PENUMBRA_WIDE void enter_instance16(const SceneData *scene, const uint index, const Ray16 *ray,
                                                             const WideRay16 *world, const float16 *end, Mask16 *on,
                                                             InsideRays16 *inside) {
#if PENUMBRA_MOTION
  if (!any16(*on)) return;
  *on = meets_moving16(scene, scene->instances + index, ray->time, world, *end, *on);
#endif
  if (!any16(*on)) return;
  Placement16 at;
  instance_matrices16(scene, index, ray->time, *on, &at);
  inside->o = transform_point16(&at.object_from_world, ray->o);
  inside->d = transform_vector16(&at.object_from_world, ray->d);
  wide_ray16(&inside->o, &inside->d, &inside->wide);
  *on &= inside->wide.is_ray;
}
#endif

// The lanes of `on` only: what the others give means nothing.
static PENUMBRA_NOINLINE PENUMBRA_WIDE void traverse16(const SceneData *scene, const Ray16 *ray, const Mask16 on, const bool any,
                                                       Best16 *h) {
  h->t = ray->tmax;
  h->u = h->v = 0.0f;
  h->key = h->lane = NONE;
#if PENUMBRA_INSTANCING
  h->instance = NONE;
  InsideRays16 inside;
#endif
  h->found = 0;
#if PENUMBRA_ROUND
  hit_planes16(scene, ray, on, any, h);
#endif
  WideRay16 world;
  wide_ray16(&ray->o, &ray->d, &world);
  Rays16 rays = {&ray->o, &ray->d, &world, &ray->time, NONE};
  Stack16 stack;
  stack.size = 0u;
  uint word = scene->root;
  Mask16 met = on & world.is_ray;
  for (;;) {
    if (any) met &= ~h->found;
#if PENUMBRA_INSTANCING
    if (word == BACK_TO_WORLD) {
      rays.o = &ray->o;
      rays.d = &ray->d;
      rays.wide = &world;
      rays.instance = NONE;
    } else if ((word & LEAF_FLAG) && is_instance(word)) {
      const uint index = word & LEAF_INSTANCE_MASK;
      enter_instance16(scene, index, ray, &world, &h->t, &met, &inside);
      if (any16(met)) {
        // Where nothing waits in the world there is no way back.
        if (stack.size) stack.entries[stack.size++] = stack_entry(BACK_TO_WORLD, 0.0f);
        rays.o = &inside.o;
        rays.d = &inside.d;
        rays.wide = &inside.wide;
        rays.instance = index;
        word = scene->instances[index].root;
        continue;
      }
    } else
#endif
    if (any16(met)) {
      if (word & LEAF_FLAG) hit_leaf16(scene, word, &rays, met, any, h);
      else visit_node16(scene, scene->nodes + word, &rays, met, any, h, &stack);
    }
    if (!stack.size) return;
    word = (uint)stack.entries[--stack.size];
    met = lanes_of_bits(stack.met[stack.size]);
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
#if PENUMBRA_INSTANCING
  hit->instance = best.instance;
#else
  hit->instance = NONE;
#endif
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
