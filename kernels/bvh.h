/* bvh.h: the nearest sphere through a tree of boxes.
 *
 * The tree leaves out work, never a hit: its boxes are padded, in the ray's own measure, by more than all roundings of
 * the sphere test together, so every sphere that testing all of them would report is reached, and the hit is the same
 * minimum of (t, id) (contract rule 8). Which tree a device walks is its own affair.
 *
 * One lane (a GPU's thread) walks nodes of four children in turn. Several lanes take one ray at a time: its box tests
 * and sphere tests against RT_LANES children or spheres are one vector operation each, which incoherent rays cannot
 * have from packets.
 *
 * Coordinates of boxes are relative to the tree's centre. A ray's parameters for the slab test (Kay and Kajiya 1986)
 * are t = plane / d - o / d, with the padding in the second term.
 */
#ifndef RT_BVH_H
#define RT_BVH_H

#include "kernels/scene_view.h"
#include "kernels/sphere.h"

/* How far a walk through the tree has got. With one lane it may be broken off (rt_bvh_walk); what remains to be seen is
 * on its stack. */
typedef struct rt_walk {
	rt_hit hit; /* the nearest so far */
	rt_u32 link, top;
	rt_mask underway;
} rt_walk;
typedef struct rt_walk_stack {
	rt_u32 links[RT_BVH_STACK(RT_LANES)];
	rt_float entries[RT_BVH_STACK(RT_LANES)];
} rt_walk_stack;

#if RT_HAS(RT_FEATURE_BVH)

/* What boxes are padded by, in units of (the tree's extent + the ray's distance from its centre + its reach). With
 * u = 2^-24 and m the vector from origin to centre, rounding moves a ray against a sphere by less than 4 u (|m| +
 * reach) across and 8 u |m| along, and the slab test errs by 3 u of a coordinate; 64 u is more than three times their
 * sum. */
#define RT_BVH_PADDING 0x1p-18f

/* Directions are kept away from 0, so that no slab's t is NaN: on the way through the scene that is less than
 * the padding. */
#define RT_MIN_SLOPE 0x1p-60f

/* A ray as the slab test reads it: t of a plane at x is x * inverse + shift. */
typedef struct rt_slabs {
	rt_vec3 inverse;
	rt_vec3 near_shift, far_shift;
} rt_slabs;

RT_FN rt_float rt_slope_inverse(rt_float d)
{
	rt_float size = rt_max(rt_abs(d), rt_splat(RT_MIN_SLOPE));
	return rt_rcp(rt_from_bits(rt_bits(size) | (rt_bits(d) & RT_SIGN_BIT)));
}

RT_FN rt_slabs rt_ray_slabs(RT_UNIFORM const rt_scene* scene, rt_ray ray)
{
	rt_slabs slabs;
	rt_vec3 centre = v3_splat(scene->bvh_x, scene->bvh_y, scene->bvh_z);
	rt_vec3 origin = v3_fma(ray.reach, ray.arm, v3_sub(ray.base, centre));
	rt_float reach = rt_max(rt_max(rt_abs(origin.x), rt_abs(origin.y)), rt_max(rt_abs(origin.z), rt_abs(ray.reach)));
	rt_float padding = (reach + rt_splat(scene->bvh_extent)) * rt_splat(RT_BVH_PADDING);
	slabs.inverse = v3(rt_slope_inverse(ray.dir.x), rt_slope_inverse(ray.dir.y), rt_slope_inverse(ray.dir.z));
	rt_vec3 shift = v3(-origin.x * slabs.inverse.x, -origin.y * slabs.inverse.y, -origin.z * slabs.inverse.z);
	rt_vec3 widen = v3(rt_abs(slabs.inverse.x), rt_abs(slabs.inverse.y), rt_abs(slabs.inverse.z));
	slabs.near_shift = v3_fma(-padding, widen, shift);
	slabs.far_shift = v3_fma(padding, widen, shift);
	return slabs;
}

/* A ray that is no number meets nothing (contract rule 7); the minima and maxima of the box test would let it visit
 * everything. */
RT_FN rt_mask rt_slabs_are_numbers(rt_slabs slabs)
{
	rt_float sum = (slabs.near_shift.x + slabs.near_shift.y) + (slabs.near_shift.z + slabs.far_shift.x) +
	               (slabs.far_shift.y + slabs.far_shift.z);
	return sum == sum;
}

#if RT_LANES == 1

/* Of so many lanes that set out together, how many must be walking for a walk to be gone on with: as measured (docs/
 * performance.md, Steps). */
