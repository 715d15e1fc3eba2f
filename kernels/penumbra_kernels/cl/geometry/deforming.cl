// Deforming triangles: vertices move in straight lines from keyframe to keyframe. Metres in the tree's frame, seconds.
#include "geometry/triangle.cl"
#include "geometry/deform_time.cl"

static inline bool hit_deforming(const SceneData *scene, const uint word, const WideRay *w, const float time,
                                 const uint instance, const bool any, Hit *best) {
  const uint first = word & LEAF_PACKET_MASK;
  const __global Packet8 *packet = scene->packets + first;
  const __global ShapeData *shape = scene->shapes + scene->triangles[packet->primitive[0]].shape;
  const DeformTime at = deform_time(scene, shape, time);
  EightTriangles a, b;
  load_triangles(packet + at.first, w, &a);
  load_triangles(packet + at.first + 1u, w, &b);
  // The same expression as in surface_triangle.cl: traversal and surface see the same vertices.
  a.ax += at.fraction * (b.ax - a.ax);
  a.ay += at.fraction * (b.ay - a.ay);
  a.az += at.fraction * (b.az - a.az);
  a.bx += at.fraction * (b.bx - a.bx);
  a.by += at.fraction * (b.by - a.by);
  a.bz += at.fraction * (b.bz - a.bz);
  a.cx += at.fraction * (b.cx - a.cx);
  a.cy += at.fraction * (b.cy - a.cy);
  a.cz += at.fraction * (b.cz - a.cz);
  return hit_triangles(&a, scene, first, w, instance, any, best);
}
