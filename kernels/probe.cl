/* probe.cl: what the self-test asks of a device: one operation at a time, on vectors of operands, through the same
 * lane types and functions that the path tracer uses. backends/self_test.cpp holds the answers.
 */
#include "common/rt_layout.h"
#include "kernels/probe.h"
#include "kernels/render.cl"

/* Operations. Operands and results are 32-bit patterns; an operation may give two words. */
#define RT_PROBE_ADD 0u
#define RT_PROBE_SUBTRACT 1u
#define RT_PROBE_MULTIPLY 2u
#define RT_PROBE_FMA 3u
#define RT_PROBE_ROOT 4u           /* rt_sqrt */
#define RT_PROBE_RECIPROCAL 5u     /* rt_rcp */
#define RT_PROBE_COMPARE 6u        /* < <= > >= == of floats, one bit each; rt_min, whose NaN behaviour is ours */
#define RT_PROBE_TO_FLOAT 7u       /* int to float */
#define RT_PROBE_TO_INT 8u         /* float to int, truncated, |a| < 2^31 */
#define RT_PROBE_SHIFT 9u          /* a >> (b & 31), a << (b & 31) */
#define RT_PROBE_INTEGER 10u       /* a * b + c, a ^ (b - c), both modulo 2^32 */
#define RT_PROBE_LONG_ADD 11u      /* (c 2^32 + a) + (c 2^32 + b) in 64 bits */
#define RT_PROBE_LONG_MULTIPLY 12u /* a * b, 32 x 32 -> 64 bits */
#define RT_PROBE_SINCOS 13u
#define RT_PROBE_ATAN2 14u
#define RT_PROBE_RANDOM 15u /* first and last of rt_random(RT_PROBE_SEED, pixel a, sample b, block c) */
#define RT_PROBE_FILM 16u   /* radiance to integer: rt_channel_sample and rt_channel_total with scale 2^40 */
#define RT_PROBE_BARE \
	17u /* a * b + c as no kernel writes it: shows whether the compiler fuses. Not asked by the self-test */
#define RT_PROBE_SOBOL \
	18u /* rt_sobol(RT_PROBE_SEED, pixel a, sample b, block c): bits of first xor third, of second xor last */

#define RT_PROBE_SEED 0x2545f491u

/* One 32x32->64 product or 64-bit sum a lane: scalars, as in rt_channel_total. */
RT_FN rt_u64 rt_probe_long(rt_u32 operation, rt_u32 a, rt_u32 b, rt_u32 c)
{
	rt_u64 high = (rt_u64)c << 32;
	if (operation == RT_PROBE_LONG_MULTIPLY)
		return (rt_u64)a * b;
	return (high + a) + (high + b);
}