#define RT_WALKERS(came) ((came) / 2u)

/* Of slabs' t. Where one is NaN the device's own let a ray into more boxes than ours, which leaves no hit out. */
#ifdef rt_native_min
RT_FN rt_float rt_slab_min(rt_float a, rt_float b) { return rt_native_min(a, b); }
RT_FN rt_float rt_slab_max(rt_float a, rt_float b) { return rt_native_max(a, b); }
#else
RT_FN rt_float rt_slab_min(rt_float a, rt_float b) { return rt_min(a, b); }
RT_FN rt_float rt_slab_max(rt_float a, rt_float b) { return rt_max(a, b); }
#endif

/* One box against one ray: where it enters, or RT_MAX_FLOAT if it misses or enters behind `limit`. */
RT_FN rt_float rt_box_entry(rt_slabs slabs, rt_float near_x, rt_float far_x, rt_float near_y, rt_float far_y,
                            rt_float near_z, rt_float far_z, rt_float limit)
{
	rt_float entry = rt_slab_max(rt_slab_max(rt_fma(near_x, slabs.inverse.x, slabs.near_shift.x),
	                                         rt_fma(near_y, slabs.inverse.y, slabs.near_shift.y)),
	                             rt_slab_max(rt_fma(near_z, slabs.inverse.z, slabs.near_shift.z), 0.0f));
	rt_float leave = rt_slab_min(rt_slab_min(rt_fma(far_x, slabs.inverse.x, slabs.far_shift.x),
	                                         rt_fma(far_y, slabs.inverse.y, slabs.far_shift.y)),
	                             rt_slab_min(rt_fma(far_z, slabs.inverse.z, slabs.far_shift.z), limit));
	return entry <= leave ? entry : RT_MAX_FLOAT;
}

/* Puts the nearer of two children first. */
#define RT_SORT_CHILDREN(i, j)      \
	if (entry[j] < entry[i]) {      \
		rt_float entry_ = entry[i]; \
		rt_u32 child_ = child[i];   \
		entry[i] = entry[j];        \
		child[i] = child[j];        \
		entry[j] = entry_;          \
		child[j] = child_;          \
	}

/* Begins a walk; `hit` is the nearest so far. */
RT_FN void rt_bvh_begin(rt_scene_view view, rt_hit hit, RT_PRIVATE rt_walk* walk)
{
	walk->hit = hit;
	walk->link = view.scene->bvh_root;
	walk->top = 0u;
	walk->underway = RT_TRUE;
}

/* Goes on with a walk to its end; or, unless it is wanted `whole`, until so few lanes of the warp are still walking
 * that the others had better shade what they met and set out again. It takes at least one step. */
