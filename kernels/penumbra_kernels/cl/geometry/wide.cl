// Eight lanes at once: what the traversal does to eight boxes or eight triangles. No lengths, no frame.
#include "base/lanes.cl"
#include "geometry/slack.h"

// A ray prepared for triangles (Woop, Benthin, Wald 2013): axes with the largest of the direction's last, origin and shear along them.
typedef struct {
  uint kx, ky, kz;
  float8 ox, oy, oz, sx, sy, sz;
} RayAxes;

// A ray in the frame of the tree that it is in, prepared for boxes and triangles.
typedef struct {
  // Slabs: t of a plane is (plane - origin) * inverse. Near and far planes have their own origins and inverses, moved so
  // that no rounding ever loses a box (see wide_ray).
  float8 near_ox, near_oy, near_oz, far_ox, far_oy, far_oz;
  float8 near_rx, near_ry, near_rz, far_rx, far_ry, far_rz;
  uint near_x, near_y, near_z;  // where a node's near planes begin, in floats; the far ones: ^ 8
  RayAxes axes;
  float3 o, d;
} WideRay;

#if PENUMBRA_X86 && defined(__FMA__)
static inline float8 fma8(const float8 a, const float8 b, const float8 c) {
  return __builtin_ia32_vfmaddps256(a, b, c);
}
#elif PENUMBRA_BUILTINS
static inline float8 fma8(const float8 a, const float8 b, const float8 c) {
  return (float8)(FMA(a.s0, b.s0, c.s0), FMA(a.s1, b.s1, c.s1), FMA(a.s2, b.s2, c.s2), FMA(a.s3, b.s3, c.s3),
                  FMA(a.s4, b.s4, c.s4), FMA(a.s5, b.s5, c.s5), FMA(a.s6, b.s6, c.s6), FMA(a.s7, b.s7, c.s7));
}
#else
static inline float8 fma8(const float8 a, const float8 b, const float8 c) { return fma(a, b, c); }
#endif

// a b - c d, to 1.5 ulp of the result: its sign is exact (Jeannerod, Louvet, Muller 2013).
static inline float8 difference_of_products8(const float8 a, const float8 b, const float8 c, const float8 d) {
  const float8 cd = c * d;
  const float8 error = fma8(-c, d, cd);
  return fma8(a, b, -cd) + error;
}

static inline uint signbit_of(const float x) { return as_uint(x) >> 31; }

// False where the ray is not one: NaN, infinite, or no direction.
static inline bool wide_ray(const float3 o, const float3 d, WideRay *w) {
  const float3 size = abs3(d);
  const float largest = max3(size);
  const float reach = max3(abs3(o));
  if (!(largest >= 0x1p-126f && is_finite(size.x + size.y + size.z) && is_finite(o.x + o.y + o.z + reach))) return false;
  w->o = o;
  w->d = d;
  // A zero component makes an infinite inverse: its planes are then at -inf and +inf, or beyond reach, or NaN where the
  // origin lies in one, which the comparisons of slab tests drop.
  const float rx = 1.0f / d.x, ry = 1.0f / d.y, rz = 1.0f / d.z;
  const float e = BOX_SLACK * reach;
  const float ex = copy_sign(e, rx), ey = copy_sign(e, ry), ez = copy_sign(e, rz);
  w->near_x = signbit_of(rx) * 8u;
  w->near_y = 16u + signbit_of(ry) * 8u;
  w->near_z = 32u + signbit_of(rz) * 8u;
  w->near_ox = o.x + ex;
  w->near_oy = o.y + ey;
  w->near_oz = o.z + ez;
  w->far_ox = o.x - ex;
  w->far_oy = o.y - ey;
  w->far_oz = o.z - ez;
  w->near_rx = rx;
  w->near_ry = ry;
  w->near_rz = rz;
  w->far_rx = rx * FAR_FACTOR;
  w->far_ry = ry * FAR_FACTOR;
  w->far_rz = rz * FAR_FACTOR;
  const uint kz = size.x > size.y ? (size.x > size.z ? 0u : 2u) : (size.y > size.z ? 1u : 2u);
  const uint kx = kz == 2u ? 0u : kz + 1u;
  const uint ky = kx == 2u ? 0u : kx + 1u;
  const float da[3] = {d.x, d.y, d.z};
  const float oa[3] = {o.x, o.y, o.z};
  const float ra[3] = {rx, ry, rz};
  const float sz = ra[kz];
  w->axes.kx = kx;
  w->axes.ky = ky;
  w->axes.kz = kz;
  w->axes.ox = oa[kx];
  w->axes.oy = oa[ky];
  w->axes.oz = oa[kz];
  w->axes.sx = da[kx] * sz;
  w->axes.sy = da[ky] * sz;
  w->axes.sz = sz;
  return true;
}
