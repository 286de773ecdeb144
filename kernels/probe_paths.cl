/* probe_paths.cl: paths as rt_render traces them, and what the contract says of each of their steps: normals and
 * directions are unit vectors (rules 11 and 12), weights are 0 or within [2^-60, 1] (rule 6), and of the sphere that a
 * ray left it meets nothing but the end of its chord (rule 10).
 *
 * Beside the counts each path has a hash of all that its steps made. tests/test_paths.cpp compares it with that of
 * another compiler.
 */
#include "kernels/path.h"
#include "kernels/probe.h"

/* What is counted of a path. */
#define RT_PATHS_STEPS 0u            /* spheres met */
#define RT_PATHS_LENGTH_FAULTS 1u    /* vectors whose |v|^2 is off 1 by more than 4 ulp: must be 0 */
#define RT_PATHS_WEIGHT_FAULTS 2u    /* steps with a weight that is out of range: must be 0 */
#define RT_PATHS_DEPARTURE_FAULTS 3u /* rays that met the sphere they left, or missed its far side: must be 0 */
#define RT_PATHS_OUTWARD 4u          /* rays that left a sphere outward */
#define RT_PATHS_INWARD 5u           /* inward */
#define RT_PATHS_WIDE 6u             /* and those of both that left a wide one */
#define RT_PATHS_AIMED 7u            /* rays aimed at lamps */
#define RT_PATHS_BITS 8u             /* a hash of hits, normals, directions, weights and radiance */
#define RT_PATHS_WORDS 9u

/* Is it neither 0 nor within [2^-60, largest]? NaN is. */
RT_FN rt_mask rt_wrong_weight(rt_float weight, rt_float largest)
{
	rt_mask within = (weight >= rt_splat(RT_MIN_THROUGHPUT)) & (weight <= largest);
	return rt_not(within | (weight == rt_splat(0.0f)));
}

RT_FN rt_mask rt_wrong_weights(rt_vec3 weight, rt_float largest)
{
	return rt_wrong_weight(weight.x, largest) | rt_wrong_weight(weight.y, largest) | rt_wrong_weight(weight.z, largest);
}

/* Did a ray meet the sphere that it leaves elsewhere than at its chord's end, or go past that? */
RT_FN rt_mask rt_wrong_departure(rt_ray ray, rt_hit hit)
{
	rt_mask inward = ray.chord > rt_splat(0.0f);
	rt_mask again = (hit.index >= rt_splat_i(0)) & (hit.index == ray.from);
	rt_mask within = (hit.index >= rt_splat_i(0)) & (hit.t <= ray.chord);
	return (again & rt_not(inward & (hit.t == ray.chord))) | (inward & rt_not(within));
}

/* Path number i, i < count, is of pixel i % (the image's pixels) and sample first_sample + i / (its pixels). out:
 * RT_PATHS_WORDS words a path. */
