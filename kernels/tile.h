/* tile.h: who takes which samples of a tile, and where they are added up. No choice here can change a bit of the film:
 * a sample's numbers are its own, and sums are integers.
 *
 * A path takes 1 to max_depth segments. Were bounces a loop within the loop over samples, lanes would wait for the
 * longest path (numerics, evidence 7). So there is one loop, in which a lane whose path has ended starts another.
 *
 * With one lane a work-item a tile's samples are cut into tasks, each some samples of one pixel. The lanes of a warp
 * share them, so that none waits for the longest pixel: a lane that is through with its task takes the next one, and
 * adds to its pixel what others add to as well. A work-item that is no warp's has a pixel's tasks for itself.
 *
 * With several lanes a work-item has a whole tile, and a lane that has taken its pixel's samples goes on with the next
 * pixel that no lane has. With a pixel each, a fifth of the lanes would wait for the last one.
 */
#ifndef RT_TILE_H
#define RT_TILE_H

#include "kernels/film.h"
#include "kernels/path.h"

/* A part of the film, and the samples to be taken of it. */
typedef struct rt_tile {
	rt_u32 column, row;         /* of the first pixel, in the window */
	rt_u32 end_column, end_row; /* behind the last one */
	rt_u32 first_sample, sample_count;
	rt_u32 first_pixel; /* of its slice of the film */
} rt_tile;

/* A pixel of the window in the film. Its index may exceed 32 bits in bytes, never in pixels. */
RT_FN rt_u32 rt_tile_pixel(rt_scene_view view, rt_tile tile, rt_u32 column, rt_u32 row)
{
	return tile.first_pixel + row * view.scene->window_width + column; /* int */
}

#if RT_LANES == 1

/* Some samples of one pixel. */
typedef struct rt_task {
	rt_u32 column, row;
	rt_u32 first_sample, sample_count;
} rt_task;

/* In how many rounds a tile's samples are taken. The first round takes half of each pixel's samples, the next one half
 * of the rest, and so on: few sums to add, and at the end little to wait for. */
#define RT_MAX_ROUNDS 6u
RT_FN rt_u32 rt_tile_rounds(rt_tile tile)
{
	rt_u32 rounds = 1u;
	while (rounds < RT_MAX_ROUNDS && tile.sample_count >> rounds != 0u)
		++rounds;
	return rounds;
}

/* The tile's task of this number: a pixel's samples in a round, without samples behind the last round. */
RT_FN rt_task rt_tile_task(rt_tile tile, rt_u32 rounds, rt_u32 number)
{
	rt_task task;
	rt_u32 columns = tile.end_column - tile.column;
	rt_u32 pixels = columns * (tile.end_row - tile.row); /* int */
	rt_u32 round, place, row;
	if (pixels == RT_TILE_WIDTH * RT_TILE_ROWS(RT_LANES)) { /* without divisions */
		round = number / (RT_TILE_WIDTH * RT_TILE_ROWS(RT_LANES));
		place = number % (RT_TILE_WIDTH * RT_TILE_ROWS(RT_LANES));
		row = place / RT_TILE_WIDTH;
	} else {
		round = number / pixels;
		place = number % pixels;
		row = place / columns;
	}
	rt_u32 first = tile.sample_count - (tile.sample_count >> round);
	rt_u32 end = tile.sample_count - (round + 1u < rounds ? tile.sample_count >> (round + 1u) : 0u);
	task.column = tile.column + (place - row * columns); /* int */
	task.row = tile.row + row;
	task.first_sample = tile.first_sample + first;
	task.sample_count = round < rounds ? end - first : 0u;
	return task;
}

/* Takes a tile's samples, as one of its lanes. */
RT_FN void rt_trace_tile(rt_scene_view view, rt_tile tile, rt_u32 item, RT_GLOBAL rt_film_pixel* RT_RESTRICT film)
{
#if RT_WARP == 1
	/* The pixel `item` alone, if the tile has so many. */
	rt_u32 column = tile.column + item % RT_TILE_WIDTH, row = tile.row + item / RT_TILE_WIDTH;
	if (column >= tile.end_column || row >= tile.end_row)
		return;
	tile.column = column;
	tile.row = row;
	tile.end_column = column + 1u;
	tile.end_row = row + 1u;
	rt_u32 lane = 0u;
#else
	rt_u32 lane = item;
#endif
	rt_u32 next = RT_WARP;
	rt_u32 rounds = rt_tile_rounds(tile);
	rt_task task = rt_tile_task(tile, rounds, lane);
	rt_mask live = task.sample_count != 0u;
	rt_mask fresh = live;
	rt_film_sum sum = rt_film_sum_zero();
	rt_u32 segments = 0u;
	rt_u32 sample = task.first_sample;
	rt_u32 x = 0u, y = 0u, pixel = 0u;
	rt_path path;
	rt_walk walk;
	rt_walk_stack stack;
	walk.underway = RT_FALSE;

	while (rt_vote_any(live)) {
		rt_mask taken = RT_FALSE;
		if (fresh) {
			x = task.column + view.scene->window_x;
			y = task.row + view.scene->window_y;
			pixel = y * view.scene->width + x;
			path = rt_path_start(view, x, y, sample);
			fresh = RT_FALSE;
		}
		if (live) {
			fresh = rt_path_step(view, &path, &walk, &stack, pixel, sample, live, &segments);
			if (fresh) {
				sum = rt_film_add(sum, RT_TRUE, rt_film_sample(view.scene, path.radiance));
				++sample;
				taken = sample == task.first_sample + task.sample_count;
			}
		}
		rt_u32 lanes = rt_warp_ballot(taken);
		if (lanes != 0u) {
			if (taken) {
				rt_film_pixel_add(&film[rt_tile_pixel(view, tile, task.column, task.row)], task.sample_count,
				                  sum.r.high, sum.r.low, sum.g.high, sum.g.low, sum.b.high, sum.b.low, segments,
				                  sum.rejected);
				sum = rt_film_sum_zero();
				segments = 0u;
				task = rt_tile_task(tile, rounds, next + rt_warp_rank(lanes, lane));
				sample = task.first_sample;
				live = fresh = task.sample_count != 0u;
			}
			next += rt_warp_count(lanes);
		}
	}
}

