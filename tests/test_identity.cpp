// The promise: one scene and seed, one film, whatever the device, the program's variant and the split of the work.
// Comparison is by hash of the integers, never by a threshold.
#include "tests/catch.h"
#include "tests/devices.h"
#include "tests/faulty_device.h"

#include "common/rt_features.h"

#include <fstream>
#include <numeric>

using namespace rt;

namespace {

SessionOptions generic()
{
	SessionOptions options;
	options.specialise = false;
	return options;
}

// The oracle: plain scalar C++.
SessionOptions oracle()
{
	SessionOptions options = generic();
	options.lanes = 1;
	return options;
}

// Says where two films differ first: scene, device, pixel, both integers.
void check_same(const Film& film, const Film& expected, const std::string& what)
{
	INFO(what);
	REQUIRE(film.sums().size() == expected.sums().size());
	std::size_t different = 0, first = 0;
	for (std::size_t i = 0; i < film.sums().size(); ++i)
		if (film.sums()[i] != expected.sums()[i] && different++ == 0)
			first = i;
	if (different) {
		const std::size_t pixel = first / 3, width = film.window().width;
		FAIL_CHECK(different << " of " << film.sums().size() << " sums differ; first at pixel (" << pixel % width
		                     << ", " << pixel / width << ") channel " << first % 3 << ": " << film.sums()[first]
		                     << " and " << expected.sums()[first]);
	}
	CHECK(film.hash().hex() == expected.hash().hex());
}

const Film& reference_film(const TestScene& scene)
{
	static std::vector<std::pair<std::string, Film>> films;
	const std::string key = scene.name + ", " + settings_text(scene);
	for (const auto& [known, film] : films)
		if (known == key)
			return film;
	films.emplace_back(key, render(pack_test_scene(scene), reference_device(), oracle(), scene.samples));
	return films.back().second;
}

} // namespace

// Run by hand after a change of the contract, with its version raised: test_identity "[update]"
TEST_CASE("write the golden hashes", "[.update]")
{
	std::vector<TestScene> scenes = test_scenes();
	for (TestScene& scene : scenes)
		scene.film = reference_film(scene).hash().hex();
	std::ofstream(RT_SOURCE_DIR "/render/golden.json") << golden_table(scenes);
}

TEST_CASE("rule 22: every scene has its golden film hash, on every device", "[golden]")
{
	for (const TestScene& scene : test_scenes()) {
		INFO(scene.name);
		const Film& film = reference_film(scene);
		CHECK(film.hash().hex() == scene.film);
		CHECK(film.rejected == 0);
		CHECK(film.segments > 0);
		for (const TestDevice& device : test_devices())
			check_same(render(pack_test_scene(scene), device, {}, scene.samples), film,
			           scene.name + ", " + device.name);
	}
}

TEST_CASE("specialised programs give the same film on every device", "[identity]")
{
	for (const TestDevice& device : test_devices())
		for (const TestScene& scene : test_scenes())
			check_same(render(pack_test_scene(scene), device, {}, scene.samples), reference_film(scene),
			           scene.name + ", specialised, " + device.name);
}

TEST_CASE("the generic program gives the same film on every device", "[identity]")
{
	for (const TestDevice& device : test_devices())
		for (const TestScene& scene : test_scenes())
			check_same(render(pack_test_scene(scene), device, generic(), scene.samples), reference_film(scene),
			           scene.name + ", generic, " + device.name);
}

TEST_CASE("any number of lanes gives the same film", "[identity]")
{
	bool shown = false;
	for (const TestDevice& device : test_devices()) {
		if (!device.has_lanes())
			continue;
		shown = true;
		for (const std::uint32_t lanes : {1u, 4u, 8u, 16u}) {
			SessionOptions options = generic();
			options.lanes = lanes;
			for (const TestScene& scene : test_scenes())
				check_same(render(pack_test_scene(scene), device, options, scene.samples), reference_film(scene),
				           scene.name + ", " + std::to_string(lanes) + " lanes, " + device.name);
			options.specialise = true;
			const TestScene& scene = test_scenes().front();
			check_same(render(pack_test_scene(scene), device, options, scene.samples), reference_film(scene),
			           scene.name + ", specialised, " + std::to_string(lanes) + " lanes, " + device.name);
			options.specialise = false;
			options.software_roots = true;
			check_same(render(pack_test_scene(scene), device, options, scene.samples), reference_film(scene),
			           scene.name + ", software roots, " + std::to_string(lanes) + " lanes, " + device.name);
		}
	}
	if (!shown)
		WARN("skipped: no device here has vector lanes");
}

TEST_CASE("software square roots and reciprocals give the same film", "[identity]")
{
	SessionOptions options = generic();
	options.software_roots = true;
	for (const TestDevice& device : test_devices())
		for (const TestScene& scene : test_scenes())
			check_same(render(pack_test_scene(scene), device, options, scene.samples), reference_film(scene),
			           scene.name + ", software roots, " + device.name);
}