RT_KERNEL(rt_probe_paths)
(RT_VALUE(rt_scene) scene_value, RT_VALUE(rt_few_spheres) few, RT_GLOBAL const rt_sphere* RT_RESTRICT spheres,
 RT_GLOBAL const rt_wide* RT_RESTRICT wide, RT_GLOBAL const rt_u32* RT_RESTRICT sphere_ids,
 RT_GLOBAL const rt_u32* RT_RESTRICT sphere_materials, RT_GLOBAL const rt_row4* RT_RESTRICT bvh,
 RT_GLOBAL const rt_material* RT_RESTRICT materials, RT_GLOBAL const rt_texture* RT_RESTRICT textures,
 RT_GLOBAL const rt_u32* RT_RESTRICT texels, RT_GLOBAL const rt_light* RT_RESTRICT lights,
 RT_GLOBAL rt_u32* RT_RESTRICT out, rt_u32 first_sample, rt_u32 count)
{
	RT_UNIFORM const rt_scene* scene = &scene_value;
	rt_scene_view view = rt_scene_viewed(scene, &few, spheres, wide, sphere_ids, sphere_materials, bvh, materials,
	                                     textures, texels, lights);

	rt_uint id = RT_GLOBAL_ID * RT_LANES + rt_lane_ids();
	rt_mask live = id < rt_splat_u(count);
	rt_uint place = rt_sel(live, id, rt_splat_u(0u));
	rt_u32 pixels = scene->width * scene->height;
	rt_uint pixel = place % pixels;
	rt_uint sample = place / pixels + first_sample;
	rt_uint none = rt_splat_u(0u), one = rt_splat_u(1u);
	rt_uint steps = none, length_faults = none, weight_faults = none, departure_faults = none;
	rt_uint outward_count = none, inward_count = none, wide_count = none, aimed_count = none;

	rt_path path = rt_path_start(view, pixel % scene->width, pixel / scene->width, sample);
	rt_uint bits = rt_probe_mix_vector(rt_probe_mix_vector(none, rt_ray_origin(path.ray)), path.ray.dir);
	length_faults += rt_sel(live & rt_probe_wrong_length(path.ray.dir), one, none);
	while (rt_any(live)) {
		rt_hit hit = rt_closest_hit(view, path.ray, live);
		rt_mask met = live & (hit.index >= rt_splat_i(0));
		rt_mask leaves = live & (path.ray.from >= rt_splat_i(0));
		rt_mask inward = path.ray.chord > rt_splat(0.0f);
		departure_faults += rt_sel(leaves & rt_wrong_departure(path.ray, hit), one, none);
		outward_count += rt_sel(leaves & rt_not(inward), one, none);
		inward_count += rt_sel(leaves & inward, one, none);
		wide_count += rt_sel(leaves & (path.ray.from < rt_splat_i((rt_i32)scene->wide_count)), one, none);

		rt_mask going = RT_FALSE;
		if (rt_any(met)) {
			rt_int index = rt_sel(met, hit.index, rt_splat_i(0));
			rt_surface surface = rt_sphere_surface(scene, spheres, path.ray, hit.t, index);
			rt_uint more = rt_probe_mix_vector(rt_probe_mix_float(bits, hit.t), surface.normal);
			rt_mask ended = rt_path_scatter(view, &path, hit, pixel, sample, met);
			more = rt_probe_mix_vector(rt_probe_mix_vector(more, path.ray.dir), path.throughput);
			bits = rt_sel(met, rt_probe_mix_vector(more, path.radiance), bits);
			steps += rt_sel(met, one, none);
			rt_mask wrong = rt_probe_wrong_length(surface.normal) | rt_probe_wrong_length(path.ray.dir);
			length_faults += rt_sel(met & wrong, one, none);
			wrong = rt_wrong_weights(path.throughput, rt_splat(1.0f));
			weight_faults += rt_sel(met & wrong, one, none);
			going = met & rt_not(ended);
#if RT_HAS(RT_FEATURE_LIGHTS)
			rt_mask aimed = met & (path.aim.lamp >= rt_splat_i(0));
			if (rt_any(aimed)) {
				rt_ray ray = path.ray;
				/* W / (1 + W^2) is at most 1/2; W alone at most 2 / p, and p is at least half of 1 / lamps. */
				rt_float largest = rt_splat(0x1.00001p-1f);
				if (scene->estimator == RT_ESTIMATOR_NEE)
					largest = 0x1.00001p+2f * rt_to_float(rt_splat_i((rt_i32)scene->light_count));
				wrong = rt_wrong_weights(path.aim.throughput, largest);
				weight_faults += rt_sel(aimed & wrong, one, none);
				length_faults += rt_sel(aimed & rt_probe_wrong_length(path.aim.dir), one, none);
				ray.dir = path.aim.dir;
				ray.chord = rt_sel(aimed, path.aim.chord, rt_splat(-1.0f));
				rt_hit seen = rt_closest_hit(view, ray, aimed);
				departure_faults += rt_sel(aimed & rt_wrong_departure(ray, seen), one, none);
				more = rt_probe_mix_vector(rt_probe_mix_vector(bits, path.aim.dir), path.aim.throughput);
				bits = rt_sel(aimed, rt_probe_mix_float(more, seen.t), bits);
				aimed_count += rt_sel(aimed, one, none);
			}
#endif
		}
		live = going;
	}

	rt_u32 ids[RT_LANES], words[RT_PATHS_WORDS][RT_LANES];
	rt_store_u(id, ids);
	rt_store_u(steps, words[RT_PATHS_STEPS]);
	rt_store_u(length_faults, words[RT_PATHS_LENGTH_FAULTS]);
	rt_store_u(weight_faults, words[RT_PATHS_WEIGHT_FAULTS]);
	rt_store_u(departure_faults, words[RT_PATHS_DEPARTURE_FAULTS]);
	rt_store_u(outward_count, words[RT_PATHS_OUTWARD]);
	rt_store_u(inward_count, words[RT_PATHS_INWARD]);
	rt_store_u(wide_count, words[RT_PATHS_WIDE]);
	rt_store_u(aimed_count, words[RT_PATHS_AIMED]);
	rt_store_u(bits, words[RT_PATHS_BITS]);
	for (rt_u32 lane = 0u; lane < RT_LANES; ++lane)
		if (ids[lane] < count)
			for (rt_u32 k = 0u; k < RT_PATHS_WORDS; ++k)
				out[ids[lane] * RT_PATHS_WORDS + k] = words[k][lane]; /* int */
}
