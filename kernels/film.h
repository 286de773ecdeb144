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

/* Of a channel */
typedef struct rt_channel_sum {
	rt_uint high, low;
} rt_channel_sum;

/* Of samples */
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

RT_FN rt_channel_sum rt_channel_sample(rt_float v, float scale, float scale_high)
{
	rt_channel_sum one;
	rt_float high = rt_fma(v, rt_splat(scale_high), rt_splat(RT_FILM_MAGIC));
	rt_float rest = rt_fma(high - RT_FILM_MAGIC, rt_splat(-0x1p20f), v * scale);
	rt_float low = rest + RT_FILM_MAGIC;
	one.high = rt_low_word(high);
	one.low = rt_low_word(low);
	return one;
}

/* One sample. A radiance that is NaN, infinite, negative or above the scene's limit counts as black and is tallied
 * (contract rule 7). */
RT_FN rt_film_sum rt_film_sample(RT_UNIFORM const rt_scene* scene, rt_vec3 radiance)
{
	rt_film_sum one;
	rt_float limit = rt_splat(scene->radiance_limit);
	rt_float zero = rt_splat(0.0f);
	rt_mask valid = (radiance.x >= zero) & (radiance.x <= limit) & (radiance.y >= zero) & (radiance.y <= limit) &
	                (radiance.z >= zero) & (radiance.z <= limit);
	radiance = v3_sel(valid, radiance, v3(zero, zero, zero));
	one.rejected = rt_sel(valid, rt_splat_u(0u), rt_splat_u(1u));
	one.r = rt_channel_sample(radiance.x, scene->film_scale, scene->film_scale_high);
	one.g = rt_channel_sample(radiance.y, scene->film_scale, scene->film_scale_high);
	one.b = rt_channel_sample(radiance.z, scene->film_scale, scene->film_scale_high);
	return one;
}

RT_FN rt_channel_sum rt_channel_add(rt_channel_sum sum, rt_mask mask, rt_channel_sum other)
{
	sum.high += rt_sel(mask, other.high, rt_splat_u(0u));
	sum.low += rt_sel(mask, other.low, rt_splat_u(0u));
	return sum;
}

/* Adds in the lanes of `mask`. */
RT_FN rt_film_sum rt_film_add(rt_film_sum sum, rt_mask mask, rt_film_sum other)
{
	sum.r = rt_channel_add(sum.r, mask, other.r);
	sum.g = rt_channel_add(sum.g, mask, other.g);
	sum.b = rt_channel_add(sum.b, mask, other.b);
	sum.rejected += rt_sel(mask, other.rejected, rt_splat_u(0u));
	return sum;
}

/* Nothing in the lanes of `mask`. */
RT_FN rt_film_sum rt_film_clear(rt_film_sum sum, rt_mask mask)
{
	rt_uint zero = rt_splat_u(0u);
	sum.r.high = rt_sel(mask, zero, sum.r.high);
	sum.r.low = rt_sel(mask, zero, sum.r.low);
	sum.g.high = rt_sel(mask, zero, sum.g.high);
	sum.g.low = rt_sel(mask, zero, sum.g.low);
	sum.b.high = rt_sel(mask, zero, sum.b.high);
	sum.b.low = rt_sel(mask, zero, sum.b.low);
	sum.rejected = rt_sel(mask, zero, sum.rejected);
	return sum;
}

/* A channel's sum over `samples` samples as one integer, from the two words that it is kept in. The high word is never
 * negative and may need all 32 bits: 2^21 for each of 2^10 samples at the limit. */
RT_FN rt_i64 rt_channel_total(rt_u32 high, rt_u32 low, rt_u32 samples)
{
	rt_u32 bias = samples * RT_FILM_MAGIC_BITS;
	return (rt_i64)(high - bias) * 1048576 + (rt_i64)(rt_i32)(low - bias);
}

/* Adds what so many samples came to, in so many segments, to a pixel; lanes of a warp may share it. */
RT_FN void rt_film_pixel_add(RT_GLOBAL rt_film_pixel* pixel, rt_u32 samples, rt_u32 r_high, rt_u32 r_low, rt_u32 g_high,
                             rt_u32 g_low, rt_u32 b_high, rt_u32 b_low, rt_u32 segments, rt_u32 rejected)
{
	rt_i64 r = rt_channel_total(r_high, r_low, samples);
	rt_i64 g = rt_channel_total(g_high, g_low, samples);
	rt_i64 b = rt_channel_total(b_high, b_low, samples);
	rt_i64 tally = (rt_i64)segments + ((rt_i64)rejected << RT_TALLY_REJECTED_SHIFT);
#if RT_WARP > 1
	rt_add_shared(&pixel->r, r);
	rt_add_shared(&pixel->g, g);
	rt_add_shared(&pixel->b, b);
	rt_add_shared(&pixel->tally, tally);
#else /* in full, since traces note no operation that is hidden in rt_compat.h */
	pixel->r += r;
	pixel->g += g;
	pixel->b += b;
	pixel->tally += tally;
#endif
}

#endif
