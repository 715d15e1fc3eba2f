// Named random dimensions. Numbers never depend on which effects are compiled in, so that a program without an
// effect draws the same numbers for everything else as one with it.
// A dimension is a 64-bit number that names one pair of uniforms: bits 0-3 slot, 4-31 bounce, 32-63 light (all lights).

#define DIM_PIXEL 0ul  // position under the reconstruction filter, 2-D
#define DIM_LENS 1ul   // point on the aperture, 2-D
#define DIM_TIME 2ul   // instant within the shutter interval, 1-D

// A hit's slots; 0 is free.
#define SLOT_LIGHT 1ul         // which light, and point or direction on it, 2-D
#define SLOT_LOBE 2ul          // whether an interface reflects, 1-D
#define SLOT_DIRECTION 3ul     // which lobe of the material, and direction in it, 2-D
#define SLOT_ROULETTE 4ul      // whether the path goes on, 1-D
#define SLOT_LIGHT_TRIANGLE 5ul  // which triangle of a mesh light, 1-D

// Dimension of a slot at hit number `bounce` (0 is the first hit).
#define DIM_BOUNCE(bounce, slot) (((ulong)(bounce) + 1ul) * 16ul + (slot))
// The same for light `light` where every light is asked.
#define DIM_LIGHT(bounce, slot, light) (DIM_BOUNCE(bounce, slot) | (((ulong)(light) + 1ul) << 32))

// The counter of numbers drawn in this dimension, all bounces and lights together: below DRAWN_COUNT.
static inline uint drawn_of(const ulong dim) { return dim < 16ul ? (uint)dim : DRAWN_BOUNCE + (uint)(dim & 15ul); }

// What a dimension samples, coarsely: a GROUP_* bit.
static inline uint group_of(const ulong dim) {
  if (dim < 16ul) return dim == DIM_PIXEL ? GROUP_PIXEL : (dim == DIM_LENS ? GROUP_LENS : GROUP_TIME);
  const ulong slot = dim & 15ul;
  return slot == SLOT_LIGHT || slot == SLOT_LIGHT_TRIANGLE ? GROUP_LIGHTS : GROUP_DIRECTIONS;
}
