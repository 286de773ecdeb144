/* render.cl: the entry points of a render. rt_clear empties the film; rt_render takes a launch's samples of the pixels,
 * tile by tile (kernels/tile.h); rt_merge adds what was taken in slices.
 */
#ifndef RT_RENDER_CL
#define RT_RENDER_CL

#include "kernels/tile.h"

/* Set by whoever builds the program; 0 says nothing. */
#ifndef RT_PROGRAM_ID
#define RT_PROGRAM_ID 0u
#endif

#define RT_LESSER(a, b) ((a) < (b) ? (a) : (b))

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
 * sample_count <= RT_MAX_SAMPLES_PER_LAUNCH. Tiles may be taken in slices, each a part of the samples, for a film of
 * its own: an image may have fewer pixels than a device has threads. Work-items beyond the tiles do nothing. */
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
	rt_scene_view view = rt_scene_viewed(scene, &few, spheres, wide, sphere_ids, sphere_materials, bvh, materials,
	                                     textures, texels, lights);

	rt_u32 tiles_across = RT_TILES(scene->window_width, 1u, RT_LANES);
	rt_u32 slice_tiles = RT_TILES(scene->window_width, row_count, RT_LANES);
	/* A tile's slices lie side by side: their rays meet the same spheres. */
	rt_u32 place = RT_GLOBAL_ID / RT_TILE_ITEMS(RT_LANES) / slices;
	rt_u32 slice = RT_GLOBAL_ID / RT_TILE_ITEMS(RT_LANES) % slices;
	/* The first slices take one sample more where the count cannot be shared out evenly. */
	rt_u32 share = sample_count / slices, rest = sample_count % slices;
	rt_tile tile;
	tile.column = place % tiles_across * RT_TILE_WIDTH;
	tile.row = first_row + place / tiles_across * RT_TILE_ROWS(RT_LANES); /* int */
	tile.end_column = RT_LESSER(tile.column + RT_TILE_WIDTH, scene->window_width);
	tile.end_row = RT_LESSER(tile.row + RT_TILE_ROWS(RT_LANES), first_row + row_count); /* int */
	tile.first_sample = first_sample + slice * share + (slice < rest ? slice : rest);   /* int */
	tile.sample_count = share + (slice < rest ? 1u : 0u);                               /* int */
	tile.first_pixel = slice * slice_pixels;
	if (place < slice_tiles)
		rt_trace_tile(view, tile, RT_GLOBAL_ID % RT_TILE_ITEMS(RT_LANES), film);
}

#endif
