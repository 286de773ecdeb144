#include "backends/stress_tile.h"

#include "backends/render_launch.h"
#include "common/rt_structs.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <vector>

namespace rt {

const char* const stress_tile_hash = "b3c20040270f4582c59175032f3dc2c4";
const char* const stress_tile_double_hash = "2389063834012db2711f978f4327de03";

namespace {

constexpr std::uint32_t size = 32, samples = 8;

// Written out in packed form, so that nothing of the scene reader stands between a device and its verdict. The camera
// looks along +z through a lens at a matte, a mirror, a fuzzy, a glass, a checkered and an image-textured sphere, two
// coincident spheres, a glowing one and a lamp, over a wide ground.
struct StressScene {
	rt_scene scene{};
	std::vector<rt_sphere> spheres;
	std::vector<rt_wide> wide;
	std::vector<std::uint32_t> ids, sphere_materials;
	std::vector<rt_material> materials;
	std::vector<rt_texture> textures;
	std::vector<std::uint32_t> texels;

	StressScene()
	{
		scene.corner_x = -1.25f;
		scene.corner_y = 1.0f;
		scene.corner_z = 3.0f;
		scene.step_x_x = 2.5f / size;
		scene.step_y_y = -2.0f / size;
		scene.lens_u_x = 0.03125f;
		scene.lens_v_y = 0.03125f;
		scene.sky_bottom_r = scene.sky_bottom_g = scene.sky_bottom_b = 1.0f;
		scene.sky_delta_r = -0.5f;
		scene.sky_delta_g = -0.25f;
		scene.film_scale = 0x1p36f; // for radiances up to 2^4
		scene.film_scale_high = 0x1p16f;
		scene.radiance_limit = 32.0f;
		scene.width = scene.height = scene.window_width = scene.window_height = size;
		scene.seed = 20261122u;
		scene.max_depth = 12;

		add_wide({0.0f, -101.0f, 3.0f, 100.0f}, 210.0f, matte(0.5f, 0.75f, 0.25f));
		add({-0.75f, 0.0f, 3.5f, 0.5f}, matte(0.7f, 0.1f, 0.2f));
		add({0.75f, 0.0f, 3.5f, 0.5f}, metal(0.8f, 0.0f));
		add({0.25f, -0.5f, 2.5f, 0.25f}, metal(0.9f, 0.3f));
		add({-0.25f, -0.5f, 2.5f, 0.25f}, glass(1.5f));
		add({-0.25f, -0.5f, 2.5f, 0.1875f}, glass(0.75f));
		add({0.0f, 0.5f, 4.0f, 0.375f}, textured(0));
		add({-1.0f, 0.625f, 4.0f, 0.3125f}, textured(1));
		add({1.0f, 0.625f, 4.0f, 0.25f}, matte(0.0f, 1.0f, 0.0f));
		add({1.0f, 0.625f, 4.0f, 0.25f}, matte(1.0f, 0.0f, 1.0f)); // coincident: the lower id owns the surface
		add({0.25f, 0.0f, 3.0f, 0.125f}, glowing());
		add({-0.25f, 1.25f, 2.0f, 0.25f}, lamp());
		scene.sphere_count = static_cast<std::uint32_t>(spheres.size());
		scene.wide_count = static_cast<std::uint32_t>(wide.size());
		scene.bvh_root = RT_BVH_NONE;

		rt_texture checker{};
		checker.kind = RT_TEXTURE_CHECKER;
		checker.squares = 10.0f;
		checker.even_r = 0.7f;
		checker.even_g = checker.even_b = 0.2f;
		checker.odd_r = checker.odd_g = checker.odd_b = 1.0f;
		rt_texture image{};
		image.kind = RT_TEXTURE_IMAGE;
		image.width = 4;
		image.height = 3;
		textures = {checker, image};
		for (std::uint32_t i = 0; i < image.width * image.height; ++i)
			texels.push_back((i * 0x9e3779b9u) >> 8);
	}

	// A tree of one node by hand (rt_row4's layout, common/rt_structs.h): its children are leaves of neighbours in the
	// list, in storage order.
	std::vector<rt_row4> plant_tree(std::uint32_t lanes)
	{
		const std::uint32_t width = RT_BVH_WIDTH(lanes), first = scene.wide_count, count = scene.sphere_count - first;
		const std::uint32_t a_leaf = (count + width - 1) / width, node_words = RT_BVH_NODE_ROWS(width) * 4;
		const std::uint32_t block_words = RT_BVH_BLOCK_ROWS(width) * 4;
		std::vector<float> words(node_words);
		for (std::uint32_t k = 0; k < width; ++k) {
			const std::uint32_t begin = first + std::min(count, k * a_leaf);
			const std::uint32_t end = first + std::min(count, (k + 1) * a_leaf);
			float box[6] = {0x1p60f, -0x1p60f, 0x1p60f, -0x1p60f, 0x1p60f, -0x1p60f};
			std::vector<float> block(block_words, std::numeric_limits<float>::quiet_NaN());
			put(block[0], begin);
			put(block[1], end - begin);
			for (std::uint32_t i = begin; i < end; ++i) {
				const rt_sphere& s = spheres[i];
				const float center[3] = {s.cx, s.cy, s.cz};
				for (std::uint32_t axis = 0; axis < 3; ++axis) {
					box[2 * axis] = std::min(box[2 * axis], center[axis] - s.radius);
					box[2 * axis + 1] = std::max(box[2 * axis + 1], center[axis] + s.radius);
					block[4 + axis * width + (i - begin)] = center[axis];
					scene.bvh_extent = std::max(scene.bvh_extent, std::fabs(center[axis]) + s.radius);
				}
				block[4 + 3 * width + (i - begin)] = s.radius;
			}
			for (std::uint32_t plane = 0; plane < 6; ++plane)
				words[plane * width + k] = box[plane];
			std::uint32_t link = RT_BVH_NONE;
			if (begin < end)
				link = RT_BVH_LEAF | (lanes > 1 ? k : (end - begin - 1) << RT_BVH_COUNT_SHIFT | begin);
			put(words[6 * width + k], link);
			if (lanes > 1)
				words.insert(words.end(), block.begin(), block.end());
		}
		scene.bvh_root = 0;
		scene.bvh_blocks = node_words / 4;
		std::vector<rt_row4> rows(words.size() / 4);
		std::memcpy(rows.data(), words.data(), words.size() * sizeof(float));
		return rows;
	}

private:
	static void put(float& word, std::uint32_t bits) { std::memcpy(&word, &bits, sizeof word); }

