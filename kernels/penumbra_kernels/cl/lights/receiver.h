// What is lit: the choice among lights may depend on it. World frame, metres relative to the anchor.
#include "base/types.h"

typedef struct {
  float3 p;
  float3 n;  // unit: light from behind this plane does nothing; 0 where light from any side counts
} Receiver;
