// Which light to ask: a walk down the light tree (Conty Estevez and Kulla 2018, "Importance Sampling of Many Lights with
// Adaptive Tree Splitting"; pbrt-v4, section 12.6.3), whose nodes have eight children here, weighed together as lanes.
// compile/light_tree.py builds it. World frame, metres relative to the anchor.
//
// A node's weight bounds the irradiance that its lights may send, as far as bounds tell: strength over squared distance,
// the least angle at which they may emit towards the receiver, and the least at which they may arrive. It is 0 only where
// none of them can light the receiver. Uniform numbers have 24 bits: a node's share of them is a whole number, split among its
// children to the last one, with at least one for every light of a child that can light. So the pmf of a light is exactly
// the share of the numbers that lead to it, and pmfs sum to 1. The way down to a light is found again by its place in the
// tree's order (Light.leaf), since each child holds consecutive places.
#include "base/lanes.cl"
#include "lights/receiver.h"
#include "lights/rest.h"

#if PENUMBRA_BUILTINS
static inline float8 sqrt8(const float8 x) {
  return (float8)(SQRT(x.s0), SQRT(x.s1), SQRT(x.s2), SQRT(x.s3), SQRT(x.s4), SQRT(x.s5), SQRT(x.s6), SQRT(x.s7));
}
#else
static inline float8 sqrt8(const float8 x) { return sqrt(x); }
#endif

#define LANES8(array) (*(const __global float8 *)(array))

// Floor of squared distances, m^2, and of weights that are not 0: both keep every sum finite and above 0.
#define LEAST_SQUARE 1e-20f
#define LEAST_WEIGHT 1e-30f
// Floor of the receiver's cosine: a weight of 0 there means below the horizon, which rounding must not decide for lights
// on it; and gloss at grazing angles is not as dark as its cosine.
#define LEAST_COSINE 0.01f
// Uniform numbers that there are; floats below it are exact.
#define NUMBERS 0x1p24f

// Sine from the cosine where both are times a length. square: the length's.
static inline float8 sine_of(const float8 cosine, const float8 square) {
  return sqrt8(MAX8(square - cosine * cosine, (float8)(0.0f)));
}

// Cosine of max(0, a - b) for angles in [0, pi] (pbrt-v4, 12.6.3), whose sines and cosines are times lengths: inverse is 1 over both. The
// difference is in [-pi, pi], so that its sine tells whether it is below 0.
static inline float8 cosine_less(const float8 cos_a, const float8 sin_a, const float8 cos_b, const float8 sin_b,
                                 const float8 inverse) {
  const float8 one = 1.0f;
  return sin_a * cos_b < cos_a * sin_b ? one : (cos_a * cos_b + sin_a * sin_b) * inverse;
}

static inline float sum8(const float8 x) {
  const float4 four = x.lo + x.hi;
  const float2 two = four.lo + four.hi;
  return two.x + two.y;
}

// Irradiance of far lights cannot be compared with bounds that the receiver is inside of: where both kinds can light it,
// each has half of the choice. Only the root has both.
static inline float8 halved(const float8 weight, const int8 far) {
  const float8 zero = 0.0f;
  const float far_sum = sum8(far ? weight : zero), near_sum = sum8(far ? zero : weight);
  if (!(far_sum > 0.0f && near_sum > 0.0f)) return weight;
  const float8 scaled = weight * (far ? (float8)(1.0f / far_sum) : (float8)(1.0f / near_sum));
  return weight > zero ? MAX8(scaled, (float8)(LEAST_WEIGHT)) : zero;
}

// Weights of the eight children. Far lights have no distance and emit to everywhere.
static inline float8 light_weights(const __global LightNode *node, const Receiver *receiver, const bool root) {
  const float8 zero = 0.0f, one = 1.0f;
  const float8 radius = LANES8(node->radius), strength = LANES8(node->strength);
  const float8 cos_spread = LANES8(node->cos_spread), sin_spread = LANES8(node->sin_spread);
  const int8 far = radius < zero;
  const float8 cx = LANES8(node->x), cy = LANES8(node->y), cz = LANES8(node->z);
  const float8 dx = far ? cx : cx - receiver->p.x;
  const float8 dy = far ? cy : cy - receiver->p.y;
  const float8 dz = far ? cz : cz - receiver->p.z;
  const float8 d2 = dx * dx + dy * dy + dz * dz;
  const float8 r2 = radius * radius;
  const int8 inside = !far & (d2 <= r2);
  // Below, sines and cosines are times the distance, and those of differences times its square: no unit vector is needed.
  const float8 inverse = one / MAX8(MAX8(d2, 0.125f * r2), (float8)(LEAST_SQUARE));
  // Half angle that the bounds subtend: all of pi from within.
  const float8 sin_bounds = far ? sin_spread : radius;
  const float8 cos_bounds = far ? cos_spread : sqrt8(MAX8(d2 - r2, zero));
  // Least angle off a normal at which they can emit towards the receiver: that off the axis, less the spread, less the half angle.
  const float8 cos_axis = -(LANES8(node->axis_x) * dx + LANES8(node->axis_y) * dy + LANES8(node->axis_z) * dz);
  const float8 sin_axis = sine_of(cos_axis, d2);
  const float8 sin_off = sin_axis * cos_spread - cos_axis * sin_spread;
  const float8 cos_off = cos_axis * cos_spread + sin_axis * sin_spread;
  const float8 cos_emitted = cosine_less(cos_off, sin_off, cos_bounds, sin_bounds, inverse);
  const float8 cos_least = (inside | (sin_off < zero)) ? one : cos_emitted;
  int8 lit = (strength > zero) & (far | (cos_least >= LANES8(node->cos_falloff)));
  float8 weight = far ? strength : strength * inverse * cos_least;
  const float3 n = receiver->n;
  if (n.x != 0.0f || n.y != 0.0f || n.z != 0.0f) {
    const float8 cos_normal = n.x * dx + n.y * dy + n.z * dz;
    const float8 cos_arriving = cosine_less(cos_normal, sine_of(cos_normal, d2), cos_bounds, sin_bounds, inverse);
    const float8 cos_lit = inside ? one : cos_arriving;
    lit &= cos_lit > -LEAST_COSINE;
    weight *= MAX8(cos_lit, (float8)(LEAST_COSINE));
  }
  weight = lit ? MAX8(weight, (float8)(LEAST_WEIGHT)) : zero;
  return root ? halved(weight, far) : weight;
}

