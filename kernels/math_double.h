/* math_double.h: the polynomials of kernels/math.h for the double rung: the only literals of a kernel without f.
 *
 * Made by tools/fit_polynomials.py --double. Errors of the functions that use them: sine and cosine below 1.6e-16,
 * atan2 below 7e-17 turns (tests/test_precision.cpp).
 */
#ifndef RT_MATH_DOUBLE_H
#define RT_MATH_DOUBLE_H

#include "common/rt_compat.h"

#if RT_PRECISION == RT_PRECISION_DOUBLE

/* sin(pi/2 f), cos(pi/2 f) and atan(t) / (2 pi t), of f and the squares. */
RT_FN rt_float rt_sine_polynomial(rt_float f, rt_float f2)
{
	rt_float s = rt_fma(f2, 0x1.e3eed68ad07ccp-25, -0x1.e30063a252650p-19);
	s = rt_fma(f2, s, 0x1.50782fca3b169p-13);
	s = rt_fma(f2, s, -0x1.32d2cce2d5387p-8);
	s = rt_fma(f2, s, 0x1.466bc67758700p-4);
	s = rt_fma(f2, s, -0x1.4abbce625be41p-1);
	return f * rt_fma(f2, s, 0x1.921fb54442d18p+0);
}

RT_FN rt_float rt_cosine_polynomial(rt_float f2)
{
	rt_float c = rt_fma(f2, -0x1.b27363485f647p-28, 0x1.f9cc777537e79p-22);
	c = rt_fma(f2, c, -0x1.a6d1ecc96ecd8p-16);
	c = rt_fma(f2, c, 0x1.e1f50683ce548p-11);
	c = rt_fma(f2, c, -0x1.55d3c7e3c96f4p-6);
	c = rt_fma(f2, c, 0x1.03c1f081b5ab1p-2);
	c = rt_fma(f2, c, -0x1.3bd3cc9be45dep+0);
	return rt_fma(f2, c, rt_splat(1.0f));
}

RT_FN rt_float rt_angle_polynomial(rt_float t2)
{
	rt_float p = rt_fma(t2, -0x1.6dbde14043c4bp-20, 0x1.12adaeb3af0afp-16);
	p = rt_fma(t2, p, -0x1.88708144634b9p-14);
	p = rt_fma(t2, p, 0x1.647e4d3492877p-12);
	p = rt_fma(t2, p, -0x1.d1919ec02755ap-11);
	p = rt_fma(t2, p, 0x1.d60b2b4dcba93p-10);
	p = rt_fma(t2, p, -0x1.83086848a029ep-9);
	p = rt_fma(t2, p, 0x1.102f8503de125p-8);
	p = rt_fma(t2, p, -0x1.558a5f9aee795p-8);
	p = rt_fma(t2, p, 0x1.8e4d909a39daep-8);
	p = rt_fma(t2, p, -0x1.befa191121a45p-8);
	p = rt_fma(t2, p, 0x1.eedfd9ae96690p-8);
	p = rt_fma(t2, p, -0x1.1248ad4d2895bp-7);
	p = rt_fma(t2, p, 0x1.32bdcd9972c34p-7);
	p = rt_fma(t2, p, -0x1.5bacbc8a9ced7p-7);
	p = rt_fma(t2, p, 0x1.912aff3a8887fp-7);
	p = rt_fma(t2, p, -0x1.da1baae2b829cp-7);
	p = rt_fma(t2, p, 0x1.21bb944661910p-6);
	p = rt_fma(t2, p, -0x1.7483758e1242ap-6);
	p = rt_fma(t2, p, 0x1.04c26be3afc29p-5);
	p = rt_fma(t2, p, -0x1.b2995e7b7b5f3p-5);
	return rt_fma(t2, p, 0x1.45f306dc9c883p-3);
}

#endif

#endif
