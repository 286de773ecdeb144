/* texture.h: colour of a textured sphere at a normal.
 *
 * With the outward unit normal n: u = (atan2(-n.z, n.x) + pi) / 2 pi, v = acos(-n.y) / pi (shared with docs/manual.md).
 * v comes from asin(n.y) = atan2(n.y, sqrt(n.x^2 + n.z^2)), which keeps its digits at the poles, where u is 0.
 */
#ifndef RT_TEXTURE_H
#define RT_TEXTURE_H

#include "common/rt_features.h"
#include "common/rt_structs.h"
#include "kernels/srgb_table.h"
#include "kernels/vec.h"

#if RT_HAS(RT_FEATURE_CHECKER) || RT_HAS(RT_FEATURE_IMAGE)

/* floor(x) of a coordinate >= 0 as an index in [0, count - 1]; the cast is of a number within range (contract rule 16).
 */
RT_FN rt_int rt_cell(rt_float x, rt_float count)
{
	rt_float last = count - 1.0f;
	rt_float inside = rt_sel(x > rt_splat(0.0f), x, rt_splat(0.0f));
	return rt_to_int(rt_sel(inside < last, inside, last));
}

/* Colour of texture `index` (valid in every lane). */
RT_FN rt_vec3 rt_texture_color(RT_GLOBAL const rt_texture* RT_RESTRICT textures,
                               RT_GLOBAL const rt_u32* RT_RESTRICT texels, rt_int index, rt_vec3 n)
{
	rt_vec3 color = v3_splat(0.0f, 0.0f, 0.0f);
	rt_float around = rt_atan2_turns(-n.z, n.x);                                 /* u - 1/2 */
	rt_float height = rt_atan2_turns(n.y, rt_sqrt(rt_fma(n.x, n.x, n.z * n.z))); /* (v - 1/2) / 2 */
	rt_mask pole = (n.x == rt_splat(0.0f)) & (n.z == rt_splat(0.0f));
	rt_float u = rt_sel(pole, rt_splat(0.0f), around + 0.5f);
	rt_uint kind = RT_GATHER_U(textures, index, .kind);
	rt_mask image = kind == rt_splat_u(RT_TEXTURE_IMAGE);

#if RT_HAS(RT_FEATURE_CHECKER)
	if (rt_any(rt_not(image))) {
		rt_float squares = RT_GATHER_F(textures, index, .squares);
		rt_float v = rt_fma(height, rt_splat(2.0f), rt_splat(0.5f));
		/* 2^20: more squares than a texture may have */
		rt_int column = rt_cell(u * squares, rt_splat(0x1p20f));
		rt_int row = rt_cell(v * squares, rt_splat(0x1p20f));
		rt_mask odd = ((column + row) & 1) != 0;
		color = v3(rt_sel(odd, RT_GATHER_F(textures, index, .odd_r), RT_GATHER_F(textures, index, .even_r)),
		           rt_sel(odd, RT_GATHER_F(textures, index, .odd_g), RT_GATHER_F(textures, index, .even_g)),
		           rt_sel(odd, RT_GATHER_F(textures, index, .odd_b), RT_GATHER_F(textures, index, .even_b)));
	}
#endif

#if RT_HAS(RT_FEATURE_IMAGE)
	if (rt_any(image)) {
		/* A checker has no texels: those lanes read texel 0 and are selected away. */
		rt_float width = rt_to_float(rt_to_int(RT_GATHER_U(textures, index, .width)));
		rt_float height_texels = rt_to_float(rt_to_int(RT_GATHER_U(textures, index, .height)));
		rt_int column = rt_cell(u * width, width);
		/* Row 0 is the top, v = 1. */
		rt_int row = rt_cell(rt_fma(height, rt_splat(-2.0f), rt_splat(0.5f)) * height_texels, height_texels);
		rt_uint first = RT_GATHER_U(textures, index, .first_texel);
		rt_uint texel = first + rt_to_uint(row) * RT_GATHER_U(textures, index, .width) + rt_to_uint(column);
		rt_uint packed = RT_GATHER_U(texels, rt_sel(image, texel, rt_splat_u(0u)), );
		rt_uint red = packed & 0xffu;
		rt_uint green = (packed >> 8) & 0xffu;
		rt_uint blue = (packed >> 16) & 0xffu;
		color = v3_sel(image,
		               v3(RT_GATHER_F(rt_srgb_table, red, ), RT_GATHER_F(rt_srgb_table, green, ),
		                  RT_GATHER_F(rt_srgb_table, blue, )),
		               color);
	}
#endif
	return color;
}

#endif

#endif
