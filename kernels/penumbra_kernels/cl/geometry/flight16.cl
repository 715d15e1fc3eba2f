// Rays in flight through a large tree, each on its own way: in a round every ray takes one step, visits a node or meets the
// triangles of a leaf, so that the others work while one waits for memory. Steps have no branches that a processor would guess
// wrong: children are sorted by a network, triangles met to the end. Each ray meets what traverse.cl finds for it, bit for bit, as
// the order of visits never shows (hit_beats). Metres, seconds.
#include "geometry/intersect.cl"
#include "geometry/triangle16.cl"

#define FLIGHT_STACK (STACK_SIZE + 8u)  // a visit writes eight children, those that are met first
#define FLIGHT_WINGS 4u                 // more vectors fly one after the other
#define FLYING (FLIGHT_WINGS * LANES)
#define FLIGHT_PACKETS (2u * FLYING + 1u)  // accel/wide.py makes no leaf of more than two

#if PENUMBRA_BUILTINS
typedef int8 LooseInt8 __attribute__((aligned(4)));
static inline void store8(const int8 v, int *to) { *(LooseInt8 *)to = v; }
#else
static inline void store8(const int8 v, int *to) { vstore8(v, 0, to); }
#endif

// In lane i the child whose number is key[i] mod 8.
#if PENUMBRA_X86 && defined(__AVX2__)
static inline int8 pick8(const __global uint *child, const int8 key) {
  return __builtin_ia32_permvarsi256(*(const __global int8 *)child, key);
}
#else
static inline int8 pick8(const __global uint *child, const int8 key) {
  int8 out;
  for (uint i = 0u; i < 8u; i++) ((int *)&out)[i] = (int)child[((const int *)&key)[i] & 7];
  return out;
}
#endif

// Each lane and its partner: the larger where `first`, the smaller in the other.
static inline int8 in_order8(const int8 v, const int8 partner, const int8 first) { return first ? MAX8(v, partner) : MIN8(v, partner); }

// The largest first (Batcher 1968, "Sorting Networks and Their Applications": bitonic merges).
static inline int8 sort8(int8 v) {
  const int8 of_two = (int8)(-1, 0, -1, 0, -1, 0, -1, 0), of_four = (int8)(-1, -1, 0, 0, -1, -1, 0, 0);
  const int8 of_eight = (int8)(-1, -1, -1, -1, 0, 0, 0, 0);
  v = in_order8(v, v.s10325476, of_two);
  v = in_order8(v, v.s32107654, of_four);
  v = in_order8(v, v.s10325476, of_two);
  v = in_order8(v, v.s76543210, of_eight);
  v = in_order8(v, v.s23016745, of_four);
  return in_order8(v, v.s10325476, of_two);
}

// The near and far planes of each ray's boxes, as in WideRay.
typedef struct {
  float16 near_ox, near_oy, near_oz, far_ox, far_oy, far_oz;
  float16 near_rx, near_ry, near_rz, far_rx, far_ry, far_rz;
  uint16 near_x, near_y, near_z;
} Slabs16;

static inline void slabs16(const WideRay16 *w, Slabs16 *s) {
  const Mask16 back_x = as_int16(w->rx) < 0, back_y = as_int16(w->ry) < 0, back_z = as_int16(w->rz) < 0;
  s->near_ox = back_x ? w->hi_ox : w->lo_ox;
  s->near_oy = back_y ? w->hi_oy : w->lo_oy;
  s->near_oz = back_z ? w->hi_oz : w->lo_oz;
  s->far_ox = back_x ? w->lo_ox : w->hi_ox;
  s->far_oy = back_y ? w->lo_oy : w->hi_oy;
  s->far_oz = back_z ? w->lo_oz : w->hi_oz;
  s->near_rx = w->rx;
  s->near_ry = w->ry;
  s->near_rz = w->rz;
  s->far_rx = w->rx * FAR_FACTOR;
  s->far_ry = w->ry * FAR_FACTOR;
  s->far_rz = w->rz * FAR_FACTOR;
  s->near_x = as_uint16(back_x & 8);
  s->near_y = as_uint16(16 + (back_y & 8));
  s->near_z = as_uint16(32 + (back_z & 8));
}

