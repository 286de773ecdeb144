/* rng.h: random numbers as a pure function of (seed, pixel, sample, block) (contract rule 14).
 *
 * A block is four numbers. Block 0 belongs to the camera (x, y in the pixel; two for the lens), block k + 1 to the k-th
 * scattering. Nothing is carried from one draw to the next, so no schedule can change a number.
 * The hash is pcg4d (Jarzynski and Olano 2020, "Hash Functions for GPU Rendering", JCGT 9(3), section 4.2): a bijection
 * of 128 bits, so two different (pixel, sample, block, seed) never give the same four words.
 */
#ifndef RT_RNG_H
#define RT_RNG_H

#include "common/rt_compat.h"

typedef struct rt_random4 {
	rt_float a, b, c, d; /* each k 2^-24 in [0, 1) */
} rt_random4;

typedef struct rt_words4 {
	rt_uint x, y, z, w;
} rt_words4;

RT_FN rt_uint rt_congruence(rt_uint v) { return v * 1664525u + 1013904223u; }

/* The published hash, word for word. */
RT_FN rt_words4 rt_pcg4d(rt_words4 v)
{
	rt_uint x = rt_congruence(v.x);
	rt_uint y = rt_congruence(v.y);
	rt_uint z = rt_congruence(v.z);
	rt_uint w = rt_congruence(v.w);
	x += y * w;
	y += z * x;
	z += x * y;
	w += y * z;
	x ^= x >> 16;
	y ^= y >> 16;
	z ^= z >> 16;
	w ^= w >> 16;
	x += y * w;
	y += z * x;
	z += x * y;
	w += y * z;
	v.x = x;
	v.y = y;
	v.z = z;
	v.w = w;
	return v;
}

/* The top 24 bits as a number in [0, 1). */
RT_FN rt_float rt_unit(rt_uint bits) { return rt_to_float(rt_to_int(bits >> 8)) * 0x1p-24f; }

/* The hash of what numbers are drawn for. */
RT_FN rt_words4 rt_block_words(rt_uint seed, rt_uint pixel, rt_uint sample, rt_uint block)
{
	rt_words4 words;
	words.x = pixel;
	words.y = sample;
	words.z = block;
	words.w = seed;
	return rt_pcg4d(words);
}

RT_FN rt_random4 rt_random(rt_u32 seed, rt_uint pixel, rt_uint sample, rt_uint block)
{
	rt_words4 words = rt_block_words(rt_splat_u(seed), pixel, sample, block);
	rt_random4 u;
	u.a = rt_unit(words.x);
	u.b = rt_unit(words.y);
	u.c = rt_unit(words.z);
	u.d = rt_unit(words.w);
	return u;
}

#endif