TEST_CASE("launches, groups and sample ranges may be split anywhere", "[identity]")
{
	struct Split {
		std::uint32_t rows, samples, group, slices;
	};
	const TestScene& scene = test_scenes().front();
	const PackedScene packed = pack_test_scene(scene);
	for (const TestDevice& device : test_devices()) {
		for (const Split& split : {Split{1, 1, 32, 1}, Split{5, 2, 64, 2}, Split{33, 3, 0, 1}, Split{34, 1, 8, 3},
		                           Split{34, 5, 0, 4}, Split{7, 5, 0, 7}}) {
			SessionOptions options;
			options.rows_per_launch = split.rows;
			options.samples_per_launch = split.samples;
			options.group_size = split.group;
			options.slices = split.slices;
			check_same(render(packed, device, options, scene.samples), reference_film(scene),
			           "split " + std::to_string(split.rows) + " rows, " + std::to_string(split.samples) +
			               " samples, " + std::to_string(split.slices) + " slices, " + device.name);
		}
		// Rule 15: films of sample ranges add up to the whole, in any order.
		for (std::uint32_t cut = 1; cut < scene.samples; ++cut) {
			Film late = render(packed, device, {}, scene.samples - cut, cut);
			REQUIRE(late.add(render(packed, device, {}, cut)));
			check_same(late, reference_film(scene), "sample ranges cut at " + std::to_string(cut) + ", " + device.name);
		}
	}
}

TEST_CASE("a part of an image has the pixels of the whole", "[identity]")
{
	const TestScene& scene = test_scenes().front();
	const Film& whole = reference_film(scene);
	for (const TestDevice& device : test_devices()) {
		PackedScene packed = pack_test_scene(scene);
		const Window window{7, 3, 21, 17};
		packed.scene.window_x = window.x;
		packed.scene.window_y = window.y;
		packed.scene.window_width = window.width;
		packed.scene.window_height = window.height;
		const Film part = render(packed, device, {}, scene.samples);
		INFO(device.name);
		for (std::uint32_t y = 0; y < window.height; ++y)
			for (std::uint32_t x = 0; x < window.width; ++x)
				for (std::size_t channel = 0; channel < 3; ++channel) {
					const std::size_t in_part = (std::size_t(y) * window.width + x) * 3 + channel;
					const std::size_t in_whole = (std::size_t(y + window.y) * scene.width + x + window.x) * 3 + channel;
					if (part.sums()[in_part] != whole.sums()[in_whole])
						FAIL("pixel (" << x + window.x << ", " << y + window.y << ") differs");
				}
	}
}

TEST_CASE("devices may share a render", "[identity]")
{
	const TestScene& scene = test_scenes().front();
	std::vector<DeviceHandle> devices;
	bool software = false;
	for (const TestDevice& device : test_devices()) {
		devices.push_back(device.device);
		software = software || device.needs_software_roots;
	}
	if (devices.size() < 2) {
		WARN("skipped: only one device here");
		return;
	}
	SessionOptions options;
	options.samples = scene.samples;
	options.software_roots = software;
	options.rows_per_launch = 7;
	options.samples_per_launch = 1;
	const Result<SessionResult> result = render_scene(pack_test_scene(scene), devices, options);
	REQUIRE(result);
	check_same(result->film, reference_film(scene), "all devices together");
}

TEST_CASE("odd sizes and single samples", "[identity]")
{
	for (const TestDevice& device : test_devices())
		for (const TestScene& scene :
		     {TestScene{"three-spheres", 1, 1, 17, 0, ""}, TestScene{"three-spheres", 1, 19, 1, 0xffffffffu, ""},
		      TestScene{"three-spheres", 131, 1, 1, 12345, ""}}) {
			const PackedScene packed = pack_test_scene(scene);
			const Film expected = render(packed, reference_device(), oracle(), scene.samples);
			check_same(render(packed, device, {}, scene.samples), expected,
			           std::to_string(scene.width) + "x" + std::to_string(scene.height) + ", " + device.name);
		}
}

TEST_CASE("other seeds, sizes and pixels give other films", "[identity]")
{
	// What would make the tests above pass for nothing: a film that does not depend on its inputs.
	TestScene scene = test_scenes().front();
	const std::string hash = reference_film(scene).hash().hex();
	scene.seed += 1;
	CHECK(render(pack_test_scene(scene), reference_device(), generic(), scene.samples).hash().hex() != hash);
	scene.seed -= 1;
	CHECK(render(pack_test_scene(scene), reference_device(), generic(), scene.samples + 1).hash().hex() != hash);
	CHECK(render(pack_test_scene(scene), reference_device(), generic(), scene.samples, 1).hash().hex() != hash);
}

