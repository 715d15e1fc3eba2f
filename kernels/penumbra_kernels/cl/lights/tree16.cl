// The light tree (lights/tree.cl) for sixteen receivers, each with the bits of the scalar functions: child by child, every lane at
// its own node.
#include "base/types16.h"
#include "lights/tree.cl"

#define CHILDREN 8u
// Lanes from which on all walk together. Measured with 200 and 2,000 lamps: six take the same time either way, sixteen 0.39 of it.
#define LEAST_WALKERS 6u

// LightNode of each lane, field by field.
typedef struct {
  float16 x[CHILDREN], y[CHILDREN], z[CHILDREN], radius[CHILDREN];
  float16 axis_x[CHILDREN], axis_y[CHILDREN], axis_z[CHILDREN];
  float16 cos_spread[CHILDREN], sin_spread[CHILDREN], cos_falloff[CHILDREN], strength[CHILDREN];
  uint16 child[CHILDREN], count[CHILDREN];
} LightNode16;

// Whether any lane's node has a child number c: nodes fill from the first one on, and those at the bottom are seldom full.
static inline bool has_child16(const LightNode16 *nodes, const uint c, const Mask16 on) {
  return any16(on & (nodes->count[c] != 0u));
}

// Fields of children that no lane's node has are left out, but for their counts.
static inline void load_nodes16(const SceneData *scene, const uint16 word, const Mask16 on, LightNode16 *nodes) {
  const __global float *from = (const __global float *)scene->light_nodes;
  const uint16 row = on ? word * WORDS(LightNode) : (uint16)(0u);
  const uint first = LANE_U(row, CTZ(mask16(on)));
  float16 *out = nodes->x;
  if (!any16(on & (row != first))) {
    for (uint i = 0u; i < WORDS(LightNode); i++) out[i] = from[first + i];
    return;
  }
  const uint counts = WORDS(LightNode) - CHILDREN;
  for (uint i = counts; i < WORDS(LightNode); i += 4u) *(Rows16 *)(out + i) = gather_rows16(from + i, row, on);
  const uint step = has_child16(nodes, 4u, on) ? 4u : CHILDREN;
  for (uint i = 0u; i < counts; i += step) *(Rows16 *)(out + i) = gather_rows16(from + i, row, on);
}

static inline float16 sine_of16(const float16 cosine, const float16 square) { return safe_sqrt16(square - cosine * cosine); }

// cosine_less of each lane.
static inline float16 cosine_less16(const float16 cos_a, const float16 sin_a, const float16 cos_b, const float16 sin_b,
                                    const float16 inverse) {
  const float16 one = 1.0f;
  return sin_a * cos_b < cos_a * sin_b ? one : (cos_a * cos_b + sin_a * sin_b) * inverse;
}

