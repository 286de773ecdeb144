/* path.h: a path, and what happens to it: it starts at the camera and goes from sphere to sphere.
 *
 * rt_path_step() takes it one segment further. Who takes which path, and when, is the business of kernels/tile.h.
 */
#ifndef RT_PATH_H
#define RT_PATH_H

#include "common/rt_features.h"
#include "common/rt_structs.h"
#include "kernels/bvh.h"
#include "kernels/camera.h"
#include "kernels/film.h"
#include "kernels/light.h"
#include "kernels/material.h"
#include "kernels/roulette.h"
#include "kernels/sampler.h"
#include "kernels/sphere.h"
#include "kernels/texture.h"

/* A path on its way. */
typedef struct rt_path {
	rt_ray ray;
	rt_vec3 throughput;
	rt_vec3 radiance; /* gathered so far */
	rt_int depth;     /* scatterings so far */
#if RT_HAS(RT_FEATURE_LIGHTS)
	rt_float cosine; /* of the ray with the normal of the diffuse surface that it leaves; 0 where that is none */
	rt_aim aim;      /* of the last scattering */
#endif
} rt_path;

RT_FN rt_path rt_path_start(rt_scene_view view, rt_uint x, rt_uint y, rt_uint sample)
{
	rt_path path;
	rt_uint pixel = y * view.scene->width + x;
	rt_random4 u = rt_camera_numbers(view.scene, pixel, sample);
	path.ray = rt_camera_ray(view.scene, rt_to_float(rt_to_int(x)), rt_to_float(rt_to_int(y)), u);
	path.throughput = v3_splat(1.0f, 1.0f, 1.0f);
	path.radiance = v3_splat(0.0f, 0.0f, 0.0f);
	path.depth = rt_splat_i(0);
#if RT_HAS(RT_FEATURE_LIGHTS)
	path.cosine = rt_splat(0.0f);
	path.aim.dir = path.radiance;
	path.aim.chord = rt_splat(-1.0f);
	path.aim.throughput = path.radiance;
	path.aim.lamp = rt_splat_i(-1);
#endif
	return path;
}

RT_FN rt_ray rt_ray_sel(rt_mask mask, rt_ray yes, rt_ray no)
{
	rt_ray ray;
	ray.base = v3_sel(mask, yes.base, no.base);
	ray.arm = v3_sel(mask, yes.arm, no.arm);
	ray.reach = rt_sel(mask, yes.reach, no.reach);
	ray.dir = v3_sel(mask, yes.dir, no.dir);
	ray.from = rt_sel(mask, yes.from, no.from);
	ray.chord = rt_sel(mask, yes.chord, no.chord);
	return ray;
}

RT_FN rt_path rt_path_sel(rt_mask mask, rt_path yes, rt_path no)
{
	rt_path path;
	path.ray = rt_ray_sel(mask, yes.ray, no.ray);
	path.throughput = v3_sel(mask, yes.throughput, no.throughput);
	path.radiance = v3_sel(mask, yes.radiance, no.radiance);
	path.depth = rt_sel(mask, yes.depth, no.depth);
#if RT_HAS(RT_FEATURE_LIGHTS)
	path.cosine = rt_sel(mask, yes.cosine, no.cosine);
	path.aim = no.aim; /* is over before another path begins */
#endif
	return path;
}

#if RT_HAS(RT_FEATURE_SKY)
RT_FN rt_vec3 rt_sky_radiance(RT_UNIFORM const rt_scene* scene, rt_vec3 dir)
{
	rt_vec3 bottom = v3_splat(scene->sky_bottom_r, scene->sky_bottom_g, scene->sky_bottom_b);
#if RT_HAS(RT_FEATURE_GRADIENT)
	/* A unit vector may be a few ulp too long: without the clamp a dark sky could turn negative. */
	rt_float height = rt_fma(dir.y, rt_splat(0.5f), rt_splat(0.5f));
	height = rt_max(rt_min(height, rt_splat(1.0f)), rt_splat(0.0f));
	return v3_fma(height, v3_splat(scene->sky_delta_r, scene->sky_delta_g, scene->sky_delta_b), bottom);
#else
	return bottom;
#endif
}
#endif

/* Weights below 2^-60 are nothing (contract rule 6). */
RT_FN rt_float rt_flush_throughput(rt_float weight)
{
	return rt_sel(weight >= rt_splat(RT_MIN_THROUGHPUT), weight, rt_splat(0.0f));
}

#if RT_HAS(RT_FEATURE_LIGHTS)
/* What a lamp's emission counts that the paths of `lamps` met: nothing or a part where the diffuse surface that they
 * left aimed at lamps too, and could have aimed at this one. */
