/* vec.h: three-vectors, one a lane. Every product that feeds a sum is an explicit fma (contract rule 3). */
#ifndef RT_VEC_H
#define RT_VEC_H

#include "kernels/math.h"

typedef struct rt_vec3 {
	rt_float x, y, z;
} rt_vec3;

RT_FN rt_vec3 v3(rt_float x, rt_float y, rt_float z)
{
	rt_vec3 v;
	v.x = x;
	v.y = y;
	v.z = z;
	return v;
}

/* The same three scalars in every lane. */
RT_FN rt_vec3 v3_splat(float x, float y, float z) { return v3(rt_splat(x), rt_splat(y), rt_splat(z)); }

RT_FN rt_vec3 v3_add(rt_vec3 a, rt_vec3 b) { return v3(a.x + b.x, a.y + b.y, a.z + b.z); }

RT_FN rt_vec3 v3_sub(rt_vec3 a, rt_vec3 b) { return v3(a.x - b.x, a.y - b.y, a.z - b.z); }

RT_FN rt_vec3 v3_negate(rt_vec3 a) { return v3(-a.x, -a.y, -a.z); }

RT_FN rt_vec3 v3_mul(rt_vec3 a, rt_vec3 b) { return v3(a.x * b.x, a.y * b.y, a.z * b.z); }

RT_FN rt_vec3 v3_scale(rt_float s, rt_vec3 a) { return v3(s * a.x, s * a.y, s * a.z); }

/* s a + b, each component rounded once */
RT_FN rt_vec3 v3_fma(rt_float s, rt_vec3 a, rt_vec3 b)
{
	return v3(rt_fma(s, a.x, b.x), rt_fma(s, a.y, b.y), rt_fma(s, a.z, b.z));
}

RT_FN rt_float v3_dot(rt_vec3 a, rt_vec3 b) { return rt_fma(a.x, b.x, rt_fma(a.y, b.y, a.z * b.z)); }

RT_FN rt_vec3 v3_sel(rt_mask mask, rt_vec3 yes, rt_vec3 no)
{
	return v3(rt_sel(mask, yes.x, no.x), rt_sel(mask, yes.y, no.y), rt_sel(mask, yes.z, no.z));
}

/* v / |v|, or `fallback` where v is too short to have a direction. */
RT_FN rt_vec3 v3_normalize(rt_vec3 v, rt_vec3 fallback)
{
	rt_float square = v3_dot(v, v);
	rt_mask defined = square > rt_splat(RT_MIN_SQUARE);
	return v3_sel(defined, v3_scale(rt_inverse_root(square), v), fallback);
}

/* v / |v| for a v whose length is within 1e-3 of 1: one Newton step from 1 for 1 / |v|. Its error, 3/8 of the square of
 * |v|^2 - 1, is far below a rounding where the length is off by roundings only; no root, no division. */
RT_FN rt_vec3 v3_renormalize(rt_vec3 v) { return v3_scale(rt_fma(rt_splat(-0.5f), v3_dot(v, v), rt_splat(1.5f)), v); }

#endif
