/* sphere.h: rays, and where they meet spheres.
 *
 * A ray's origin is kept as base + reach arm: the centre, radius and unit normal of the sphere it leaves (or the
 * camera, 1 and a point of the lens). Differences of centres are then formed before anything small is added to them, by
 * one fma.
 *
 * There is no epsilon. A ray that leaves a sphere outward skips that sphere; one that leaves inward can meet of it only
 * the far point, at t = -2 r (n . d), its chord (contract rule 10). All tests are written so that NaN means miss.
 *
 * With m = c - o, b = m . d, l = m - b d (the foot of the perpendicular): D = r^2 - |l|^2 keeps its digits when the
 * sphere is far away (Hearn and Baker; Haines, Gunther and Akenine-Moller 2019, Ray Tracing Gems 7). One more
 * projection (b2 = l . d, "twice is enough") removes what rounding of b left in l.
 *
 * A wide sphere (RT_WIDE_RATIO times the smallest or more, the camera within RT_WIDE_REACH radii) is mostly seen from
 * close by, where C = |m|^2 - r^2 is the difference of huge numbers. Seen from the camera C is known to twice the
 * precision (rt_wide), and C(o) = C0 - 2 c . o + |o|^2; the roots are then q and C / q (Press et al., Numerical
 * Recipes, section 5.6).
 */
#ifndef RT_SPHERE_H
#define RT_SPHERE_H

#include "common/rt_features.h"
#include "common/rt_structs.h"
#include "kernels/scene_view.h"
#include "kernels/vec.h"

/* A program specialised to few spheres knows how many, so that loops over them unroll, and has them among its
 * parameters, so that a GPU reads them as operands. */
#if defined(RT_DEF_SPHERE_COUNT)
#define RT_FEW_SPHERES 1
#define RT_SPHERE_COUNT(scene) ((rt_u32)RT_DEF_SPHERE_COUNT)
#define RT_WIDE_COUNT(scene) ((rt_u32)RT_DEF_WIDE_COUNT)
#else
#define RT_FEW_SPHERES 0
#define RT_SPHERE_COUNT(scene) ((scene)->sphere_count)
#define RT_WIDE_COUNT(scene) ((scene)->wide_count)
#endif

/* No distance is larger. */
#define RT_MAX_FLOAT 0x1.fffffep+127f

/* Of many spheres most are missed: they cost no square root. Among few, and where several lanes must agree, the branch
 * costs more than it saves. */
#define RT_ROOT_OF_MISSED (RT_FEW_SPHERES || RT_LANES > 1)

typedef struct rt_ray {
	rt_vec3 base, arm; /* origin = base + reach arm */
	rt_float reach;
	rt_vec3 dir;    /* unit */
	rt_int from;    /* storage index of the sphere that it leaves, or -1 */
	rt_float chord; /* distance to the far side of that sphere if it leaves inward, else -1 */
} rt_ray;

/* The origin as one rounded point: relative to the camera it has an error of half an ulp. */
RT_FN rt_vec3 rt_ray_origin(rt_ray ray) { return v3_fma(ray.reach, ray.arm, ray.base); }

typedef struct rt_hit {
	rt_float t;
	rt_int index; /* storage index, or -1 */
#if RT_HAS(RT_FEATURE_PERMUTED)
	rt_uint id;
#endif
} rt_hit;

/* The perpendicular from a sphere's centre to a ray. */
typedef struct rt_foot {
	rt_vec3 m;   /* origin to centre */
	rt_vec3 l;   /* foot to centre, projected once */
	rt_float b;  /* distance along the ray to the foot, before */
	rt_float b2; /* and what the second projection adds to it */
} rt_foot;

RT_FN rt_foot rt_sphere_foot(rt_vec3 center, rt_ray ray)
{
	rt_foot f;
	f.m = v3_fma(-ray.reach, ray.arm, v3_sub(center, ray.base));
	f.b = v3_dot(f.m, ray.dir);
	f.l = v3_fma(-f.b, ray.dir, f.m);
	f.b2 = v3_dot(f.l, ray.dir);
	return f;
}

/* r^2 - |l|^2 with l projected twice: |l - b2 d|^2 = |l|^2 - b2^2 */
RT_FN rt_float rt_foot_discriminant(rt_foot f, rt_float radius)
{
	return rt_fma(f.b2, f.b2, rt_fma(radius, radius, -v3_dot(f.l, f.l)));
}

/* Distance to the first point of the sphere in front of the origin; *met says whether there is one. The sphere that the
 * ray leaves is never met here: its far side is the ray's chord. */
