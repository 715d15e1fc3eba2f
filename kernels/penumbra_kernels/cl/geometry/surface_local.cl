// A point on a surface in the frame of the tree that it was found in. Metres.
#include "base/types.h"

typedef struct {
  float3 p, p_error;
  float3 ng;       // unit, outside
  float3 ns;       // any length; 0: as ng
  float3 tangent;  // dp/du, any length; 0: none
  float2 uv;
  uint shape;
} LocalSurface;