RT_FN rt_float rt_chance_weight(rt_scene_view view, rt_path path, rt_int index, rt_vec3 emission, rt_mask lamps)
{
	rt_mask aimed = lamps & (path.cosine > rt_splat(0.0f));
	rt_float weight = rt_splat(1.0f);
	if (view.scene->estimator != RT_ESTIMATOR_PATH && rt_any(aimed)) {
		rt_light_cone cone = rt_light_seen(view, path.ray, index);
		rt_float part = rt_splat(0.0f);
		if (view.scene->estimator == RT_ESTIMATOR_MIS) {
			rt_float chance = rt_light_chance(view.scene, emission, RT_GATHER_F(view.spheres, index, .radius));
			part = rt_mis_chance(rt_light_weight(cone, path.cosine, chance));
		}
		weight = rt_sel(aimed & cone.outside, part, weight);
	}
	return weight;
}

/* Aims at a lamp from the diffuse surfaces of `mask`, which `ray` leaves: n is the unit normal on its side, `inward`
 * whether that is the inner side of a sphere of this radius. c and d of the bounce's numbers are the place in the cone.
 */
RT_FN rt_aim rt_aim_at_lamp(rt_scene_view view, rt_ray ray, rt_vec3 n, rt_mask inward, rt_float radius,
                            rt_vec3 throughput, rt_random4 u, rt_uint pixel, rt_uint sample, rt_uint block,
                            rt_mask mask)
{
	rt_aim aim;
	rt_int lamp = rt_to_int(rt_splat_u(view.lights[0].sphere));
	if (view.scene->light_count > 1u)
		lamp = rt_light_choice(view, rt_scattering_numbers(view.scene, pixel, sample, block | RT_LAMP_BLOCK));
	rt_light_cone cone = rt_light_seen(view, ray, lamp);
	aim.dir = rt_light_direction(cone, u.c, u.d);
	rt_float cosine = v3_dot(n, aim.dir);
	rt_float chance = rt_light_chance(view.scene, rt_emission(view, lamp), RT_GATHER_F(view.spheres, lamp, .radius));
	rt_float weight = rt_light_weight(cone, cosine, chance);
	if (view.scene->estimator == RT_ESTIMATOR_MIS)
		weight = rt_mis_aimed(weight);
	aim.throughput = v3(rt_flush_throughput(throughput.x * weight), rt_flush_throughput(throughput.y * weight),
	                    rt_flush_throughput(throughput.z * weight));
	aim.chord = rt_sel(inward, (radius + radius) * cosine, rt_splat(-1.0f));
	mask = mask & cone.outside & (cosine > rt_splat(0.0f)) &
	       (rt_max(aim.throughput.x, rt_max(aim.throughput.y, aim.throughput.z)) > rt_splat(0.0f));
	aim.lamp = rt_sel(mask, lamp, rt_splat_i(-1));
	return aim;
}
#endif

