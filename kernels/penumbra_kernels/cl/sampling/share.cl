// Adaptive sampling: which of an axis of sample indices a pixel takes. A replicate's axis is the same for all pixels, so that
// sum nodes and their tree are too; a pixel of level j takes the indices below `kept`, and of those from there on the
// multiples of 2^j. LEVEL_NONE takes no others. What it takes it numbers from 0 on without gaps: its own samples, of which its
// sampler knows alone. Indices that are not taken are zeros in the sums and are not counted (penumbra_kernels.allotment).
#include "sampling/sampler.cl"

#define REFINED_SALT 0x452821e638d01377ul

// A pixel's part in one node.
typedef struct {
  ulong first;   // the first of its own samples in the node
  uint count;    // how many; 0, or a power of two
  bool thinned;  // fewer than the node's range is long
} Share;

// Of the indices below `end`, how many the pixel takes.
static inline ulong own_samples(const ulong end, const uint level, const ulong kept) {
  if (end <= kept) return end;
  if (level == LEVEL_NONE) return kept;
  const ulong round = (1ul << level) - 1ul;
  return kept + ((end + round) >> level) - ((kept + round) >> level);
}

// A pixel that takes every index.
static inline Share whole_share(const __global Params *params) {
  Share s;
  s.first = params->first_sample;
  s.count = params->sample_count;
  s.thinned = false;
  return s;
}

// Of the node [first, first + count), which lies wholly below `kept` or wholly beyond.
static inline Share share_of(const __global Params *params, const uint level) {
  const ulong first = params->first_sample;
  Share s;
  s.first = own_samples(first, level, params->kept);
  s.count = (uint)(own_samples(first + params->sample_count, level, params->kept) - s.first);
  s.thinned = s.count < params->sample_count;
  return s;
}

// Have the sampler fill strata of the pixel's own samples. Samplers that fill a grid begin another one behind the kept
// samples, with random numbers of its own: the first P of N strata are no grid, but P strata and N - P strata together are
// evenly spread. The others go on with their sequence.
static inline void sampler_share(Sampler *s, const __global Params *params, const uint level, Share *share) {
  const ulong kept = params->kept;
  const ulong planned = params->strata;  // of this launch: what was planned while the kept ones were taken, or the axis
  if (params->first_sample < kept) {
    s->strata = (uint)planned * s->stride;
    return;
  }
  s->strata = planned > kept ? (uint)own_samples(planned, level, kept) * s->stride : 0u;
#if PENUMBRA_SAMPLER == SAMPLER_REGULAR || PENUMBRA_SAMPLER == SAMPLER_STRATIFIED || PENUMBRA_SAMPLER == SAMPLER_JITTERED
  if (kept == 0ul) return;
  s->strata = s->strata > 0u ? s->strata - (uint)kept * s->stride : 0u;
  s->key = hash_combine(s->key, REFINED_SALT);
  share->first -= kept;
#endif
}