#else

/* The lanes' pixels, and the next one that no lane has had. */
typedef struct rt_tile_work {
	rt_u32 columns[RT_LANES], rows[RT_LANES];
	rt_u32 next_column, next_row;
} rt_tile_work;

/* Gives a pixel to each lane of `lanes` (bit k for lane k); returns those for which there is none. */
RT_FN rt_u32 rt_tile_deal(RT_PRIVATE rt_tile_work* work, rt_tile tile, rt_u32 lanes)
{
	for (; lanes != 0u && work->next_row < tile.end_row; lanes &= lanes - 1u) {
		rt_u32 lane = rt_lowest_bit(lanes);
		work->columns[lane] = work->next_column;
		work->rows[lane] = work->next_row;
		if (++work->next_column == tile.end_column) {
			work->next_column = tile.column;
			++work->next_row;
		}
	}
	return lanes;
}

/* Adds the sums of `lanes` to their pixels. */
RT_FN void rt_tile_add(rt_scene_view view, rt_tile tile, RT_PRIVATE const rt_tile_work* work, rt_u32 lanes,
                       rt_film_sum sum, rt_uint segments, RT_GLOBAL rt_film_pixel* RT_RESTRICT film)
{
	rt_u32 r_high[RT_LANES], r_low[RT_LANES], g_high[RT_LANES], g_low[RT_LANES], b_high[RT_LANES], b_low[RT_LANES];
	rt_u32 tally_segments[RT_LANES], rejected[RT_LANES];
	rt_store_u(sum.r.high, r_high);
	rt_store_u(sum.r.low, r_low);
	rt_store_u(sum.g.high, g_high);
	rt_store_u(sum.g.low, g_low);
	rt_store_u(sum.b.high, b_high);
	rt_store_u(sum.b.low, b_low);
	rt_store_u(segments, tally_segments);
	rt_store_u(sum.rejected, rejected);
	for (; lanes != 0u; lanes &= lanes - 1u) {
		rt_u32 lane = rt_lowest_bit(lanes);
		rt_film_pixel_add(&film[rt_tile_pixel(view, tile, work->columns[lane], work->rows[lane])], tile.sample_count,
		                  r_high[lane], r_low[lane], g_high[lane], g_low[lane], b_high[lane], b_low[lane],
		                  tally_segments[lane], rejected[lane]);
	}
}

/* Takes a tile's samples. */
RT_FN void rt_trace_tile(rt_scene_view view, rt_tile tile, rt_u32 item, RT_GLOBAL rt_film_pixel* RT_RESTRICT film)
{
	rt_tile_work work;
	rt_film_sum sum = rt_film_sum_zero();
	rt_uint segments = rt_splat_u(0u);
	rt_u32 last_sample = tile.first_sample + tile.sample_count - 1u;
	rt_uint sample = rt_splat_u(tile.first_sample);
	(void)item;
	rt_store_u(rt_splat_u(tile.column), work.columns);
	rt_store_u(rt_splat_u(tile.row), work.rows);
	work.next_column = tile.column;
	work.next_row = tile.row;
	rt_u32 idle = tile.sample_count == 0u ? ~0u : rt_tile_deal(&work, tile, rt_mask_bits(RT_TRUE));
	rt_mask live = rt_lane_mask(~idle);
	rt_uint x = rt_load_u(work.columns) + view.scene->window_x, y = rt_load_u(work.rows) + view.scene->window_y;
	rt_uint pixel = y * view.scene->width + x;
	rt_path path = rt_path_start(view, x, y, sample);
	rt_walk walk;
	rt_walk_stack stack;
	walk.underway = RT_FALSE;

	while (rt_any(live)) {
		rt_mask finished = rt_path_step(view, &path, &walk, &stack, pixel, sample, live, &segments);
		if (rt_any(finished)) {
			sum = rt_film_add(sum, finished, rt_film_sample(view.scene, path.radiance));
			rt_mask taken = finished & (sample == rt_splat_u(last_sample));
			rt_u32 lanes = rt_mask_bits(taken);
			sample = rt_sel(finished, sample + 1u, sample);
			if (lanes != 0u) {
				rt_tile_add(view, tile, &work, lanes, sum, segments, film);
				sum = rt_film_clear(sum, taken);
				segments = rt_sel(taken, rt_splat_u(0u), segments);
				sample = rt_sel(taken, rt_splat_u(tile.first_sample), sample);
				idle |= rt_tile_deal(&work, tile, lanes);
				live = rt_lane_mask(~idle);
				x = rt_load_u(work.columns) + view.scene->window_x;
				y = rt_load_u(work.rows) + view.scene->window_y;
				pixel = y * view.scene->width + x;
			}
			path = rt_path_sel(finished, rt_path_start(view, x, y, sample), path);
		}
	}
}

#endif

#endif
