// Textures: a colour in [0, 1] at a surface point. uv (0, 0) is an image's lower left; texels are stored row by row from the
// top, linear Rec.709. Any uv gives a colour: those that are not finite count as 0.
#include "base/types.h"

#define TEXTURE_WRAP_SHIFT 1u  // flags: bit 0 bilinear, bits 1-2 wrap
#define TEXTURE_WRAP_MASK 3u
#define WRAP_REPEAT 0u
#define WRAP_MIRROR 1u
#define WRAP_CLAMP 2u

// Largest integer not above x. From 2^23 on floats are integers.
static inline float floor_of(const float x) {
  if (!(FABS(x) < 8388608.0f)) return x;
  const float truncated = (float)(int)x;
  return truncated > x ? truncated - 1.0f : truncated;
}

// Folds a coordinate into [0, 1] by the wrap mode.
static inline float wrap_coordinate(const float x, const uint wrap) {
  if (!is_finite(x)) return 0.0f;
  if (wrap == WRAP_CLAMP) return CLAMP01(x);
  if (wrap == WRAP_REPEAT) return x - floor_of(x);
  const float period = x - 2.0f * floor_of(0.5f * x);
  return period > 1.0f ? 2.0f - period : period;
}

// Index of a texel at most one beyond an edge: the other edge's when repeating, else (clamped or mirrored) the edge's own.
static inline int wrap_texel(const int i, const int count, const uint wrap) {
  if (i < 0) return wrap == WRAP_REPEAT ? count - 1 : 0;
  if (i >= count) return wrap == WRAP_REPEAT ? 0 : count - 1;
  return i;
}

static inline float3 texel_at(const SceneData *scene, const __global Texture *texture, const int x, const int y) {
  return scene->texels[texture->first_texel + (ulong)y * texture->width + (ulong)x].xyz;
}

static inline float3 image_nearest(const SceneData *scene, const __global Texture *texture, const float u, const float v) {
  const int width = (int)texture->width, height = (int)texture->height;
  const int x = MIN((int)(u * (float)width), width - 1);
  const int y = MIN((int)((1.0f - v) * (float)height), height - 1);
  return texel_at(scene, texture, x, y);
}

static inline float3 image_bilinear(const SceneData *scene, const __global Texture *texture, const float u, const float v,
                                    const uint wrap) {
  const int width = (int)texture->width, height = (int)texture->height;
  const float x = u * (float)width - 0.5f, y = (1.0f - v) * (float)height - 0.5f;
  const float x0 = floor_of(x), y0 = floor_of(y);
  const float fx = x - x0, fy = y - y0;
  const int left = wrap_texel((int)x0, width, wrap), right = wrap_texel((int)x0 + 1, width, wrap);
  const int top = wrap_texel((int)y0, height, wrap), bottom = wrap_texel((int)y0 + 1, height, wrap);
  const float3 upper = texel_at(scene, texture, left, top) * (1.0f - fx) + texel_at(scene, texture, right, top) * fx;
  const float3 lower = texel_at(scene, texture, left, bottom) * (1.0f - fx) + texel_at(scene, texture, right, bottom) * fx;
  return upper * (1.0f - fy) + lower * fy;
}

// Squares of side 1/2: color0 where both coordinates lie in the same half of their period.
static inline float3 checker(const __global Texture *texture, const float u, const float v) {
  const bool same = (u - floor_of(u) >= 0.5f) == (v - floor_of(v) >= 0.5f);
  return load3(same ? texture->color0 : texture->color1);
}

// Texture number `index` at uv.
static inline float3 texture_lookup(const SceneData *scene, const uint index, const float2 uv) {
  const __global Texture *texture = scene->textures + index;
  const float u = uv.x * texture->uv_scale[0] + texture->uv_offset[0];
  const float v = uv.y * texture->uv_scale[1] + texture->uv_offset[1];
  if (texture->type == TEXTURE_IMAGE) {
    const uint wrap = (texture->flags >> TEXTURE_WRAP_SHIFT) & TEXTURE_WRAP_MASK;
    const float s = wrap_coordinate(u, wrap), t = wrap_coordinate(v, wrap);
    if (texture->flags & TEXTURE_BILINEAR) return image_bilinear(scene, texture, s, t, wrap);
    return image_nearest(scene, texture, s, t);
  }
  if (texture->type == TEXTURE_CHECKER) return checker(texture, is_finite(u) ? u : 0.0f, is_finite(v) ? v : 0.0f);
  return load3(texture->color0);
}
