/* probe.h: what the kernels that ask devices about the rules share (probe.cl, exhaust.cl, probe_paths.cl). Nothing that
 * renders includes it.
 */
#ifndef RT_PROBE_H
#define RT_PROBE_H

#include "kernels/film.h"
#include "kernels/vec.h"

RT_FN rt_uint rt_probe_mix(rt_uint hash, rt_uint word)
{
	hash = (hash ^ word) * 0x9e3779b1u;
	return hash ^ (hash >> 15);
}

RT_FN rt_uint rt_probe_mix_float(rt_uint hash, rt_float x) { return rt_probe_mix(hash, rt_bits(x)); }

RT_FN rt_uint rt_probe_mix_vector(rt_uint hash, rt_vec3 v)
{
	return rt_probe_mix_float(rt_probe_mix_float(rt_probe_mix_float(hash, v.x), v.y), v.z);
}

/* Is |v|^2 off 1 by more than 4 ulp? NaN is. */
RT_FN rt_mask rt_probe_wrong_length(rt_vec3 v)
{
	rt_float off = rt_abs(v3_dot(v, v) - 1.0f);
	return rt_not(off <= rt_splat(0x1p-21f));
}

typedef struct rt_probe_words {
	rt_uint low, high;
} rt_probe_words;

/* The integer of 64 bits that one sample of radiance v makes at scale 2^40. */
RT_FN rt_probe_words rt_probe_film(rt_float v)
{
	rt_u32 highs[RT_LANES], lows[RT_LANES];
	rt_probe_words words;
	rt_channel_sum sum = rt_channel_sample(v, 0x1p40f, 0x1p20f);
	rt_store_u(sum.high, highs);
	rt_store_u(sum.low, lows);
	for (rt_u32 lane = 0u; lane < RT_LANES; ++lane) {
		rt_u64 value = (rt_u64)rt_channel_total(highs[lane], lows[lane], 1u);
		lows[lane] = (rt_u32)(value & 0xffffffffu);
		highs[lane] = (rt_u32)(value >> 32);
	}
	words.low = RT_GATHER_U(lows, rt_lane_ids(), );
	words.high = RT_GATHER_U(highs, rt_lane_ids(), );
	return words;
}

#endif