RT_FN rt_float rt_sphere_distance(rt_vec3 center, rt_float radius, rt_ray ray, rt_mask is_from, RT_PRIVATE rt_mask* met)
{
	rt_foot f = rt_sphere_foot(center, ray);
	rt_float discriminant = rt_foot_discriminant(f, radius);
	rt_mask candidate = (discriminant >= rt_splat(0.0f)) & rt_not(is_from);
	rt_float t = rt_splat(0.0f);
	if (RT_ROOT_OF_MISSED || rt_any(candidate)) {
		rt_float half_chord = rt_sqrt(discriminant);
		rt_float middle = f.b + f.b2;
		rt_float near_t = middle - half_chord;
		t = rt_sel(near_t > rt_splat(0.0f), near_t, middle + half_chord);
	}
	*met = candidate & (t > rt_splat(0.0f));
	return t;
}

#if RT_HAS(RT_FEATURE_WIDE)
/* The same for a wide sphere. origin is the ray's, origin_square its square. */
RT_FN rt_float rt_wide_distance(rt_vec3 center, rt_float radius, rt_float c0_high, rt_float c0_low, rt_ray ray,
                                rt_vec3 origin, rt_float origin_square, rt_mask is_from, RT_PRIVATE rt_mask* met)
{
	rt_foot f = rt_sphere_foot(center, ray);
	rt_float c = rt_fma(rt_splat(-2.0f), v3_dot(center, origin), c0_high) + (origin_square + c0_low);
	/* Within a radius of the foot b^2 - C is the better discriminant, further off r^2 - |l|^2. */
	rt_float discriminant = rt_fma(f.b, f.b, -c);
	rt_mask distant = rt_not(rt_abs(f.b) < radius);
	if (rt_any(distant))
		discriminant = rt_sel(distant, rt_foot_discriminant(f, radius), discriminant);
	rt_float half_chord = rt_sqrt(discriminant);
	rt_mask ahead = f.b >= rt_splat(0.0f);
	rt_float q = rt_sel(ahead, f.b + half_chord, f.b - half_chord);
	rt_mask two_roots = rt_abs(q) > rt_splat(RT_MIN_SQUARE);
	rt_float other = c * rt_rcp(rt_sel(two_roots, q, rt_splat(1.0f)));
	rt_float t = rt_sel(ahead & rt_not(other > rt_splat(0.0f)), q, other);
	*met = (discriminant >= rt_splat(0.0f)) & two_roots & rt_not(is_from) & (t > rt_splat(0.0f));
	return t;
}
#endif

/* Nothing met yet. */
RT_FN rt_hit rt_hit_none(void)
{
	rt_hit hit;
	hit.t = rt_splat(RT_MAX_FLOAT);
	hit.index = rt_splat_i(-1);
#if RT_HAS(RT_FEATURE_PERMUTED)
	hit.id = rt_splat_u(0xffffffffu);
#endif
	return hit;
}

/* Keeps the minimum of (t, id) (contract rule 8). */
RT_FN rt_hit rt_hit_nearer(rt_hit hit, rt_float t, rt_mask met, rt_u32 index, RT_GLOBAL const rt_u32* sphere_ids)
{
#if RT_HAS(RT_FEATURE_PERMUTED)
	rt_uint id = rt_splat_u(sphere_ids[index]);
	rt_mask nearer = met & ((t < hit.t) | ((t == hit.t) & (id < hit.id)));
	hit.id = rt_sel(nearer, id, hit.id);
#else
	/* Spheres come in the order of their ids: an equal t later in the loop has the larger id. */
	rt_mask nearer = met & (t < hit.t);
#endif
	hit.t = rt_sel(nearer, t, hit.t);
	hit.index = rt_sel(nearer, rt_splat_i((rt_i32)index), hit.index);
	return hit;
}

/* The same for the far side of the sphere that the ray leaves inward. */
RT_FN rt_hit rt_hit_nearer_chord(rt_hit hit, rt_ray ray, RT_GLOBAL const rt_u32* sphere_ids)
{
	rt_mask inward = ray.chord > rt_splat(0.0f);
#if RT_HAS(RT_FEATURE_PERMUTED)
	rt_int from = rt_sel(inward, ray.from, rt_splat_i(0));
	rt_uint id = RT_GATHER_U(sphere_ids, from, );
	rt_mask nearer = inward & ((ray.chord < hit.t) | ((ray.chord == hit.t) & (id < hit.id)));
	hit.id = rt_sel(nearer, id, hit.id);
#else
	rt_mask nearer = inward & ((ray.chord < hit.t) | ((ray.chord == hit.t) & (ray.from < hit.index)));
#endif
	hit.t = rt_sel(nearer, ray.chord, hit.t);
	hit.index = rt_sel(nearer, ray.from, hit.index);
	return hit;
}

