/* rt_structs.h: what host and devices share in memory.
 *
 * Members are float, rt_u32 and rt_i32 only; every struct is a row of 16-byte rows; padding is named and zero;
 * links are indices. The assertion behind each struct is checked by the device's compiler too, and the self-test
 * reads sizes and offsets back from the device (kernels/probe.cl).
 *
 * Lengths are in scene units relative to the camera; colours are linear RGB.
 */
#ifndef RT_STRUCTS_H
#define RT_STRUCTS_H

#include "common/rt_compat.h"

/* A sphere as the hit test reads it. radius > 0 always: a hollow sphere becomes its dielectric's inverse index. */
typedef struct RT_ALIGN_16 rt_sphere {
	float cx, cy, cz; /* centre */
	float radius;
} rt_sphere;
RT_STATIC_ASSERT(sizeof(rt_sphere) == 16, sphere);

/* For a wide sphere (much larger than the smallest): C0 = |c|^2 - r^2 seen from the camera, to twice the precision. */
typedef struct rt_wide {
	float c0_high, c0_low;
	float reserved0, reserved1;
} rt_wide;
RT_STATIC_ASSERT(sizeof(rt_wide) == 16, wide);

/* What a program made for few spheres gets as a parameter. OpenCL promises room for 1024 bytes of parameters. */
#define RT_MAX_FEW_SPHERES 16
typedef struct rt_few_spheres {
	rt_sphere spheres[RT_MAX_FEW_SPHERES];
	rt_wide wide[RT_MAX_FEW_SPHERES];
} rt_few_spheres;
RT_STATIC_ASSERT(sizeof(rt_few_spheres) == 512, few_spheres);

/* Four floats that devices read at once: what a BVH is made of (kernels/bvh.h, render/bvh.h).
 *
 * A node of W children is 7 W / 4 rows: W low and W high planes in x, then in y, then in z, then W links. A link is a
 * node's index or, with RT_BVH_LEAF, spheres: for one lane (W = 4) the first one's storage index and their count - 1;
 * for several (W = RT_LANES) the index of a block. A block is 1 + W rows: the first sphere's storage index, then W
 * centres' x, y and z and W radii, where a slot without a sphere has radius NaN, which is never met. Links and indices
 * are bit patterns. */
typedef struct RT_ALIGN_16 rt_row4 {
	float a, b, c, d;
} rt_row4;
RT_STATIC_ASSERT(sizeof(rt_row4) == 16, row4);

#define RT_BVH_WIDTH(lanes) ((lanes) == 1u ? 4u : (lanes))
#define RT_BVH_NODE_ROWS(width) (7u * (width) / 4u)
#define RT_BVH_BLOCK_ROWS(width) (1u + (width))
#define RT_BVH_LEAF 0x80000000u
#define RT_BVH_COUNT_SHIFT 27
#define RT_BVH_COUNT_MASK 0xfu
#define RT_BVH_FIRST_MASK 0x7ffffffu
#define RT_BVH_NONE 0xffffffffu /* no tree, or no child */
/* Links that a walk keeps at most; the builder sees to it. */
#define RT_BVH_STACK(lanes) ((lanes) == 1u ? 64u : 128u)

#define RT_SAMPLER_INDEPENDENT 0u
#define RT_SAMPLER_STRATIFIED 1u
#define RT_SAMPLER_SOBOL 2u

#define RT_ESTIMATOR_PATH 0u
#define RT_ESTIMATOR_NEE 1u
#define RT_ESTIMATOR_MIS 2u

#define RT_MATERIAL_LAMBERTIAN 0u
#define RT_MATERIAL_METAL 1u
#define RT_MATERIAL_DIELECTRIC 2u
#define RT_MATERIAL_LIGHT 3u

#define RT_NO_TEXTURE 0xffffffffu

typedef struct RT_ALIGN_16 rt_material {
	float albedo_r, albedo_g, albedo_b; /* in [0, 1]; dielectric: 1 */
	float fuzz;                         /* metal, in [0, 1] */
	float emission_r, emission_g, emission_b;
	float ior;         /* dielectric: index inside relative to outside, > 0 */
	float ior_inverse; /* 1 / ior, rounded once */
	rt_u32 kind;
	rt_u32 texture; /* RT_NO_TEXTURE or an index */
	rt_u32 reserved0;
} rt_material;
RT_STATIC_ASSERT(sizeof(rt_material) == 48, material);

#define RT_TEXTURE_CHECKER 0u
#define RT_TEXTURE_IMAGE 1u