RT_FN void rt_bvh_walk(rt_scene_view view, rt_ray ray, RT_PRIVATE rt_walk* walk, RT_PRIVATE rt_walk_stack* stack,
                       int whole)
{
	rt_slabs slabs = rt_ray_slabs(view.scene, ray);
	/* Rows of a node: near and far planes by axis; which is which depends on the sign of the direction. */
	rt_u32 flip_x = rt_sign_bit(ray.dir.x);
	rt_u32 flip_y = rt_sign_bit(ray.dir.y);
	rt_u32 flip_z = rt_sign_bit(ray.dir.z);
	rt_u32 top = walk->top;
	rt_u32 link = walk->link;
	rt_hit hit = walk->hit;
	rt_u32 came = rt_warp_count(rt_warp_here());

	walk->underway = RT_FALSE;
	if (!rt_slabs_are_numbers(slabs))
		return;
	for (;;) {
		/* Go down to a leaf, nearest child first. */
		while ((link & RT_BVH_LEAF) == 0u) {
			RT_GLOBAL const rt_row4* node = &view.bvh[link * RT_BVH_NODE_ROWS(4u)];
			rt_row4 near_x = node[flip_x], far_x = node[1u - flip_x];
			rt_row4 near_y = node[2u + flip_y], far_y = node[3u - flip_y];
			rt_row4 near_z = node[4u + flip_z], far_z = node[5u - flip_z];
			rt_row4 links = node[6];
			rt_float entry[4];
			rt_u32 child[4];
			entry[0] = rt_box_entry(slabs, near_x.a, far_x.a, near_y.a, far_y.a, near_z.a, far_z.a, hit.t);
			entry[1] = rt_box_entry(slabs, near_x.b, far_x.b, near_y.b, far_y.b, near_z.b, far_z.b, hit.t);
			entry[2] = rt_box_entry(slabs, near_x.c, far_x.c, near_y.c, far_y.c, near_z.c, far_z.c, hit.t);
			entry[3] = rt_box_entry(slabs, near_x.d, far_x.d, near_y.d, far_y.d, near_z.d, far_z.d, hit.t);
			child[0] = rt_bits_one(links.a);
			child[1] = rt_bits_one(links.b);
			child[2] = rt_bits_one(links.c);
			child[3] = rt_bits_one(links.d);
			RT_SORT_CHILDREN(0, 1)
			RT_SORT_CHILDREN(2, 3)
			RT_SORT_CHILDREN(0, 2)
			RT_SORT_CHILDREN(1, 3)
			RT_SORT_CHILDREN(1, 2)
			link = RT_BVH_NONE;
			if (entry[0] < RT_MAX_FLOAT) {
				link = child[0];
				if (entry[3] < RT_MAX_FLOAT) {
					stack->links[top] = child[3];
					stack->entries[top++] = entry[3];
				}
				if (entry[2] < RT_MAX_FLOAT) {
					stack->links[top] = child[2];
					stack->entries[top++] = entry[2];
				}
				if (entry[1] < RT_MAX_FLOAT) {
					stack->links[top] = child[1];
					stack->entries[top++] = entry[1];
				}
			}
		}
		if (link != RT_BVH_NONE) {
			rt_u32 i = link & RT_BVH_FIRST_MASK;
			rt_u32 end = i + ((link >> RT_BVH_COUNT_SHIFT) & RT_BVH_COUNT_MASK) + 1u;
			for (; i < end; ++i) {
				rt_mask met;
				rt_float t = rt_sphere_distance(v3(view.spheres[i].cx, view.spheres[i].cy, view.spheres[i].cz),
				                                view.spheres[i].radius, ray, ray.from == (rt_i32)i, &met);
				if (met && t <= hit.t)
					hit = rt_hit_nearer(hit, t, met, i, view.sphere_ids);
			}
		}
		/* What lies behind the hit needs no visit; an equal t may still have the smaller id. */
		do {
			if (top == 0u) {
				walk->hit = hit;
				return;
			}
			link = stack->links[--top];
		} while (stack->entries[top] > hit.t);
		if (!whole && RT_WALKERS(came) > rt_warp_count(rt_warp_here()))
			break;
	}
	walk->hit = hit;
	walk->link = link;
	walk->top = top;
	walk->underway = RT_TRUE;
}

RT_FN rt_hit rt_bvh_hit(rt_scene_view view, rt_ray ray, rt_hit hit, rt_mask live)
{
	rt_walk walk;
	rt_walk_stack stack;
	(void)live;
	rt_bvh_begin(view, hit, &walk);
	rt_bvh_walk(view, ray, &walk, &stack, 1);
	return walk.hit;
}

#else

/* A ray's members for all lanes, to be taken lane by lane. */
typedef struct rt_ray_store {
	float base_x[RT_LANES], base_y[RT_LANES], base_z[RT_LANES];
	float arm_x[RT_LANES], arm_y[RT_LANES], arm_z[RT_LANES];
	float dir_x[RT_LANES], dir_y[RT_LANES], dir_z[RT_LANES];
	float reach[RT_LANES];
	float inverse_x[RT_LANES], inverse_y[RT_LANES], inverse_z[RT_LANES];
	float near_x[RT_LANES], near_y[RT_LANES], near_z[RT_LANES];
	float far_x[RT_LANES], far_y[RT_LANES], far_z[RT_LANES];
	float t[RT_LANES];
	rt_u32 from[RT_LANES], index[RT_LANES], id[RT_LANES], live[RT_LANES];
} rt_ray_store;

