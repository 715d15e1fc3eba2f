// What the traversal does to sixteen rays at once: preparing them, boxes, and which of two hits counts. Metres in the tree's frame.
#include "base/types16.h"
#include "geometry/wide.cl"

// The first hit of each ray. Equal t are decided by the key, kind and primitive, then by the instance; both mean nothing where
// `found` is not.
typedef struct {
  float16 t, u, v;
  uint16 key, lane;
#if PENUMBRA_INSTANCING
  uint16 instance;
#endif
  Mask16 found;
} Best16;

#define KEY_KIND_SHIFT 30u

// Prepared as wide_ray prepares one.
typedef struct {
  float16 near_ox, near_oy, near_oz, far_ox, far_oy, far_oz;
  float16 near_rx, near_ry, near_rz, far_rx, far_ry, far_rz;
  Mask16 back_x, back_y, back_z;  // towards smaller coordinates: the near planes are the high ones
  Mask16 last_x, last_y;          // the axis of the direction's largest component, z otherwise
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

// Of x, y, z the one along the axis, the next and the one after it.
#define ALONG(w, x, y, z) ((w)->last_x ? (x) : (w)->last_y ? (y) : (z))
#define NEXT(w, x, y, z) ((w)->last_x ? (y) : (w)->last_y ? (z) : (x))
#define AFTER(w, x, y, z) ((w)->last_x ? (z) : (w)->last_y ? (x) : (y))

static inline void wide_ray16(const Vec16 *o, const Vec16 *d, WideRay16 *w) {
  const float16 ax = abs16(d->x), ay = abs16(d->y), az = abs16(d->z);
  const float16 largest = MAX16(MAX16(ax, ay), az);
  const float16 reach = MAX16(MAX16(abs16(o->x), abs16(o->y)), abs16(o->z));
  w->is_ray = (largest >= 0x1p-126f) & is_finite16(ax + ay + az) & is_finite16(o->x + o->y + o->z + reach);
  const float16 rx = 1.0f / d->x, ry = 1.0f / d->y, rz = 1.0f / d->z;
  const float16 e = BOX_SLACK * reach;
  const float16 ex = copy_sign16(e, rx), ey = copy_sign16(e, ry), ez = copy_sign16(e, rz);
  w->back_x = as_int16(rx) < 0;
  w->back_y = as_int16(ry) < 0;
  w->back_z = as_int16(rz) < 0;
  w->near_ox = o->x + ex;
  w->near_oy = o->y + ey;
  w->near_oz = o->z + ez;
  w->far_ox = o->x - ex;
  w->far_oy = o->y - ey;
  w->far_oz = o->z - ez;
  w->near_rx = rx;
  w->near_ry = ry;
  w->near_rz = rz;
  w->far_rx = rx * FAR_FACTOR;
  w->far_ry = ry * FAR_FACTOR;
  w->far_rz = rz * FAR_FACTOR;
  w->last_x = (ax > ay) & (ax > az);
  w->last_y = !(ax > ay) & (ay > az);
  w->okx = NEXT(w, o->x, o->y, o->z);
  w->oky = AFTER(w, o->x, o->y, o->z);
  w->okz = ALONG(w, o->x, o->y, o->z);
  w->sz = ALONG(w, rx, ry, rz);
  w->sx = NEXT(w, d->x, d->y, d->z) * w->sz;
  w->sy = AFTER(w, d->x, d->y, d->z) * w->sz;
}

// The rays that meet a box each no later than `end`, by its near and far planes (nodes8.cl), and t at which they enter it.
static inline Mask16 meet_planes16(const Vec16 near, const Vec16 far, const WideRay16 *w, const float16 end, float16 *enter) {
  const float16 nx = (near.x - w->near_ox) * w->near_rx;
  const float16 ny = (near.y - w->near_oy) * w->near_ry;
  const float16 nz = (near.z - w->near_oz) * w->near_rz;
  const float16 fx = (far.x - w->far_ox) * w->far_rx;
  const float16 fy = (far.y - w->far_oy) * w->far_ry;
  const float16 fz = (far.z - w->far_oz) * w->far_rz;
  const float16 zero = 0.0f;
  *enter = MAX16(nx, MAX16(ny, MAX16(nz, zero)));
  return *enter <= MIN16(fx, MIN16(fy, MIN16(fz, end)));
}

// The same with child i of a node for all of them.
static inline Mask16 meet_box16(const __global Node8 *n, const uint i, const WideRay16 *w, const float16 end,
                                float16 *enter) {
  const float16 lx = n->lo_x[i], ly = n->lo_y[i], lz = n->lo_z[i], hx = n->hi_x[i], hy = n->hi_y[i], hz = n->hi_z[i];
  const Vec16 near = vec16(w->back_x ? hx : lx, w->back_y ? hy : ly, w->back_z ? hz : lz);
  const Vec16 far = vec16(w->back_x ? lx : hx, w->back_y ? ly : hy, w->back_z ? lz : hz);
  return meet_planes16(near, far, w, end, enter);
}

// Where `on`, a hit at t counts if it is nearer than the best, or as near and before it in the order.
static inline void offer16(const Mask16 on, const float16 t, const float16 u, const float16 v, const uint key, const uint lane,
                           const uint instance, const bool any, Best16 *h) {
  Mask16 wins = on & (t > 0.0f);
  if (any) {
    h->found |= wins & (t < h->t);
    return;
  }
  Mask16 first = h->key > key;
#if PENUMBRA_INSTANCING
  first |= (h->key == key) & (h->instance > instance);
#endif
  wins &= (t < h->t) | ((t == h->t) & h->found & first);
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
