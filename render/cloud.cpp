// The built-in scene `cloud-N`. Positions, radii and materials are a pure function of (sphere, dimension), in integers
// and single correctly rounded operations, so every machine makes the same cloud and any sphere can be made alone.
#include "render/scene.h"
#include "render/scene_ranges.h"
#include "support/memory.h"
#include "support/pages.h"
#include "support/thread_pool.h"

#include <fmt/format.h>

#include <cmath>
#include <new>

namespace rt {

namespace {

// What is drawn for a sphere; each is its own stream of random numbers.
enum Dimension : std::uint64_t { X, Y, Z, Radius, Colour, Dimensions = 8 };

// 24 random bits: SplitMix64's output function (Steele, Lea and Flood 2014) of a counter.
std::uint32_t random_24_bits(std::uint64_t sphere, Dimension dimension)
{
	std::uint64_t z = (sphere * Dimensions + dimension + 1) * 0x9e3779b97f4a7c15u;
	z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
	z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
	return static_cast<std::uint32_t>((z ^ (z >> 31)) >> 40);
}

// floor(2^12 * cube root of n), for n <= 2^26: integers, because no library's cbrt rounds the same everywhere.
std::uint64_t cube_root_12_bits(std::uint64_t n)
{
	const std::uint64_t cube = n << 36;
	std::uint64_t root = 0;
	for (std::uint64_t bit = std::uint64_t(1) << 20; bit; bit >>= 1) {
		const std::uint64_t larger = root | bit;
		if (larger * larger * larger <= cube)
			root = larger;
	}
	return root;
}

// The cube is [-1, 1]^3 whatever N is. Radii lie between half and one and a half of a mean that makes the spheres'
// volumes a tenth of the cube's (overlaps counted twice), so clouds of all sizes look equally dense.
constexpr double mean_radius_of_one = 0.555;

// What a render takes at its peak, tree and all; 10^7 spheres were measured to take 149 (docs/performance.md).
constexpr double host_bytes_a_sphere = 150;

constexpr std::uint64_t spheres_of_a_piece = 16384;

} // namespace

Result<Scene> make_cloud(std::uint64_t count)
{
	const auto gibibytes = [](std::uint64_t spheres) {
		return static_cast<double>(spheres) * host_bytes_a_sphere / 0x1p30;
	};
	if (count < 1 || count > max_spheres)
		return Error{ErrorKind::InputOutput,
		             fmt::format("a cloud of {} spheres cannot be made: a scene has at most {}, which take about "
		                         "{:.1f} GiB of host memory",
		                         count, max_spheres, gibibytes(max_spheres)),
		             fmt::format("cloud-{}", count),
		             fmt::format("ask for 1 to {} spheres", max_spheres),
		             {}};
	if (const std::uint64_t free = available_host_bytes();
	    free && gibibytes(count) * 0x1p30 > static_cast<double>(free))
		return Error{ErrorKind::Memory,
		             fmt::format("a cloud of {} spheres takes about {:.1f} GiB of host memory and {:.1f} GiB are free",
		                         count, gibibytes(count), static_cast<double>(free) / 0x1p30),
		             fmt::format("cloud-{}", count),
		             "ask for fewer spheres",
		             {}};
	try {
		Scene scene;
		scene.name = fmt::format("cloud-{}", count);
		scene.camera.from = {4.5, 2.75, -5.5};
		scene.camera.at = {0, 0, 0};
		scene.camera.vfov = 30;
		scene.camera.focus = distance(scene.camera.from, scene.camera.at);
		scene.sky.kind = Sky::Kind::Constant;
		scene.sky.bottom = scene.sky.top = {1, 1, 1};

		const struct {
			const char* name;
			Vec3d albedo;
		} colours[] = {{"brick", {0.75, 0.25, 0.1875}},
		               {"ochre", {0.875, 0.625, 0.1875}},
		               {"chalk", {0.8125, 0.8125, 0.78125}},
		               {"sea", {0.125, 0.4375, 0.625}},
		               {"slate", {0.25, 0.3125, 0.375}}};
		for (const auto& colour : colours) {
			Material material;
			material.name = colour.name;
			material.albedo = colour.albedo;
			scene.materials.push_back(material);
		}

		const double mean_radius = mean_radius_of_one * 4096 / static_cast<double>(cube_root_12_bits(count));
		reserve_pages(scene.spheres, count);
		scene.spheres.resize(count);
		parallel_for(count, spheres_of_a_piece, [&](std::uint64_t begin, std::uint64_t end) {
			for (std::uint64_t i = begin; i < end; ++i) {
				Sphere& sphere = scene.spheres[i];
				for (const Dimension axis : {X, Y, Z})
					sphere.center[axis] = std::fma(random_24_bits(i, axis), 0x1p-23, -1.0);
				sphere.radius = mean_radius * std::fma(random_24_bits(i, Radius), 0x1p-24, 0.5);
				sphere.material = random_24_bits(i, Colour) % static_cast<std::uint32_t>(scene.materials.size());
			}
		});
		update_scene_hash(scene);
		return scene;
	} catch (const std::bad_alloc&) {
		return Error{ErrorKind::Memory,
		             fmt::format("no memory for {} spheres", count),
		             fmt::format("cloud-{}", count),
		             "ask for fewer spheres",
		             {}};
	}
}

} // namespace rt
