/* exhaust.cl: the elementary operations over all their inputs, and rays that must not meet again the sphere they leave.
 *
 * A device makes its operands itself, from a number, and gives one hash for each block of results, so that 2^32 results
 * need not travel. verify/exhaustive.cpp knows the answers and compares hashes; of a block that differs it asks for the
 * results themselves, which blocks of one input give.
 */
#include "kernels/path.h"
#include "kernels/probe.h"

#define RT_EXHAUST_ROOT 0u       /* rt_sqrt of every bit pattern but infinity */
#define RT_EXHAUST_RECIPROCAL 1u /* rt_rcp of every bit pattern in its range */
#define RT_EXHAUST_QUOTIENT 2u   /* a rt_rcp(b): the contract has no other division. Every fourth b is all ones */
#define RT_EXHAUST_ADD 3u
#define RT_EXHAUST_MULTIPLY 4u
#define RT_EXHAUST_FMA 5u
#define RT_EXHAUST_SINCOS 6u    /* of k 2^-24 */
#define RT_EXHAUST_ATAN2 7u     /* of pairs */
#define RT_EXHAUST_FILM 8u      /* radiance in [0, 2] to integer, scale 2^40 */
#define RT_EXHAUST_TO_INT 9u    /* float to int of every |a| < 2^31 */
#define RT_EXHAUST_TO_FLOAT 10u /* int to float of every int */
#define RT_EXHAUST_ASIN 11u     /* of the heights of normals, as textures take it: atan2(a, sqrt(b^2 + c^2)) */
#define RT_EXHAUST_CELL 12u     /* rt_cell of every bit pattern a, among b cells */
#define RT_EXHAUST_ROULETTE 13u /* of throughput a, pixel b, sample c: the weight, and the throughput times it */
#define RT_EXHAUST_RANDOM 14u   /* two of the numbers of a key: of pixel a, sample b, block c */
#define RT_EXHAUST_SOBOL 15u    /* the same of the sampler sobol */

typedef struct rt_operands {
	rt_uint a, b, c;
	rt_mask used; /* an input out of the operation's range has 0 for its result */
} rt_operands;

/* A bijection of 32 bits whose output looks random (Appleby's finaliser of MurmurHash3). */
RT_FN rt_uint rt_exhaust_shuffle(rt_uint x)
{
	x = (x ^ (x >> 16)) * 0x85ebca6bu;
	x = (x ^ (x >> 13)) * 0xc2b2ae35u;
	return x ^ (x >> 16);
}

/* A float of a random sign with the exponent `low` to low + span - 1. Of one in four the mantissa is all zeros or all
 * ones with at most one bit changed: where rounding goes wrong first. */
RT_FN rt_uint rt_exhaust_number(rt_uint random, rt_uint low, rt_u32 span)
{
	rt_uint more = rt_exhaust_shuffle(random + 0x9e3779b9u);
	rt_uint bit = (random >> 3) & 31u;
	rt_uint one = rt_splat_u(1u) << bit;
	rt_uint special = rt_sel((random & 4u) != 0u, rt_splat_u(0x7fffffu), rt_splat_u(0u)) ^ (one & 0x7fffffu);
	rt_uint mantissa = rt_sel((random & 3u) == 0u, special, random >> 9);
	rt_uint exponent = low + 127u + (((more >> 16) * span) >> 16); /* int */
	return (more << 31) | (exponent << 23) | mantissa;
}

