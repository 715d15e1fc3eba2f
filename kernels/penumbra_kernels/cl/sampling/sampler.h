// One sampler interface. PENUMBRA_SAMPLER (a SAMPLER_* constant) picks the file that implements it.
//   sampler_start(params, x, y, replicate)   for a pixel of the full frame
//   sampler_next(s, index)                   begin the replicate's sample `index`
//   sample_1d(s, dimension)                  a uniform number in [0, 1)
//   sample_2d(s, dimension)                  a uniform point in [0, 1)^2
//   sample_1d_of(s, dimension, j, m), sample_2d_of(...)   number j of m that one sample draws in this dimension:
//                                   element index * m + j of the sequence, so that they are stratified together
// Every file has x_1d(s, dimension, element, strata) and x_2d(...): element `element` of the dimension's sequence, of which
// `strata` are planned (0: unknown). Elements beyond the plan go on with strata of their own.
#include "layout.h"
#include "base/hash.cl"
#include "base/dimensions.h"


typedef struct {
  ulong key;      // hash of (seed, pixel, replicate)
  ulong index;    // of the sample within its replicate
  uint reversed;  // its low 32 bits, the lowest first (sobol)
  uint strata;    // planned samples a replicate; 0: unknown, strata double
  uint passes;    // log2 of the samples below the pixel's rank (blue noise)
  uint digits;    // base-4 digits of the pixel's rank (blue noise)
  uint stride;    // samples of all replicates between two of this one (regular)
  ulong rank;     // the pixel's rank on the Z-curve (blue noise), the replicate (regular)
  ulong frame_key;  // hash of (seed, replicate): the same in every pixel (blue noise)
#if PENUMBRA_PICK_FREEZE
  uint other_groups;  // GROUP_* bits that draw from a second, independent stream
#endif
#if PENUMBRA_COUNT_DRAWS
  uint *drawn;  // numbers drawn so far: of each camera dimension, then of each slot of the hits' (drawn_of)
#endif
} Sampler;
