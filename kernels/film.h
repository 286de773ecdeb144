/* film.h: radiance to integers (contract rule 15).
 *
 * A channel's radiance v becomes the integer round-half-even(v 2^f). It may have 41 bits, so it is kept as
 * high 2^20 + low with |low| <= 2^19: high = round(v 2^(f - 20)), low = round(v 2^f - high 2^20), where the difference
 * is exact. Adding 1.5 2^23 to a float leaves the rounded integer in its low bits; those bits are summed as they are
 * and the constant is taken off at the end; a double takes 1.5 2^52 and the low half of its bits.
 * RT_MAX_SAMPLES_PER_LAUNCH keeps both 32-bit sums from overflowing.
 */
#ifndef RT_FILM_H
#define RT_FILM_H

#include "common/rt_structs.h"
#include "kernels/vec.h"

#if RT_PRECISION == RT_PRECISION_DOUBLE
#define RT_FILM_MAGIC 0x1.8p+52f
#define RT_FILM_MAGIC_BITS 0u /* of its low word, where the integer is */
#else
#define RT_FILM_MAGIC 0x1.8p+23f
#define RT_FILM_MAGIC_BITS 0x4b400000u
#endif

typedef struct rt_channel_sum {
	rt_uint high, low;
} rt_channel_sum;

typedef struct rt_film_sum {
	rt_channel_sum r, g, b;
	rt_uint rejected;
} rt_film_sum;

RT_FN rt_film_sum rt_film_sum_zero(void)
{
	rt_film_sum sum;
	sum.r.high = sum.r.low = rt_splat_u(0u);
	sum.g = sum.r;
	sum.b = sum.r;
	sum.rejected = rt_splat_u(0u);
	return sum;
}

RT_FN rt_channel_sum rt_channel_add(rt_channel_sum sum, rt_mask finished, rt_float v, float scale, float scale_high)
{
	rt_float high = rt_fma(v, rt_splat(scale_high), rt_splat(RT_FILM_MAGIC));
	rt_float rest = rt_fma(high - RT_FILM_MAGIC, rt_splat(-0x1p20f), v * scale);
	rt_float low = rest + RT_FILM_MAGIC;
	sum.high += rt_sel(finished, rt_low_word(high), rt_splat_u(0u));
	sum.low += rt_sel(finished, rt_low_word(low), rt_splat_u(0u));
	return sum;
}

/* Adds one sample in the lanes where it is finished. A radiance that is NaN, infinite, negative or above the scene's
 * limit counts as black and is tallied (contract rule 7). */
RT_FN rt_film_sum rt_film_add(RT_UNIFORM const rt_scene* scene, rt_film_sum sum, rt_mask finished, rt_vec3 radiance)
{
	rt_float limit = rt_splat(scene->radiance_limit);
	rt_float zero = rt_splat(0.0f);
	rt_mask valid = (radiance.x >= zero) & (radiance.x <= limit) & (radiance.y >= zero) & (radiance.y <= limit) &
	                (radiance.z >= zero) & (radiance.z <= limit);
	radiance = v3_sel(valid, radiance, v3(zero, zero, zero));
	sum.rejected += rt_sel(finished & rt_not(valid), rt_splat_u(1u), rt_splat_u(0u));
	sum.r = rt_channel_add(sum.r, finished, radiance.x, scene->film_scale, scene->film_scale_high);
	sum.g = rt_channel_add(sum.g, finished, radiance.y, scene->film_scale, scene->film_scale_high);
	sum.b = rt_channel_add(sum.b, finished, radiance.z, scene->film_scale, scene->film_scale_high);
	return sum;
}

/* The integer that `samples` additions to a channel of one lane make. The high sum is never negative and may need all
 * 32 bits: 2^21 for each of 2^10 samples at the limit. */
RT_FN rt_i64 rt_channel_total(rt_u32 high, rt_u32 low, rt_u32 samples)
{
	rt_u32 bias = samples * RT_FILM_MAGIC_BITS;
	return (rt_i64)(high - bias) * 1048576 + (rt_i64)(rt_i32)(low - bias);
}

#endif
