// Where a traversal keeps the children that wait.
#include "base/types.h"

#define LEVEL_STACK 95u  // accel/build.py promises that no tree needs more
#if PENUMBRA_INSTANCING
#define STACK_SIZE (2u * LEVEL_STACK + 1u)
#else
#define STACK_SIZE LEVEL_STACK
#endif
#define BACK_TO_WORLD 0xffffffffu  // as a child word: the mark below an instance's entries
#define NO_CHILD 0x80000000u       // an empty leaf

// Waiting children: t in the high half, so that they compare by it (t >= 0), the child word in the low half.
typedef struct {
  ulong entries[STACK_SIZE];
  uint size;
} Stack;

static inline ulong stack_entry(const uint word, const float t) { return ((ulong)as_uint(t) << 32) | word; }