/* The nearest of the wide spheres, and of the others too if `all`; the chord included. */
RT_FN rt_hit rt_closest_listed(rt_scene_view view, rt_ray ray, int all)
{
#if RT_FEW_SPHERES
	RT_UNIFORM const rt_sphere* spheres = view.few->spheres;
#else
	RT_GLOBAL const rt_sphere* spheres = view.spheres;
#endif
	rt_hit hit = rt_hit_none();
	rt_u32 i = 0u;
#if RT_HAS(RT_FEATURE_WIDE)
#if RT_FEW_SPHERES
	RT_UNIFORM const rt_wide* wide = view.few->wide;
#else
	RT_GLOBAL const rt_wide* wide = view.wide;
#endif
	rt_vec3 origin = rt_ray_origin(ray);
	rt_float origin_square = v3_dot(origin, origin);
	for (; i < RT_WIDE_COUNT(view.scene); ++i) {
		rt_mask met;
		rt_float t = rt_wide_distance(v3_splat(spheres[i].cx, spheres[i].cy, spheres[i].cz),
		                              rt_splat(spheres[i].radius), rt_splat(wide[i].c0_high), rt_splat(wide[i].c0_low),
		                              ray, origin, origin_square, ray.from == rt_splat_i((rt_i32)i), &met);
		hit = rt_hit_nearer(hit, t, met, i, view.sphere_ids);
	}
#endif
	if (all) {
		for (; i < RT_SPHERE_COUNT(view.scene); ++i) {
			rt_mask met;
			rt_float t = rt_sphere_distance(v3_splat(spheres[i].cx, spheres[i].cy, spheres[i].cz),
			                                rt_splat(spheres[i].radius), ray, ray.from == rt_splat_i((rt_i32)i), &met);
			hit = rt_hit_nearer(hit, t, met, i, view.sphere_ids);
		}
	}
	return rt_hit_nearer_chord(hit, ray, view.sphere_ids);
}

/* The point of a sphere that a ray met. */
typedef struct rt_surface {
	rt_vec3 base, arm; /* point = base + reach arm */
	rt_float reach;
	rt_vec3 normal; /* outward, unit */
	rt_float radius;
} rt_surface;

/* `index` must be a valid storage index in every lane. The normal comes from the foot of the perpendicular, never from
 * point minus centre, whose digits cancel for a small sphere far away. */
RT_FN rt_surface rt_sphere_surface(RT_UNIFORM const rt_scene* scene, RT_GLOBAL const rt_sphere* RT_RESTRICT spheres,
                                   rt_ray ray, rt_float t, rt_int index)
{
	rt_surface s;
	rt_vec3 center =
	    v3(RT_GATHER_F(spheres, index, .cx), RT_GATHER_F(spheres, index, .cy), RT_GATHER_F(spheres, index, .cz));
	s.radius = RT_GATHER_F(spheres, index, .radius);

	/* From the foot, half a chord back or forth. A grazing ray whose D falls below 0 here touches at the foot. */
	rt_foot f = rt_sphere_foot(center, ray);
	rt_vec3 l = v3_fma(-f.b2, ray.dir, f.l);
	rt_float half_chord = rt_sqrt(rt_fma(s.radius, s.radius, -v3_dot(l, l)));
	/* Only from within does a ray meet the far side, and then the foot is nearer than the radius; from far away t and
	 * the foot's distance are too coarse to tell the sides apart. */
	rt_float middle = f.b + f.b2;
	rt_mask far_side = (t > middle) & (middle < s.radius + s.radius);
	rt_float along = rt_sel(far_side, half_chord, -half_chord);
	rt_vec3 from_center = v3_fma(along, ray.dir, v3_negate(l));

	/* On the far side of the sphere that the ray leaves t is exact, and from_center = t d - m is its mirror image. */
	rt_vec3 direct = v3_fma(t, ray.dir, v3_negate(f.m));
	rt_mask use_direct = ray.from == index;
#if RT_HAS(RT_FEATURE_WIDE)
	/* On a wide sphere near the camera the ray's own point is finer than steps of ulp(radius). */
	rt_vec3 point = v3_fma(t, ray.dir, rt_ray_origin(ray));
	rt_mask near_camera =
	    (index < rt_splat_i((rt_i32)RT_WIDE_COUNT(scene))) & (v3_dot(point, point) < s.radius * s.radius);
	use_direct = use_direct | near_camera;
#endif
	from_center = v3_sel(use_direct, direct, from_center);
	s.normal = v3_renormalize(v3_scale(rt_rcp(s.radius), from_center));
	s.base = center;
	s.arm = s.normal;
	s.reach = s.radius;
#if RT_HAS(RT_FEATURE_WIDE)
	s.base = v3_sel(near_camera, v3_splat(0.0f, 0.0f, 0.0f), s.base);
	s.arm = v3_sel(near_camera, point, s.arm);
	s.reach = rt_sel(near_camera, rt_splat(1.0f), s.reach);
#endif
	return s;
}

#endif