/* out: 2 words an item. */
RT_KERNEL(rt_probe)
(RT_GLOBAL const rt_u32* RT_RESTRICT as, RT_GLOBAL const rt_u32* RT_RESTRICT bs, RT_GLOBAL const rt_u32* RT_RESTRICT cs,
 RT_GLOBAL rt_u32* RT_RESTRICT out, rt_u32 operation, rt_u32 count)
{
	rt_uint item = RT_GLOBAL_ID * RT_LANES + rt_lane_ids();
	rt_uint index = rt_sel(item < rt_splat_u(count), item, rt_splat_u(0u));
	rt_uint a_bits = RT_GATHER_U(as, index, );
	rt_uint b_bits = RT_GATHER_U(bs, index, );
	rt_uint c_bits = RT_GATHER_U(cs, index, );
	rt_float a = rt_from_bits(a_bits);
	rt_float b = rt_from_bits(b_bits);
	rt_float c = rt_from_bits(c_bits);
	rt_float first = a;
	rt_float second = rt_splat(0.0f);
	rt_uint x = rt_splat_u(0u);
	rt_uint y = rt_splat_u(0u);
	rt_mask is_float = RT_TRUE;
	rt_u32 longs[2 * RT_LANES];
	rt_u32 items[RT_LANES], xs[RT_LANES], ys[RT_LANES];

	if (operation == RT_PROBE_ADD)
		first = a + b;
	else if (operation == RT_PROBE_SUBTRACT)
		first = a - b;
	else if (operation == RT_PROBE_MULTIPLY)
		first = a * b;
	else if (operation == RT_PROBE_FMA)
		first = rt_fma(a, b, c);
	else if (operation == RT_PROBE_BARE)
		first = a * b + c; /* bare: on purpose, the only one */
	else if (operation == RT_PROBE_ROOT)
		first = rt_sqrt(a);
	else if (operation == RT_PROBE_RECIPROCAL)
		first = rt_rcp(a);
	else if (operation == RT_PROBE_SINCOS)
		rt_sincos_turns(a, &first, &second);
	else if (operation == RT_PROBE_ATAN2)
		first = rt_atan2_turns(a, b);
	else if (operation == RT_PROBE_TO_FLOAT)
		first = rt_to_float(rt_to_int(a_bits & 0x7fffffffu));
	else if (operation == RT_PROBE_RANDOM) {
		rt_random4 u = rt_random(RT_PROBE_SEED, a_bits, b_bits, c_bits);
		first = u.a;
		second = u.d;
	} else
		is_float = RT_FALSE;

	if (operation == RT_PROBE_COMPARE) {
		x = rt_sel(a < b, rt_splat_u(1u), rt_splat_u(0u)) | rt_sel(a <= b, rt_splat_u(2u), rt_splat_u(0u)) |
		    rt_sel(a > b, rt_splat_u(4u), rt_splat_u(0u)) | rt_sel(a >= b, rt_splat_u(8u), rt_splat_u(0u)) |
		    rt_sel(a == b, rt_splat_u(16u), rt_splat_u(0u));
		/* A NaN's payload is the device's own; which operand is chosen is ours. */
		y = rt_sel(rt_bits(rt_min(a, b)) == b_bits, rt_splat_u(1u), rt_splat_u(0u));
	} else if (operation == RT_PROBE_TO_INT)
		x = rt_to_uint(rt_to_int(a));
	else if (operation == RT_PROBE_SHIFT) {
		x = a_bits >> (b_bits & 31u);
		y = a_bits << (b_bits & 31u);
	} else if (operation == RT_PROBE_INTEGER) {
		x = a_bits * b_bits + c_bits; /* int */
		y = a_bits ^ (b_bits - c_bits);
	}
#if RT_HAS(RT_FEATURE_SOBOL)
	else if (operation == RT_PROBE_SOBOL) {
		rt_random4 u = rt_sobol(RT_PROBE_SEED, a_bits, b_bits, c_bits);
		x = rt_bits(u.a) ^ rt_bits(u.c);
		y = rt_bits(u.b) ^ rt_bits(u.d);
	}
#endif
	x = rt_sel(is_float, rt_bits(first), x);
	y = rt_sel(is_float, rt_bits(second), y);
	if (operation == RT_PROBE_FILM) {
		rt_probe_words words = rt_probe_film(a);
		x = words.low;
		y = words.high;
	}

	if (operation == RT_PROBE_LONG_ADD || operation == RT_PROBE_LONG_MULTIPLY) {
		for (rt_u32 lane = 0u; lane < RT_LANES; ++lane) {
			rt_u32 i = RT_GLOBAL_ID * RT_LANES + lane;
			i = i < count ? i : 0u;
			rt_u64 value = rt_probe_long(operation, as[i], bs[i], cs[i]);
			longs[2u * lane] = (rt_u32)(value & 0xffffffffu);
			longs[2u * lane + 1u] = (rt_u32)(value >> 32);
		}
	} else {
		rt_store_u(x, xs);
		rt_store_u(y, ys);
		for (rt_u32 lane = 0u; lane < RT_LANES; ++lane) {
			longs[2u * lane] = xs[lane];
			longs[2u * lane + 1u] = ys[lane];
		}
	}
	rt_store_u(item, items);
	for (rt_u32 lane = 0u; lane < RT_LANES; ++lane) {
		if (items[lane] < count) {
			out[2u * items[lane]] = longs[2u * lane];
			out[2u * items[lane] + 1u] = longs[2u * lane + 1u];
		}
	}
}

/* Sizes and member offsets of the shared structs, in the order of RT_LAYOUT_LIST, by one work-item. `memory` is only
 * pointed into, never read. */
#define RT_PROBE_SIZE(type) out[n++] = (rt_u32)sizeof(type);
#define RT_PROBE_OFFSET(type, member) \
	out[n++] = (rt_u32)((RT_GLOBAL char*)&((RT_GLOBAL type*)memory)->member - (RT_GLOBAL char*)memory);

RT_KERNEL(rt_probe_layout)(RT_GLOBAL rt_scene* RT_RESTRICT memory, RT_GLOBAL rt_u32* RT_RESTRICT out)
{
	rt_u32 n = 0u;
	if (RT_GLOBAL_ID != 0u)
		return;
	RT_LAYOUT_LIST(RT_PROBE_SIZE, RT_PROBE_OFFSET)
}