typedef struct rt_texture {
	float even_r, even_g, even_b;
	float squares; /* checker: 1 / size */
	float odd_r, odd_g, odd_b;
	rt_u32 kind;
	rt_u32 first_texel; /* image: index of its first texel */
	rt_u32 width, height;
	rt_u32 reserved0;
} rt_texture;
RT_STATIC_ASSERT(sizeof(rt_texture) == 48, texture);

/* A row of the table by which a lamp is chosen (kernels/light.h): with a chance of `threshold` the sphere of its own,
 * else the other. Storage indices. */
typedef struct rt_light {
	rt_u32 sphere, other;
	float threshold;
	rt_u32 reserved0;
} rt_light;
RT_STATIC_ASSERT(sizeof(rt_light) == 16, light);

/* The table has at most so many rows: kernels/light.h finds one by 32-bit integers. */
#define RT_MAX_LIGHTS (1u << 20)

/* Everything of a scene that is not a list. */
typedef struct rt_scene {
	/* The camera is the origin. A primary ray goes from the lens to
	 * corner + (x + u) step_x + (y + v) step_y, a point of the plane in focus; (0, 0) is the top left pixel. */
	float corner_x, corner_y, corner_z, reserved0;
	float step_x_x, step_x_y, step_x_z, reserved1;
	float step_y_x, step_y_y, step_y_z, reserved2;
	float lens_u_x, lens_u_y, lens_u_z, reserved3; /* lens radius times the camera's right */
	float lens_v_x, lens_v_y, lens_v_z, reserved4; /* lens radius times the camera's up */
	/* sky radiance = bottom + clamp((d.y + 1) / 2) delta */
	float sky_bottom_r, sky_bottom_g, sky_bottom_b;
	float light_floor; /* a lamp is chosen with probability light_floor + light_share L (r light_radius_inverse)^2 */
	float sky_delta_r, sky_delta_g, sky_delta_b;
	float light_share;
	float film_scale;      /* 2^f */
	float film_scale_high; /* 2^(f - 20) */
	float radiance_limit;  /* a sample above it is rejected and counted */
	float light_radius_inverse;
	rt_u32 width, height;      /* of the whole image, pixels */
	rt_u32 window_x, window_y; /* the part that is rendered */
	rt_u32 window_width, window_height;
	rt_u32 seed, max_depth;
	rt_u32 sphere_count, wide_count; /* wide spheres have the ids [0, wide_count) */
	rt_u32 bvh_root;                 /* a link; RT_BVH_NONE where all spheres are to be tried */
	rt_u32 bvh_blocks;               /* row at which the blocks begin */
	float bvh_x, bvh_y, bvh_z;       /* the tree's centre, of which its boxes are relative */
	float bvh_extent;                /* no box reaches further from the centre, along any axis */
	rt_u32 sampler, estimator;       /* RT_SAMPLER_*, RT_ESTIMATOR_* */
	rt_u32 roulette;                 /* scatterings after which Russian roulette may end a path; 0: never */
	rt_u32 light_count;              /* lamps that rays are aimed at */
} rt_scene;
RT_STATIC_ASSERT(sizeof(rt_scene) == 208, scene);

/* A pixel of the film: sums of round-half-even(radiance 2^f), and a tally of path segments (low 40 bits) and rejected
 * samples (bits 40 and up). */
typedef struct rt_film_pixel {
	rt_i64 r, g, b;
	rt_i64 tally;
} rt_film_pixel;
RT_STATIC_ASSERT(sizeof(rt_film_pixel) == 32, film_pixel);

#define RT_TALLY_REJECTED_SHIFT 40

/* A launch takes the film in tiles (kernels/tile.h). With one lane a tile is a warp, whose lanes look the same way;
 * with several it is a work-item, and the larger it is the shorter, of the whole, do lanes wait for the last one. */
#define RT_TILE_WIDTH 8u
#define RT_TILE_ROWS(lanes) ((lanes) == 1u ? 4u : 16u)
#define RT_TILE_ITEMS(lanes) ((lanes) == 1u ? 32u : 1u)
#define RT_TILES(width, rows, lanes) \
	(((width) + RT_TILE_WIDTH - 1u) / RT_TILE_WIDTH * (((rows) + RT_TILE_ROWS(lanes) - 1u) / RT_TILE_ROWS(lanes)))

/* Samples of one pixel that one launch may take: bounds the kernel's 32-bit partial sums (kernels/film.h). */
#define RT_MAX_SAMPLES_PER_LAUNCH 1024u

#endif