// Splits `numbers` of the uniform numbers among a node's children: *ends are the running sums, the last one `numbers`.
// Where no child can light the receiver, all share by their lights' count: the sample will be worth nothing anyway.
static inline void light_shares(const SceneData *scene, const uint word, const Receiver *receiver, const int numbers,
                                int8 *ends) {
  const __global LightNode *node = scene->light_nodes + word;
  const float8 zero = 0.0f;
  const int8 count = *(const __global int8 *)node->count;
  float8 weights = light_weights(node, receiver, word == 0u);
  float total = sum8(weights);
  if (!(total > 0.0f)) {
    weights = convert_float8(count);
    total = sum8(weights);
  }
  const int8 least = weights > zero ? count : (int8)(0);
  const int4 four = least.lo + least.hi;
  const int2 two = four.lo + four.hi;
  // Rounding never gives more than there are; what it leaves goes to the last child that gets any.
  const float8 free = (float)(numbers - (two.x + two.y)) * (1.0f - 0x1p-20f) / total;
  int8 sum = least + convert_int8(weights * free);
  // Lane by lane: joined from shorter vectors, these leave lanes undefined on the way, which oclgrind 21.10 cannot follow.
  sum += (int8)(0, sum.s0, sum.s1, sum.s2, sum.s3, sum.s4, sum.s5, sum.s6);
  sum += (int8)(0, 0, sum.s0, sum.s1, sum.s2, sum.s3, sum.s4, sum.s5);
  sum += (int8)(0, 0, 0, 0, sum.s0, sum.s1, sum.s2, sum.s3);
  *ends = sum == sum.s7 ? (int8)(numbers) : sum;
}

// The child whose share holds `number`, and its share.
static inline uint light_lane(const int8 ends[1], const int number, int *first, int *numbers) {
  const uint lane = POPCOUNT(lane_mask(ends[0] <= (int8)(number)));
  const int *e = (const int *)ends;
  *first = lane ? e[lane - 1u] : 0;
  *numbers = e[lane] - *first;
  return lane;
}

// A light by u.x of a point u of [0, 1)^2, and the probability of choosing it; u becomes a point for a sample of that light.
static inline uint light_tree_choose(const SceneData *scene, const Receiver *receiver, float2 *u, float *pmf) {
  int number = (int)(u->x * NUMBERS), numbers = (int)NUMBERS;
  uint word = 0u;
  do {
    int8 ends[1];
    int first;
    light_shares(scene, word, receiver, numbers, ends);
    word = scene->light_nodes[word].child[light_lane(ends, number, &first, &numbers)];
    number -= first;
  } while (!(word & LEAF_FLAG));
  u->x = place_among((float)number, (float)numbers, digits_behind(u->y));
  *pmf = (float)numbers * (1.0f / NUMBERS);
  return word & ~LEAF_FLAG;
}

// The probability with which light_tree_choose finds a light.
static inline float light_tree_pmf(const SceneData *scene, const Receiver *receiver, const uint light) {
  uint place = scene->lights[light].leaf, word = 0u;
  if (place == NONE) return 0.0f;
  int numbers = (int)NUMBERS;
  do {
    const __global LightNode *node = scene->light_nodes + word;
    int8 ends[1];
    uint lane = 0u;
    light_shares(scene, word, receiver, numbers, ends);
    while (lane < 7u && place >= node->count[lane]) place -= node->count[lane++];
    const int *e = (const int *)ends;
    numbers = e[lane] - (lane ? e[lane - 1u] : 0);
    word = node->child[lane];
  } while (numbers > 0 && !(word & LEAF_FLAG));
  return (float)numbers * (1.0f / NUMBERS);
}
