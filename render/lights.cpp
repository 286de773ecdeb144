#include "render/lights.h"

#include "common/rt_features.h"

#include <algorithm>
#include <cmath>
#include <fmt/format.h>

namespace rt {
namespace {

struct Lamp {
	std::uint32_t sphere; // storage index
	double emission;      // of the brightest channel
	double radius;
};

std::vector<Lamp> lamps_of(const PackedScene& packed)
{
	std::vector<Lamp> lamps;
	for (std::size_t i = 0; i < packed.spheres.size(); ++i) {
		const rt_material& material = packed.materials[packed.sphere_materials[i]];
		const float emission = std::max({material.emission_r, material.emission_g, material.emission_b});
		if (emission > 0)
			lamps.push_back(
			    {static_cast<std::uint32_t>(i), static_cast<double>(emission), double(packed.spheres[i].radius)});
	}
	return lamps;
}

// As rt_light_chance() in kernels/light.h, of the same floats.
double chance_of(const rt_scene& scene, const Lamp& lamp)
{
	const double ratio = lamp.radius * static_cast<double>(scene.light_radius_inverse);
	return std::fma(lamp.emission * static_cast<double>(scene.light_share), ratio * ratio,
	                static_cast<double>(scene.light_floor));
}

// Rows are found as floor(n k / 2^24), k uniform: a row's chance is the count of its k over 2^24.
double row_chance(std::uint64_t row, std::uint64_t rows)
{
	const auto first = [rows](std::uint64_t r) { return ((r << 24) + rows - 1) / rows; };
	return std::ldexp(static_cast<double>(first(row + 1) - first(row)), -24);
}

// The alias method of Vose (1991) with rows of unequal chance: a lamp that needs less than its own row shares it with
// one that needs more.
std::vector<rt_light> alias_table(const std::vector<Lamp>& lamps, const rt_scene& scene)
{
	std::vector<rt_light> table(lamps.size());
	std::vector<double> left(lamps.size());
	std::vector<std::uint32_t> small, large;
	const auto sort_in = [&](std::uint32_t i) { (left[i] < row_chance(i, lamps.size()) ? small : large).push_back(i); };
	double total = 0;
	for (const Lamp& lamp : lamps)
		total += chance_of(scene, lamp);
	for (std::size_t i = 0; i < lamps.size(); ++i) {
		left[i] = chance_of(scene, lamps[i]) / total;
		table[i] = {lamps[i].sphere, lamps[i].sphere, 1.0f, 0};
		sort_in(static_cast<std::uint32_t>(i));
	}
	while (!small.empty() && !large.empty()) {
		const std::uint32_t taker = small.back(), giver = large.back();
		const double row = row_chance(taker, lamps.size());
		small.pop_back();
		large.pop_back();
		table[taker].other = lamps[giver].sphere;
		table[taker].threshold = static_cast<float>(left[taker] / row);
		left[giver] -= row - left[taker];
		sort_in(giver);
	}
	return table; // what is left over are roundings: rows of their own
}

} // namespace

Status pack_lights(PackedScene& packed)
{
	rt_scene& scene = packed.scene;
	if (scene.estimator == RT_ESTIMATOR_PATH)
		return success();
	const std::vector<Lamp> lamps = lamps_of(packed);
	if (lamps.empty() || (packed.features & RT_FEATURE_LAMBERTIAN) == 0) {
		scene.estimator = RT_ESTIMATOR_PATH;
		return success();
	}
	if (lamps.size() > RT_MAX_LIGHTS)
		return Error{ErrorKind::Usage,
		             fmt::format("the scene has {} lamps, more than rays can be aimed at", lamps.size()),
		             {},
		             fmt::format("use at most {}, or --estimator path, which has no limit", RT_MAX_LIGHTS),
		             {}};

	double largest = 0, power = 0;
	for (const Lamp& lamp : lamps)
		largest = std::max(largest, lamp.radius);
	for (const Lamp& lamp : lamps) {
		const double ratio = lamp.radius / largest;
		power = std::fma(lamp.emission * ratio, ratio, power);
	}
	const auto count = static_cast<double>(lamps.size());
	scene.light_count = static_cast<std::uint32_t>(lamps.size());
	scene.light_radius_inverse = static_cast<float>(1 / largest);
	// A lamp alone is chosen with probability 1 exactly.
	scene.light_share = lamps.size() == 1 ? 0.0f : static_cast<float>(0.5 / power);
	scene.light_floor = lamps.size() == 1 ? 1.0f : static_cast<float>(0.5 / count);
	packed.lights = alias_table(lamps, scene);
	packed.features |= RT_FEATURE_LIGHTS;
	return success();
}

double brightest_choice(const PackedScene& packed)
{
	double brightest = 0;
	if (!packed.lights.empty())
		for (const Lamp& lamp : lamps_of(packed))
			brightest = std::max(brightest, lamp.emission / chance_of(packed.scene, lamp));
	return brightest;
}

void follow_spheres(const PackedScene& before, PackedScene& out)
{
	if (before.lights.empty())
		return;
	std::vector<std::uint32_t> place(out.sphere_ids.size()); // by id
	for (std::size_t i = 0; i < out.sphere_ids.size(); ++i)
		place[out.sphere_ids[i]] = static_cast<std::uint32_t>(i);
	for (std::size_t i = 0; i < before.lights.size(); ++i) {
		out.lights[i].sphere = place[before.sphere_ids[before.lights[i].sphere]];
		out.lights[i].other = place[before.sphere_ids[before.lights[i].other]];
	}
}

} // namespace rt
