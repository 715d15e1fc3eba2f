// Deforming triangles: vertices move in straight lines from keyframe to keyframe. Metres in the tree's frame, seconds.
#include "geometry/triangle.cl"
#include "geometry/deform_time.cl"

// Moves the vertices of a towards those of b.
static inline void deform_triangles(const float fraction, const EightTriangles *b, EightTriangles *a) {
  // The same expression as in surface_triangle.cl: traversal and surface see the same vertices.
  a->ax += fraction * (b->ax - a->ax);
  a->ay += fraction * (b->ay - a->ay);
  a->az += fraction * (b->az - a->az);
  a->bx += fraction * (b->bx - a->bx);
  a->by += fraction * (b->by - a->by);
  a->bz += fraction * (b->bz - a->bz);
  a->cx += fraction * (b->cx - a->cx);
  a->cy += fraction * (b->cy - a->cy);
  a->cz += fraction * (b->cz - a->cz);
}

// The triangles of the keyframes' packets from `first` on, where they are at a time.
static inline void load_deforming(const SceneData *scene, const __global Packet8 *first, const RayAxes *r, const float time,
                                  EightTriangles *e) {
  const __global ShapeData *shape = scene->shapes + scene->triangles[first->primitive[0]].shape;
  const DeformTime at = deform_time(scene, shape, time);
  EightTriangles next;
  load_triangles(first + at.first, r, e);
  load_triangles(first + at.first + 1u, r, &next);
  deform_triangles(at.fraction, &next, e);
}

static inline bool hit_deforming(const SceneData *scene, const uint word, const WideRay *w, const float time,
                                 const uint instance, const bool any, Hit *best) {
  const uint first = word & LEAF_PACKET_MASK;
  EightTriangles e;
  load_deforming(scene, scene->packets + first, &w->axes, time, &e);
  return hit_triangles(&e, scene, first, w, instance, any, best);
}
