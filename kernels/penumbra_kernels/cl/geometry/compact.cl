// One ray a thread: what the traversal does to a node's eight boxes and to a leaf's triangles, one after the other, from the small
// records of accel/compact.py. The same interface and the same arithmetic as wide.cl and triangle.cl, so that hits are the same,
// bit for bit: boxes here hold the boxes there, and the order of visits never shows. Metres in the tree's frame.
#include "geometry/hit.cl"
#include "geometry/slack.h"

// A ray in the frame of the tree that it is in, prepared for boxes and triangles; see wide.cl.
typedef struct {
  float3 o, d;
  float3 near_o, far_o, near_r, far_r;
  uint kx, ky, kz;  // triangles: axes with the largest of the direction's last
  float3 ok;        // the origin along them
  float sx, sy, sz; // shear along them
} WideRay;

#define NO_ENTRY ((ulong)NO_CHILD | 0xffffffff00000000ul)  // farther than any

static inline float component(const float3 v, const uint axis) { return axis == 0u ? v.x : axis == 1u ? v.y : v.z; }
static inline float3 permuted(const WideRay *w, const float3 v) {
  return (float3)(component(v, w->kx), component(v, w->ky), component(v, w->kz));
}

// False where the ray is not one: NaN, infinite, or no direction.
static inline bool wide_ray(const float3 o, const float3 d, WideRay *w) {
  const float3 size = abs3(d);
  const float reach = max3(abs3(o));
  if (!(max3(size) >= 0x1p-126f && is_finite(size.x + size.y + size.z) && is_finite(o.x + o.y + o.z + reach))) return false;
  w->o = o;
  w->d = d;
  const float3 r = (float3)(1.0f / d.x, 1.0f / d.y, 1.0f / d.z);
  const float e = BOX_SLACK * reach;
  const float3 moved = (float3)(copy_sign(e, r.x), copy_sign(e, r.y), copy_sign(e, r.z));
  w->near_o = o + moved;
  w->far_o = o - moved;
  w->near_r = r;
  w->far_r = r * FAR_FACTOR;
  w->kz = size.x > size.y ? (size.x > size.z ? 0u : 2u) : (size.y > size.z ? 1u : 2u);
  w->kx = w->kz == 2u ? 0u : w->kz + 1u;
  w->ky = w->kx == 2u ? 0u : w->kx + 1u;
  w->ok = permuted(w, o);
  w->sz = component(r, w->kz);
  w->sx = component(d, w->kx) * w->sz;
  w->sy = component(d, w->ky) * w->sz;
  return true;
}

static inline float grid_plane(const uint steps, const uint lane, const float size, const float origin) {
  return FMA((float)((steps >> (8u * lane)) & 255u), size, origin);
}

// One axis of four children: where the ray enters and leaves between the planes. NaN of a plane that the origin lies in is
// always the first operand, and dropped.
static inline void cut_axis(const uint near_steps, const uint far_steps, const uint lane, const float size, const float origin,
                            const float near_o, const float near_r, const float far_o, const float far_r, float *enter,
                            float *leave) {
  const float a = (grid_plane(near_steps, lane, size, origin) - near_o) * near_r;
  const float b = (grid_plane(far_steps, lane, size, origin) - far_o) * far_r;
  *enter = MAX(a, *enter);
  *leave = MIN(b, *leave);
}

