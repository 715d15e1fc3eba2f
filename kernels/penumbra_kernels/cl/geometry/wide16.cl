// What the traversal does to sixteen rays at once: preparing them, boxes, and which of two hits counts. Metres in the tree's frame.
#include "base/types16.h"
#include "geometry/wide.cl"

// The first hit of each ray. Equal t are decided by the key, kind and primitive, then by the instance; both are 0 before anything
// is found, so that nothing counts at t itself.
typedef struct {
  float16 t, u, v;
  uint16 key, lane;
#if PENUMBRA_INSTANCING
  uint16 instance;
#endif
  Mask16 found;
} Best16;

#define KEY_KIND_SHIFT 30u

// Prepared as wide_ray prepares one, but that planes are told apart as low and high, which all lanes have in common, not near and far.
typedef struct {
  float16 lo_ox, lo_oy, lo_oz, hi_ox, hi_oy, hi_oz;
  float16 rx, ry, rz;
  int16 kx, ky, kz;               // as in RayAxes
  float16 okx, oky, okz, sx, sy, sz;
  Mask16 is_ray;
} WideRay16;

// Sixteen rays in the frame of the tree that they are in: the world's, or an instance's.
typedef struct {
  const Vec16 *o, *d;
  const WideRay16 *wide;
  const float16 *time;
  uint instance;  // or NONE
} Rays16;

// Component k of v in each lane.
static inline float16 component16(const Vec16 v, const int16 k) { return k == 0 ? v.x : k == 1 ? v.y : v.z; }

// The same of a point that all lanes have.
#if PENUMBRA_512
static inline float16 component_of16(const float4 p, const int16 k) {
  return __builtin_ia32_vpermilvarps512(__builtin_shufflevector(p, p, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3), k);
}
#elif PENUMBRA_X86 && defined(__AVX__)
static inline float16 component_of16(const float4 p, const int16 k) {
  const float8 twice = (float8)(p, p);
  return (float16)(__builtin_ia32_vpermilvarps256(twice, k.lo), __builtin_ia32_vpermilvarps256(twice, k.hi));
}
#else
static inline float16 component_of16(const float4 p, const int16 k) { return component16(all16(p.xyz), k); }
#endif

static inline void wide_ray16(const Vec16 *o, const Vec16 *d, WideRay16 *w) {
  const float16 ax = abs16(d->x), ay = abs16(d->y), az = abs16(d->z);
  const float16 largest = MAX16(MAX16(ax, ay), az);
  const float16 reach = MAX16(MAX16(abs16(o->x), abs16(o->y)), abs16(o->z));
  w->is_ray = (largest >= 0x1p-126f) & is_finite16(ax + ay + az) & is_finite16(o->x + o->y + o->z + reach);
  // Zeros lose their sign: see meet_planes16.
  w->rx = 1.0f / (d->x + 0.0f);
  w->ry = 1.0f / (d->y + 0.0f);
  w->rz = 1.0f / (d->z + 0.0f);
  const float16 e = BOX_SLACK * reach;
  w->lo_ox = o->x + e;
  w->lo_oy = o->y + e;
  w->lo_oz = o->z + e;
  w->hi_ox = o->x - e;
  w->hi_oy = o->y - e;
  w->hi_oz = o->z - e;
  const int16 zero = 0, one = 1, two = 2;
  w->kz = ((ax > ay) & (ax > az)) ? zero : (!(ax > ay) & (ay > az)) ? one : two;
  w->kx = w->kz == 2 ? zero : w->kz + 1;
  w->ky = w->kx == 2 ? zero : w->kx + 1;
  w->okx = component16(*o, w->kx);
  w->oky = component16(*o, w->ky);
  w->okz = component16(*o, w->kz);
  w->sz = component16(vec16(w->rx, w->ry, w->rz), w->kz);
  w->sx = component16(*d, w->kx) * w->sz;
  w->sy = component16(*d, w->ky) * w->sz;
}

// The rays that meet a box each no later than `end`, by its low and high planes, and t at which they enter it. Whichever plane of an
// axis is nearer, the low one's origin is moved up and the high one's down: away from the box's inside (wide_ray). A direction that
// is 0 has an infinite inverse: where the origin lies in a plane its t is NaN, and so, or infinite, is what the axis gives.
static inline Mask16 meet_planes16(const Vec16 lo, const Vec16 hi, const WideRay16 *w, const float16 end, float16 *enter) {
  const float16 lx = (lo.x - w->lo_ox) * w->rx, hx = (hi.x - w->hi_ox) * w->rx;
  const float16 ly = (lo.y - w->lo_oy) * w->ry, hy = (hi.y - w->hi_oy) * w->ry;
  const float16 lz = (lo.z - w->lo_oz) * w->rz, hz = (hi.z - w->hi_oz) * w->rz;
  const float16 nx = MIN16(hx, lx), ny = MIN16(hy, ly), nz = MIN16(hz, lz);
  const float16 fx = MAX16(lx, hx), fy = MAX16(ly, hy), fz = MAX16(lz, hz);
  const float16 zero = 0.0f, infinity = INF_F;
  *enter = MAX16(nx, MAX16(ny, MAX16(nz, zero)));
  const float16 leave = MIN16(fx, MIN16(fy, MIN16(fz, infinity))) * FAR_FACTOR;
  return *enter <= MIN16(leave, end);
}

// The same with child i of a node for all of them.
static inline Mask16 meet_box16(const __global Node8 *n, const uint i, const WideRay16 *w, const float16 end,
                                float16 *enter) {
  const Vec16 lo = vec16((float16)(n->lo_x[i]), (float16)(n->lo_y[i]), (float16)(n->lo_z[i]));
  const Vec16 hi = vec16((float16)(n->hi_x[i]), (float16)(n->hi_y[i]), (float16)(n->hi_z[i]));
  return meet_planes16(lo, hi, w, end, enter);
}

static inline void nothing_yet16(const float16 end, Best16 *h) {
  const float16 zero = 0.0f;
  const uint16 none = 0u;
  h->t = end;
  h->u = h->v = zero;
  h->key = h->lane = none;
#if PENUMBRA_INSTANCING
  h->instance = none;
#endif
  h->found = 0;
}

// Where `on`, a hit at t counts if it is nearer than the best, or as near and before it in the order. Ties are rare: a branch that a
// processor guesses right spares the next hit the wait for what it asks.
static inline void offer16(const Mask16 on, const float16 t, const float16 u, const float16 v, const uint key, const uint lane,
                           const uint instance, Best16 *h) {
  const float16 never = as_float16((uint16)(0x7fc00000u));
  const float16 at = (on & (t > 0.0f)) ? t : never;
  Mask16 wins = at < h->t;
  const Mask16 tie = at == h->t;
  if (any16(tie)) {
    Mask16 first = h->key > key;
#if PENUMBRA_INSTANCING
    first |= (h->key == key) & (h->instance > instance);
#endif
    wins |= tie & first;
  }
  h->t = wins ? t : h->t;
  h->u = wins ? u : h->u;
  h->v = wins ? v : h->v;
  h->key = wins ? (uint16)key : h->key;
  h->lane = wins ? (uint16)lane : h->lane;
#if PENUMBRA_INSTANCING
  h->instance = wins ? (uint16)instance : h->instance;
#endif
  h->found |= wins;
}
