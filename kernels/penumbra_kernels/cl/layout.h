// Generated from layout.py by `python -m penumbra_kernels.layout`: edit that, not this.

#define NONE 4294967295u
#define MOTION_BOXES 8u
#define SHAPE_HAS_NORMALS 1u
#define SHAPE_HAS_UVS 2u
#define SHAPE_FLIP 4u
#define SHAPE_QUAD 8u
#define LEAF_FLAG 2147483648u
#define LEAF_TYPE_SHIFT 29u
#define LEAF_TRIANGLES 0u
#define LEAF_ROUND 1u
#define LEAF_INSTANCE 2u
#define LEAF_DEFORMING 3u
#define LEAF_COUNT_SHIFT 27u
#define LEAF_PACKET_MASK 134217727u
#define LEAF_DISC_SHIFT 28u
#define LEAF_ROUND_MASK 268435455u
#define LEAF_INSTANCE_MASK 536870911u
#define MATERIAL_DIFFUSE 0u
#define MATERIAL_PHONG 1u
#define MATERIAL_MIRROR 2u
#define MATERIAL_CONDUCTOR 3u
#define MATERIAL_PLASTIC 4u
#define MATERIAL_DIELECTRIC 5u
#define MATERIAL_THIN_DIELECTRIC 6u
#define MATERIAL_DIFFUSE_TRANSMISSION 7u
#define MATERIAL_BLACK 8u
#define MATERIAL_FLAG_FRESNEL 1u
#define MATERIAL_FLAG_COMPENSATE 2u
#define ALBEDO_NODES 32u
#define ALBEDO_AZIMUTHS 5u
#define TEXTURE_CONSTANT 0u
#define TEXTURE_CHECKER 1u
#define TEXTURE_IMAGE 2u
#define TEXTURE_BILINEAR 1u
#define LIGHT_POINT 0u
#define LIGHT_SPOT 1u
#define LIGHT_DIRECTIONAL 2u
#define LIGHT_QUAD 3u
#define LIGHT_DISC 4u
#define LIGHT_SPHERE 5u
#define LIGHT_MESH 6u
#define LIGHT_ENVIRONMENT 7u
#define LIGHT_TWO_SIDED 1u
#define OPTION_ALL_LIGHTS 1u
#define OPTION_NO_MIS 2u
#define OPTION_LIGHT_TREE 4u
#define OPTION_LIGHTS_TO_MEET 8u
#define LEVEL_NONE 255u
#define OPTION_TOGETHER 16u
#define OPTION_OTHER_SHIFT 16u
#define GROUP_PIXEL 1u
#define GROUP_LENS 2u
#define GROUP_TIME 4u
#define GROUP_LIGHTS 8u
#define GROUP_DIRECTIONS 16u
#define DRAWN_BOUNCE 2u
#define DRAWN_COUNT 8u
#define SUM_RGBA 0u
#define SUM_TAKEN 4u
#define SUM_LIT 5u
#define SUM_REJECTED 6u
#define SUM_REJECTED_IN 7u
#define SUM_RAYS 8u
#define SUM_PLANES 9u
#define SAMPLER_REGULAR 0u
#define SAMPLER_RANDOM 1u
#define SAMPLER_INDEPENDENT 2u
#define SAMPLER_STRATIFIED 3u
#define SAMPLER_JITTERED 4u
#define SAMPLER_SOBOL 5u
#define SAMPLER_BLUE_NOISE 6u

typedef struct {
  float world_from_camera[3][4];
  float scale_x;
  float scale_y;
  float aperture_radius;
  float focus_distance;
  float blade_rotation;
  float shutter_open;
  float shutter_close;
  uint kind;
  uint blades;
  uint first_keyframe;
  uint keyframe_count;
  uint pad0;
} Camera;
// sizeof(Camera) == 96

typedef struct {
  Camera camera;
  ulong seed;
  ulong first_sample;
  uint sample_count;
  uint first_replicate;
  uint replicate_count;
  uint strata;
  uint tile_x;
  uint tile_y;
  uint tile_width;
  uint tile_height;
  uint film_width;
  uint film_height;
  float filter_radius;
  uint max_bounces;
  uint roulette_start;
  uint shadow_rays;
  uint light_count;
  uint plane_count;
  uint items_per_group;
  uint item_count;
  uint root;
  uint environment_light;
  uint log2_samples;
  uint options;
  uint kept;
  uint sum_stride;
} Params;
// sizeof(Params) == 208