// Whether the ray meets the box of one child no later than `end`.
static inline bool meets_box(const __global CompactNode *node, const uint lane, const WideRay *w, const float end) {
  const uint exponents = node->exponents;
  const bool back_x = signbit(w->near_r.x), back_y = signbit(w->near_r.y), back_z = signbit(w->near_r.z);
  const uint lo_x = node->lo_x[lane], hi_x = node->hi_x[lane];
  const uint lo_y = node->lo_y[lane], hi_y = node->hi_y[lane];
  const uint lo_z = node->lo_z[lane], hi_z = node->hi_z[lane];
  float enter = 0.0f, leave = end;
  cut_axis(back_x ? hi_x : lo_x, back_x ? lo_x : hi_x, 0u, as_float((exponents & 255u) << 23), node->origin[0],
           w->near_o.x, w->near_r.x, w->far_o.x, w->far_r.x, &enter, &leave);
  cut_axis(back_y ? hi_y : lo_y, back_y ? lo_y : hi_y, 0u, as_float(((exponents >> 8) & 255u) << 23), node->origin[1],
           w->near_o.y, w->near_r.y, w->far_o.y, w->far_r.y, &enter, &leave);
  cut_axis(back_z ? hi_z : lo_z, back_z ? lo_z : hi_z, 0u, as_float(((exponents >> 16) & 255u) << 23), node->origin[2],
           w->near_o.z, w->near_r.z, w->far_o.z, w->far_r.z, &enter, &leave);
  return enter <= leave;
}

// The nearest child that is met, or NO_CHILD; the others wait on the stack, the second nearest on its top.
static inline uint visit_node(const SceneData *scene, const __global CompactNode *node, const WideRay *w, const float end,
                              Stack *stack) {
  const uint exponents = node->exponents;
  const float3 origin = load3(node->origin);
  const float size_x = as_float((exponents & 255u) << 23), size_y = as_float(((exponents >> 8) & 255u) << 23),
              size_z = as_float(((exponents >> 16) & 255u) << 23);
  const bool back_x = signbit(w->near_r.x), back_y = signbit(w->near_r.y), back_z = signbit(w->near_r.z);
  const __global uint *lo_x = (const __global uint *)node->lo_x, *hi_x = (const __global uint *)node->hi_x;
  const __global uint *lo_y = (const __global uint *)node->lo_y, *hi_y = (const __global uint *)node->hi_y;
  const __global uint *lo_z = (const __global uint *)node->lo_z, *hi_z = (const __global uint *)node->hi_z;
  ulong nearest = NO_ENTRY, second = NO_ENTRY;
  for (uint half4 = 0u; half4 < 2u; half4++) {
    const uint near_x = back_x ? hi_x[half4] : lo_x[half4], far_x = back_x ? lo_x[half4] : hi_x[half4];
    const uint near_y = back_y ? hi_y[half4] : lo_y[half4], far_y = back_y ? lo_y[half4] : hi_y[half4];
    const uint near_z = back_z ? hi_z[half4] : lo_z[half4], far_z = back_z ? lo_z[half4] : hi_z[half4];
    for (uint lane = 0u; lane < 4u; lane++) {
      float enter = 0.0f, leave = end;
      cut_axis(near_x, far_x, lane, size_x, origin.x, w->near_o.x, w->near_r.x, w->far_o.x, w->far_r.x, &enter, &leave);
      cut_axis(near_y, far_y, lane, size_y, origin.y, w->near_o.y, w->near_r.y, w->far_o.y, w->far_r.y, &enter, &leave);
      cut_axis(near_z, far_z, lane, size_z, origin.z, w->near_o.z, w->near_r.z, w->far_o.z, w->far_r.z, &enter, &leave);
      const uint word = node->child[4u * half4 + lane];
      if (!(enter <= leave) || word == NO_CHILD) continue;
      const ulong entry = stack_entry(word, enter);
      const ulong later = MAX(nearest, entry);
      nearest = MIN(nearest, entry);
      if (second != NO_ENTRY) stack->entries[stack->size++] = MAX(second, later);
      second = MIN(second, later);
    }
  }
  if (second != NO_ENTRY) stack->entries[stack->size++] = second;
  return (uint)nearest;
}

// A triangle's vertices along the ray's permuted axes, relative to nothing yet.
typedef struct {
  float3 a, b, c;
} OneTriangle;