/* The operands that belong to an input's number. */
RT_FN rt_operands rt_exhaust_operands(rt_u32 operation, rt_uint input)
{
	rt_operands o;
	rt_uint low = rt_splat_u(0u - 60u);
	o.a = input;
	o.b = rt_splat_u(0u);
	o.c = rt_splat_u(0u);
	o.used = RT_TRUE;
	if (operation == RT_EXHAUST_ROOT)
		o.used = input != 0x7f800000u;
	else if (operation == RT_EXHAUST_RECIPROCAL) {
		rt_uint size = input & 0x7fffffffu;
		o.used = (size >= 0x0d800000u) & (size <= 0x71800000u); /* 2^-100 and 2^100 */
	} else if (operation == RT_EXHAUST_ASIN) {
		/* All three within [1, 2), or smaller by some powers of two: poles, equator and between. */
		rt_uint x = rt_exhaust_shuffle(input + 0x2545f491u);
		rt_uint y = rt_exhaust_shuffle(x ^ 0x6a09e667u);
		rt_uint z = rt_exhaust_shuffle(y ^ 0xbb67ae85u);
		o.a = rt_exhaust_number(x, rt_splat_u(0u - 12u), 13u);
		o.b = rt_exhaust_number(y, rt_splat_u(0u - 12u), 13u);
		o.c = rt_exhaust_number(z, rt_splat_u(0u - 12u), 13u);
	} else if (operation == RT_EXHAUST_CELL) {
		/* Of every other input so many cells that it lies in the last but one, the last or just beyond. */
		rt_float x = rt_from_bits(input);
		rt_mask inside = (x >= rt_splat(1.0f)) & (x < rt_splat(0x1p20f));
		rt_uint cells = rt_to_uint(rt_to_int(rt_sel(inside, x, rt_splat(1.0f)))) + ((input >> 1) & 1u);
		rt_uint other = (rt_exhaust_shuffle(input) >> 12) + 1u;
		o.b = rt_bits(rt_to_float(rt_to_int(rt_sel((input & 1u) == rt_splat_u(0u), cells, other))));
	} else if (operation >= RT_EXHAUST_ROULETTE && operation <= RT_EXHAUST_SOBOL) {
		o.a = rt_exhaust_shuffle(input + 0x2545f491u);
		o.b = rt_exhaust_shuffle(o.a ^ 0x6a09e667u);
		o.c = rt_exhaust_shuffle(o.b ^ 0xbb67ae85u);
		if (operation == RT_EXHAUST_ROULETTE) {
			/* From 2^-60, the least throughput, to 1; one in eight just below 1. */
			rt_uint any = rt_exhaust_number(o.a, rt_splat_u(0u - 60u), 60u) & 0x7fffffffu;
			o.a = rt_sel((input & 7u) == rt_splat_u(0u), 0x3f7fffffu - (o.a & 1023u), any);
		}
	} else if (operation == RT_EXHAUST_SINCOS)
		o.a = rt_bits(rt_to_float(rt_to_int(input)) * 0x1p-24f);
	else if (operation == RT_EXHAUST_TO_INT)
		o.a = (input >> 1) | (input << 31);
	else if (operation >= RT_EXHAUST_QUOTIENT && operation <= RT_EXHAUST_ATAN2) {
		rt_uint x = rt_exhaust_shuffle(input + 0x2545f491u);
		rt_uint y = rt_exhaust_shuffle(x ^ 0x6a09e667u);
		rt_uint z = rt_exhaust_shuffle(y ^ 0xbb67ae85u);
		rt_uint kind = input & 15u;
		o.a = rt_exhaust_number(x, low, 121u);
		if (operation == RT_EXHAUST_QUOTIENT || operation == RT_EXHAUST_MULTIPLY) {
			o.b = rt_exhaust_number(y, low, 121u);
			if (operation == RT_EXHAUST_QUOTIENT)
				o.b = rt_sel((input & 3u) == 0u, o.b | 0x7fffffu, o.b);
		} else if (operation == RT_EXHAUST_FMA) {
			o.a = rt_exhaust_number(x, rt_splat_u(0u - 30u), 61u);
			o.b = rt_exhaust_number(y, rt_splat_u(0u - 30u), 61u);
			/* c about as large as the product: digits cancel. */
			rt_uint sum = ((o.a >> 23) & 255u) + ((o.b >> 23) & 255u);
			o.c = rt_exhaust_number(z, sum - 254u - 30u, 61u);
		} else {
			rt_uint near_a = ((o.a >> 23) & 255u) - 127u - 30u;
			o.b = rt_exhaust_number(y, near_a, 61u);
			if (operation == RT_EXHAUST_ATAN2) {
				rt_uint flip = y & 0x80000000u;
				o.b = rt_sel(kind == rt_splat_u(1u), (o.a & 0x7fffffffu) | flip, o.b); /* on the diagonals */
				o.b = rt_sel(kind == rt_splat_u(2u), flip, o.b);                       /* on the axes */
				o.a = rt_sel(kind == rt_splat_u(3u), flip, o.a);
			}
		}
	}
	return o;
}

/* Block k takes inputs number first + stride (k length + i), i < length, of the `count` there are. out: 2 words a
 * block: a hash and 0, or of blocks of one input the result's two words. */