// light_weights of each lane's child number c, before the root's are halved.
static inline float16 light_weight16(const LightNode16 *node, const uint c, const Receiver16 *receiver) {
  const float16 zero = 0.0f, one = 1.0f, least_square = LEAST_SQUARE;
  const float16 radius = node->radius[c], strength = node->strength[c];
  const float16 cos_spread = node->cos_spread[c], sin_spread = node->sin_spread[c];
  const Mask16 far = radius < zero;
  const float16 cx = node->x[c], cy = node->y[c], cz = node->z[c];
  const float16 dx = far ? cx : cx - receiver->p.x;
  const float16 dy = far ? cy : cy - receiver->p.y;
  const float16 dz = far ? cz : cz - receiver->p.z;
  const float16 d2 = dx * dx + dy * dy + dz * dz;
  const float16 r2 = radius * radius;
  const Mask16 inside = ~far & (d2 <= r2);
  const float16 eighth = 0.125f * r2, outer = MAX16(d2, eighth);
  const float16 inverse = one / MAX16(outer, least_square);
  const float16 sin_bounds = far ? sin_spread : radius;
  const float16 cos_bounds = far ? cos_spread : safe_sqrt16(d2 - r2);
  const float16 cos_axis = -(node->axis_x[c] * dx + node->axis_y[c] * dy + node->axis_z[c] * dz);
  const float16 sin_axis = sine_of16(cos_axis, d2);
  const float16 sin_off = sin_axis * cos_spread - cos_axis * sin_spread;
  const float16 cos_off = cos_axis * cos_spread + sin_axis * sin_spread;
  const float16 cos_emitted = cosine_less16(cos_off, sin_off, cos_bounds, sin_bounds, inverse);
  const float16 cos_least = (inside | (sin_off < zero)) ? one : cos_emitted;
  Mask16 lit = (strength > zero) & (far | (cos_least >= node->cos_falloff[c]));
  float16 weight = far ? strength : strength * inverse * cos_least;
  const Vec16 n = receiver->n;
  const Mask16 plane = (n.x != 0.0f) | (n.y != 0.0f) | (n.z != 0.0f);
  const float16 cos_normal = n.x * dx + n.y * dy + n.z * dz, least_cosine = LEAST_COSINE;
  const float16 cos_arriving = cosine_less16(cos_normal, sine_of16(cos_normal, d2), cos_bounds, sin_bounds, inverse);
  const float16 cos_lit = inside ? one : cos_arriving;
  lit &= ~plane | (cos_lit > -LEAST_COSINE);
  weight = plane ? weight * MAX16(cos_lit, least_cosine) : weight;
  const float16 least_weight = LEAST_WEIGHT;
  return lit ? MAX16(weight, least_weight) : zero;
}

// sum8 of each lane.
static inline float16 sum_children16(const float16 *x) {
  return ((x[0] + x[4]) + (x[2] + x[6])) + ((x[1] + x[5]) + (x[3] + x[7]));
}

// halved of each lane.
static inline void halve16(const LightNode16 *node, float16 *weight) {
  const float16 zero = 0.0f, least_weight = LEAST_WEIGHT;
  float16 far[CHILDREN], near[CHILDREN];
  for (uint c = 0u; c < CHILDREN; c++) {
    far[c] = node->radius[c] < zero ? weight[c] : zero;
    near[c] = node->radius[c] < zero ? zero : weight[c];
  }
  const float16 far_sum = sum_children16(far), near_sum = sum_children16(near);
  const Mask16 both = (far_sum > zero) & (near_sum > zero);
  if (!any16(both)) return;
  for (uint c = 0u; c < CHILDREN; c++) {
    const float16 scaled = weight[c] * (node->radius[c] < zero ? 1.0f / far_sum : 1.0f / near_sum);
    weight[c] = (both & (weight[c] > zero)) ? MAX16(scaled, least_weight) : weight[c];
  }
}

// light_shares of the lanes of `on`, each at its own node. All are at the root, or none.
static inline void light_shares16(const LightNode16 *node, const Receiver16 *receiver, const int16 numbers, const bool root,
                                  const Mask16 on, int16 *ends) {
  const float16 zero = 0.0f;
  float16 weights[CHILDREN];
  for (uint c = 0u; c < CHILDREN; c++) weights[c] = has_child16(node, c, on) ? light_weight16(node, c, receiver) : zero;
  if (root) halve16(node, weights);
  const Mask16 dark = !(sum_children16(weights) > zero);
  int16 sum = 0;
  for (uint c = 0u; c < CHILDREN; c++) {
    weights[c] = dark ? to_float16(as_int16(node->count[c])) : weights[c];
    sum += weights[c] > zero ? as_int16(node->count[c]) : (int16)(0);
  }
  const float16 free = to_float16(numbers - sum) * (1.0f - 0x1p-20f) / sum_children16(weights);
  sum = 0;
  for (uint c = 0u; c < CHILDREN; c++) {
    sum += (weights[c] > zero ? as_int16(node->count[c]) : (int16)(0)) + to_int16(weights[c] * free);
    ends[c] = sum;
  }
  for (uint c = 0u; c < CHILDREN; c++) ends[c] = ends[c] == sum ? numbers : ends[c];
}

// Where each lane is on its way down.
typedef struct {
  uint16 word;
  int16 numbers;  // the node's share of the uniform numbers
  int16 at;       // choosing: a number of that share; finding: a place among the node's lights
} LightWalk16;

