/* peak.cl: how fast a device is at best: long chains of independent multiply-adds and nothing else, through the lane
 * types of the path tracer. render/peak.cpp times them.
 *
 * Twelve chains hide the latency of every device known (an fma takes 4 cycles, of which 2 begin in each) and fit, with
 * their constant, the 16 vector registers of AVX2. x <- x x + b does not settle, and no compiler can jump ahead in it.
 */
#include "common/rt_compat.h"

#define RT_PEAK_EACH_CHAIN(X) X(0) X(1) X(2) X(3) X(4) X(5) X(6) X(7) X(8) X(9) X(10) X(11)
/* One round of the loop: 8 multiply-adds of each chain (the host counts on it). */
#define RT_PEAK_ROUND(X)  \
	RT_PEAK_EACH_CHAIN(X) \
	RT_PEAK_EACH_CHAIN(X) \
	RT_PEAK_EACH_CHAIN(X) \
	RT_PEAK_EACH_CHAIN(X) \
	RT_PEAK_EACH_CHAIN(X) \
	RT_PEAK_EACH_CHAIN(X) \
	RT_PEAK_EACH_CHAIN(X) \
	RT_PEAK_EACH_CHAIN(X)

/* Every chain's end reaches memory, so that none can be left out. out: one word an item. */
RT_FN void rt_peak_store(RT_GLOBAL rt_u32* RT_RESTRICT out, rt_uint bits)
{
	rt_u32 words[RT_LANES];
	rt_u32 all = 0u;
	rt_store_u(bits, words);
	for (rt_u32 lane = 0u; lane < RT_LANES; ++lane)
		all ^= words[lane];
	out[RT_GLOBAL_ID] = all;
}

/* `out` has a word for each of the `items`; the backend may start more items. */
RT_KERNEL(rt_peak_fma)(RT_GLOBAL rt_u32* RT_RESTRICT out, rt_u32 items, rt_u32 rounds)
{
	rt_uint first = (rt_lane_ids() + RT_GLOBAL_ID) & 15u;
	rt_float b = rt_splat(-1.5f); /* x stays within [-1.5, 1.5], and never comes to rest */
	rt_uint all = rt_splat_u(0u);
#define RT_PEAK_DECLARE(i) rt_float x##i = rt_to_float(rt_to_int(first + rt_splat_u(i))) * rt_splat(0x1p-5f);
#define RT_PEAK_STEP(i) x##i = rt_fma(x##i, x##i, b);
#define RT_PEAK_FOLD(i) all = all ^ rt_bits(x##i);
	RT_PEAK_EACH_CHAIN(RT_PEAK_DECLARE)
	for (rt_u32 round = 0u; round < rounds; ++round) {
		RT_PEAK_ROUND(RT_PEAK_STEP)
	}
	RT_PEAK_EACH_CHAIN(RT_PEAK_FOLD)
#undef RT_PEAK_DECLARE
#undef RT_PEAK_STEP
#undef RT_PEAK_FOLD
	if (RT_GLOBAL_ID < items)
		rt_peak_store(out, all);
}

/* The same with 32-bit integers. */
RT_KERNEL(rt_peak_integer)(RT_GLOBAL rt_u32* RT_RESTRICT out, rt_u32 items, rt_u32 rounds)
{
	rt_uint first = rt_lane_ids() + RT_GLOBAL_ID;
	rt_uint b = rt_splat_u(0x9e3779b9u);
	rt_uint all = rt_splat_u(0u);
#define RT_PEAK_DECLARE(i) rt_uint x##i = first + rt_splat_u(i);
#define RT_PEAK_STEP(i) x##i = x##i * x##i + b; /* int */
#define RT_PEAK_FOLD(i) all = all ^ x##i;
	RT_PEAK_EACH_CHAIN(RT_PEAK_DECLARE)
	for (rt_u32 round = 0u; round < rounds; ++round) {
		RT_PEAK_ROUND(RT_PEAK_STEP)
	}
	RT_PEAK_EACH_CHAIN(RT_PEAK_FOLD)
#undef RT_PEAK_DECLARE
#undef RT_PEAK_STEP
#undef RT_PEAK_FOLD
	if (RT_GLOBAL_ID < items)
		rt_peak_store(out, all);
}