RT_KERNEL(rt_exhaust)
(RT_GLOBAL rt_u32* RT_RESTRICT out, rt_u32 operation, rt_u32 first, rt_u32 stride, rt_u32 count, rt_u32 length)
{
	rt_uint block = RT_GLOBAL_ID * RT_LANES + rt_lane_ids();
	rt_uint hash = rt_splat_u(0u);
	rt_uint x = hash, y = hash;
	rt_u32 blocks[RT_LANES], xs[RT_LANES], ys[RT_LANES];
	for (rt_u32 i = 0u; i < length; ++i) {
		rt_uint place = block * length + i;                                     /* int */
		rt_operands o = rt_exhaust_operands(operation, place * stride + first); /* int */
		rt_float a = rt_from_bits(o.a);
		rt_float b = rt_from_bits(o.b);
		rt_float first_result = a;
		rt_float second_result = rt_splat(0.0f);
		if (operation == RT_EXHAUST_ROOT)
			first_result = rt_sqrt(a);
		else if (operation == RT_EXHAUST_RECIPROCAL)
			first_result = rt_rcp(rt_sel(o.used, a, rt_splat(1.0f)));
		else if (operation == RT_EXHAUST_QUOTIENT)
			first_result = a * rt_rcp(b);
		else if (operation == RT_EXHAUST_ADD)
			first_result = a + b;
		else if (operation == RT_EXHAUST_MULTIPLY)
			first_result = a * b;
		else if (operation == RT_EXHAUST_FMA)
			first_result = rt_fma(a, b, rt_from_bits(o.c));
		else if (operation == RT_EXHAUST_SINCOS)
			rt_sincos_turns(a, &first_result, &second_result);
		else if (operation == RT_EXHAUST_ATAN2)
			first_result = rt_atan2_turns(a, b);
		else if (operation == RT_EXHAUST_ASIN) {
			rt_float c = rt_from_bits(o.c);
			first_result = rt_atan2_turns(a, rt_sqrt(rt_fma(b, b, c * c)));
		} else if (operation == RT_EXHAUST_TO_FLOAT)
			first_result = rt_to_float(rt_to_int(o.a));
		x = rt_bits(first_result);
		y = rt_bits(second_result);
		if (operation == RT_EXHAUST_TO_INT)
			x = rt_to_uint(rt_to_int(a));
		else if (operation == RT_EXHAUST_FILM) {
			rt_probe_words words = rt_probe_film(a);
			x = words.low;
			y = words.high;
		} else if (operation == RT_EXHAUST_RANDOM || operation == RT_EXHAUST_SOBOL) {
			/* Of the key's four numbers the first two, or the last two where c is odd. */
			rt_mask last = (o.c & 1u) != 0u;
			rt_uint seed = rt_exhaust_shuffle(o.c ^ 0x3c6ef372u);
#if RT_HAS(RT_FEATURE_SOBOL)
			if (operation == RT_EXHAUST_SOBOL) {
				rt_uint scramble = rt_sel(last, rt_splat_u(RT_SCRAMBLE_CD), rt_splat_u(RT_SCRAMBLE_AB));
				rt_random2 point = rt_sobol_point(seed, o.a, scramble, o.c, rt_reverse_bits(o.b));
				x = rt_bits(point.a);
				y = rt_bits(point.b);
			}
#endif
			if (operation == RT_EXHAUST_RANDOM) {
				rt_words4 words = rt_block_words(seed, o.a, o.b, o.c);
				x = rt_bits(rt_unit(rt_sel(last, words.z, words.x)));
				y = rt_bits(rt_unit(rt_sel(last, words.w, words.y)));
			}
		}
#if RT_HAS(RT_FEATURE_CHECKER)
		if (operation == RT_EXHAUST_CELL)
			x = rt_to_uint(rt_cell(a, b));
#endif
#if RT_HAS(RT_FEATURE_ROULETTE)
		if (operation == RT_EXHAUST_ROULETTE) {
			rt_float weight = rt_roulette(0x51ab1e5u, o.b, o.c, o.c >> 26, a);
			x = rt_bits(weight);
			y = rt_bits(weight * a);
		}
#endif

		x = rt_sel(o.used, x, rt_splat_u(0u));
		y = rt_sel(o.used, y, rt_splat_u(0u));
		hash = rt_sel(place < rt_splat_u(count), rt_probe_mix(rt_probe_mix(hash, x), y), hash);
	}
	if (length > 1u) {
		x = hash;
		y = rt_splat_u(0u);
	}
	rt_store_u(block, blocks);
	rt_store_u(x, xs);
	rt_store_u(y, ys);
	for (rt_u32 lane = 0u; lane < RT_LANES; ++lane) {
		if (blocks[lane] < (count + (length - 1u)) / length) {
			out[2u * blocks[lane]] = xs[lane];
			out[2u * blocks[lane] + 1u] = ys[lane];
		}
	}
}

