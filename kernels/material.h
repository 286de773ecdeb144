/* material.h: how surfaces scatter light. One direction a material, chosen by the bounce's block of random numbers.
 *
 * `n` is the unit normal on the side the ray came from, c = -(d . n) the cosine of incidence, in [0, 1].
 */
#ifndef RT_MATERIAL_H
#define RT_MATERIAL_H

#include "common/rt_features.h"
#include "common/rt_structs.h"
#include "kernels/rng.h"
#include "kernels/vec.h"

/* d + 2 c n: the mirror direction */
RT_FN rt_vec3 rt_reflect(rt_vec3 d, rt_float c, rt_vec3 n) { return v3_fma(c * 2.0f, n, d); }

/* w given in a frame whose z axis is n. The frame is that of Duff et al. 2017 (JCGT 6(1)), applied without forming its
 * axes: with n' = (n.x, n.y, |n.z|) the vector is turned from z to n', then mirrored where n.z < 0. */
RT_FN rt_vec3 rt_from_frame(rt_vec3 w, rt_vec3 n)
{
	rt_float up = rt_abs(n.z);
	rt_float across = rt_fma(w.x, n.x, w.y * n.y);
	rt_float along = rt_fma(-across, rt_rcp(1.0f + up), w.z);
	rt_float z = rt_fma(up, w.z, -across);
	return v3(rt_fma(n.x, along, w.x), rt_fma(n.y, along, w.y),
	          rt_from_bits(rt_bits(z) ^ (rt_bits(n.z) & RT_SIGN_BIT)));
}

/* Diffuse and fuzzy directions start from the same point: with s = sqrt(u), q = sqrt(1 - u) and an angle,
 * (s cos, s sin, q) is cosine-distributed about z and (2 s q cos, 2 s q sin, 1 - 2 u) uniform on the unit sphere. */
typedef struct rt_disc_sample {
	rt_float s, q, sine, cosine;
} rt_disc_sample;

RT_FN rt_disc_sample rt_sample_disc(rt_random4 u)
{
	rt_disc_sample p;
	p.s = rt_sqrt(u.a);
	p.q = rt_sqrt(1.0f - u.a);
	rt_sincos_turns(u.b, &p.sine, &p.cosine);
	return p;
}

/* Lambert's cosine law: density (direction . n) / pi. */
RT_FN rt_vec3 rt_scatter_lambertian(rt_disc_sample p, rt_vec3 n)
{
	return rt_from_frame(v3(p.s * p.cosine, p.s * p.sine, p.q), n);
}

/* Mirror direction plus fuzz times a uniform point of the unit sphere; not normalised. */
RT_FN rt_vec3 rt_scatter_metal(rt_disc_sample p, rt_float u, rt_float fuzz, rt_vec3 mirrored)
{
	rt_float ring = (p.s + p.s) * p.q; /* not s q 2, which a compiler may turn into s q + s q and fuse */
	return v3_fma(fuzz, v3(ring * p.cosine, ring * p.sine, rt_fma(u, rt_splat(-2.0f), rt_splat(1.0f))), mirrored);
}

/* Refraction or reflection, by the Fresnel equations for unpolarised light (Born and Wolf, section 1.5.2). eta is the
 * index on the ray's side over the index beyond. *refracted says which; total reflection and refraction come from the
 * same expression, so there is no gap between them. Not normalised. */
RT_FN rt_vec3 rt_scatter_dielectric(rt_float u, rt_float eta, rt_vec3 d, rt_float c, rt_vec3 n,
                                    RT_PRIVATE rt_mask* refracted)
{
	/* 1 - eta^2 (1 - c^2) in the order that keeps its digits where eta is near 1: an index of 1 refracts nothing. */
	rt_float scaled = eta * c;
	rt_float cosine2 = rt_fma(scaled, scaled, rt_fma(-eta, eta, rt_splat(1.0f)));
	rt_float beyond = rt_sqrt(cosine2); /* cosine of refraction */
	rt_float perpendicular = rt_fma(eta, c, beyond);
	rt_float parallel = rt_fma(eta, beyond, c);
	rt_float both = perpendicular * parallel;
	rt_mask transmits = (cosine2 > rt_splat(0.0f)) & (both > rt_splat(RT_MIN_SQUARE));
	rt_float inverse = rt_rcp(rt_sel(transmits, both, rt_splat(1.0f)));
	rt_float rs = rt_fma(eta, c, -beyond) * parallel * inverse;
	rt_float rp = rt_fma(eta, beyond, -c) * perpendicular * inverse;
	rt_float reflectance = 0.5f * rt_fma(rs, rs, rp * rp);
	*refracted = transmits & (u >= reflectance);
	rt_vec3 through = v3_fma(rt_fma(eta, c, -beyond), n, v3_scale(eta, d));
	return v3_sel(*refracted, through, rt_reflect(d, c, n));
}

#endif