// Where each ray is: ray k is lane k % LANES of wing k / LANES. Children wait under keys: t at which the ray enters, its last three bits
// replaced by the child's number.
typedef struct {
  WideRay16 wide[FLIGHT_WINGS];  // in the frame of the tree that the ray is in, of what triangles ask for
  Slabs16 slabs[FLIGHT_WINGS];
#if PENUMBRA_ROUND || PENUMBRA_INSTANCING
  Vec16 o[FLIGHT_WINGS], d[FLIGHT_WINGS];
#endif
  uint instance[FLYING];
  Hit best[FLYING];
  uint word[FLYING];  // where it goes in this round
  uint size[FLYING];
  int keys[FLYING][FLIGHT_STACK];
  uint words[FLYING][FLIGHT_STACK];
} Flight;

// Ray k behind `count` others, or not: without a branch. How many there are then.
static inline uint add_ray(uint *rays, const uint count, const uint k, const bool in) {
  rays[count] = k;
  return count + (in ? 1u : 0u);
}

static inline void push_child(Flight *f, const uint k, const int key, const uint word) {
  f->keys[k][f->size[k]] = key;
  f->words[k][f->size[k]++] = word;
}

// Ray k as wide_ray prepares it: for triangles, and all of it.
static inline RayAxes flying_axes(const Flight *f, const uint k) { return lane_axes(f->wide + k / LANES, k % LANES); }

static inline WideRay flying_ray(const Flight *f, const uint ray) {
  const uint wing = ray / LANES, k = ray % LANES;
  const Slabs16 *s = f->slabs + wing;
  WideRay out;
  out.near_ox = LANE_F(s->near_ox, k);
  out.near_oy = LANE_F(s->near_oy, k);
  out.near_oz = LANE_F(s->near_oz, k);
  out.far_ox = LANE_F(s->far_ox, k);
  out.far_oy = LANE_F(s->far_oy, k);
  out.far_oz = LANE_F(s->far_oz, k);
  out.near_rx = LANE_F(s->near_rx, k);
  out.near_ry = LANE_F(s->near_ry, k);
  out.near_rz = LANE_F(s->near_rz, k);
  out.far_rx = LANE_F(s->far_rx, k);
  out.far_ry = LANE_F(s->far_ry, k);
  out.far_rz = LANE_F(s->far_rz, k);
  out.near_x = LANE_U(s->near_x, k);
  out.near_y = LANE_U(s->near_y, k);
  out.near_z = LANE_U(s->near_z, k);
  out.axes = flying_axes(f, ray);
#if PENUMBRA_ROUND || PENUMBRA_INSTANCING
  out.o = lane3(f->o + wing, k);
  out.d = lane3(f->d + wing, k);
#endif
  return out;
}

// The children that ray k meets onto its stack, the nearer the later.
static inline void step_to_node(const SceneData *scene, Flight *f, const uint k) {
  const __global Node8 *node = scene->nodes + f->word[k];
  const WideRay w[1] = {flying_ray(f, k)};
  const int8 number = (int8)(0, 1, 2, 3, 4, 5, 6, 7), none = -1;
  float8 enter;
  const int8 meets = meet_boxes(node, w, f->best[k].t, &enter);
  const int8 keys = sort8(meets ? (as_int8(enter) & ~7) | number : none);
  store8(keys, f->keys[k] + f->size[k]);
  store8(pick8(node->child, keys), (int *)f->words[k] + f->size[k]);
  f->size[k] += POPCOUNT(lane_mask(meets));
}

// Takes the next child that ray k enters no later than its best hit; false where nothing waits any more.
static inline bool next_child(Flight *f, const uint k) {
  const int end = as_int(f->best[k].t) | 7;
  uint size = f->size[k];
  bool near = false;
  while (size && !near) near = f->keys[k][--size] <= end;
  f->size[k] = size;
  f->word[k] = f->words[k][size];
  return near;
}

// Ray k has met something: where any hit will do it ends.
static inline void end_ray(Flight *f, const uint k) {
  f->best[k].kind = PRIMITIVE_TRIANGLE;
  f->size[k] = 0u;
}

#if PENUMBRA_INSTANCING
static inline Ray flying_from(const Wing16 *wings, const uint k) { return lane_ray(wings[k / LANES].rays, k % LANES); }

