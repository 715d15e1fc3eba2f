// The sample key: (seed, pixel, replicate, sample index, named dimension), hashed in 64 bits.
// Counter-based: who renders, in which tile, in which order, changes nothing.

// Bijective finaliser of splitmix64 (Steele, Lea, Flood 2014; constants of Stafford's variant 13).
static inline ulong mix64(ulong x) {
  x ^= x >> 30;
  x *= 0xbf58476d1ce4e5b9ul;
  x ^= x >> 27;
  x *= 0x94d049bb133111ebul;
  return x ^ (x >> 31);
}

#define HASH_STEP 0x9e3779b97f4a7c15ul

static inline ulong hash_combine(const ulong key, const ulong value) { return mix64(key + HASH_STEP * (value + 1ul)); }

// Key of everything but the sample index and the dimension.
static inline ulong pixel_key(const ulong seed, const uint x, const uint y, const uint replicate) {
  return hash_combine(hash_combine(mix64(seed + HASH_STEP), ((ulong)y << 32) | x), replicate);
}

// A uniform number in [0, 1): 24 bits, so that it never rounds up to 1.
static inline float uniform_of(const uint bits) { return (float)(bits >> 8) * 0x1p-24f; }

// Keeps keys of the whole frame apart from those of pixels.
#define FRAME_SALT 0x9216d5d98979fb1bul
// Keeps the second stream of a measurement apart from the first.
#define OTHER_SALT 0x2545f4914f6cdd1dul
