// The light tree (lights/tree.cl) for sixteen receivers, each at its own node and with the bits of the scalar functions.
#include "base/types16.h"
#include "lights/rest16.h"
#include "lights/tree.cl"

#define CHILDREN 8u
// Lanes from which on all walk together. Measured with 200 lamps: sixteen take about a quarter of their time one by one, four the same.
#define LEAST_WALKERS 4u

// A child in each lane: the fields of LightNode.
typedef struct {
  float16 x, y, z, radius, axis_x, axis_y, axis_z, cos_spread, sin_spread, cos_falloff, strength;
} LightChild16;

// Child number c of one node in all lanes.
static inline LightChild16 one_child16(const __global LightNode *node, const uint c) {
  LightChild16 out;
  out.x = node->x[c];
  out.y = node->y[c];
  out.z = node->z[c];
  out.radius = node->radius[c];
  out.axis_x = node->axis_x[c];
  out.axis_y = node->axis_y[c];
  out.axis_z = node->axis_z[c];
  out.cos_spread = node->cos_spread[c];
  out.sin_spread = node->sin_spread[c];
  out.cos_falloff = node->cos_falloff[c];
  out.strength = node->strength[c];
  return out;
}

// Four children, from number `first` on, each of the nodes that begin at words row[0], row[4], row[8] and row[12], as they stand there:
// only what comes of them is turned into lanes of nodes.
static inline LightChild16 four_children16(const __global LightNode *nodes, const uint first, const uint *row) {
  LightChild16 out;
  out.x = four_rows(nodes->x + first, row);
  out.y = four_rows(nodes->y + first, row);
  out.z = four_rows(nodes->z + first, row);
  out.radius = four_rows(nodes->radius + first, row);
  out.axis_x = four_rows(nodes->axis_x + first, row);
  out.axis_y = four_rows(nodes->axis_y + first, row);
  out.axis_z = four_rows(nodes->axis_z + first, row);
  out.cos_spread = four_rows(nodes->cos_spread + first, row);
  out.sin_spread = four_rows(nodes->sin_spread + first, row);
  out.cos_falloff = four_rows(nodes->cos_falloff + first, row);
  out.strength = four_rows(nodes->strength + first, row);
  return out;
}

static inline float16 sine_of16(const float16 cosine, const float16 square) { return safe_sqrt16(square - cosine * cosine); }

// cosine_less of each lane.
static inline float16 cosine_less16(const float16 cos_a, const float16 sin_a, const float16 cos_b, const float16 sin_b,
                                    const float16 inverse) {
  const float16 one = 1.0f;
  return sin_a * cos_b < cos_a * sin_b ? one : (cos_a * cos_b + sin_a * sin_b) * inverse;
}

// light_weights of the children, before the root's are halved. p, n: of their receivers.
static inline float16 light_weight16(const LightChild16 *child, const Vec16 p, const Vec16 n) {
  const float16 zero = 0.0f, one = 1.0f, least_square = LEAST_SQUARE;
  const float16 radius = child->radius, strength = child->strength;
  const float16 cos_spread = child->cos_spread, sin_spread = child->sin_spread;
  const Mask16 far = radius < zero;
  const float16 dx = far ? child->x : child->x - p.x;
  const float16 dy = far ? child->y : child->y - p.y;
  const float16 dz = far ? child->z : child->z - p.z;
  const float16 d2 = dx * dx + dy * dy + dz * dz;
  const float16 r2 = radius * radius;
  const Mask16 inside = ~far & (d2 <= r2);
  const float16 eighth = 0.125f * r2, outer = MAX16(d2, eighth);
  const float16 inverse = one / MAX16(outer, least_square);
  const float16 sin_bounds = far ? sin_spread : radius;
  const float16 cos_bounds = far ? cos_spread : safe_sqrt16(d2 - r2);
  const float16 cos_axis = -(child->axis_x * dx + child->axis_y * dy + child->axis_z * dz);
  const float16 sin_axis = sine_of16(cos_axis, d2);
  const float16 sin_off = sin_axis * cos_spread - cos_axis * sin_spread;
  const float16 cos_off = cos_axis * cos_spread + sin_axis * sin_spread;
  const float16 cos_emitted = cosine_less16(cos_off, sin_off, cos_bounds, sin_bounds, inverse);
  const float16 cos_least = (inside | (sin_off < zero)) ? one : cos_emitted;
  Mask16 lit = (strength > zero) & (far | (cos_least >= child->cos_falloff));
  float16 weight = far ? strength : strength * inverse * cos_least;
  const Mask16 plane = (n.x != 0.0f) | (n.y != 0.0f) | (n.z != 0.0f);
  const float16 cos_normal = n.x * dx + n.y * dy + n.z * dz, least_cosine = LEAST_COSINE;
  const float16 cos_arriving = cosine_less16(cos_normal, sine_of16(cos_normal, d2), cos_bounds, sin_bounds, inverse);
  const float16 cos_lit = inside ? one : cos_arriving;
  lit &= ~plane | (cos_lit > -LEAST_COSINE);
  weight = plane ? weight * MAX16(cos_lit, least_cosine) : weight;
  const float16 least_weight = LEAST_WEIGHT;
  return lit ? MAX16(weight, least_weight) : zero;
}

static inline Vec16 four_points16(const Vec16 *v, const uint k) {
  return vec16(four_of16(v->x, k), four_of16(v->y, k), four_of16(v->z, k));
}

