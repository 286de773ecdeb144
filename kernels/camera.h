/* camera.h: primary rays through a pinhole or a thin lens. The camera is the origin. */
#ifndef RT_CAMERA_H
#define RT_CAMERA_H

#include "common/rt_features.h"
#include "common/rt_structs.h"
#include "kernels/rng.h"
#include "kernels/sphere.h"

/* The ray of pixel (x, y) for the camera's block of random numbers. */
RT_FN rt_ray rt_camera_ray(RT_UNIFORM const rt_scene* scene, rt_float x, rt_float y, rt_random4 u)
{
	rt_ray ray;
	rt_vec3 corner = v3_splat(scene->corner_x, scene->corner_y, scene->corner_z);
	rt_vec3 step_x = v3_splat(scene->step_x_x, scene->step_x_y, scene->step_x_z);
	rt_vec3 step_y = v3_splat(scene->step_y_x, scene->step_y_y, scene->step_y_z);
	rt_vec3 target = v3_fma(y + u.b, step_y, v3_fma(x + u.a, step_x, corner));

	ray.base = v3_splat(0.0f, 0.0f, 0.0f);
	ray.arm = ray.base;
	ray.reach = rt_splat(1.0f);
#if RT_HAS(RT_FEATURE_DEFOCUS)
	/* A uniform point of the lens. */
	rt_float sine, cosine;
	rt_float distance = rt_sqrt(u.c);
	rt_sincos_turns(u.d, &sine, &cosine);
	rt_vec3 lens_u = v3_splat(scene->lens_u_x, scene->lens_u_y, scene->lens_u_z);
	rt_vec3 lens_v = v3_splat(scene->lens_v_x, scene->lens_v_y, scene->lens_v_z);
	ray.arm = v3_fma(distance * cosine, lens_u, v3_scale(distance * sine, lens_v));
#endif
	ray.dir = v3_normalize(v3_sub(target, ray.arm), target);
	ray.from = rt_splat_i(-1);
	ray.chord = rt_splat(-1.0f);
	return ray;
}

#endif
