// regular: the same fixed grid of N points, N all replicates' samples together, in every pixel and every domain, as in
// classic ray tracing: aliasing and hard-edged shadows are shown, not hidden. In the pixel sample i takes point i, elsewhere
// the dimension's own fixed permutation of the grid. Nothing is random, so nothing has a variance.
#include "sampling/strata.cl"

#define REGULAR_KEY 0x243f6a8885a308d3ul  // fixed: no seed changes the picture

static inline uint regular_point(const Stratum t, const ulong dimension) {
  return dimension == DIM_PIXEL ? t.offset : permute(t.offset, t.count, hash_combine(REGULAR_KEY, dimension));
}

static inline float regular_1d(const Sampler *s, const ulong dimension, const ulong element, const uint strata) {
  const Stratum t = stratum_of(element, strata);
  return stratum_1d(regular_point(t, dimension), t.count, 0.5f);
}

static inline float2 regular_2d(const Sampler *s, const ulong dimension, const ulong element, const uint strata) {
  const Stratum t = stratum_of(element, strata);
  return stratum_2d(regular_point(t, dimension), t.count, (float2)(0.5f));
}
