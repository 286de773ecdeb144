/* light.h: rays aimed at lamps (next-event estimation).
 *
 * A lamp is a sphere that emits: a light, or a lambertian that glows. Seen from a point outside of it, it fills a cone
 * of half-angle asin(r / |m|), m the vector from the point to its centre; a direction is chosen uniformly over the
 * cone's solid angle, 2 pi (1 - cos) (Shirley, Wang and Zimmerman 1996; Pharr, Jakob and Humphreys, Physically Based
 * Rendering, 3rd edition, section 14.2). From within a lamp, or from its own surface, there is no cone: it is met by
 * chance only, and its emission then counts as if rays were never aimed.
 *
 * The cone is widened by more than the roundings of a direction, so that every ray that can meet the lamp lies in it.
 * Rays beside the lamp gather nothing, which the wider cone's weight makes up for; a lamp smaller than a direction's
 * rounding is then noisy, never too dark.
 *
 * With W = albedo-free weight of an aimed ray, (cos / pi) 2 pi (1 - cos_max) / chance, which is also the ratio of the
 * densities with which a diffuse bounce and an aimed ray choose a direction, the power heuristic (Veach 1997, section
 * 9.2.4) gives the aimed ray 1 / (1 + W^2) and the bounce W^2 / (1 + W^2).
 */
#ifndef RT_LIGHT_H
#define RT_LIGHT_H

#include "common/rt_features.h"
#include "common/rt_structs.h"
#include "kernels/material.h"
#include "kernels/rng.h"
#include "kernels/scene_view.h"
#include "kernels/sphere.h"

#if RT_HAS(RT_FEATURE_LIGHTS)

/* What the sine of a cone's half-angle is widened by: a part of itself, for the roundings of m and r, and an angle, for
 * those of directions. */
#define RT_CONE_SCALE 0x1.00001p+0f
#define RT_CONE_MARGIN 0x1p-22f

/* Blocks of random numbers that choose a lamp: this bit beside the bounce's block. */
#define RT_LAMP_BLOCK 0x80000000u

typedef struct rt_light_cone {
	rt_vec3 axis;    /* unit, from the point to the lamp's centre */
	rt_float height; /* 1 - cos of the half-angle */
	rt_mask outside; /* whether there is a cone; the rest means nothing without */
} rt_light_cone;

/* The cone of a sphere of this radius whose centre is at m from the point. */
RT_FN rt_light_cone rt_sphere_cone(rt_vec3 m, rt_float radius)
{
	rt_light_cone cone;
	rt_float square = v3_dot(m, m);
	rt_mask apart = square > radius * radius;
	rt_float inverse = rt_inverse_root(rt_sel(apart, square, rt_splat(1.0f)));
	rt_float sine = rt_fma(radius * inverse, rt_splat(RT_CONE_SCALE), rt_splat(RT_CONE_MARGIN));
	cone.outside = apart & (sine < rt_splat(1.0f));
	sine = rt_sel(cone.outside, sine, rt_splat(1.0f));
	/* 1 - cos as sin^2 / (1 + cos), whose digits do not cancel. */
	rt_float cosine = rt_sqrt(rt_fma(-sine, sine, rt_splat(1.0f)));
	cone.height = sine * sine * rt_rcp(1.0f + cosine);
	cone.axis = v3_scale(inverse, m);
	return cone;
}

/* The cone of the sphere with this storage index, as the origin of a ray sees it; none for the sphere that the ray
 * leaves. Aimed rays and lamps met by chance ask here, so that they agree. */
RT_FN rt_light_cone rt_light_seen(rt_scene_view view, rt_ray ray, rt_int index)
{
	rt_vec3 center = v3(RT_GATHER_F(view.spheres, index, .cx), RT_GATHER_F(view.spheres, index, .cy),
	                    RT_GATHER_F(view.spheres, index, .cz));
	rt_light_cone cone = rt_sphere_cone(v3_fma(-ray.reach, ray.arm, v3_sub(center, ray.base)),
	                                    RT_GATHER_F(view.spheres, index, .radius));
	cone.outside = cone.outside & (ray.from != index);
	return cone;
}

/* A direction uniform over the cone's solid angle; unit. */
RT_FN rt_vec3 rt_light_direction(rt_light_cone cone, rt_float u, rt_float turn)
{
	rt_float sine, cosine;
	rt_float across = rt_sqrt(u * cone.height * rt_fma(-u, cone.height, rt_splat(2.0f)));
	rt_sincos_turns(turn, &sine, &cosine);
	return v3_renormalize(
	    rt_from_frame(v3(across * cosine, across * sine, rt_fma(-u, cone.height, rt_splat(1.0f))), cone.axis));
}

/* The probability with which a lamp is chosen: half of it in proportion to its power, half the same for all. */
RT_FN rt_float rt_light_chance(RT_UNIFORM const rt_scene* scene, rt_vec3 emission, rt_float radius)
{
	rt_float brightest = rt_max(emission.x, rt_max(emission.y, emission.z));
	rt_float ratio = radius * scene->light_radius_inverse;
	return rt_fma(brightest * scene->light_share, ratio * ratio, rt_splat(scene->light_floor));
}

/* W of the head of this file, for the direction's cosine with the surface's normal. */
RT_FN rt_float rt_light_weight(rt_light_cone cone, rt_float cosine, rt_float chance)
{
	return (cosine + cosine) * cone.height * rt_rcp(chance); /* a product doubled could be fused */
}

/* What is left of an aimed ray's weight where lamps met by chance count too, and what these get. */
RT_FN rt_float rt_mis_aimed(rt_float weight) { return weight * rt_rcp(rt_fma(weight, weight, rt_splat(1.0f))); }
RT_FN rt_float rt_mis_chance(rt_float weight)
{
	return weight * weight * rt_rcp(rt_fma(weight, weight, rt_splat(1.0f)));
}

/* The storage index of a lamp, by the alias method (Walker 1977). The row is floor(n a) by integers, a = k 2^-24, so
 * that the table's maker knows each row's chance (render/lights.cpp). */
RT_FN rt_int rt_light_choice(rt_scene_view view, rt_random4 u)
{
	rt_uint k = rt_to_uint(rt_to_int(u.a * 0x1p24f));
	rt_u32 count = view.scene->light_count;
	rt_int row = rt_to_int(((k >> 12) * count + (((k & 0xfffu) * count) >> 12)) >> 12);
	rt_uint own = RT_GATHER_U(view.lights, row, .sphere);
	rt_uint other = RT_GATHER_U(view.lights, row, .other);
	return rt_to_int(rt_sel(u.b < RT_GATHER_F(view.lights, row, .threshold), own, other));
}

RT_FN rt_vec3 rt_emission(rt_scene_view view, rt_int index)
{
	rt_int material = rt_to_int(RT_GATHER_U(view.sphere_materials, index, ));
	return v3(RT_GATHER_F(view.materials, material, .emission_r), RT_GATHER_F(view.materials, material, .emission_g),
	          RT_GATHER_F(view.materials, material, .emission_b));
}

/* A ray on its way to a lamp. */
typedef struct rt_aim {
	rt_vec3 dir;        /* unit */
	rt_float chord;     /* as a ray's */
	rt_vec3 throughput; /* of the path, times the weight */
	rt_int lamp;        /* storage index, or -1: nothing was aimed at */
} rt_aim;

#endif

#endif