static inline OneTriangle load_triangle(const __global CompactTriangle *from, const WideRay *w) {
  OneTriangle one;
  one.a = permuted(w, load3(from->v0));
  one.b = permuted(w, load3(from->v1));
  one.c = permuted(w, load3(from->v2));
  return one;
}

static inline float2 sheared(const WideRay *w, const float3 v) { return (float2)(v.x - w->sx * v.z, v.y - w->sy * v.z); }

// The three vertices of a lane.
static inline void lane_vertices(const SceneData *scene, const uint lane, float3 v[3]) {
  const __global CompactTriangle *from = scene->packets + lane;
  v[0] = load3(from->v0);
  v[1] = load3(from->v1);
  v[2] = load3(from->v2);
}

// Offers the triangle if it is hit; watertight as triangle.cl is, operation by operation.
static inline bool hit_triangle(const OneTriangle *one, const SceneData *scene, const uint lane, const WideRay *w,
                                const uint instance, const bool any, Hit *best) {
  const float3 ra = one->a - w->ok, rb = one->b - w->ok, rc = one->c - w->ok;
  const float2 a = sheared(w, ra), b = sheared(w, rb), c = sheared(w, rc);
  const float u = difference_of_products(c.x, b.y, c.y, b.x);
  const float v = difference_of_products(a.x, c.y, a.y, c.x);
  const float q = difference_of_products(b.x, a.y, b.y, a.x);
  const float low = MIN(MIN(u, v), q), high = MAX(MAX(u, v), q);
  const float det = u + v + q;
  if (!((low >= 0.0f || high <= 0.0f) && det != 0.0f)) return false;
  const float inverse = 1.0f / det;
  const float b0 = u * inverse, b1 = v * inverse, b2 = q * inverse;
  const float t = (b0 * ra.z + b1 * rb.z + b2 * rc.z) * w->sz;
  if (!(t > 0.0f && (any ? t < best->t : t <= best->t))) return false;
  if (!any && hit_offer(t, b1, b2, PRIMITIVE_TRIANGLE, scene->packets[lane].primitive, instance, best)) best->lane = lane;
  return true;
}

// A leaf's packets, one triangle after the other.
static inline bool hit_packets(const SceneData *scene, const uint word, const WideRay *w, const uint instance,
                               const bool any, Hit *best) {
  uint first = 8u * (word & LEAF_PACKET_MASK);
  bool found = false;
  for (uint n = (word >> LEAF_COUNT_SHIFT) & 3u; n; n--, first += 8u) {
    for (uint lane = first; lane < first + 8u; lane++) {
      const OneTriangle one = load_triangle(scene->packets + lane, w);
      found |= hit_triangle(&one, scene, lane, w, instance, any, best);
      if (any && found) return true;
      if (scene->packets[lane].last) break;
    }
  }
  return found;
}

#if PENUMBRA_DEFORMATION
static inline bool hit_deforming(const SceneData *scene, const uint word, const WideRay *w, const float time,
                                 const uint instance, const bool any, Hit *best) {
  const uint first = 8u * (word & LEAF_PACKET_MASK);
  const __global CompactTriangle *lanes = scene->packets + first;
  const __global ShapeData *shape = scene->shapes + scene->triangles[lanes->primitive].shape;
  const DeformTime at = deform_time(scene, shape, time);
  bool found = false;
  for (uint lane = 0u; lane < 8u; lane++) {
    OneTriangle one = load_triangle(lanes + 8u * at.first + lane, w);
    const OneTriangle next = load_triangle(lanes + 8u * (at.first + 1u) + lane, w);
    // The same expression as in surface_triangle.cl: traversal and surface see the same vertices.
    one.a += at.fraction * (next.a - one.a);
    one.b += at.fraction * (next.b - one.b);
    one.c += at.fraction * (next.c - one.c);
    found |= hit_triangle(&one, scene, first + lane, w, instance, any, best);
    if (any && found) return true;
    if (lanes[lane].last) break;
  }
  return found;
}
#endif
