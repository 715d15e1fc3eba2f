// What kernels pass to each other. Lengths in metres relative to the scene's anchor, world frame unless said.
#include "layout.h"
#include "base/math.cl"

// A half line. tmin is always 0: rays start off their surface (spawn_ray), so that no epsilon hides anything.
typedef struct {
  float3 o;
  float3 d;      // need not be of unit length (object space keeps the world's parameter)
  float tmax;
  float time;    // seconds from the frame's time
} Ray;

#define PRIMITIVE_TRIANGLE 0u
#define PRIMITIVE_SPHERE 1u
#define PRIMITIVE_DISC 2u
#define PRIMITIVE_PLANE 3u

// Where a ray first meets the scene. Ties in t go to the lowest (kind, primitive, instance).
typedef struct {
  float t;
  float u, v;        // triangles: barycentrics of vertices 1 and 2; discs: the two half-axis coordinates
  uint kind;         // PRIMITIVE_*, or NONE for a miss
  uint primitive;    // index within its kind
  uint instance;     // or NONE
  uint lane;         // triangles: 8 * packet + lane, where the tree has their vertices (those of the first keyframe)
} Hit;

// A point on a surface, ready for shading.
typedef struct {
  float3 p;
  float3 p_error;    // bound on the absolute error of p, by component (pbrt-v4, 6.8)
  float3 ng;         // unit geometric normal, points outside
  float3 ns;         // unit shading normal, same side as ng
  float3 tangent;    // unit, orthogonal to ns: dp/du projected, the direction that anisotropy follows
  float2 uv;
  uint shape;        // index into shapes
  uint instance;     // or NONE
  uint kind, primitive;
} Surface;

// The tree as the device's kind wants it: eight lanes at once, or compact for one thread a ray (geometry/compact.cl).
#if PENUMBRA_COMPACT_TREE
typedef CompactNode TreeNode;
typedef CompactTriangle TreeTriangles;
#else
typedef Node8 TreeNode;
typedef Packet8 TreeTriangles;
#endif

// All of the scene on the device. Pointers of effects that are out are null and never read.
typedef struct {
  const __global TreeNode *nodes;
  const __global TreeTriangles *packets;
  const __global PacketCorners *corners;  // of each packet, where all trees are small (compile/together.py), or null
  const __global SphereData *spheres;
  const __global DiscData *discs;
  const __global PlaneData *planes;
  const __global Instance *instances;
  const __global Keyframe *keyframes;
  const __global float *times;         // of deformation keyframes
  const __global ShapeData *shapes;
  const __global TriangleData *triangles;
  const __global float *positions;     // 3 a vertex
  const __global float *normals;       // 3 a vertex of the meshes that have them
  const __global float *uvs;           // 2 a vertex of the meshes that have them
  const __global Material *materials;
  const __global float *albedo_table;  // directional albedo of GGX lobes, see materials/
  const __global Texture *textures;
  const __global float4 *texels;
  const __global Light *lights;
  const __global Alias *light_table;   // the light choice, an entry a light (the environment last)
  const __global LightNode *light_nodes;  // the light tree (lights/tree.cl), its root first
  const __global float *emitter_cdf;   // triangles of mesh lights
  const __global float4 *environment;  // see lights/environment.cl
  uint plane_count;
  uint light_count;
  uint root;
  uint environment_light;
  bool light_tree;                     // choose by the tree, not by the table
} SceneData;