/* What is counted of rays. */
#define RT_EXHAUST_MET 0u           /* camera rays that met the sphere they were sent to */
#define RT_EXHAUST_OUTWARD 1u       /* rays that left it outward from where they met it */
#define RT_EXHAUST_REHITS 2u        /* and met it again: must be 0 */
#define RT_EXHAUST_INWARD 3u        /* rays that left it inward */
#define RT_EXHAUST_CHORD_FAULTS 4u  /* and did not meet it at their chord's end and there alone: must be 0 */
#define RT_EXHAUST_BOOK_REHITS 5u   /* outward rays that meet it again by the textbook's form: t > 1e-3 */
#define RT_EXHAUST_LENGTH_FAULTS 6u /* normals and directions whose |v|^2 is off 1 by more than 4 ulp: must be 0 */
#define RT_EXHAUST_BITS 7u          /* a sum of hashes of all normals and directions: the same on every device */
#define RT_EXHAUST_COUNTERS 8u

/* Does a ray from `point` along `dir` meet the sphere by b^2 - 4ac and epsilon 1e-3? The control. */
RT_FN rt_mask rt_exhaust_textbook(rt_vec3 center, rt_float radius, rt_vec3 point, rt_vec3 dir)
{
	rt_vec3 oc = v3_sub(point, center);
	rt_float a = v3_dot(dir, dir);
	rt_float half_b = v3_dot(oc, dir);
	rt_float c = rt_fma(-radius, radius, v3_dot(oc, oc));
	rt_float discriminant = rt_fma(half_b, half_b, -(a * c));
	rt_float root = rt_sqrt(discriminant);
	rt_float inverse = rt_rcp(a);
	rt_float near_t = (-half_b - root) * inverse;
	rt_float far_t = (root - half_b) * inverse;
	return (discriminant >= rt_splat(0.0f)) &
	       ((near_t > rt_splat(0x1.0624dep-10f)) | (far_t > rt_splat(0x1.0624dep-10f)));
}

/* Each lane of `count` sends `length` rays from the camera to points of one sphere; from where one meets it, another
 * leaves: half of them anywhere, half almost along the surface. Sixteen lanes share a sphere, so that the counts do not
 * depend on RT_LANES. out: RT_EXHAUST_COUNTERS words a lane. */
