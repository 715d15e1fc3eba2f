// One sampler interface. PENUMBRA_SAMPLER (a SAMPLER_* constant) picks the file that implements it.
//   sample_1d(s, dimension)         a uniform number in [0, 1)
//   sample_2d(s, dimension)         a uniform point in [0, 1)^2
//   sample_1d_of(s, dimension, j, m), sample_2d_of(...)   number j of m that one sample draws in this dimension:
//                                   element index * m + j of the sequence, so that they are stratified together
#include "layout.h"
#include "base/hash.cl"
#include "base/dimensions.h"

typedef struct {
  ulong key;      // hash of (seed, pixel, replicate)
  ulong index;    // of the sample within its replicate
  uint strata;    // planned samples a replicate; 0: unknown, strata double
  uint passes;    // log2 of the samples below the pixel's rank (blue noise)
  ulong rank;     // the pixel's rank on the scrambled Z-curve (blue noise)
  ulong frame_key;  // hash of (seed, replicate): the same in every pixel (blue noise, regular)
} Sampler;