/* Walks the tree with the ray of one lane. */
RT_FN void rt_bvh_hit_lane(rt_scene_view view, RT_PRIVATE rt_ray_store* store, rt_u32 lane)
{
	rt_u32 stack[RT_BVH_STACK(RT_LANES)];
	float entries[RT_BVH_STACK(RT_LANES)];
	rt_u32 top = 0u;
	rt_u32 link = view.scene->bvh_root;
	float nearest = store->t[lane];
	rt_u32 nearest_id = store->id[lane];
	rt_u32 nearest_index = store->index[lane];
	rt_ray ray;
	rt_slabs slabs;
	ray.base = v3_splat(store->base_x[lane], store->base_y[lane], store->base_z[lane]);
	ray.arm = v3_splat(store->arm_x[lane], store->arm_y[lane], store->arm_z[lane]);
	ray.dir = v3_splat(store->dir_x[lane], store->dir_y[lane], store->dir_z[lane]);
	ray.reach = rt_splat(store->reach[lane]);
	ray.from = rt_splat_i((rt_i32)store->from[lane]);
	ray.chord = rt_splat(-1.0f);
	slabs.inverse = v3_splat(store->inverse_x[lane], store->inverse_y[lane], store->inverse_z[lane]);
	slabs.near_shift = v3_splat(store->near_x[lane], store->near_y[lane], store->near_z[lane]);
	slabs.far_shift = v3_splat(store->far_x[lane], store->far_y[lane], store->far_z[lane]);
	rt_u32 flip_x = store->inverse_x[lane] < 0.0f ? 1u : 0u;
	rt_u32 flip_y = store->inverse_y[lane] < 0.0f ? 1u : 0u;
	rt_u32 flip_z = store->inverse_z[lane] < 0.0f ? 1u : 0u;

	for (;;) {
		if ((link & RT_BVH_LEAF) == 0u) {
			RT_GLOBAL const rt_row4* node = &view.bvh[link * RT_BVH_NODE_ROWS(RT_LANES)];
			rt_float limit = rt_splat(nearest);
			rt_float entry = rt_max(
			    rt_max(rt_fma(rt_load_rows(node, flip_x), slabs.inverse.x, slabs.near_shift.x),
			           rt_fma(rt_load_rows(node, 2u + flip_y), slabs.inverse.y, slabs.near_shift.y)),
			    rt_max(rt_fma(rt_load_rows(node, 4u + flip_z), slabs.inverse.z, slabs.near_shift.z), rt_splat(0.0f)));
			rt_float leave =
			    rt_min(rt_min(rt_fma(rt_load_rows(node, 1u - flip_x), slabs.inverse.x, slabs.far_shift.x),
			                  rt_fma(rt_load_rows(node, 3u - flip_y), slabs.inverse.y, slabs.far_shift.y)),
			           rt_min(rt_fma(rt_load_rows(node, 5u - flip_z), slabs.inverse.z, slabs.far_shift.z), limit));
			rt_mask reached = entry <= leave;
			if (rt_any(reached)) {
				/* Go on with the nearest child that it reaches, and push the others, the nearer the later. */
				float lane_entry[RT_LANES];
				rt_u32 lane_link[RT_LANES];
				rt_u32 first = top;
				rt_u32 left = rt_mask_bits(reached);
				float next_entry = RT_MAX_FLOAT;
				link = RT_BVH_NONE;
				rt_store_f(entry, lane_entry);
				rt_store_u(rt_bits(rt_load_rows(node, 6u)), lane_link);
				do {
					rt_u32 k = rt_lowest_bit(left);
					rt_u32 further = lane_link[k];
					float further_entry = lane_entry[k];
					left &= left - 1u;
					if (further == RT_BVH_NONE) /* a ray of infinite numbers reaches empty places too */
						continue;
					if (link == RT_BVH_NONE || further_entry < next_entry) {
						rt_u32 other = link;
						float other_entry = next_entry;
						link = further;
						next_entry = further_entry;
						further = other;
						further_entry = other_entry;
					}
					if (further != RT_BVH_NONE) {
						rt_u32 place = top++;
						while (place > first && entries[place - 1u] < further_entry) {
							entries[place] = entries[place - 1u];
							stack[place] = stack[place - 1u];
							--place;
						}
						entries[place] = further_entry;
						stack[place] = further;
					}
				} while (left != 0u);
				if (link != RT_BVH_NONE)
					continue;
			}
		} else {
			/* A block: the index of its first sphere and the number of them, then centres and radii side by side. */
			RT_GLOBAL const rt_row4* block =
			    &(view.bvh + view.scene->bvh_blocks)[(link & RT_BVH_FIRST_MASK) * RT_BVH_BLOCK_ROWS(RT_LANES)];
			rt_u32 first = rt_bits_one(block->a);
			rt_vec3 centers =
			    v3(rt_load_rows(block + 1u, 0u), rt_load_rows(block + 1u, 1u), rt_load_rows(block + 1u, 2u));
			rt_mask met;
			rt_float t = rt_sphere_distance(centers, rt_load_rows(block + 1u, 3u), ray,
			                                ray.from == rt_to_int(first + rt_lane_ids()), &met);
			met = met & (t <= rt_splat(nearest));
			if (rt_any(met)) {
				float lane_t[RT_LANES];
				rt_u32 left = rt_mask_bits(met);
				rt_store_f(t, lane_t);
				while (left != 0u) {
					rt_u32 k = rt_lowest_bit(left);
					left &= left - 1u;
					if (lane_t[k] < nearest || (lane_t[k] == nearest && view.sphere_ids[first + k] < nearest_id)) {
						nearest = lane_t[k];
						nearest_index = first + k;
						nearest_id = view.sphere_ids[nearest_index];
					}
				}
			}
		}
		/* What lies behind the hit needs no visit; an equal t may still have the smaller id. */
		do {
			if (top == 0u) {
				store->t[lane] = nearest;
				store->index[lane] = nearest_index;
				store->id[lane] = nearest_id;
				return;
			}
			link = stack[--top];
		} while (entries[top] > nearest);
	}
}

