/* math.h: the elementary functions, defined so that every device computes the same bits.
 *
 * Square root and reciprocal are correctly rounded: by the device's own means where the self-test proves them
 * (RT_DEF_NATIVE_ROOTS), else by the fma sequences below, whose result is the correctly rounded one for every seed
 * within 4 ulp. The rest is polynomials in fma Horner form with hex-float constants; tools/fit_polynomials.py made
 * them. Those of the double rung are in kernels/math_double.h.
 */
#ifndef RT_MATH_H
#define RT_MATH_H

#include "common/rt_compat.h"
#include "common/rt_contract.h"
#include "kernels/math_double.h"

#if !RT_DEF_NATIVE_ROOTS

#if !RT_HARDWARE_SEEDS
/* An integer guess and Newton steps: within 2 ulp over the contract's range. */
RT_FN rt_float rt_seed_rsqrt(rt_float x)
{
	rt_float y = rt_from_bits(0x5f375a86u - (rt_bits(x) >> 1));
	rt_float half_x = -0.5f * x;
	y = y * rt_fma(half_x * y, y, rt_splat(1.5f));
	y = y * rt_fma(half_x * y, y, rt_splat(1.5f));
	y = y * rt_fma(half_x * y, y, rt_splat(1.5f));
	return y;
}
RT_FN rt_float rt_seed_rcp(rt_float x)
{
	rt_float y = rt_from_bits(0x7ef311c7u - rt_bits(x));
	y = rt_fma(rt_fma(-x, y, rt_splat(1.0f)), y, y);
	y = rt_fma(rt_fma(-x, y, rt_splat(1.0f)), y, y);
	y = rt_fma(rt_fma(-x, y, rt_splat(1.0f)), y, y);
	return y;
}
#endif

/* Coupled iteration for g ~ sqrt(x) and h ~ 1 / (2 sqrt(x)) and one residual step (Markstein 1990; the form of IA-64's
 * software square root, Cornea, Harrison and Tang 2002, section 9.4). Needs x normal and above 2^-100. */
RT_FN rt_float rt_root(rt_float x)
{
	rt_float y = rt_seed_rsqrt(x);
	rt_float h = 0.5f * y;
	rt_float g = x * y;
	rt_float d = rt_fma(-g, h, rt_splat(0.5f));
	h = rt_fma(d, h, h);
	g = rt_fma(d, g, g);
	return rt_fma(rt_fma(-g, g, x), h, g);
}

/* 1 / x: two Newton steps round correctly except for the divisor mantissa of all ones, whose reciprocal lies just above
 * the middle of two floats (Markstein's exception); its bits are known: 0x7f000000 - bits(x). */
RT_FN rt_float rt_rcp(rt_float x)
{
	rt_float y = rt_seed_rcp(x);
	y = rt_fma(rt_fma(-x, y, rt_splat(1.0f)), y, y);
	y = rt_fma(rt_fma(-x, y, rt_splat(1.0f)), y, y);
	return rt_sel((rt_bits(x) & 0x7fffffu) == rt_splat_u(0x7fffffu), rt_from_bits(0x7f000000u - rt_bits(x)), y);
}

#else

RT_FN rt_float rt_root(rt_float x) { return rt_native_sqrt(x); }

/* 1 / x, correctly rounded, for 2^-100 <= |x| <= 2^100; elsewhere devices may differ, so callers select it away. */
RT_FN rt_float rt_rcp(rt_float x) { return rt_native_rcp(x); }

#endif

/* sqrt(x), correctly rounded, for x > 2^-100; 0 for everything else, NaN included. */
RT_FN rt_float rt_sqrt(rt_float x) { return rt_sel(x > rt_splat(RT_MIN_SQUARE), rt_root(x), rt_splat(0.0f)); }

/* 1 / sqrt(x), rounded twice, for x > 2^-100; the fast rung has one operation for it. */
#if RT_FAST(RT_FAST_ROOTS)
RT_FN rt_float rt_inverse_root(rt_float x) { return rt_fast_rsqrt(x); }
#else
RT_FN rt_float rt_inverse_root(rt_float x) { return rt_rcp(rt_root(x)); }
#endif

/* The smaller and the larger; b where either is NaN. */
RT_FN rt_float rt_min(rt_float a, rt_float b) { return rt_sel(a < b, a, b); }
RT_FN rt_float rt_max(rt_float a, rt_float b) { return rt_sel(a > b, a, b); }
RT_FN rt_float rt_abs(rt_float a) { return rt_from_bits(rt_bits(a) & ~RT_SIGN_BIT); }