// Ray k goes on in another frame.
static inline void set_frame(Flight *f, const uint ray, const WideRay *w, const uint instance) {
  const uint wing = ray / LANES, k = ray % LANES;
  Slabs16 *slabs = f->slabs + wing;
  WideRay16 *to = f->wide + wing;
  LANE_F(slabs->near_ox, k) = w->near_ox.s0;
  LANE_F(slabs->near_oy, k) = w->near_oy.s0;
  LANE_F(slabs->near_oz, k) = w->near_oz.s0;
  LANE_F(slabs->far_ox, k) = w->far_ox.s0;
  LANE_F(slabs->far_oy, k) = w->far_oy.s0;
  LANE_F(slabs->far_oz, k) = w->far_oz.s0;
  LANE_F(slabs->near_rx, k) = w->near_rx.s0;
  LANE_F(slabs->near_ry, k) = w->near_ry.s0;
  LANE_F(slabs->near_rz, k) = w->near_rz.s0;
  LANE_F(slabs->far_rx, k) = w->far_rx.s0;
  LANE_F(slabs->far_ry, k) = w->far_ry.s0;
  LANE_F(slabs->far_rz, k) = w->far_rz.s0;
  LANE_U(slabs->near_x, k) = w->near_x;
  LANE_U(slabs->near_y, k) = w->near_y;
  LANE_U(slabs->near_z, k) = w->near_z;
  LANE_U(to->kx, k) = w->axes.kx;
  LANE_U(to->ky, k) = w->axes.ky;
  LANE_U(to->kz, k) = w->axes.kz;
  LANE_F(to->okx, k) = w->axes.ox.s0;
  LANE_F(to->oky, k) = w->axes.oy.s0;
  LANE_F(to->okz, k) = w->axes.oz.s0;
  LANE_F(to->sx, k) = w->axes.sx.s0;
  LANE_F(to->sy, k) = w->axes.sy.s0;
  LANE_F(to->sz, k) = w->axes.sz.s0;
  set_lane3(f->o + wing, k, w->o);
  set_lane3(f->d + wing, k, w->d);
  f->instance[ray] = instance;
}

// Ray k, in the world, meets an instance.
static inline void step_into(const SceneData *scene, const Wing16 *wings, Flight *f, const uint k) {
  const uint index = f->word[k] & LEAF_INSTANCE_MASK;
  const Ray ray = flying_from(wings, k);
  const WideRay world = flying_ray(f, k);
  WideRay inside;
  if (!enter_instance(scene, index, &ray, &world, f->best[k].t, &inside)) return;
  // Where nothing waits in the world there is no way back.
  if (f->size[k]) push_child(f, k, 0, BACK_TO_WORLD);
  push_child(f, k, 0, scene->instances[index].root);
  set_frame(f, k, &inside, index);
}

static inline void step_back(const Wing16 *wings, Flight *f, const uint k) {
  const Ray ray = flying_from(wings, k);
  WideRay world;
  wide_ray(ray.o, ray.d, &world);
  set_frame(f, k, &world, NONE);
}
#endif

// What is no leaf of triangles that stand still, ray by ray; whether it was that.
static inline bool step_to_other(const SceneData *scene, const Wing16 *wings, Flight *f, const uint k, const bool any) {
#if PENUMBRA_ROUND || PENUMBRA_DEFORMATION || PENUMBRA_INSTANCING
  const uint word = f->word[k], type = (word >> LEAF_TYPE_SHIFT) & 3u;
  if (type == LEAF_TRIANGLES) return false;
#if PENUMBRA_INSTANCING
  if (word == BACK_TO_WORLD) {
    step_back(wings, f, k);
    return true;
  }
  if (type == LEAF_INSTANCE) {
    step_into(scene, wings, f, k);
    return true;
  }
#endif
  const WideRay w = flying_ray(f, k);
  if (hit_leaf(scene, word, &w, LANE_F(wings[k / LANES].rays->time, k % LANES), f->instance[k], any, f->best + k) && any) end_ray(f, k);
  return true;
#else
  return false;
#endif
}

// Packets that rays meet in a round, and the triangles that they hit.
typedef struct {
  uint lane[FLIGHT_PACKETS], packet[FLIGHT_PACKETS];
  float8 t[FLIGHT_PACKETS], u[FLIGHT_PACKETS], v[FLIGHT_PACKETS];
  uint mask[FLIGHT_PACKETS], of[FLIGHT_PACKETS];
} Meetings;

// The packets of a leaf behind `count` others; how many there are then.
static inline uint add_packets(Meetings *m, uint count, const uint k, const uint word) {
  const uint packets = (word >> LEAF_COUNT_SHIFT) & 3u, first = word & LEAF_PACKET_MASK;
  m->packet[count] = first;
  count = add_ray(m->lane, count, k, packets > 0u);
  m->packet[count] = first + 1u;
  return add_ray(m->lane, count, k, packets > 1u);
}