/* Scatters the paths of `shade`, which met sphere hit.index at hit.t. Returns the lanes whose path ends here. */
RT_FN rt_mask rt_path_scatter(rt_scene_view view, RT_PRIVATE rt_path* path, rt_hit hit, rt_uint pixel, rt_uint sample,
                              rt_mask shade)
{
	/* Find the point and its material; lanes that do not shade look at sphere 0 and are masked. */
	rt_int index = rt_sel(shade, hit.index, rt_splat_i(0));
	rt_surface surface = rt_sphere_surface(view.scene, view.spheres, path->ray, hit.t, index);
	rt_int material = rt_to_int(RT_GATHER_U(view.sphere_materials, index, ));
	rt_uint kind = RT_GATHER_U(view.materials, material, .kind);
	rt_mask ended = RT_FALSE;

#if RT_HAS(RT_FEATURE_EMISSION)
	rt_vec3 emission =
	    v3(RT_GATHER_F(view.materials, material, .emission_r), RT_GATHER_F(view.materials, material, .emission_g),
	       RT_GATHER_F(view.materials, material, .emission_b));
#if RT_HAS(RT_FEATURE_LIGHTS)
	rt_mask emits = rt_max(emission.x, rt_max(emission.y, emission.z)) > rt_splat(0.0f);
	emission = v3_scale(rt_chance_weight(view, *path, index, emission, shade & emits), emission);
#endif
	rt_vec3 lit = v3(rt_fma(path->throughput.x, emission.x, path->radiance.x),
	                 rt_fma(path->throughput.y, emission.y, path->radiance.y),
	                 rt_fma(path->throughput.z, emission.z, path->radiance.z));
	path->radiance = v3_sel(shade, lit, path->radiance);
	ended = kind == rt_splat_u(RT_MATERIAL_LIGHT);
#endif

	/* Turn the normal to the side the ray came from. */
	rt_vec3 d = path->ray.dir;
	rt_float projection = v3_dot(d, surface.normal);
	rt_mask front = projection < rt_splat(0.0f);
	rt_vec3 n = v3_sel(front, surface.normal, v3_negate(surface.normal));
	rt_float c = rt_min(rt_abs(projection), rt_splat(1.0f));
	rt_mask inward = rt_not(front);

	/* Choose a direction. */
	rt_uint block = rt_to_uint(path->depth + 1);
	rt_random4 u = rt_scattering_numbers(view.scene, pixel, sample, block);
	rt_vec3 direction = n;
	rt_mask mirror = RT_FALSE; /* may point below the surface, where metal absorbs */
#if RT_HAS(RT_FEATURE_DIELECTRIC)
	rt_mask dielectric = kind == rt_splat_u(RT_MATERIAL_DIELECTRIC);
	if (rt_any(shade & dielectric)) {
		rt_mask refracted;
		rt_float eta = rt_sel(front, RT_GATHER_F(view.materials, material, .ior_inverse),
		                      RT_GATHER_F(view.materials, material, .ior));
		rt_vec3 bent = rt_scatter_dielectric(u.a, eta, d, c, n, &refracted);
		direction = v3_sel(dielectric, bent, direction);
		inward = rt_sel(dielectric & refracted, front, inward);
	}
#endif
#if RT_HAS(RT_FEATURE_METAL)
	mirror = kind == rt_splat_u(RT_MATERIAL_METAL);
	direction = v3_sel(mirror, rt_reflect(d, c, n), direction);
#endif
#if RT_HAS(RT_FEATURE_LAMBERTIAN) || RT_HAS(RT_FEATURE_FUZZ)
	rt_disc_sample disc;
#if RT_HAS(RT_FEATURE_LAMBERTIAN)
	rt_mask diffuse = kind == rt_splat_u(RT_MATERIAL_LAMBERTIAN);
#else
	rt_mask diffuse = RT_FALSE;
#endif
#if RT_HAS(RT_FEATURE_FUZZ)
	rt_float fuzz = RT_GATHER_F(view.materials, material, .fuzz);
	rt_mask fuzzy = mirror & (fuzz > rt_splat(0.0f));
#else
	rt_mask fuzzy = RT_FALSE;
#endif
	if (rt_any(shade & (diffuse | fuzzy))) {
		disc = rt_sample_disc(u);
#if RT_HAS(RT_FEATURE_LAMBERTIAN)
		direction = v3_sel(diffuse, rt_scatter_lambertian(disc, n), direction);
#endif
#if RT_HAS(RT_FEATURE_FUZZ)
		if (rt_any(shade & fuzzy))
			direction = v3_sel(fuzzy, v3_normalize(rt_scatter_metal(disc, u.a, fuzz, direction), n), direction);
#endif
	}
#endif
	/* Its length is off by roundings only. */
	direction = v3_renormalize(direction);
	ended = ended | (mirror & rt_not(v3_dot(direction, n) > rt_splat(0.0f)));

	/* Weigh it. */
	rt_vec3 albedo =
	    v3(RT_GATHER_F(view.materials, material, .albedo_r), RT_GATHER_F(view.materials, material, .albedo_g),
	       RT_GATHER_F(view.materials, material, .albedo_b));
#if RT_HAS(RT_FEATURE_CHECKER) || RT_HAS(RT_FEATURE_IMAGE)
	rt_uint texture = RT_GATHER_U(view.materials, material, .texture);
	rt_mask textured = texture != rt_splat_u(RT_NO_TEXTURE);
	if (rt_any(shade & textured)) {
		rt_int texture_index = rt_to_int(rt_sel(textured, texture, rt_splat_u(0u)));
		rt_vec3 color = rt_texture_color(view.textures, view.texels, texture_index, surface.normal);
		albedo = v3_sel(textured, color, albedo);
	}
#endif
	rt_vec3 throughput = v3_mul(path->throughput, albedo);
	throughput =
	    v3(rt_flush_throughput(throughput.x), rt_flush_throughput(throughput.y), rt_flush_throughput(throughput.z));
#if RT_HAS(RT_FEATURE_LIGHTS)
	rt_vec3 aimed_throughput = throughput;
#endif
#if RT_HAS(RT_FEATURE_ROULETTE)
	rt_float brightest = rt_max(throughput.x, rt_max(throughput.y, throughput.z));
	rt_mask at_stake = (path->depth + 1 >= rt_splat_i((rt_i32)view.scene->roulette)) & (brightest < rt_splat(1.0f));
	if (view.scene->roulette != 0u && rt_any(shade & at_stake)) {
		rt_float weight =
		    rt_roulette(view.scene->seed, pixel, sample, block, rt_sel(at_stake, brightest, rt_splat(0.0f)));
		throughput = v3_sel(at_stake, v3_scale(weight, throughput), throughput);
	}
#endif
	ended = ended | rt_not(rt_max(throughput.x, rt_max(throughput.y, throughput.z)) > rt_splat(0.0f));

	/* Leave the surface. */
	rt_ray leaving;
	leaving.base = surface.base;
	leaving.arm = surface.arm;
	leaving.reach = surface.reach;
	leaving.dir = direction;
	leaving.from = index;
	leaving.chord =
	    rt_sel(inward, (surface.radius + surface.radius) * -v3_dot(surface.normal, direction), rt_splat(-1.0f));
	path->ray = rt_ray_sel(shade, leaving, path->ray);
	path->throughput = v3_sel(shade, throughput, path->throughput);
	path->depth = rt_sel(shade, path->depth + 1, path->depth);
	ended = ended | (path->depth >= rt_splat_i((rt_i32)view.scene->max_depth));
#if RT_HAS(RT_FEATURE_LIGHTS)
	rt_mask aiming = shade & diffuse & (path->depth < rt_splat_i((rt_i32)view.scene->max_depth));
	path->cosine = rt_sel(shade, rt_sel(diffuse, v3_dot(n, direction), rt_splat(0.0f)), path->cosine);
	path->aim.lamp = rt_splat_i(-1);
	if (view.scene->estimator != RT_ESTIMATOR_PATH && rt_any(aiming))
		path->aim = rt_aim_at_lamp(view, leaving, n, inward, surface.radius, aimed_throughput, u, pixel, sample,
		                           rt_to_uint(path->depth), aiming);
#endif
	return ended & shade;
}