RT_FN rt_hit rt_bvh_hit(rt_scene_view view, rt_ray ray, rt_hit hit, rt_mask live)
{
	rt_slabs slabs = rt_ray_slabs(view.scene, ray);
	rt_ray_store store;
	rt_store_f(ray.base.x, store.base_x);
	rt_store_f(ray.base.y, store.base_y);
	rt_store_f(ray.base.z, store.base_z);
	rt_store_f(ray.arm.x, store.arm_x);
	rt_store_f(ray.arm.y, store.arm_y);
	rt_store_f(ray.arm.z, store.arm_z);
	rt_store_f(ray.dir.x, store.dir_x);
	rt_store_f(ray.dir.y, store.dir_y);
	rt_store_f(ray.dir.z, store.dir_z);
	rt_store_f(ray.reach, store.reach);
	rt_store_f(slabs.inverse.x, store.inverse_x);
	rt_store_f(slabs.inverse.y, store.inverse_y);
	rt_store_f(slabs.inverse.z, store.inverse_z);
	rt_store_f(slabs.near_shift.x, store.near_x);
	rt_store_f(slabs.near_shift.y, store.near_y);
	rt_store_f(slabs.near_shift.z, store.near_z);
	rt_store_f(slabs.far_shift.x, store.far_x);
	rt_store_f(slabs.far_shift.y, store.far_y);
	rt_store_f(slabs.far_shift.z, store.far_z);
	rt_store_f(hit.t, store.t);
	rt_store_u(rt_to_uint(ray.from), store.from);
	rt_store_u(rt_to_uint(hit.index), store.index);
	rt_store_u(hit.id, store.id);
	rt_store_u(rt_sel(live & rt_slabs_are_numbers(slabs), rt_splat_u(1u), rt_splat_u(0u)), store.live);
	for (rt_u32 lane = 0u; lane < RT_LANES; ++lane)
		if (store.live[lane] != 0u)
			rt_bvh_hit_lane(view, &store, lane);
	hit.t = rt_load_f(store.t);
	hit.index = rt_to_int(rt_load_u(store.index));
	hit.id = rt_load_u(store.id);
	return hit;
}

#endif

#endif

/* The nearest sphere in front of the ray, where `live`: the minimum of (t, id). */
RT_FN rt_hit rt_closest_hit(rt_scene_view view, rt_ray ray, rt_mask live)
{
#if RT_HAS(RT_FEATURE_BVH)
	int has_tree = view.scene->bvh_root != RT_BVH_NONE;
	rt_hit hit = rt_closest_listed(view, ray, !has_tree);
	return has_tree ? rt_bvh_hit(view, ray, hit, live) : hit;
#else
	(void)live;
	return rt_closest_listed(view, ray, 1);
#endif
}

/* The same for a path's next segment, in pieces where that keeps a warp busy: until walk->underway says that it is
 * over, the hit is none yet. `walk` and `stack` are the path's. */
RT_FN rt_hit rt_next_hit(rt_scene_view view, rt_ray ray, rt_mask live, RT_PRIVATE rt_walk* walk,
                         RT_PRIVATE rt_walk_stack* stack)
{
#if RT_HAS(RT_FEATURE_BVH) && RT_WARP > 1
	int has_tree = view.scene->bvh_root != RT_BVH_NONE;
	(void)live;
	if (!walk->underway)
		rt_bvh_begin(view, rt_closest_listed(view, ray, !has_tree), walk);
	walk->underway = RT_FALSE;
	if (has_tree)
		rt_bvh_walk(view, ray, walk, stack, 0);
	return walk->hit;
#else
	(void)walk;
	(void)stack;
	return rt_closest_hit(view, ray, live);
#endif
}

#endif