// How many of them are hit.
static inline uint meet_packets(const SceneData *scene, const Flight *f, const bool any, const uint count, Meetings *m) {
  uint hits = 0u;
  for (uint i = 0u; i < count; i++) {
    const uint k = m->lane[i];
    const RayAxes axes = flying_axes(f, k);
    EightTriangles e;
    load_triangles(scene->packets + m->packet[i], &axes, &e);
    const uint mask = meet_triangles(&e, &axes, f->best[k].t, any, false, m->t + hits, m->u + hits, m->v + hits);
    m->mask[hits] = mask;
    hits = add_ray(m->of, hits, i, mask != 0u);
  }
  return hits;
}

// Offers what was hit, in the order of packets.
static inline void take_hits(const SceneData *scene, const bool any, const uint hits, const Meetings *m, Flight *f) {
  for (uint n = 0u; n < hits; n++) {
    const uint k = m->lane[m->of[n]], packet = m->packet[m->of[n]];
    if (any) end_ray(f, k);
    else offer_triangles(m->mask[n], scene, packet, f->instance[k], m->t + n, m->u + n, m->v + n, f->best + k);
  }
}

// One round: where every ray that still flies goes, and its step there. How many fly on.
static inline uint fly_on(const SceneData *scene, const Wing16 *wings, const bool any, const uint count, uint *flying, Flight *f) {
  uint to_nodes[FLYING + 1u], to_leaves[FLYING + 1u];
  Meetings m;
  uint left = 0u, nodes = 0u, leaves = 0u, packets = 0u;
  for (uint i = 0u; i < count; i++) {
    const uint k = flying[i];
    if (!next_child(f, k)) continue;
    const uint word = f->word[k];
    prefetch_child(scene, word);
    left = add_ray(flying, left, k, true);
    nodes = add_ray(to_nodes, nodes, k, !(word & LEAF_FLAG));
    leaves = add_ray(to_leaves, leaves, k, (word & LEAF_FLAG) != 0u);
  }
  for (uint i = 0u; i < nodes; i++) step_to_node(scene, f, to_nodes[i]);
  for (uint i = 0u; i < leaves; i++) {
    const uint k = to_leaves[i];
    if (!step_to_other(scene, wings, f, k, any)) packets = add_packets(&m, packets, k, f->word[k]);
  }
  take_hits(scene, any, meet_packets(scene, f, any, packets, &m), &m, f);
  return left;
}

// The rays of a wing at the tree's root, behind `count` others that fly. How many there are then.
static inline uint take_off(const SceneData *scene, const Wing16 *w, const uint wing, const bool any, uint count, uint *flying,
                            Flight *f) {
  WideRay16 *wide = f->wide + wing;
  wide_ray16(&w->rays->o, &w->rays->d, wide);
  slabs16(wide, f->slabs + wing);
#if PENUMBRA_ROUND || PENUMBRA_INSTANCING
  f->o[wing] = w->rays->o;
  f->d[wing] = w->rays->d;
#endif
  for (LANES_OF(k, w->on)) {
    const uint ray = wing * LANES + k;
    f->best[ray] = no_hit(LANE_F(w->rays->tmax, k));
    f->instance[ray] = NONE;
    f->size[ray] = 0u;
    push_child(f, ray, 0, scene->root);
#if PENUMBRA_ROUND
    const Ray one = lane_ray(w->rays, k);
    if (hit_planes(scene, &one, any, f->best + ray) && any) end_ray(f, ray);
#endif
    count = add_ray(flying, count, ray, LANE_I(wide->is_ray, k) != 0);
  }
  return count;
}

static inline void land(const Flight *f, const uint wing, const bool any, Wing16 *w) {
  w->found = 0;
  for (LANES_OF(k, w->on)) {
    const Hit *best = f->best + wing * LANES + k;
    LANE_I(w->found, k) = best->kind != NONE ? -1 : 0;
    if (!any) set_lane_hit(&w->hit, k, *best);
  }
}

// All rays of the wings that are on: what each meets first, or whether it meets anything.
static PENUMBRA_NOINLINE PENUMBRA_WIDE void fly16(const SceneData *scene, Wing16 *wings, const uint count, const bool any) {
  Flight f[1];
  uint flying[FLYING + 1u];
  for (uint first = 0u; first < count; first += FLIGHT_WINGS) {
    const uint last = MIN(first + FLIGHT_WINGS, count);
    uint left = 0u;
    for (uint w = first; w < last; w++) left = take_off(scene, wings + w, w - first, any, left, flying, f);
    while (left) left = fly_on(scene, wings + first, any, left, flying, f);
    for (uint w = first; w < last; w++) land(f, w - first, any, wings + w);
  }
}