#if RT_HAS(RT_FEATURE_LIGHTS)
/* Follows the rays that the paths of `mask` aimed at lamps. A lamp is seen where it is the nearest that the ray meets.
 */
RT_FN rt_vec3 rt_gather_aimed(rt_scene_view view, rt_path path, rt_mask mask)
{
	rt_ray ray = path.ray;
	ray.dir = path.aim.dir;
	/* Elsewhere the chord is of a ray that is over, and the path's may leave no sphere. */
	ray.chord = rt_sel(mask, path.aim.chord, rt_splat(-1.0f));
	rt_hit hit = rt_closest_hit(view, ray, mask);
	rt_mask seen = mask & (hit.index == path.aim.lamp);
	rt_vec3 emission = rt_emission(view, rt_sel(seen, path.aim.lamp, rt_splat_i(0)));
	rt_vec3 lit = v3(rt_fma(path.aim.throughput.x, emission.x, path.radiance.x),
	                 rt_fma(path.aim.throughput.y, emission.y, path.radiance.y),
	                 rt_fma(path.aim.throughput.z, emission.z, path.radiance.z));
	return v3_sel(seen, lit, path.radiance);
}
#endif

/* Takes the paths of `live` one segment further, or a part of one (rt_next_hit), and returns those that end with it;
 * *segments counts. */
RT_FN rt_mask rt_path_step(rt_scene_view view, RT_PRIVATE rt_path* path, RT_PRIVATE rt_walk* walk,
                           RT_PRIVATE rt_walk_stack* stack, rt_uint pixel, rt_uint sample, rt_mask live,
                           RT_PRIVATE rt_uint* segments)
{
	rt_hit hit = rt_next_hit(view, path->ray, live, walk, stack);
	live = live & rt_not(walk->underway);
	rt_mask met = hit.index >= rt_splat_i(0);
	rt_mask missed = live & rt_not(met);
	rt_mask shade = live & met;
	rt_mask finished = missed;
	*segments += rt_sel(live, rt_splat_u(1u), rt_splat_u(0u));

#if RT_HAS(RT_FEATURE_SKY)
	if (rt_any(missed)) {
		rt_vec3 sky = rt_sky_radiance(view.scene, path->ray.dir);
		rt_vec3 lit =
		    v3(rt_fma(path->throughput.x, sky.x, path->radiance.x), rt_fma(path->throughput.y, sky.y, path->radiance.y),
		       rt_fma(path->throughput.z, sky.z, path->radiance.z));
		path->radiance = v3_sel(missed, lit, path->radiance);
	}
#endif
	if (rt_any(shade))
		finished = finished | rt_path_scatter(view, path, hit, pixel, sample, shade);
#if RT_HAS(RT_FEATURE_LIGHTS)
	rt_mask aimed = shade & (path->aim.lamp >= rt_splat_i(0));
	if (rt_any(aimed)) {
		path->radiance = rt_gather_aimed(view, *path, aimed);
		*segments += rt_sel(aimed, rt_splat_u(1u), rt_splat_u(0u));
	}
#endif
	return finished;
}

#endif