TEST_CASE("rule 8: spheres may be stored in any order", "[identity]")
{
	for (const char* name : {"three-spheres", "weekend", "cornell", "cloud-1000"})
		for (const TestScene& scene : test_scenes()) {
			if (scene.name != name)
				continue;
			const PackedScene packed = pack_test_scene(scene);
			std::vector<std::uint32_t> order(packed.spheres.size());
			std::iota(order.begin(), order.end(), 0u);
			// Reversed within each class, and a fixed shuffle.
			const auto narrow = order.begin() + static_cast<std::ptrdiff_t>(packed.wide.size());
			std::reverse(order.begin(), narrow);
			std::reverse(narrow, order.end());
			for (std::size_t i = packed.wide.size(); i < order.size(); ++i)
				std::swap(order[i], order[packed.wide.size() + (i * 7919) % (order.size() - packed.wide.size())]);
			const PackedScene shuffled = permute_spheres(packed, order);
			for (const TestDevice& device : test_devices())
				check_same(render(shuffled, device, {}, scene.samples), reference_film(scene),
				           scene.name + ", shuffled, " + device.name);
		}
}

TEST_CASE("rule 8: of coincident spheres the lowest id owns the surface in any storage order", "[identity]")
{
	Result<SceneFile> file = open_scene("three-spheres");
	REQUIRE(file);
	Scene scene = file->base;
	// The blue sphere again, with the metal's material: it must not show.
	Sphere twin = scene.spheres[1];
	twin.material = scene.spheres[3].material;
	scene.spheres.push_back(twin);
	RenderSettings settings;
	settings.width = 40;
	settings.height = 24;
	const Result<PackedScene> packed = pack_scene(scene, settings, {0, 0, 40, 24});
	REQUIRE(packed);
	scene.spheres.pop_back();
	const Result<PackedScene> without = pack_scene(scene, settings, {0, 0, 40, 24});
	REQUIRE(without);
	const Film expected = render(*packed, reference_device(), generic(), 3);
	// Camera rays that meet the pair see the first one's colour: the primary hits are those without the twin.
	for (const TestDevice& device : test_devices()) {
		check_same(render(*packed, device, {}, 3), expected, "twin last, " + device.name);
		check_same(render(permute_spheres(*packed, {0, 4, 3, 2, 1}), device, {}, 3), expected,
		           "twin first, " + device.name);
		if (device.is_reference())
			continue;
		// The control: by distance alone the first in memory wins.
		TestDevice without_ids = device;
		without_ids.device = make_faulty(
		    device.device,
		    {"no ids", {{"kernels/sphere.h", "((t < hit.t) | ((t == hit.t) & (id < hit.id)))", "(t < hit.t)"}}});
		CHECK(render(permute_spheres(*packed, {0, 4, 3, 2, 1}), without_ids, {}, 3).sums() != expected.sums());
	}
	CHECK(expected.sums() != render(*without, reference_device(), generic(), 3).sums());
}

TEST_CASE("rule 9: scaling a scene by a power of two changes no bit", "[identity]")
{
	for (const char* name : {"three-spheres", "weekend", "floating", "furnace"}) {
		Result<SceneFile> file = open_scene(name);
		REQUIRE(file);
		const auto film_at = [&](int k, const TestDevice& device) {
			Scene scene = file->base;
			const auto scaled = [&](double v) { return std::ldexp(v, k); };
			for (Vec3d* v : {&scene.camera.from, &scene.camera.at})
				for (double& c : *v)
					c = scaled(c);
			scene.camera.aperture = scaled(scene.camera.aperture);
			scene.camera.focus = scaled(scene.camera.focus);
			for (Sphere& sphere : scene.spheres) {
				for (double& c : sphere.center)
					c = scaled(c);
				sphere.radius = scaled(sphere.radius);
			}
			RenderSettings settings;
			settings.width = 30;
			settings.height = 20;
			const Result<PackedScene> packed = pack_scene(scene, settings, {0, 0, 30, 20});
			if (!packed)
				FAIL(packed.error().message);
			return render(*packed, device, {}, 2);
		};
		for (const TestDevice& device : test_devices()) {
			const Film expected = film_at(0, device);
			for (const int k : {-20, -7, 9, 20})
				check_same(film_at(k, device), expected,
				           std::string(name) + " x 2^" + std::to_string(k) + ", " + device.name);
			// The control: a factor that is no power of two changes bits.
			Scene scene = file->base;
			for (Sphere& sphere : scene.spheres)
				sphere.radius *= 1.1;
			RenderSettings settings;
			settings.width = 30;
			settings.height = 20;
			const Result<PackedScene> packed = pack_scene(scene, settings, {0, 0, 30, 20});
			REQUIRE(packed);
			CHECK(render(*packed, device, {}, 2).hash().hex() != expected.hash().hex());
			// Another: a distance of 1e-3 below which nothing is met.
			if (std::string(name) != "floating" || device.is_reference())
				continue;
			TestDevice with_epsilon = device;
			with_epsilon.device =
			    make_faulty(device.device, {"epsilon",
			                                {{"kernels/sphere.h", "*met = candidate & (t > rt_splat(0.0f));",
			                                  "*met = candidate & (t > rt_splat(0x1.0624dep-10f));"}}});
			CHECK(film_at(-20, with_epsilon).hash().hex() != expected.hash().hex());
		}
	}
}
