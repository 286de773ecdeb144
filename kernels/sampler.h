/* sampler.h: where a path's random numbers come from: the choice of sampler (contract rule 14).
 *
 * A block is four numbers, two points of the unit square: (a, b) and (c, d). Which block belongs to what is said in
 * kernels/rng.h. Every number is a pure function of (seed, pixel, sample, block); none depends on how many samples
 * there will be, so a render may go on.
 *   independent  the hash itself
 *   sobol        each of the two points is one of an Owen-scrambled (0, 2)-sequence over the pixel's samples: in the
 *                first 2^m samples every box of 2^-k by 2^(k - m) has one point. Points of other blocks and pixels
 *                are other scrambles in another order (padding)
 *   stratified   the camera's block as sobol, so that pixel and lens are covered evenly, the others independent
 */
#ifndef RT_SAMPLER_H
#define RT_SAMPLER_H

#include "common/rt_features.h"
#include "common/rt_structs.h"
#include "kernels/rng.h"

#if RT_HAS(RT_FEATURE_SOBOL) || RT_HAS(RT_FEATURE_STRATIFIED)

/* What takes the sample's place in the hash where a point's scrambles are drawn. No sample has these numbers. */
#define RT_SCRAMBLE_AB 0xfffffffeu
#define RT_SCRAMBLE_CD 0xffffffffu

typedef struct rt_random2 {
	rt_float a, b;
} rt_random2;

RT_FN rt_uint rt_reverse_bits(rt_uint v)
{
	v = ((v & 0x55555555u) << 1) | ((v >> 1) & 0x55555555u);
	v = ((v & 0x33333333u) << 2) | ((v >> 2) & 0x33333333u);
	v = ((v & 0x0f0f0f0fu) << 4) | ((v >> 4) & 0x0f0f0f0fu);
	v = ((v & 0x00ff00ffu) << 8) | ((v >> 8) & 0x00ff00ffu);
	return (v << 16) | (v >> 16);
}

/* Flips each bit or not by a hash of the seed and the bits below it: with bits in reverse, Owen's nested scramble. The
 * form is that of Laine and Karras 2011 as used by Burley 2020 ("Practical Hash-based Owen Scrambling", JCGT 9(4));
 * operations and constants are those that Vegdahl found to scramble better ("Building a Better LK Hash",
 * psychopath.io, 2021-01-30 with its correction of 2021-05-08). */
RT_FN rt_uint rt_nested_flips(rt_uint v, rt_uint seed)
{
	v ^= v * 0x3d20adeau;
	v += seed;
	v *= (seed >> 16) | 1u;
	v ^= v * 0x05526c56u;
	v ^= v * 0x53a22864u;
	return v;
}

/* Sobol's second dimension of point v, lowest bit first. Its matrix is Pascal's triangle modulo 2, the product of five
 * steps because C(j, i) is odd just if no bit of i is missing in j (Lucas); the first dimension's is the identity. */
RT_FN rt_uint rt_pascal(rt_uint v)
{
	v ^= (v >> 1) & 0x55555555u;
	v ^= (v >> 2) & 0x33333333u;
	v ^= (v >> 4) & 0x0f0f0f0fu;
	v ^= (v >> 8) & 0x00ff00ffu;
	return v ^ (v >> 16);
}

/* The point of the sample whose bits in reverse are given. The hash's lowest bits are weak (docs/random.md) and would
 * decide about halves of the square, so its highest are folded onto them.
 * No struct is handed on from a caller: of two calls with one struct, a member changed between them, Mesa's compiler
 * loses the first (docs/devices.md, rusticl). */
RT_FN rt_random2 rt_sobol_point(rt_uint seed, rt_uint pixel, rt_uint scramble, rt_uint block, rt_uint reversed_sample)
{
	rt_words4 words = rt_block_words(seed, pixel, scramble, block);
	rt_uint order = words.x ^ (words.x >> 16);
	rt_uint seed_a = words.y ^ (words.y >> 16);
	rt_uint seed_b = words.z ^ (words.z >> 16);
	rt_uint index = rt_reverse_bits(rt_nested_flips(reversed_sample, order));
	rt_random2 u;
	u.a = rt_unit(rt_reverse_bits(rt_nested_flips(index, seed_a)));
	u.b = rt_unit(rt_reverse_bits(rt_nested_flips(rt_pascal(index), seed_b)));
	return u;
}

RT_FN rt_random4 rt_sobol(rt_u32 seed, rt_uint pixel, rt_uint sample, rt_uint block)
{
	rt_uint seeds = rt_splat_u(seed);
	rt_uint reversed_sample = rt_reverse_bits(sample);
	rt_random2 ab = rt_sobol_point(seeds, pixel, rt_splat_u(RT_SCRAMBLE_AB), block, reversed_sample);
	rt_random2 cd = rt_sobol_point(seeds, pixel, rt_splat_u(RT_SCRAMBLE_CD), block, reversed_sample);
	rt_random4 u;
	u.a = ab.a;
	u.b = ab.b;
	u.c = cd.a;
	u.d = cd.b;
	return u;
}

#endif

/* Block 0, the camera's. */
RT_FN rt_random4 rt_camera_numbers(RT_UNIFORM const rt_scene* scene, rt_uint pixel, rt_uint sample)
{
#if RT_HAS(RT_FEATURE_SOBOL) || RT_HAS(RT_FEATURE_STRATIFIED)
	if (scene->sampler != RT_SAMPLER_INDEPENDENT)
		return rt_sobol(scene->seed, pixel, sample, rt_splat_u(0u));
#endif
	return rt_random(scene->seed, pixel, sample, rt_splat_u(0u));
}

/* Block k + 1, the k-th scattering's. */
RT_FN rt_random4 rt_scattering_numbers(RT_UNIFORM const rt_scene* scene, rt_uint pixel, rt_uint sample, rt_uint block)
{
#if RT_HAS(RT_FEATURE_SOBOL)
	if (scene->sampler == RT_SAMPLER_SOBOL)
		return rt_sobol(scene->seed, pixel, sample, block);
#endif
	return rt_random(scene->seed, pixel, sample, block);
}

#endif
