/* render.cl: the entry points of a render. rt_clear empties the film; in rt_render each work-item takes a launch's
 * samples of RT_LANES pixels.
 *
 * Work-items are laid out in tiles of 8x4 pixels, so that the lanes of a warp look the same way. How pixels map to
 * work-items cannot change a bit of the film.
 */
#ifndef RT_RENDER_CL
#define RT_RENDER_CL

#include "kernels/path.h"

/* Set by whoever builds the program; 0 says nothing. */
#ifndef RT_PROGRAM_ID
#define RT_PROGRAM_ID 0u
#endif

#define RT_TILE_WIDTH 8u
#define RT_TILE_ROWS 4u
#define RT_TILE_PIXELS (RT_TILE_WIDTH * RT_TILE_ROWS)

RT_KERNEL(rt_clear)(RT_GLOBAL rt_film_pixel* RT_RESTRICT film, rt_u32 pixels)
{
	rt_u32 i = RT_GLOBAL_ID;
	if (i < pixels) {
		film[i].r = 0;
		film[i].g = 0;
		film[i].b = 0;
		film[i].tally = 0;
	}
}

/* Which text the program was made from, as the host put it in: a driver that runs an old binary gives itself away. */
RT_KERNEL(rt_identify)(RT_GLOBAL rt_u32* RT_RESTRICT out)
{
	if (RT_GLOBAL_ID == 0u)
		out[0] = RT_PROGRAM_ID;
}

/* Adds the other slices of a film of `slices` slices to the first. */
RT_KERNEL(rt_merge)(RT_GLOBAL rt_film_pixel* RT_RESTRICT film, rt_u32 pixels, rt_u32 slices)
{
	rt_u32 i = RT_GLOBAL_ID;
	if (i < pixels) {
		for (rt_u32 slice = 1u; slice < slices; ++slice) {
			RT_GLOBAL const rt_film_pixel* other = &film[slice * pixels + i]; /* int */
			film[i].r += other->r;
			film[i].g += other->g;
			film[i].b += other->b;
			film[i].tally += other->tally;
		}
	}
}

/* film: `slices` times window_width x (rows of the window), row-major, slice_pixels apart. The launch covers rows
 * [first_row, first_row + row_count) of the window and samples [first_sample, first_sample + sample_count), where
 * sample_count <= RT_MAX_SAMPLES_PER_LAUNCH. An image with fewer pixels than a device has threads is taken in slices:
 * each work-item takes a part of the samples, for a film of its own. Work-items beyond the tiles do nothing. */
RT_KERNEL(rt_render)
(RT_VALUE(rt_scene) scene_value, RT_VALUE(rt_few_spheres) few, RT_GLOBAL const rt_sphere* RT_RESTRICT spheres,
 RT_GLOBAL const rt_wide* RT_RESTRICT wide, RT_GLOBAL const rt_u32* RT_RESTRICT sphere_ids,
 RT_GLOBAL const rt_u32* RT_RESTRICT sphere_materials, RT_GLOBAL const rt_row4* RT_RESTRICT bvh,
 RT_GLOBAL const rt_material* RT_RESTRICT materials, RT_GLOBAL const rt_texture* RT_RESTRICT textures,
 RT_GLOBAL const rt_u32* RT_RESTRICT texels, RT_GLOBAL const rt_light* RT_RESTRICT lights,
 RT_GLOBAL rt_film_pixel* RT_RESTRICT film, rt_u32 first_row, rt_u32 row_count, rt_u32 first_sample,
 rt_u32 sample_count, rt_u32 slices, rt_u32 slice_pixels)
{
	RT_UNIFORM const rt_scene* scene = &scene_value;
	rt_scene_view view;
	view.scene = scene;
	view.few = &few;
	view.spheres = spheres;
	view.wide = wide;
	view.sphere_ids = sphere_ids;
	view.sphere_materials = sphere_materials;
	view.bvh = bvh;
	view.materials = materials;
	view.textures = textures;
	view.texels = texels;
	view.lights = lights;

	/* Lanes are neighbours in a tile, so a work-item never straddles two tiles. */
	rt_u32 tiles_across = (scene->window_width + (RT_TILE_WIDTH - 1u)) / RT_TILE_WIDTH;
	rt_u32 first_slot = RT_GLOBAL_ID * RT_LANES;
	rt_u32 slice_tiles = tiles_across * ((row_count + (RT_TILE_ROWS - 1u)) / RT_TILE_ROWS);
	rt_u32 slice = first_slot / RT_TILE_PIXELS / slice_tiles;
	rt_u32 tile = first_slot / RT_TILE_PIXELS % slice_tiles;
	rt_uint slot = (first_slot % RT_TILE_PIXELS) + rt_lane_ids();
	rt_uint column = (tile % tiles_across) * RT_TILE_WIDTH + slot % RT_TILE_WIDTH;
	rt_uint row = first_row + (tile / tiles_across) * RT_TILE_ROWS + slot / RT_TILE_WIDTH;
	/* The first slices take one sample more where the count cannot be shared out evenly. */
	rt_u32 share = sample_count / slices, rest = sample_count % slices;
	rt_u32 slice_first = slice * share + (slice < rest ? slice : rest); /* int */
	share += slice < rest ? 1u : 0u;
	rt_mask live = (column < rt_splat_u(scene->window_width)) & (row < rt_splat_u(first_row + row_count)) &
	               (rt_splat_u(slice) < rt_splat_u(share == 0u ? 0u : slices));

	rt_uint segments;
	rt_film_sum sum = rt_trace_pixels(view, column + scene->window_x, row + scene->window_y, live,
	                                  first_sample + slice_first, share, &segments);

	rt_u32 columns[RT_LANES], rows[RT_LANES], tally_segments[RT_LANES], rejected[RT_LANES];
	rt_u32 r_high[RT_LANES], r_low[RT_LANES], g_high[RT_LANES], g_low[RT_LANES], b_high[RT_LANES], b_low[RT_LANES];
	rt_store_u(column, columns);
	rt_store_u(row, rows);
	rt_store_u(segments, tally_segments);
	rt_store_u(sum.rejected, rejected);
	rt_store_u(sum.r.high, r_high);
	rt_store_u(sum.r.low, r_low);
	rt_store_u(sum.g.high, g_high);
	rt_store_u(sum.g.low, g_low);
	rt_store_u(sum.b.high, b_high);
	rt_store_u(sum.b.low, b_low);
	for (rt_u32 lane = 0u; lane < RT_LANES; ++lane) {
		if (columns[lane] < scene->window_width && rows[lane] < first_row + row_count && slice < slices) {
			/* The first pixel's index may exceed 32 bits in bytes, never in pixels. */
			RT_GLOBAL rt_film_pixel* pixel =
			    &film[slice * slice_pixels + rows[lane] * scene->window_width + columns[lane]]; /* int */
			pixel->r += rt_channel_total(r_high[lane], r_low[lane], share);
			pixel->g += rt_channel_total(g_high[lane], g_low[lane], share);
			pixel->b += rt_channel_total(b_high[lane], b_low[lane], share);
			pixel->tally += (rt_i64)tally_segments[lane] + ((rt_i64)rejected[lane] << RT_TALLY_REJECTED_SHIFT);
		}
	}
}

#endif