RT_KERNEL(rt_exhaust_rays)
(RT_GLOBAL const rt_sphere* RT_RESTRICT spheres, RT_GLOBAL const rt_u32* RT_RESTRICT sphere_ids,
 RT_GLOBAL rt_u32* RT_RESTRICT out, rt_u32 first, rt_u32 sphere_count, rt_u32 count, rt_u32 length)
{
	rt_u32 first_lane = RT_GLOBAL_ID * RT_LANES;
	rt_uint id = first_lane + rt_lane_ids();
	RT_GLOBAL const rt_sphere* sphere = &spheres[((first + first_lane) / 16u) % sphere_count]; /* int */
	rt_vec3 center = v3_splat(sphere->cx, sphere->cy, sphere->cz);
	rt_float radius = rt_splat(sphere->radius);
	rt_float zero = rt_splat(0.0f);
	rt_uint none = rt_splat_u(0u), one = rt_splat_u(1u);
	rt_uint met_count = none, outward_count = none, rehits = none, inward_count = none, chord_faults = none;
	rt_uint book_rehits = none, length_faults = none, bits = none;
	rt_scene scene;
	rt_scene_view view;
	rt_few_spheres few;
	scene.sphere_count = 1u;
	scene.wide_count = 0u;
	scene.bvh_root = RT_BVH_NONE;
#if RT_FEW_SPHERES
	few.spheres[0] = *sphere;
#endif
	view.scene = &scene;
	view.few = &few;
	view.spheres = sphere;
	view.sphere_ids = sphere_ids;

	for (rt_u32 i = 0u; i < length; ++i) {
		rt_random4 u = rt_random(0x51ab1e5u, first + id, rt_splat_u(i), none);
		rt_random4 v = rt_random(0x51ab1e5u, first + id, rt_splat_u(i), one);
		rt_float sine, cosine;
		/* To a point of the disc that the sphere shows. */
		rt_sincos_turns(u.a, &sine, &cosine);
		rt_float off = radius * rt_sqrt(u.b);
		rt_vec3 axis = v3_normalize(center, v3_splat(0.0f, 0.0f, 1.0f));
		rt_vec3 target = v3_add(center, rt_from_frame(v3(off * cosine, off * sine, zero), axis));
		rt_ray ray;
		ray.base = v3_splat(0.0f, 0.0f, 0.0f);
		ray.arm = ray.base;
		ray.reach = rt_splat(1.0f);
		ray.dir = v3_renormalize(v3_normalize(target, axis));
		ray.from = rt_splat_i(-1);
		ray.chord = rt_splat(-1.0f);
		rt_hit hit = rt_closest_listed(view, ray, 1);
		rt_mask met = hit.index == rt_splat_i(0);
		rt_surface surface = rt_sphere_surface(&scene, sphere, ray, hit.t, rt_splat_i(0));

		/* Leaves as rt_path_scatter() has it: the sign of z chooses the side. */
		rt_uint how = rt_bits(v.c);
		rt_float steep = rt_from_bits((126u - (how & 31u)) << 23); /* 2^-1 to 2^-32 */
		rt_float z = rt_sel(v.d < rt_splat(0.5f), v.a, steep);
		rt_float ring = rt_sqrt(rt_fma(-z, z, rt_splat(1.0f)));
		rt_mask inward = v.c < rt_splat(0.5f);
		rt_vec3 n = v3_sel(inward, v3_negate(surface.normal), surface.normal);
		rt_sincos_turns(v.b, &sine, &cosine);
		rt_ray leaving;
		leaving.base = surface.base;
		leaving.arm = surface.arm;
		leaving.reach = surface.reach;
		leaving.dir = v3_renormalize(rt_from_frame(v3(ring * cosine, ring * sine, z), n));
		leaving.from = rt_splat_i(0);
		leaving.chord =
		    rt_sel(inward, (surface.radius + surface.radius) * -v3_dot(surface.normal, leaving.dir), rt_splat(-1.0f));
		rt_hit again = rt_closest_listed(view, leaving, 1);
		rt_mask meets = again.index == rt_splat_i(0);
		/* Along the surface a chord may round to none. */
		rt_mask at_end = rt_sel(leaving.chord > zero, rt_sel(again.t == leaving.chord, meets, RT_FALSE), rt_not(meets));
		rt_mask outward = met & rt_not(inward);
		rt_mask by_book =
		    rt_exhaust_textbook(center, radius, v3_fma(hit.t, ray.dir, v3_splat(0.0f, 0.0f, 0.0f)), leaving.dir);
		rt_mask wrong_length =
		    rt_probe_wrong_length(ray.dir) | rt_probe_wrong_length(surface.normal) | rt_probe_wrong_length(leaving.dir);
		length_faults += rt_sel(met & wrong_length, one, none);
		bits += rt_sel(met, rt_probe_mix_vector(rt_probe_mix_vector(none, surface.normal), leaving.dir), none);
		met_count += rt_sel(met, one, none);
		outward_count += rt_sel(outward, one, none);
		rehits += rt_sel(outward & meets, one, none);
		inward_count += rt_sel(met & inward, one, none);
		chord_faults += rt_sel(met & inward & rt_not(at_end), one, none);
		book_rehits += rt_sel(outward & by_book, one, none);
	}
	rt_u32 ids[RT_LANES], words[RT_EXHAUST_COUNTERS][RT_LANES];
	rt_store_u(id, ids);
	rt_store_u(met_count, words[RT_EXHAUST_MET]);
	rt_store_u(outward_count, words[RT_EXHAUST_OUTWARD]);
	rt_store_u(rehits, words[RT_EXHAUST_REHITS]);
	rt_store_u(inward_count, words[RT_EXHAUST_INWARD]);
	rt_store_u(chord_faults, words[RT_EXHAUST_CHORD_FAULTS]);
	rt_store_u(book_rehits, words[RT_EXHAUST_BOOK_REHITS]);
	rt_store_u(length_faults, words[RT_EXHAUST_LENGTH_FAULTS]);
	rt_store_u(bits, words[RT_EXHAUST_BITS]);
	for (rt_u32 lane = 0u; lane < RT_LANES; ++lane)
		if (ids[lane] < count)
			for (rt_u32 k = 0u; k < RT_EXHAUST_COUNTERS; ++k)
				out[ids[lane] * RT_EXHAUST_COUNTERS + k] = words[k][lane]; /* int */
}
