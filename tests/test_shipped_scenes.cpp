// The scenes that ship, the built-in cloud, and how a user names them.
#include "render/scene_file.h"
#include "render/scene_ranges.h"
#include "tests/catch.h"

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <set>

using namespace rt;

namespace {

const std::string scenes = RT_SOURCE_DIR "/scenes";

bool contains(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

// $RT_SCENES for one test.
struct ScenesVariable {
	explicit ScenesVariable(const std::string& value) { setenv("RT_SCENES", value.c_str(), 1); }
	~ScenesVariable() { unsetenv("RT_SCENES"); }
	ScenesVariable(const ScenesVariable&) = delete;
	ScenesVariable& operator=(const ScenesVariable&) = delete;
};

} // namespace

TEST_CASE("every shipped scene is read")
{
	const ScenesVariable variable(scenes);
	std::set<std::string> names;
	for (const auto& entry : std::filesystem::directory_iterator(scenes)) {
		if (entry.path().extension() != ".json" || entry.path().stem().extension() == ".schema")
			continue;
		const std::string name = entry.path().stem().string();
		INFO(name);
		const Result<SceneFile> file = open_scene(name);
		if (!file)
			FAIL(file.error().message << " | " << file.error().where);
		CHECK(file->base.name == name);
		CHECK_FALSE(file->base.spheres.empty());
		const Result<SceneFile> same = load_scene_file(entry.path().string());
		REQUIRE(same);
		CHECK(same->base.hash == file->base.hash);
		names.insert(name);
	}
	CHECK(names == std::set<std::string>{"closed", "cornell", "floating", "furnace", "lamp", "one-sphere", "orbit",
	                                     "planets", "three-spheres", "weekend"});
}

TEST_CASE("what the shipped scenes promise")
{
	const ScenesVariable variable(scenes);
	const auto scene = [](const char* name) {
		Result<SceneFile> file = open_scene(name);
		REQUIRE(file);
		return std::move(file->base);
	};
	SECTION("the furnace absorbs nothing")
	{
		const Scene furnace = scene("furnace");
		CHECK(furnace.sky.kind == Sky::Kind::Constant);
		CHECK(furnace.sky.bottom == Vec3d{1, 1, 1});
		for (const Material& material : furnace.materials) {
			CHECK(material.albedo == Vec3d{1, 1, 1});
			CHECK(material.emission == Vec3d{0, 0, 0});
			CHECK(material.fuzz == 0);
		}
	}
	SECTION("the closed sphere has a closed form")
	{
		const Scene closed = scene("closed");
		REQUIRE(closed.spheres.size() == 1);
		CHECK(closed.camera.from == closed.spheres[0].center);
		CHECK(closed.materials[0].albedo == Vec3d{0.5, 0.5, 0.5});
		CHECK(closed.materials[0].emission == Vec3d{0.5, 0.5, 0.5});
	}
	SECTION("the cornell room is closed, and the camera and all balls are inside")
	{
		const Scene cornell = scene("cornell");
		REQUIRE(cornell.spheres.size() == 9);
		const auto outside_walls = [&](const Vec3d& point, double margin) {
			bool outside = true;
			for (std::size_t i = 0; i < 6; ++i)
				outside = outside && distance(point, cornell.spheres[i].center) >= cornell.spheres[i].radius + margin;
			return outside;
		};
		CHECK(outside_walls(cornell.camera.from, 1));
		for (std::size_t i = 6; i < 9; ++i)
			CHECK(outside_walls(cornell.spheres[i].center, cornell.spheres[i].radius - 0.1));
	}
	SECTION("the lamp is small, the only one, and shines on matte and metal from near by")
	{
		const Scene lamp = scene("lamp");
		REQUIRE(lamp.spheres.size() == 24);
		const Sphere &ground = lamp.spheres.front(), &bulb = lamp.spheres.back();
		for (const Sphere& sphere : lamp.spheres) {
			const Material::Kind kind = lamp.materials[sphere.material].kind;
			CHECK((kind == Material::Kind::Light) == (&sphere == &bulb));
			CHECK(kind != Material::Kind::Dielectric);
			if (&sphere == &bulb || &sphere == &ground)
				continue;
			CHECK(distance(sphere.center, bulb.center) > 10 * bulb.radius + sphere.radius);
			// They stand on the ground, and apart.
			CHECK(distance(sphere.center, ground.center) == Approx(ground.radius + sphere.radius).margin(1e-3));
			for (const Sphere* other = &sphere + 1; other != &bulb; ++other)
				CHECK(distance(sphere.center, other->center) > sphere.radius + other->radius);
		}
	}
	SECTION("weekend is the book's scene")
	{
		const Scene weekend = scene("weekend");
		CHECK(weekend.spheres.size() > 450);
		CHECK(weekend.spheres.size() <= 488);
		CHECK(weekend.camera.aperture == 0.1);
		CHECK(weekend.camera.focus == 10);
		// Small spheres stand apart from the three large ones.
		for (std::size_t i = 4; i < weekend.spheres.size(); ++i) {
			CHECK(weekend.spheres[i].radius == 0.2);
			for (std::size_t k = 1; k < 4; ++k)
				CHECK(distance(weekend.spheres[i].center, weekend.spheres[k].center) > 1.2);
		}
	}
	SECTION("textured scenes have their maps")
	{
		const Scene planets = scene("planets");
		REQUIRE(planets.textures.size() == 5);
		for (const Texture& texture : planets.textures) {
			CHECK(texture.width == 512);
			CHECK(texture.height == 256);
			CHECK(texture.texels.size() == 512 * 256);
			CHECK(std::set<std::uint32_t>(texture.texels.begin(), texture.texels.end()).size() > 100);
		}
	}
	SECTION("the orbit closes")
	{
		const ScenesVariable again(scenes);
		const Result<SceneFile> orbit = open_scene("orbit");
		REQUIRE(orbit);
		REQUIRE(orbit->sphere_tracks.size() == 1);
		CHECK(orbit->camera_track.size() == 3);
		CHECK(orbit->at_frame(0)->hash == orbit->at_frame(48)->hash);
		CHECK(orbit->at_frame(0)->hash != orbit->at_frame(24)->hash);
		for (int frame = 0; frame <= 48; ++frame)
			CHECK(orbit->at_frame(frame));
	}
}

TEST_CASE("names of scenes that do not exist are answered with those that do")
{
	const ScenesVariable variable(scenes);
	const Result<SceneFile> near = open_scene("weeknd");
	REQUIRE_FALSE(near);
	CHECK(near.error().kind == ErrorKind::InputOutput);
	CHECK(contains(near.error().message, "\"weeknd\""));
	CHECK(contains(near.error().cure, "did you mean \"weekend\"?"));
	const Result<SceneFile> far = open_scene("some/where/teapot.json");
	REQUIRE_FALSE(far);
	CHECK(contains(far.error().cure, "closed, cloud-N") == false); // sorted, with the built-in one last
	CHECK(contains(far.error().cure, "three-spheres, weekend, cloud-N"));
	CHECK_FALSE(contains(far.error().cure, "did you mean"));
	CHECK_FALSE(contains(far.error().cure, "schema"));
	const Result<SceneFile> directory = open_scene(scenes);
	REQUIRE_FALSE(directory);
	CHECK(contains(directory.error().message, "is a directory"));
	CHECK(directory.error().kind == ErrorKind::InputOutput);
	CHECK_FALSE(open_scene(""));
}

TEST_CASE("clouds are named by their number")
{
	CHECK(open_scene("cloud-1000")->base.hash == make_cloud(1000)->hash);
	CHECK(open_scene("cloud-1e3")->base.hash == make_cloud(1000)->hash);
	CHECK(open_scene("cloud-12E2")->base.spheres.size() == 1200);
	CHECK(open_scene("cloud-7")->base.name == "cloud-7");
	for (const char* bad :
	     {"cloud-", "cloud-0", "cloud-x", "cloud--5", "cloud-1.5", "cloud-1e", "cloud-e5", "cloud-67108865",
	      "cloud-1e9", "cloud-99999999999999999999999", "cloud-1e99999999999999999999", "cloud-0e5"}) {
		INFO(bad);
		const Result<SceneFile> file = open_scene(bad);
		REQUIRE_FALSE(file);
		CHECK(file.error().kind == ErrorKind::InputOutput);
		CHECK_FALSE(file.error().cure.empty());
	}
	const Result<SceneFile> large = open_scene("cloud-1e8");
	REQUIRE_FALSE(large);
	CHECK(contains(large.error().message, "67108864"));
	CHECK(contains(large.error().message, "GiB"));
}

TEST_CASE("a cloud is the same on every machine")
{
	// Pinned: a change of the generator changes every cloud that anyone has measured.
	CHECK(make_cloud(1)->hash.hex() == "647d520b224b795fe006270203c800e1");
	CHECK(make_cloud(1000)->hash.hex() == "0f5287bde733064f55694c29dbd7ca9a");
	CHECK(make_cloud(100000)->hash.hex() == "b612b99f00204c96b87776ac5474f71d");
}

TEST_CASE("a cloud fills its cube evenly, whatever its size")
{
	for (const std::uint64_t count : {std::uint64_t(10), std::uint64_t(1000), std::uint64_t(100000)}) {
		INFO(count);
		const Scene cloud = make_cloud(count).value();
		REQUIRE(cloud.spheres.size() == count);
		const double n = static_cast<double>(count);
		double volume = 0;
		double smallest = 1e9, largest = 0;
		Vec3d mean{};
		std::vector<double> uses(cloud.materials.size());
		for (const Sphere& sphere : cloud.spheres) {
			for (std::size_t k = 0; k < 3; ++k) {
				REQUIRE(std::abs(sphere.center[k]) <= 1);
				mean[k] += sphere.center[k] / n;
			}
			volume += 4.18879 * sphere.radius * sphere.radius * sphere.radius;
			smallest = std::min(smallest, sphere.radius);
			largest = std::max(largest, sphere.radius);
			REQUIRE(sphere.material < uses.size());
			++uses[sphere.material];
		}
		CHECK(largest <= 3 * smallest);
		// Five standard deviations of what even spreading gives.
		for (const double m : mean)
			CHECK(std::abs(m) < 5 * std::sqrt(1 / (3 * n)));
		for (const double use : uses)
			CHECK(std::abs(use - n / 5) < 5 * std::sqrt(n * 0.16));
		// E[r^3] is 1.25 of the mean radius cubed: a tenth of the cube's 8, with the spread of n samples.
		CHECK(std::abs(volume / 8 - 0.112) < 0.5 / std::sqrt(n));
	}
}
