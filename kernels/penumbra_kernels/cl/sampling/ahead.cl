// Sobol numbers drawn ahead: a dimension's for eight consecutive samples of a pixel and replicate at once. They share its hash, and
// what is left is a loop without branches, which compilers turn into vector code: eight cost little more than one. So does the
// cosine-distributed direction that a point of the square stands for, which materials ask for more than for anything else.
// What is kept is what sobol.cl gives for each sample by itself, bit for bit. For CPUs; a GPU's threads are lanes already.
#include "sampling/sobol.cl"
#include "sampling/warp.cl"

#define AHEAD 8u          // samples; their indices differ in the lowest three bits
#define AHEAD_BOUNCES 9u  // the camera's dimensions and those of so many hits have a row each
#define AHEAD_SLOTS 6u
#define AHEAD_KEPT ((AHEAD_BOUNCES + 1u) * AHEAD_SLOTS)  // at most 63

// A row is drawn when its dimension is first asked for: a bit of `drawn` each. The last one, which is never kept, serves all other
// dimensions: deeper hits, single lights.
struct Ahead {
  float x[AHEAD_KEPT + 1u][AHEAD], y[AHEAD_KEPT + 1u][AHEAD];
  float cosine[AHEAD_BOUNCES + 1u][3][AHEAD];  // directions of each hit's SLOT_DIRECTION
  ulong drawn;
  ulong block;  // of the samples with indices from AHEAD * block on
};

static inline void ahead_start(Sampler *s, Ahead *ahead) {
  ahead->drawn = 0ul;
  ahead->block = 0ul;
  s->ahead = ahead;
}

// To the sample that the sampler is at.
static inline void ahead_next(const Sampler *s) {
  const ulong block = s->index / AHEAD;
  if (block != s->ahead->block) s->ahead->drawn = 0ul;
  s->ahead->block = block;
}

static inline bool has_row(const ulong dimension) { return dimension < (AHEAD_BOUNCES + 1u) * 16u; }

static inline uint row_of(const ulong dimension) {
  return has_row(dimension) ? ((uint)dimension >> 4) * AHEAD_SLOTS + ((uint)dimension & 15u) : AHEAD_KEPT;
}

static inline uint cosine_row_of(const ulong dimension) {
  return has_row(dimension) ? ((uint)dimension >> 4) - 1u : AHEAD_BOUNCES;
}

static inline uint lane_of(const Sampler *s) { return (uint)s->index % AHEAD; }

static inline bool is_drawn(const Sampler *s, const ulong dimension) {
  return has_row(dimension) && ((s->ahead->drawn >> row_of(dimension)) & 1ul) != 0ul;
}

static PENUMBRA_NOINLINE void draw_row_1d(const Sampler *s, const ulong dimension) {
  Ahead *a = s->ahead;
  const uint row = row_of(dimension);
  const ulong key = sobol_key(s, dimension, s->index);
  const uint first = (uint)a->block * AHEAD;
  for (uint i = 0u; i < AHEAD; i++) {
    const uint shuffled = owen_scramble(first + i, (uint)key);
    a->x[row][i] = uniform_of(sobol_x(shuffled, (uint)(key >> 32)));
  }
  a->drawn |= 1ul << row;
}

// Rows are written at the end: arrays of the function's own overlap nothing, which vector code has to know.
static PENUMBRA_NOINLINE void draw_row_2d(const Sampler *s, const ulong dimension) {
  Ahead *a = s->ahead;
  const uint row = row_of(dimension);
  const ulong key = sobol_key(s, dimension, s->index);
  const ulong more = mix64(key);
  const uint first = (uint)a->block * AHEAD;
  float x[AHEAD], y[AHEAD];
  for (uint i = 0u; i < AHEAD; i++) {
    const uint shuffled = owen_scramble(first + i, (uint)key);
    x[i] = uniform_of(sobol_x(shuffled, (uint)(more >> 32)));
    y[i] = uniform_of(sobol_y(shuffled, (uint)more));
  }
  for (uint i = 0u; i < AHEAD; i++) {
    a->x[row][i] = x[i];
    a->y[row][i] = y[i];
  }
  a->drawn |= 1ul << row;
  if ((dimension & 15ul) != SLOT_DIRECTION) return;
  float (*cosine)[AHEAD] = a->cosine[cosine_row_of(dimension)];
  for (uint i = 0u; i < AHEAD; i++) {
    float pdf;
    const float3 d = square_to_cosine_hemisphere((float2)(x[i], y[i]), &pdf);
    cosine[0][i] = d.x;
    cosine[1][i] = d.y;
    cosine[2][i] = d.z;
  }
}

static inline float ahead_1d(const Sampler *s, const ulong dimension) {
  if (!is_drawn(s, dimension)) draw_row_1d(s, dimension);
  return s->ahead->x[row_of(dimension)][lane_of(s)];
}

static inline float2 ahead_2d(const Sampler *s, const ulong dimension) {
  if (!is_drawn(s, dimension)) draw_row_2d(s, dimension);
  const uint row = row_of(dimension), lane = lane_of(s);
  return (float2)(s->ahead->x[row][lane], s->ahead->y[row][lane]);
}

// The point of a bounce's SLOT_DIRECTION, with its direction.
static inline SquarePoint ahead_direction(const Sampler *s, const ulong dimension) {
  SquarePoint at = square_point(ahead_2d(s, dimension));
  const float (*cosine)[AHEAD] = s->ahead->cosine[cosine_row_of(dimension)];
  const uint lane = lane_of(s);
  at.cosine = (float3)(cosine[0][lane], cosine[1][lane], cosine[2][lane]);
  at.has_cosine = true;
  return at;
}
