// texture.cl in sixteen lanes that look at the same texture.
#include "base/lanes16.cl"
#include "materials/texture.cl"

static inline float16 floor16(const float16 x) {
  const float16 truncated = to_float16(to_int16(x));
  const float16 below = truncated > x ? truncated - 1.0f : truncated;
  return abs16(x) < 8388608.0f ? below : x;
}

static inline float16 wrap_coordinate16(const float16 x, const uint wrap) {
  const float16 zero = 0.0f;
  float16 folded;
  if (wrap == WRAP_CLAMP) {
    folded = clamp01_16(x);
  } else if (wrap == WRAP_REPEAT) {
    folded = x - floor16(x);
  } else {
    const float16 period = x - 2.0f * floor16(0.5f * x);
    folded = period > 1.0f ? 2.0f - period : period;
  }
  return is_finite16(x) ? folded : zero;
}

static inline int16 wrap_texel16(const int16 i, const int count, const uint wrap) {
  const int16 first = 0, last = count - 1;
  const int16 up = i >= count ? (wrap == WRAP_REPEAT ? first : last) : i;
  return i < 0 ? (wrap == WRAP_REPEAT ? last : first) : up;
}

// A texture has fewer than 2^29 texels, so that a place in it is an int.
static inline Vec16 texels_at16(const SceneData *scene, const __global Texture *texture, const int16 x, const int16 y,
                                const Mask16 on) {
  const __global float *texels = (const __global float *)(scene->texels + texture->first_texel);
  return gather3_16(texels, as_uint16(y * (int)texture->width + x) * 4u, on);
}

static inline Vec16 image_nearest16(const SceneData *scene, const __global Texture *texture, const float16 u, const float16 v,
                                    const Mask16 on) {
  const int width = (int)texture->width, height = (int)texture->height;
  const int16 x = to_int16(u * (float)width), y = to_int16((1.0f - v) * (float)height);
  const int16 right = width - 1, bottom = height - 1;
  return texels_at16(scene, texture, MIN16(x, right), MIN16(y, bottom), on);
}

// a (1 - t) + b t.
static inline Vec16 mixed16(const Vec16 a, const Vec16 b, const float16 t) {
  return add16(scale16(a, 1.0f - t), scale16(b, t));
}

static inline Vec16 image_bilinear16(const SceneData *scene, const __global Texture *texture, const float16 u, const float16 v,
                                     const uint wrap, const Mask16 on) {
  const int width = (int)texture->width, height = (int)texture->height;
  const float16 x = u * (float)width - 0.5f, y = (1.0f - v) * (float)height - 0.5f;
  const float16 x0 = floor16(x), y0 = floor16(y);
  const float16 fx = x - x0, fy = y - y0;
  const int16 column = to_int16(x0), row = to_int16(y0);
  const int16 left = wrap_texel16(column, width, wrap), right = wrap_texel16(column + 1, width, wrap);
  const int16 top = wrap_texel16(row, height, wrap), bottom = wrap_texel16(row + 1, height, wrap);
  const Vec16 upper =
      mixed16(texels_at16(scene, texture, left, top, on), texels_at16(scene, texture, right, top, on), fx);
  const Vec16 lower =
      mixed16(texels_at16(scene, texture, left, bottom, on), texels_at16(scene, texture, right, bottom, on), fx);
  return mixed16(upper, lower, fy);
}

static inline Vec16 checker16(const __global Texture *texture, const float16 u, const float16 v) {
  const Mask16 apart = (u - floor16(u) >= 0.5f) ^ (v - floor16(v) >= 0.5f);
  return where16(apart, all16(load3(texture->color1)), all16(load3(texture->color0)));
}

// texture_lookup at (u, v); kept out of its callers, which look two colours up.
static PENUMBRA_NOINLINE PENUMBRA_WIDE void texture_lookup16(const SceneData *scene, const uint index, const float16 *u,
                                                             const float16 *v, const Mask16 *on, Vec16 *color) {
  const __global Texture *texture = scene->textures + index;
  const float16 s = *u * texture->uv_scale[0] + texture->uv_offset[0];
  const float16 t = *v * texture->uv_scale[1] + texture->uv_offset[1];
  const float16 zero = 0.0f;
  if (texture->type == TEXTURE_IMAGE) {
    const uint wrap = (texture->flags >> TEXTURE_WRAP_SHIFT) & TEXTURE_WRAP_MASK;
    const float16 x = wrap_coordinate16(s, wrap), y = wrap_coordinate16(t, wrap);
    *color = texture->flags & TEXTURE_BILINEAR ? image_bilinear16(scene, texture, x, y, wrap, *on)
                                               : image_nearest16(scene, texture, x, y, *on);
  } else if (texture->type == TEXTURE_CHECKER) {
    *color = checker16(texture, is_finite16(s) ? s : zero, is_finite16(t) ? t : zero);
  } else {
    *color = all16(load3(texture->color0));
  }
}