typedef struct {
  float albedo_depth[4];
  float normal[3];
  uint object_id;
} Layers;
// sizeof(Layers) == 32

typedef struct {
  float rotation[4];
  float translation[3];
  float time;
  float stretch[3][4];
} Keyframe;
// sizeof(Keyframe) == 80

typedef struct {
  float object_from_world[3][4];
  float world_from_object[3][4];
  uint root;
  uint first_keyframe;
  uint keyframe_count;
  uint object_id;
  uint inner_first_keyframe;
  uint inner_keyframe_count;
  uint slides;
  uint motion_node;
} Instance;
// sizeof(Instance) == 128

typedef struct {
  float lo_x[8];
  float hi_x[8];
  float lo_y[8];
  float hi_y[8];
  float lo_z[8];
  float hi_z[8];
  uint child[8];
  uint pad[8];
} Node8;
// sizeof(Node8) == 256

typedef struct {
  float v0[3][8];
  float v1[3][8];
  float v2[3][8];
  uint primitive[8];
} Packet8;
// sizeof(Packet8) == 320

typedef struct {
  float corner[24][4];
  uchar index[24];
  uint corners;
  uint triangles;
} PacketCorners;
// sizeof(PacketCorners) == 416

typedef struct {
  uchar lo_x[8];
  uchar hi_x[8];
  uchar lo_y[8];
  uchar hi_y[8];
  uchar lo_z[8];
  uchar hi_z[8];
  uint child[8];
  float origin[3];
  uint exponents;
} CompactNode;
// sizeof(CompactNode) == 96

typedef struct {
  float v0[3];
  float v1[3];
  float v2[3];
  uint primitive;
  uint last;
  uint pad0;
} CompactTriangle;
// sizeof(CompactTriangle) == 48

typedef struct {
  float center[3];
  float radius;
  float frame[3];
  uint shape;
} SphereData;
// sizeof(SphereData) == 32

typedef struct {
  float center[3];
  uint shape;
  float u[4];
  float v[4];
} DiscData;
// sizeof(DiscData) == 48

typedef struct {
  float point[3];
  uint shape;
  float normal[4];
  float tangent_u[4];
  float tangent_v[4];
  uint first_keyframe;
  uint keyframe_count;
  uint pad0;
  uint pad1;
} PlaneData;
// sizeof(PlaneData) == 80

typedef struct {
  uint material;
  uint light;
  uint flags;
  uint object_id;
  int normal_offset;
  int uv_offset;
  uint first_triangle;
  uint triangle_count;
  uint deform_stride;
  uint deform_count;
  uint deform_first_time;
  uint pad0;
} ShapeData;
// sizeof(ShapeData) == 48

typedef struct {
  uint vertex[3];
  uint shape;
} TriangleData;
// sizeof(TriangleData) == 16

typedef struct {
  float color0[3];
  uint texture0;
  float color1[3];
  uint texture1;
  float alpha_x;
  float alpha_y;
  float rotation;
  float ior;
  float exponent;
  uint type;
  uint flags;
  uint albedo;
} Material;
// sizeof(Material) == 64

typedef struct {
  float color0[3];
  uint type;
  float color1[3];
  uint flags;
  float uv_scale[2];
  float uv_offset[2];
  uint width;
  uint height;
  ulong first_texel;
} Texture;
// sizeof(Texture) == 64

typedef struct {
  float radiance[3];
  uint type;
  float position[3];
  uint shape;
  float direction[3];
  float inner;
  float axis_v[3];
  float outer;
  float area;
  float pmf;
  uint first_cdf;
  uint triangle_count;
  uint first_triangle;
  uint instance;
  uint flags;
  uint first_keyframe;
  uint keyframe_count;
  uint width;
  uint height;
  uint leaf;
} Light;
// sizeof(Light) == 112

typedef struct {
  float x[8];
  float y[8];
  float z[8];
  float radius[8];
  float axis_x[8];
  float axis_y[8];
  float axis_z[8];
  float cos_spread[8];
  float sin_spread[8];
  float cos_falloff[8];
  float strength[8];
  uint child[8];
  uint count[8];
} LightNode;
// sizeof(LightNode) == 416

typedef struct {
  float threshold;
  uint other;
  float pmf;
  float first;
} Alias;
// sizeof(Alias) == 16
