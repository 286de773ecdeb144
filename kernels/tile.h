/* tile.h: who takes which samples of a tile, and where they are added up. No choice here can change a bit of the film:
 * a sample's numbers are its own, and sums are integers.
 *
 * A path takes 1 to max_depth segments. Were bounces a loop within the loop over samples, lanes would wait for the
 * longest path (numerics, evidence 7). So there is one loop, in which a lane whose path has ended starts the next
 * sample of its pixel: one lane       a work-item has one pixel several lanes  a work-item has a whole tile, and a lane
 * that has taken its pixel's samples goes on with the next pixel that no lane has. With a pixel each, a fifth of the
 * lanes would wait for the last one
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

/* The lanes' pixels, and the next one that no lane has had. */
typedef struct rt_tile_work {
	rt_u32 columns[RT_LANES], rows[RT_LANES];
	rt_u32 next_column, next_row;
} rt_tile_work;

#if RT_LANES > 1
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
#endif

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
	for (rt_u32 lane = 0u; lane < RT_LANES; ++lane) {
		if ((lanes >> lane & 1u) != 0u) {
			/* The first pixel's index may exceed 32 bits in bytes, never in pixels. */
			RT_GLOBAL rt_film_pixel* pixel =
			    &film[tile.first_pixel + work->rows[lane] * view.scene->window_width + work->columns[lane]]; /* int */
			pixel->r += rt_channel_total(r_high[lane], r_low[lane], tile.sample_count);
			pixel->g += rt_channel_total(g_high[lane], g_low[lane], tile.sample_count);
			pixel->b += rt_channel_total(b_high[lane], b_low[lane], tile.sample_count);
			pixel->tally += (rt_i64)tally_segments[lane] + ((rt_i64)rejected[lane] << RT_TALLY_REJECTED_SHIFT);
		}
	}
}

/* Takes a tile's samples, or with one lane those of the tile's pixel `item`. */
RT_FN void rt_trace_tile(rt_scene_view view, rt_tile tile, rt_u32 item, RT_GLOBAL rt_film_pixel* RT_RESTRICT film)
{
	rt_tile_work work;
	rt_film_sum sum = rt_film_sum_zero();
	rt_uint segments = rt_splat_u(0u);
	rt_u32 last_sample = tile.first_sample + tile.sample_count - 1u;
	rt_uint sample = rt_splat_u(tile.first_sample);
#if RT_LANES == 1
	work.columns[0] = tile.column + item % RT_TILE_WIDTH;
	work.rows[0] = tile.row + item / RT_TILE_WIDTH;
	int inside = work.columns[0] < tile.end_column && work.rows[0] < tile.end_row;
	rt_mask live = inside && tile.sample_count != 0u;
	rt_uint x = work.columns[0] + view.scene->window_x, y = work.rows[0] + view.scene->window_y;
#else
	(void)item;
	rt_store_u(rt_splat_u(tile.column), work.columns);
	rt_store_u(rt_splat_u(tile.row), work.rows);
	work.next_column = tile.column;
	work.next_row = tile.row;
	rt_u32 idle = tile.sample_count == 0u ? ~0u : rt_tile_deal(&work, tile, rt_mask_bits(RT_TRUE));
	rt_mask live = rt_lane_mask(~idle);
	rt_uint x = rt_load_u(work.columns) + view.scene->window_x, y = rt_load_u(work.rows) + view.scene->window_y;
#endif
	rt_uint pixel = y * view.scene->width + x;
	rt_path path = rt_path_start(view, x, y, sample);

	while (rt_vote_any(live)) {
		RT_IF_ONE_LANE(live)
		{
			rt_mask finished = rt_path_step(view, &path, pixel, sample, live, &segments);
			if (rt_any(finished)) {
				sum = rt_film_add(sum, finished, rt_film_sample(view.scene, path.radiance));
				rt_mask taken = finished & (sample == rt_splat_u(last_sample));
				sample = rt_sel(finished, sample + 1u, sample);
#if RT_LANES == 1
				live = rt_not(taken);
#else
				rt_u32 lanes = rt_mask_bits(taken);
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
#endif
				path = rt_path_sel(finished, rt_path_start(view, x, y, sample), path);
			}
		}
	}
#if RT_LANES == 1
	if (inside)
		rt_tile_add(view, tile, &work, 1u, sum, segments, film);
#endif
}

#endif
