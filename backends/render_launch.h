// render_launch.h: how the kernel rt_render (kernels/render.cl) is launched.
#pragma once

#include "backends/backend.h"
#include "common/rt_structs.h"

#include <cstdint>
#include <vector>

namespace rt {

// A packed scene's lists (render/pack.h) on a device. None may be null: an empty list is a buffer that is not read.
struct SceneBuffers {
	BufferHandle spheres, wide, ids, sphere_materials, bvh, materials, textures, texels, lights;
};

// Rows of the window and samples of their pixels that a launch takes.
struct RenderRange {
	std::uint32_t first_row = 0, rows = 0;
	std::uint32_t first_sample = 0, samples = 0;
	std::uint32_t slices = 1;       // parts of the samples, taken side by side
	std::uint32_t slice_pixels = 0; // of the film from one slice to the next
};

// Of rt_render.
std::vector<Argument> render_arguments(const rt_scene& scene, const rt_few_spheres& few, const SceneBuffers& lists,
                                       const BufferHandle& film, const RenderRange& range);

// Work-items for that range of a window.
constexpr std::uint64_t render_items(std::uint64_t width, const RenderRange& range, std::uint32_t lanes)
{
	return RT_TILES(width, range.rows, lanes) * RT_TILE_ITEMS(lanes) * range.slices;
}

// Of the groups that they are best launched in; 0: the backend's choice. A work-item of several lanes has a tile's
// work: a group of them would make the driver keep each one's stacks, and PoCL compile for longer.
constexpr std::uint32_t render_group(std::uint32_t lanes) { return lanes > 1 ? 1 : 0; }

} // namespace rt
