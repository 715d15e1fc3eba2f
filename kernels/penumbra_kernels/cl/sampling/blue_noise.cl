// blue_noise: one Sobol sequence for the whole frame, dealt to the pixels along a randomised Z-curve, so that neighbours get
// complementary samples and the error of the picture turns to high frequencies (Ahmed and Wonka 2020, "Screen-Space
// Blue-Noise Diffusion of Monte Carlo Sampling Error via Hierarchical Ordering of Pixels"). Each replicate and each dimension
// has its own order of the pixels and its own scrambling.
#include "sampling/strata.cl"
#include "sampling/owen.cl"

static inline ulong spread_bits(const uint x) {
  ulong v = x;
  v = (v | (v << 16)) & 0x0000ffff0000fffful;
  v = (v | (v << 8)) & 0x00ff00ff00ff00fful;
  v = (v | (v << 4)) & 0x0f0f0f0f0f0f0f0ful;
  v = (v | (v << 2)) & 0x3333333333333333ul;
  return (v | (v << 1)) & 0x5555555555555555ul;
}

// A pixel's place on the Z-curve (Morton 1966).
static inline ulong z_curve(const uint x, const uint y) { return (spread_bits(y) << 1) | spread_bits(x); }

// Image of a base-4 digit under permutation number p of the 24: each is x -> M x + c over pairs of bits, M one of the six
// invertible 2x2 matrices (a nibble each: the images of 1 and of 2), c one of four.
static inline uint permute_digit(const uint digit, const uint p) {
  const uint columns = 0xb7e6d9u >> (4u * (p >> 2));
  return (p & 3u) ^ ((digit & 1u) ? columns & 3u : 0u) ^ ((digit & 2u) ? (columns >> 2) & 3u : 0u);
}

// The order of base-4 digits from `digits` - 1 down to 0: each is permuted by a hash of the digits above it.
static inline ulong shuffle_digits(const ulong rank, const uint digits, const bool half_digit, const ulong key) {
  const uint low = half_digit ? 1u : 0u;  // an odd number of bits ends in one binary digit
  ulong out = 0ul;
  for (int i = (int)digits - 1; i >= 0; --i) {
    const uint shift = 2u * (uint)i + low;
    const ulong above = rank >> (shift + 2u);
    const ulong h = ((above + key) * 0xbf58476d1ce4e5b9ul) ^ ((ulong)i << 32);
    const uint p = (uint)((((h ^ (h >> 32)) * 0x94d049bb133111ebul) >> 40) * 24ul >> 24);
    out |= (ulong)permute_digit((uint)(rank >> shift) & 3u, p) << shift;
  }
  if (half_digit) out |= (rank ^ mix64((rank >> 1) + key)) & 1ul;
  return out;
}

// Elements below 2^bits of each pixel share one ordering; those beyond start anew.
static inline ulong blue_index(const Sampler *s, const ulong element, const uint strata, ulong *key) {
  const uint per_sample = strata > s->strata && s->strata > 0u ? bits_of(strata / s->strata) : 0u;
  const uint bits = MIN(s->passes + per_sample, 32u);  // with the rank's 30 bits less than 64
  const ulong epoch = element >> bits;
  if (epoch) *key = hash_combine(*key, epoch);
  const ulong rank = (s->rank << bits) | (element & ((1ul << bits) - 1ul));
  return shuffle_digits(rank, s->digits + (bits >> 1), (bits & 1u) != 0u, *key);
}

static inline float blue_noise_1d(const Sampler *s, const ulong dimension, const ulong element, const uint strata) {
  ulong key = hash_combine(s->frame_key, dimension);
  const ulong index = blue_index(s, element, strata, &key);
  return uniform_of(sobol_x((uint)index, (uint)mix64(key)));
}

// An index has up to 62 bits. In the first dimension those beyond 32 lie below its resolution. In the second, column 32 + k
// of the Pascal matrix modulo 2 equals column k in its first 32 rows (Lucas: C(32 + k, j) and C(k, j) have the same parity
// for j < 32), so the high half of the index is folded onto the low one.
static inline float2 blue_noise_2d(const Sampler *s, const ulong dimension, const ulong element, const uint strata) {
  ulong key = hash_combine(s->frame_key, dimension);
  const ulong index = blue_index(s, element, strata, &key);
  const ulong seeds = mix64(key);
  const uint folded = (uint)index ^ (uint)(index >> 32);
  const ulong xy = sobol_xy((uint)index, folded, (uint)seeds, (uint)(seeds >> 32));
  return (float2)(uniform_of((uint)(xy >> 32)), uniform_of((uint)xy));
}
