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

static inline bool hit_deforming(const SceneData *scene, const uint word, const WideRay *w, const float time,
                                 const uint instance, const bool any, Hit *best) {
  const uint first = word & LEAF_PACKET_MASK;
  const __global Packet8 *packet = scene->packets + first;
  const __global ShapeData *shape = scene->shapes + scene->triangles[packet->primitive[0]].shape;
  const DeformTime at = deform_time(scene, shape, time);
  EightTriangles a, b;
  load_triangles(packet + at.first, w, &a);
  load_triangles(packet + at.first + 1u, w, &b);
  deform_triangles(at.fraction, &b, &a);
  return hit_triangles(&a, scene, first, w, instance, any, best);
}
