/* roulette.h: Russian roulette: a dim path is ended by chance, or goes on with more weight, so that the mean stays.
 *
 * A path whose largest throughput is b < 1 goes on with probability q, and its throughput is multiplied by 1 / q.
 *   q    b rounded up to the next multiple of 2^-24. Random numbers are multiples of 2^-24 too, so q is exactly the
 *        probability: at b itself dim paths would survive too often.
 *   <= 1 No weight exceeds 1, so the film's bound holds (contract rule 6): q >= b, and for r = 1 / q correctly rounded
 *        q r = 1 + e with |e| < 2^-24 rounds to 1 or less; rounding is monotonic, so b r does too.
 * The number is the first of a block of its own, hashed whatever the sampler: it depends on no number that chose a
 * direction. The block's others are not used.
 */
#ifndef RT_ROULETTE_H
#define RT_ROULETTE_H

#include "common/rt_features.h"
#include "kernels/math.h"
#include "kernels/rng.h"

#if RT_HAS(RT_FEATURE_ROULETTE)

/* A bit that no scattering's block has: marks the one that belongs to the roulette behind it. */
#define RT_ROULETTE_BLOCK 0x40000000u

/* What to multiply the throughput by: 1 / q, or 0 where the path ends. b in [0, 1). */
RT_FN rt_float rt_roulette(rt_u32 seed, rt_uint pixel, rt_uint sample, rt_uint block, rt_float b)
{
	rt_float q = rt_to_float(rt_to_int(b * 0x1p24f) + 1) * 0x1p-24f;
	rt_random4 u = rt_random(seed, pixel, sample, block | RT_ROULETTE_BLOCK);
	return rt_sel(u.a < q, rt_rcp(q), rt_splat(0.0f));
}

#endif

#endif