static inline void walk_start16(const int16 at, LightWalk16 *walk) {
  walk->word = 0u;
  walk->numbers = (int)NUMBERS;
  walk->at = at;
}

// A step of light_tree_choose or, where it `finds` a light, of light_tree_pmf, for the lanes of `on`.
static PENUMBRA_NOINLINE PENUMBRA_WIDE void walk_step16(const SceneData *scene, const Receiver16 *receiver, const bool finds,
                                                        const bool root, const Mask16 *on, LightWalk16 *walk) {
  LightNode16 node;
  int16 ends[CHILDREN];
  load_nodes16(scene, walk->word, *on, &node);
  light_shares16(&node, receiver, walk->numbers, root, *on, ends);
  const int16 at = walk->at;
  int16 before = 0, start = 0;
  for (uint c = 0u; c < CHILDREN; c++) {
    const Mask16 here = *on & (at >= start);
    walk->word = here ? node.child[c] : walk->word;
    walk->numbers = here ? ends[c] - before : walk->numbers;
    walk->at = here ? at - start : walk->at;
    before = ends[c];
    start = finds ? start + as_int16(node.count[c]) : before;
  }
}

static inline void walk16(const SceneData *scene, const Receiver16 *receiver, const bool finds, const Mask16 on,
                          LightWalk16 *walk) {
  bool root = true;
  for (Mask16 left = on; any16(left); left &= ((walk->word & LEAF_FLAG) == 0u) & (walk->numbers > 0)) {
    walk_step16(scene, receiver, finds, root, &left, walk);
    root = false;
  }
}

static inline float16 walk_pmf16(const LightWalk16 *walk) { return to_float16(walk->numbers) * (1.0f / NUMBERS); }

static PENUMBRA_NOINLINE PENUMBRA_WIDE void tree_choose_each(const SceneData *scene, const Receiver16 *receiver, const float16 *u,
                                                             const Mask16 *on, uint16 *light, float16 *pmf) {
  for (LANES_OF(k, *on)) {
    const Receiver lit = lane_receiver(receiver, k);
    float chance;
    LANE_U(*light, k) = light_tree_choose(scene, &lit, LANE_F(*u, k), &chance);
    LANE_F(*pmf, k) = chance;
  }
}

static PENUMBRA_NOINLINE PENUMBRA_WIDE void tree_pmf_each(const SceneData *scene, const Receiver16 *receiver, const uint16 *light,
                                                          const Mask16 *on, float16 *pmf) {
  for (LANES_OF(k, *on)) {
    const Receiver lit = lane_receiver(receiver, k);
    LANE_F(*pmf, k) = light_tree_pmf(scene, &lit, LANE_U(*light, k));
  }
}

static inline bool few_walkers16(const Mask16 on) { return POPCOUNT(mask16(on)) < LEAST_WALKERS; }

// light_tree_choose of the lanes of `on`.
static inline uint16 light_tree_choose16(const SceneData *scene, const Receiver16 *receiver, const float16 u, const Mask16 on,
                                         float16 *pmf) {
  uint16 light = 0u;
  if (few_walkers16(on)) {
    tree_choose_each(scene, receiver, &u, &on, &light, pmf);
    return light;
  }
  LightWalk16 walk;
  walk_start16(to_int16(u * NUMBERS), &walk);
  walk16(scene, receiver, false, on, &walk);
  *pmf = walk_pmf16(&walk);
  return walk.word & ~LEAF_FLAG;
}

// light_tree_pmf of the lanes of `on`.
static inline float16 light_tree_pmf16(const SceneData *scene, const Receiver16 *receiver, const uint16 light, const Mask16 on) {
  float16 pmf = 0.0f;
  if (few_walkers16(on)) {
    tree_pmf_each(scene, receiver, &light, &on, &pmf);
    return pmf;
  }
  const uint16 place = gather_u16(&scene->lights->leaf, light * WORDS(Light), on);
  const Mask16 has = on & (place != NONE);
  LightWalk16 walk;
  walk_start16(as_int16(place), &walk);
  walk16(scene, receiver, true, has, &walk);
  return has ? walk_pmf16(&walk) : pmf;
}