// The weights of four children, from number `first` on, of each lane's node.
static inline Rows16 light_weights16(const __global LightNode *nodes, const uint first, const uint16 row, const Receiver16 *receiver) {
  float16 weights[4];
  for (uint k = 0u; k < 4u; k++) {
    const LightChild16 children = four_children16(nodes, first, (const uint *)&row + k);
    weights[k] = light_weight16(&children, four_points16(&receiver->p, k), four_points16(&receiver->n, k));
  }
  return turn_rows16(weights[0], weights[1], weights[2], weights[3]);
}

// sum8 of each lane.
static inline float16 sum_children16(const float16 *x) {
  return ((x[0] + x[4]) + (x[2] + x[6])) + ((x[1] + x[5]) + (x[3] + x[7]));
}

// halved of each lane, all of which are at the root.
static inline void halve16(const __global LightNode *root, float16 *weight) {
  const float16 zero = 0.0f, least_weight = LEAST_WEIGHT;
  float16 far[CHILDREN], near[CHILDREN];
  for (uint c = 0u; c < CHILDREN; c++) {
    far[c] = root->radius[c] < 0.0f ? weight[c] : zero;
    near[c] = root->radius[c] < 0.0f ? zero : weight[c];
  }
  const float16 far_sum = sum_children16(far), near_sum = sum_children16(near);
  const Mask16 both = (far_sum > zero) & (near_sum > zero);
  if (!any16(both)) return;
  for (uint c = 0u; c < CHILDREN; c++) {
    const float16 scaled = weight[c] * (root->radius[c] < 0.0f ? 1.0f / far_sum : 1.0f / near_sum);
    weight[c] = (both & (weight[c] > zero)) ? MAX16(scaled, least_weight) : weight[c];
  }
}

// light_shares of the lanes of `on`, each at its own node. All are at the root, or none. count: the children's, of each lane.
static inline void light_shares16(const __global LightNode *nodes, const uint16 row, const Receiver16 *receiver, const int16 numbers,
                                  const bool root, const Mask16 on, int16 *count, int16 *ends) {
  const float16 zero = 0.0f;
  float16 weights[CHILDREN];
  for (uint c = 0u; c < CHILDREN; c += 4u) *(Rows16 *)(count + c) = gather_rows16(nodes->count + c, row, on);
  for (uint c = 0u; c < CHILDREN; c++) weights[c] = zero;
  // Nodes fill from the first child on, and those at the bottom are seldom full.
  if (root) {
    for (uint c = 0u; c < CHILDREN && nodes->count[c]; c++) {
      const LightChild16 child = one_child16(nodes, c);
      weights[c] = light_weight16(&child, receiver->p, receiver->n);
    }
    halve16(nodes, weights);
  } else {
    for (uint c = 0u; c < CHILDREN && any16(on & (count[c] != 0)); c += 4u)
      *(Rows16 *)(weights + c) = light_weights16(nodes, c, row, receiver);
  }
  float16 total = sum_children16(weights);
  const Mask16 dark = on & !(total > zero);
  if (any16(dark)) {
    for (uint c = 0u; c < CHILDREN; c++) weights[c] = dark ? to_float16(count[c]) : weights[c];
    total = sum_children16(weights);
  }
  int16 least[CHILDREN], sum = 0;
  for (uint c = 0u; c < CHILDREN; c++) {
    least[c] = weights[c] > zero ? count[c] : (int16)(0);
    sum += least[c];
  }
  const float16 free = to_float16(numbers - sum) * (1.0f - 0x1p-20f) / total;
  sum = 0;
  for (uint c = 0u; c < CHILDREN; c++) {
    sum += least[c] + to_int16(weights[c] * free);
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
  const uint16 row = *on ? walk->word * WORDS(LightNode) : (uint16)(0u);
  int16 count[CHILDREN], ends[CHILDREN];
  light_shares16(scene->light_nodes, row, receiver, walk->numbers, root, *on, count, ends);
  const int16 at = walk->at;
  int16 before = 0, after = ends[0], first = 0, start = 0;
  uint16 child = 0u;
  for (uint c = 1u; c < CHILDREN; c++) {
    start = finds ? start + count[c - 1u] : ends[c - 1u];
    const Mask16 here = at >= start;
    child = here ? (uint16)(c) : child;
    before = here ? ends[c - 1u] : before;
    after = here ? ends[c] : after;
    first = here ? start : first;
  }
  walk->numbers = *on ? after - before : walk->numbers;
  walk->at = *on ? at - first : at;
  walk->word = *on ? gather_u16(scene->light_nodes->child, row + child, *on) : walk->word;
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

static PENUMBRA_NOINLINE PENUMBRA_WIDE void tree_choose_each(const SceneData *scene, const Receiver16 *receiver, const Mask16 *on,
                                                             Point16 *u, uint16 *light, float16 *pmf) {
  for (LANES_OF(k, *on)) {
    const Receiver lit = lane_receiver(receiver, k);
    float2 point = (float2)(LANE_F(u->x, k), LANE_F(u->y, k));
    float chance;
    LANE_U(*light, k) = light_tree_choose(scene, &lit, &point, &chance);
    LANE_F(u->x, k) = point.x;
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
static inline uint16 light_tree_choose16(const SceneData *scene, const Receiver16 *receiver, const Mask16 on, Point16 *u,
                                         float16 *pmf) {
  uint16 light = 0u;
  if (few_walkers16(on)) {
    tree_choose_each(scene, receiver, &on, u, &light, pmf);
    return light;
  }
  LightWalk16 walk;
  walk_start16(to_int16(u->x * NUMBERS), &walk);
  walk16(scene, receiver, false, on, &walk);
  u->x = place_among16(to_float16(walk.at), to_float16(walk.numbers), digits_behind16(u->y));
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
