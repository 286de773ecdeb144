/* rt_contract.h: the numeric contract's version and limits (docs/contract.md).
 *
 * Any change of arithmetic, of a constant, of the random numbers or of the film's layout raises RT_CONTRACT_VERSION
 * and brings new golden hashes.
 */
#ifndef RT_CONTRACT_H
#define RT_CONTRACT_H

#define RT_CONTRACT_VERSION 2

/* Rule 5: every nonzero length of a scene lies in [2^-30, 2^30], and no sphere is further than 2^24 radii away. */
#define RT_MIN_LENGTH 0x1p-30
#define RT_MAX_LENGTH 0x1p+30
#define RT_MAX_DISTANCE_IN_RADII 0x1p+24

/* A sphere is wide if its radius is at least RT_WIDE_RATIO times the scene's smallest and the camera is within
 * RT_WIDE_REACH radii of its centre: further off, C = |m|^2 - r^2 has lost more than r^2 - |l|^2 does. */
#define RT_WIDE_RATIO 32.0
#define RT_WIDE_REACH 2.0

/* Rule 6: throughput components below this are set to zero. */
#define RT_MIN_THROUGHPUT 0x1p-60f

/* Below this, rt_sqrt is 0 and a vector has no direction: keeps the residuals of kernels/math.h normal numbers. */
#define RT_MIN_SQUARE 0x1p-100f

/* Rule 15: f = RT_FILM_BITS - ceil(log2 L_max): a sample is at most 2^40, so 2^22 of them leave a bit of an int64 free.
 */
#define RT_FILM_BITS 40
#define RT_MAX_SAMPLES (1u << 22)

#endif
