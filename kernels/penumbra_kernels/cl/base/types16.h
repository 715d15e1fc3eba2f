// What the functions of sixteen lanes pass to each other: the structs of types.h, a lane each. World frame, metres, seconds.
#include "base/lanes16.cl"
#include "lights/receiver.h"

typedef struct {
  Vec16 o, d;
  float16 tmax, time;
} Ray16;

// The first hit of each ray. kind: NONE where there is none.
typedef struct {
  float16 t, u, v;
  uint16 kind, primitive, instance, lane;
} Hit16;

// Sixteen rays, and what those that are on meet.
typedef struct {
  const Ray16 *rays;
  Mask16 on, found;
  Hit16 hit;  // where any hit will do it means nothing
} Wing16;

typedef struct {
  Vec16 p, p_error, ng, ns, tangent;
  float16 u, v;
  uint16 shape, instance, kind, primitive;
} Surface16;

typedef struct {
  Vec16 p, n;
} Receiver16;

static inline Ray lane_ray(const Ray16 *r, const uint k) {
  Ray ray;
  ray.o = lane3(&r->o, k);
  ray.d = lane3(&r->d, k);
  ray.tmax = LANE_F(r->tmax, k);
  ray.time = LANE_F(r->time, k);
  return ray;
}

static inline void set_lane_ray(Ray16 *r, const uint k, const Ray ray) {
  set_lane3(&r->o, k, ray.o);
  set_lane3(&r->d, k, ray.d);
  LANE_F(r->tmax, k) = ray.tmax;
  LANE_F(r->time, k) = ray.time;
}

static inline Hit lane_hit(const Hit16 *h, const uint k) {
  Hit hit;
  hit.t = LANE_F(h->t, k);
  hit.u = LANE_F(h->u, k);
  hit.v = LANE_F(h->v, k);
  hit.kind = LANE_U(h->kind, k);
  hit.primitive = LANE_U(h->primitive, k);
  hit.instance = LANE_U(h->instance, k);
  hit.lane = LANE_U(h->lane, k);
  return hit;
}

static inline void set_lane_hit(Hit16 *h, const uint k, const Hit hit) {
  LANE_F(h->t, k) = hit.t;
  LANE_F(h->u, k) = hit.u;
  LANE_F(h->v, k) = hit.v;
  LANE_U(h->kind, k) = hit.kind;
  LANE_U(h->primitive, k) = hit.primitive;
  LANE_U(h->instance, k) = hit.instance;
  LANE_U(h->lane, k) = hit.lane;
}

static inline Surface lane_surface(const Surface16 *s, const uint k) {
  Surface surface;
  surface.p = lane3(&s->p, k);
  surface.p_error = lane3(&s->p_error, k);
  surface.ng = lane3(&s->ng, k);
  surface.ns = lane3(&s->ns, k);
  surface.tangent = lane3(&s->tangent, k);
  surface.uv = (float2)(LANE_F(s->u, k), LANE_F(s->v, k));
  surface.shape = LANE_U(s->shape, k);
  surface.instance = LANE_U(s->instance, k);
  surface.kind = LANE_U(s->kind, k);
  surface.primitive = LANE_U(s->primitive, k);
  return surface;
}

static inline void set_lane_surface(Surface16 *s, const uint k, const Surface *surface) {
  set_lane3(&s->p, k, surface->p);
  set_lane3(&s->p_error, k, surface->p_error);
  set_lane3(&s->ng, k, surface->ng);
  set_lane3(&s->ns, k, surface->ns);
  set_lane3(&s->tangent, k, surface->tangent);
  LANE_F(s->u, k) = surface->uv.x;
  LANE_F(s->v, k) = surface->uv.y;
  LANE_U(s->shape, k) = surface->shape;
  LANE_U(s->instance, k) = surface->instance;
  LANE_U(s->kind, k) = surface->kind;
  LANE_U(s->primitive, k) = surface->primitive;
}

static inline Receiver lane_receiver(const Receiver16 *r, const uint k) {
  Receiver receiver;
  receiver.p = lane3(&r->p, k);
  receiver.n = lane3(&r->n, k);
  return receiver;
}