	static rt_material plain(std::uint32_t kind)
	{
		rt_material material{};
		material.albedo_r = material.albedo_g = material.albedo_b = 1.0f;
		material.ior = material.ior_inverse = 1.0f;
		material.kind = kind;
		material.texture = RT_NO_TEXTURE;
		return material;
	}
	static rt_material matte(float r, float g, float b)
	{
		rt_material material = plain(RT_MATERIAL_LAMBERTIAN);
		material.albedo_r = r;
		material.albedo_g = g;
		material.albedo_b = b;
		return material;
	}
	static rt_material textured(std::uint32_t texture)
	{
		rt_material material = plain(RT_MATERIAL_LAMBERTIAN);
		material.texture = texture;
		return material;
	}
	static rt_material metal(float albedo, float fuzz)
	{
		rt_material material = plain(RT_MATERIAL_METAL);
		material.albedo_r = material.albedo_g = material.albedo_b = albedo;
		material.fuzz = fuzz;
		return material;
	}
	static rt_material glass(float ior)
	{
		rt_material material = plain(RT_MATERIAL_DIELECTRIC);
		material.ior = ior;
		material.ior_inverse = 1.0f / ior;
		return material;
	}
	static rt_material glowing()
	{
		rt_material material = matte(0.5f, 0.5f, 0.5f);
		material.emission_r = 1.5f;
		material.emission_b = 0.25f;
		return material;
	}
	static rt_material lamp()
	{
		rt_material material = plain(RT_MATERIAL_LIGHT);
		material.emission_r = material.emission_g = material.emission_b = 4.0f;
		return material;
	}
	void add(const rt_sphere& sphere, const rt_material& material)
	{
		ids.push_back(static_cast<std::uint32_t>(spheres.size()));
		sphere_materials.push_back(static_cast<std::uint32_t>(materials.size()));
		spheres.push_back(sphere);
		materials.push_back(material);
	}
	// c0 = |c|^2 - r^2, exact here
	void add_wide(const rt_sphere& sphere, float c0, const rt_material& material)
	{
		rt_wide w{};
		w.c0_high = c0;
		wide.push_back(w);
		add(sphere, material);
	}
};

template <class T>
Result<BufferHandle> upload(Device& device, const std::vector<T>& list)
{
	RT_TRY_ASSIGN(BufferHandle buffer, device.alloc(list.size() * sizeof(T)));
	RT_TRY(device.write(buffer, 0, list.data(), list.size() * sizeof(T)));
	return buffer;
}

} // namespace

Result<Hash128> render_stress_tile(Device& device, const ProgramHandle& program, std::uint32_t lanes, bool through_tree)
{
	StressScene stress;
	std::vector<rt_row4> tree(1);
	if (through_tree)
		tree = stress.plant_tree(lanes);
	std::vector<rt_film_pixel> pixels(size * size, rt_film_pixel{});
	SceneBuffers lists;
	RT_TRY_ASSIGN(lists.spheres, upload(device, stress.spheres));
	RT_TRY_ASSIGN(lists.wide, upload(device, stress.wide));
	RT_TRY_ASSIGN(lists.ids, upload(device, stress.ids));
	RT_TRY_ASSIGN(lists.sphere_materials, upload(device, stress.sphere_materials));
	RT_TRY_ASSIGN(lists.bvh, upload(device, tree));
	RT_TRY_ASSIGN(lists.materials, upload(device, stress.materials));
	RT_TRY_ASSIGN(lists.textures, upload(device, stress.textures));
	RT_TRY_ASSIGN(lists.texels, upload(device, stress.texels));
	RT_TRY_ASSIGN(lists.lights, upload(device, std::vector<rt_light>(1)));
	RT_TRY_ASSIGN(const BufferHandle film, upload(device, pixels));
	RenderRange range;
	range.rows = size;
	range.samples = samples;
	range.slice_pixels = size * size;
	RT_TRY(device.launch(program, "rt_render", render_items(size, range, lanes),
	                     render_arguments(stress.scene, {}, lists, film, range), render_group(lanes)));
	RT_TRY(device.wait());
	RT_TRY(device.read(film, 0, pixels.data(), pixels.size() * sizeof(rt_film_pixel)));
	Hasher hasher;
	for (const rt_film_pixel& pixel : pixels)
		for (const std::int64_t sum : {pixel.r, pixel.g, pixel.b, pixel.tally})
			hasher.add_u64(static_cast<std::uint64_t>(sum));
	return hasher.result();
}

} // namespace rt