#if RT_PRECISION != RT_PRECISION_DOUBLE
/* sin(pi/2 f), cos(pi/2 f) and atan(t) / (2 pi t), of f and the squares. */
RT_FN rt_float rt_sine_polynomial(rt_float f, rt_float f2)
{
	rt_float s = rt_fma(f2, rt_splat(-0x1.2d9302p-8f), rt_splat(0x1.465e92p-4f));
	s = rt_fma(f2, s, rt_splat(-0x1.4abbbap-1f));
	return f * rt_fma(f2, s, rt_splat(0x1.921fb6p+0f));
}
RT_FN rt_float rt_cosine_polynomial(rt_float f2)
{
	rt_float c = rt_fma(f2, rt_splat(0x1.d9fcf4p-11f), rt_splat(-0x1.55c67ap-6f));
	c = rt_fma(f2, c, rt_splat(0x1.03c1ep-2f));
	c = rt_fma(f2, c, rt_splat(-0x1.3bd3ccp+0f));
	return rt_fma(f2, c, rt_splat(1.0f));
}
RT_FN rt_float rt_angle_polynomial(rt_float t2)
{
	rt_float p = rt_fma(t2, rt_splat(0x1.db9b94p-12f), rt_splat(-0x1.4f343ep-9f));
	p = rt_fma(t2, p, rt_splat(0x1.bd49eep-8f));
	p = rt_fma(t2, p, rt_splat(-0x1.875cf6p-7f));
	p = rt_fma(t2, p, rt_splat(0x1.1578eep-6f));
	p = rt_fma(t2, p, rt_splat(-0x1.725f9ap-6f));
	p = rt_fma(t2, p, rt_splat(0x1.04a9cap-5f));
	p = rt_fma(t2, p, rt_splat(-0x1.b2988p-5f));
	return rt_fma(t2, p, rt_splat(0x1.45f306p-3f));
}
#endif

#if RT_FAST_HAS_SINCOS
/* The same of the device's own functions. Half a turn is taken off because they are best about 0. */
RT_FN void rt_sincos_turns(rt_float u, RT_PRIVATE rt_float* sine, RT_PRIVATE rt_float* cosine)
{
	rt_float angle = rt_fma(u, rt_splat(0x1.921fb6p+2f), rt_splat(-0x1.921fb6p+1f));
	*sine = -rt_fast_sin(angle);
	*cosine = -rt_fast_cos(angle);
}
#else
/* sin and cos of 2 pi u for u in [0, 1]: an exact reduction to a quarter turn, |f| <= 1/2, and a polynomial each.
 * Over all u = k 2^-24 the error is below 1e-7 and 2 ulp (tests/test_contract.cpp). */
RT_FN void rt_sincos_turns(rt_float u, RT_PRIVATE rt_float* sine, RT_PRIVATE rt_float* cosine)
{
	rt_int quadrant = rt_to_int(rt_fma(u, rt_splat(4.0f), rt_splat(0.5f)));
	rt_float f = rt_fma(u, rt_splat(4.0f), -rt_to_float(quadrant));
	rt_float f2 = f * f;
	rt_float s = rt_sine_polynomial(f, f2);
	rt_float c = rt_cosine_polynomial(f2);
	rt_mask odd = (quadrant & 1) != 0;
	rt_float a = rt_sel(odd, c, s);
	rt_float b = rt_sel(odd, s, c);
	*sine = rt_sel((quadrant & 2) != 0, -a, a);
	*cosine = rt_sel(((quadrant + 1) & 2) != 0, -b, b);
}

#endif

/* atan2(y, x) in turns, in [-1/2, 1/2]; 0 where x = y = 0. Octant reduction and an odd polynomial. */
RT_FN rt_float rt_atan2_turns(rt_float y, rt_float x)
{
	rt_float ax = rt_abs(x);
	rt_float ay = rt_abs(y);
	rt_mask steep = ay > ax;
	rt_mask behind = x < rt_splat(0.0f);
	rt_float larger = rt_sel(steep, ay, ax);
	rt_float smaller = rt_sel(steep, ax, ay);
	rt_mask defined = larger > rt_splat(RT_MIN_SQUARE);
	rt_float t = smaller * rt_rcp(rt_sel(defined, larger, rt_splat(1.0f)));
	rt_float t2 = t * t;
	rt_float p = rt_angle_polynomial(t2);
	/* The angle is start +- t p: from the nearest axis, towards or away from it. */
	rt_float start = rt_sel(steep, rt_splat(0.25f), rt_sel(behind, rt_splat(0.5f), rt_splat(0.0f)));
	rt_float angle = rt_fma(rt_sel((steep ^ behind) != 0, -t, t), p, start);
	angle = rt_sel(y < rt_splat(0.0f), -angle, angle);
	return rt_sel(defined, angle, rt_splat(0.0f));
}

#endif
