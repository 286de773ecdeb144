/* rt_layout.h: every member of every shared struct, for reading sizes and offsets back from a device. */
#ifndef RT_LAYOUT_H
#define RT_LAYOUT_H

#include "common/rt_structs.h"

/* One struct a paragraph, which clang-format cannot know. */
/* clang-format off */
/* S(struct) opens a struct, M(struct, member) names a member. */
#define RT_LAYOUT_LIST(S, M)                                                                           \
	S(rt_sphere) M(rt_sphere, cx) M(rt_sphere, cy) M(rt_sphere, cz) M(rt_sphere, radius)               \
	S(rt_wide) M(rt_wide, c0_high) M(rt_wide, c0_low)                                                  \
	S(rt_few_spheres) M(rt_few_spheres, spheres) M(rt_few_spheres, wide)                               \
	S(rt_row4) M(rt_row4, a) M(rt_row4, b) M(rt_row4, c) M(rt_row4, d)                                 \
	S(rt_material) M(rt_material, albedo_r) M(rt_material, albedo_g) M(rt_material, albedo_b)          \
	M(rt_material, fuzz) M(rt_material, emission_r) M(rt_material, emission_g)                         \
	M(rt_material, emission_b) M(rt_material, ior) M(rt_material, ior_inverse) M(rt_material, kind)    \
	M(rt_material, texture) M(rt_material, reserved0)                                                  \
	S(rt_texture) M(rt_texture, even_r) M(rt_texture, even_g) M(rt_texture, even_b)                    \
	M(rt_texture, squares) M(rt_texture, odd_r) M(rt_texture, odd_g) M(rt_texture, odd_b)              \
	M(rt_texture, kind) M(rt_texture, first_texel) M(rt_texture, width) M(rt_texture, height)          \
	S(rt_light) M(rt_light, sphere) M(rt_light, other) M(rt_light, threshold)                          \
	S(rt_scene) M(rt_scene, corner_x) M(rt_scene, corner_y) M(rt_scene, corner_z)                      \
	M(rt_scene, step_x_x) M(rt_scene, step_x_y) M(rt_scene, step_x_z) M(rt_scene, step_y_x)            \
	M(rt_scene, step_y_y) M(rt_scene, step_y_z) M(rt_scene, lens_u_x) M(rt_scene, lens_u_y)            \
	M(rt_scene, lens_u_z) M(rt_scene, lens_v_x) M(rt_scene, lens_v_y) M(rt_scene, lens_v_z)            \
	M(rt_scene, sky_bottom_r) M(rt_scene, sky_bottom_g) M(rt_scene, sky_bottom_b)                      \
	M(rt_scene, light_floor) M(rt_scene, sky_delta_r) M(rt_scene, sky_delta_g) M(rt_scene, sky_delta_b) M(rt_scene, light_share) \
	M(rt_scene, film_scale) M(rt_scene, film_scale_high) M(rt_scene, radiance_limit)                   \
	M(rt_scene, light_radius_inverse)                                                                  \
	M(rt_scene, width) M(rt_scene, height) M(rt_scene, window_x) M(rt_scene, window_y)                 \
	M(rt_scene, window_width) M(rt_scene, window_height) M(rt_scene, seed) M(rt_scene, max_depth)      \
	M(rt_scene, sphere_count) M(rt_scene, wide_count) M(rt_scene, bvh_root) M(rt_scene, bvh_blocks)    \
	M(rt_scene, bvh_x) M(rt_scene, bvh_y) M(rt_scene, bvh_z) M(rt_scene, bvh_extent)                   \
	M(rt_scene, sampler) M(rt_scene, estimator) M(rt_scene, roulette) M(rt_scene, light_count)         \
	S(rt_film_pixel) M(rt_film_pixel, r) M(rt_film_pixel, g) M(rt_film_pixel, b) M(rt_film_pixel, tally)
/* clang-format on */

#endif
