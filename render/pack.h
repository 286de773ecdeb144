// pack.h: from a Scene in double to the structs that kernels read (the only place where a scene is rounded to float).
#pragma once

#include "common/rt_structs.h"
#include "render/film.h"
#include "render/scene.h"
#include "support/result.h"

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace rt {

struct PackedScene {
	rt_scene scene{};
	std::vector<rt_sphere> spheres;              // storage order; wide spheres first
	std::vector<rt_wide> wide;                   // one for each wide sphere
	std::vector<std::uint32_t> sphere_ids;       // id of a stored sphere: its rank in (wide first, then file order)
	std::vector<std::uint32_t> sphere_materials; // index into materials, in storage order
	std::vector<rt_row4> bvh;                    // empty, or a tree over the spheres that are not wide (render/bvh.h)
	std::vector<rt_material> materials;
	std::vector<rt_texture> textures;
	std::vector<std::uint32_t> texels;
	std::vector<rt_light> lights; // empty, or the table by which lamps are chosen (render/lights.h)
	std::uint32_t features = 0;   // RT_FEATURE_* bits that the scene needs
	std::int32_t film_exponent = 0;

	std::uint64_t bytes() const; // device memory of everything above
	void free_lists();           // gives their memory back; what is no list stays
	// Room for the lists of so many spheres, ready to be filled (support/pages.h).
	void reserve_spheres(std::size_t count);
};

// Shifts the scene in double so that the camera is the origin and rounds it once. Errors (Usage): values outside the
// contract's range (rule 5), samples or film sums that could overflow (rule 15), an empty or too large window.
Result<PackedScene> pack_scene(const Scene& scene, const RenderSettings& settings, const Window& window);

// The same scene with its spheres stored in another order (ids unchanged): `order` is a permutation that keeps wide
// spheres first. For tests of rule 8 and for acceleration structures.
PackedScene permute_spheres(const PackedScene& packed, const std::vector<std::uint32_t>& order);

// Names of the bits in a feature mask, lowest first.
std::vector<std::string> feature_names(std::uint32_t features);

} // namespace rt
