// Rays aimed at lamps: where they go, how often, and that the image stays the same in the mean and in every bit on
// every device. Seeds are fixed; each family of statistical tests fails a correct program with probability 1e-4.
#include "tests/catch.h"
#include "tests/devices.h"
#include "tests/faulty_device.h"
#include "tests/statistics.h"

#include "common/rt_features.h"
#include "kernels/path.h"
#include "render/bvh.h"
#include "render/lights.h"

#include <cmath>
#include <cstdio>
#include <functional>
#include <map>
#include <numeric>
#include <random>

using namespace rt;

namespace {

constexpr double level = 1e-4;
constexpr double pi = 3.14159265358979323846;

#define CHECK_FAMILY(family)                                                                                \
	do {                                                                                                    \
		INFO("worst of " << (family).tests() << ": " << (family).worst() << ", family p " << (family).p()); \
		CHECK((family).p() > level);                                                                        \
	} while (false)

// ---- vectors in double ----

double dot(const Vec3d& a, const Vec3d& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
Vec3d cross(const Vec3d& a, const Vec3d& b)
{
	return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
Vec3d scaled(double s, const Vec3d& a) { return {s * a[0], s * a[1], s * a[2]}; }
Vec3d unit(const Vec3d& v) { return scaled(1 / std::sqrt(dot(v, v)), v); }
Vec3d in_double(rt_vec3 v) { return {static_cast<double>(v.x), static_cast<double>(v.y), static_cast<double>(v.z)}; }
rt_vec3 in_float(const Vec3d& v)
{
	return v3(static_cast<float>(v[0]), static_cast<float>(v[1]), static_cast<float>(v[2]));
}

// 1 - cos of the cone that a sphere fills, sine = radius / distance.
double true_height(double sine) { return sine * sine / (1 + std::sqrt(1 - sine * sine)); }

// ---- scenes ----

Material matte(double albedo)
{
	Material material;
	material.albedo = {albedo, albedo, albedo};
	return material;
}

Material coloured(Vec3d albedo)
{
	Material material;
	material.albedo = albedo;
	return material;
}

Material light(Vec3d emission)
{
	Material material;
	material.kind = Material::Kind::Light;
	material.emission = emission;
	return material;
}

Material glowing(double albedo, Vec3d emission)
{
	Material material = matte(albedo);
	material.emission = emission;
	return material;
}

Material kind_of(Material::Kind kind)
{
	Material material;
	material.kind = kind;
	material.albedo = {0.9, 0.9, 0.9};
	return material;
}

struct Builder {
	Scene scene;
	Builder(Vec3d from, Vec3d at, double vfov)
	{
		scene.camera.from = from;
		scene.camera.at = at;
		scene.camera.vfov = vfov;
		scene.render.width = 64;
		scene.render.height = 48;
		scene.render.max_depth = 12;
		scene.render.seed = 1;
	}
	Builder& add(const Vec3d& center, double radius, const Material& material)
	{
		scene.materials.push_back(material);
		scene.spheres.push_back({center, radius, static_cast<std::uint32_t>(scene.materials.size() - 1)});
		return *this;
	}
};

// A lamp over matte balls on a ground: large enough that paths find it too.
Scene ground_scene()
{
	return Builder({0, 2, 6}, {0, 0.8, 0}, 50)
	    .add({0, -1000, 0}, 1000, coloured({0.5, 0.6, 0.4}))
	    .add({0, 2.6, 0}, 1, light({4, 3, 2}))
	    .add({-1.5, 0.7, 0.5}, 0.7, coloured({0.8, 0.3, 0.3}))
	    .add({1.6, 0.5, 1}, 0.5, kind_of(Material::Kind::Metal))
	    .add({0.3, 0.4, 1.5}, 0.4, matte(0.9))
	    .scene;
}

// Lamps behind the horizon, half below it, and half in the ground.
Scene horizon_scene()
{
	return Builder({0, 1.5, 8}, {0, 0.5, 0}, 60)
	    .add({0, -30, 0}, 30, matte(0.7))
	    .add({-12, -3.5, -3}, 3, light({5, 4, 3}))
	    .add({9, -1, -2}, 2, light({1, 3, 5}))
	    .add({0, 0.2, 0}, 1, light({1, 1, 1}))
	    .add({3, 1, 3}, 1, matte(0.5))
	    .scene;
}

// Lamps of many sizes and powers, some behind others, one glowing matte, one in glass, one before a mirror.
Scene lamps_scene()
{
	Material glass = kind_of(Material::Kind::Dielectric);
	Material brushed = kind_of(Material::Kind::Metal);
	brushed.fuzz = 0.4;
	return Builder({0, 3, 9}, {0, 1.2, 0}, 55)
	    .add({0, -1000, 0}, 1000, matte(0.6))
	    .add({-3, 2, -1}, 0.8, light({6, 1, 1}))
	    .add({-3, 0.8, 0.6}, 0.75, matte(0.8))
	    .add({3, 3, -2}, 1, light({0.5, 4, 0.5}))
	    .add({2.4, 2.2, -0.9}, 0.5, matte(0.4))
	    .add({0.2, 0.6, 1.6}, 0.55, light({0.2, 0.3, 2}))
	    .add({0, 1.4, -1}, 1.2, glowing(0.5, {0.3, 0.3, 0.1}))
	    .add({-1.5, 0.6, 2.2}, 0.6, glass)
	    .add({-1.5, 0.6, 2.2}, 0.35, light({3, 3, 3}))
	    .add({2.4, 0.7, 1.8}, 0.7, brushed)
	    .scene;
}

// A lamp whose cone is nearly half of all directions.
Scene huge_scene()
{
	return Builder({0, 0, 3}, {0, 0, 0}, 60)
	    .add({0, 0, 0}, 1, matte(0.8))
	    .add({-1.8, 0.4, 0.5}, 0.5, matte(0.6))
	    .add({0, 10003, 0}, 1e4, light({2, 1, 0.5}))
	    .scene;
}

// Everything, the camera too, inside of a glowing sphere, with a lamp of its own.
Scene inside_scene()
{
	return Builder({0, 0.5, 4}, {0, 0, 0}, 60)
	    .add({0, 0, 0}, 9, glowing(0.4, {0.3, 0.4, 0.5}))
	    .add({0, 0, 0}, 1, matte(0.8))
	    .add({1.7, 0.8, 0.6}, 0.6, light({5, 4, 3}))
	    .scene;
}

Scene shipped(const std::string& name)
{
	const Result<SceneFile> file = open_scene(name);
	REQUIRE(file);
	Scene scene = file->base;
	scene.render.width = 48;
	scene.render.height = 36;
	scene.render.max_depth = 12;
	return scene;
}

// The shipped scene at night, under a lamp.
Scene weekend_scene()
{
	Scene scene = shipped("weekend");
	scene.sky.bottom = {0.02, 0.02, 0.03};
	scene.sky.top = {0.01, 0.01, 0.02};
	scene.materials.push_back(light({6, 5, 4}));
	scene.spheres.push_back({{3, 4, 3}, 1.5, static_cast<std::uint32_t>(scene.materials.size() - 1)});
	return scene;
}

PackedScene pack(const Scene& scene, Estimator estimator, std::uint32_t seed = 1)
{
	RenderSettings settings = scene.render;
	settings.estimator = estimator;
	settings.seed = seed;
	const Result<PackedScene> packed = pack_scene(scene, settings, {0, 0, settings.width, settings.height});
	if (!packed)
		FAIL(packed.error().message);
	return *packed;
}

constexpr std::array<Estimator, 2> aiming{Estimator::Nee, Estimator::Mis};

// ---- comparing means ----

// The pixels of two films are independent of each other and, if the estimators agree, equal in the mean: the sum of
// their differences over its root sum of squares is normal.
void compare(TestFamily& family, const std::string& name, const Film& a, const Film& b)
{
	const std::uint32_t width = a.window().width, height = a.window().height;
	const auto z_of = [&](std::uint32_t x0, std::uint32_t x1, std::uint32_t y0, std::uint32_t y1, int channel) {
		double sum = 0, squares = 0;
		for (std::uint32_t y = y0; y < y1; ++y)
			for (std::uint32_t x = x0; x < x1; ++x) {
				const double difference = a.radiance(x, y, channel) - b.radiance(x, y, channel);
				sum += difference;
				squares += difference * difference;
			}
		return squares > 0 ? sum / std::sqrt(squares) : 0.0;
	};
	for (int channel = 0; channel < 3; ++channel) {
		family.add(name + ", whole, channel " + std::to_string(channel), normal_p(z_of(0, width, 0, height, channel)));
		for (std::uint32_t i = 0; i < 4; ++i)
			for (std::uint32_t j = 0; j < 4; ++j)
				family.add(
				    name + ", part " + std::to_string(i) + " " + std::to_string(j),
				    normal_p(z_of(width * i / 4, width * (i + 1) / 4, height * j / 4, height * (j + 1) / 4, channel)));
	}
}

double mean_of(const Film& film, int channel)
{
	double sum = 0;
	for (std::uint32_t y = 0; y < film.window().height; ++y)
		for (std::uint32_t x = 0; x < film.window().width; ++x)
			sum += film.radiance(x, y, channel);
	return sum / static_cast<double>(film.pixels());
}

} // namespace

// ---- the cone ----

TEST_CASE("a lamp's cone has its solid angle, and a little more")
{
	const std::vector<Vec3d> ways = {{0, 0, 1}, {0, 0, -1}, {1, 0, 0}, unit({1, -2, 3}), unit({-3, 1, -2})};
	for (const Vec3d& way : ways)
		for (const double distance : {1e-8, 0.3, 1.0, 7e4, 1e9})
			for (const double ratio : {1e-6, 1e-4, 1e-2, 0.1, 0.5, 0.9, 0.99, 0.9999}) {
				const rt_vec3 m = in_float(scaled(distance, way));
				const auto radius = static_cast<float>(ratio * distance);
				const rt_light_cone cone = rt_sphere_cone(m, radius);
				INFO("distance " << distance << ", radius / distance " << ratio);
				REQUIRE(cone.outside);
				const double sine = static_cast<double>(radius) / std::sqrt(dot(in_double(m), in_double(m)));
				const auto height = static_cast<double>(cone.height);
				CHECK(height >= true_height(sine));
				CHECK(height <= true_height(std::fmin(1.0, sine * (1 + 2e-6) + 3e-7)) * (1 + 1e-6));
				CHECK(std::sqrt(dot(in_double(cone.axis), in_double(cone.axis))) == Approx(1).epsilon(1e-6));
				// The density over the true cone's directions adds up to 1 but for what the cone is wider.
				if (ratio >= 1e-2)
					CHECK(true_height(sine) / height > 1 - 1e-3);
			}
	// From within, from the surface and from so near that roundings could hide the difference, there is no cone.
	for (const double distance : {0.0, 1e-20, 0.5, 1.0, 1 + 2e-7}) {
		INFO(distance);
		CHECK_FALSE(rt_sphere_cone(v3(0, static_cast<float>(distance), 0), 1).outside);
	}
	CHECK_FALSE(rt_sphere_cone(v3(0, std::nanf(""), 0), 1).outside);
}

TEST_CASE("cones have no scale")
{
	const rt_vec3 m = v3(0.3f, -1.7f, 2.9f);
	const rt_light_cone one = rt_sphere_cone(m, 0.77f);
	for (const int k : {-28, -3, 5, 28}) {
		const float s = std::ldexp(1.0f, k);
		const rt_light_cone other = rt_sphere_cone(v3(m.x * s, m.y * s, m.z * s), 0.77f * s);
		CHECK(other.height == one.height);
		CHECK(other.axis.x == one.axis.x);
		CHECK(other.axis.y == one.axis.y);
		CHECK(other.axis.z == one.axis.z);
	}
}

TEST_CASE("aimed directions fill the cone evenly")
{
	TestFamily family, wrong;
	for (const Vec3d& way : {Vec3d{0, 0, 1}, Vec3d{0, 0, -1}, Vec3d{1, 0, 0}, unit({1, -2, 3}), unit({-2, 2, -3})})
		for (const double ratio : {1e-4, 1e-2, 0.3, 0.9, 0.9999}) {
			const rt_light_cone cone = rt_sphere_cone(in_float(scaled(3, way)), static_cast<float>(3 * ratio));
			REQUIRE(cone.outside);
			const auto height = static_cast<double>(cone.height);
			const Vec3d across = unit(cross(std::fabs(way[0]) < 0.5 ? Vec3d{1, 0, 0} : Vec3d{0, 1, 0}, way));
			const Vec3d along = cross(way, across);
			EvenGrid grid(32, 32), wrong_grid(32, 32);
			double widest = 0, longest = 0;
			for (std::uint32_t i = 0; i < 1u << 18; ++i) {
				const rt_random4 u = rt_random(5, i, 7, 1);
				const auto add = [&](EvenGrid& to, float rise) {
					const rt_vec3 direction = rt_light_direction(cone, rise, u.d);
					longest = std::fmax(longest, std::fabs(dot(in_double(direction), in_double(direction)) - 1));
					const Vec3d d = unit(in_double(direction));
					const Vec3d off = {d[0] - way[0], d[1] - way[1], d[2] - way[2]};
					const double part = dot(off, off) / 2 / height; // (1 - cos) / (1 - cos_max)
					widest = std::fmax(widest, part);
					to.add(part, std::atan2(dot(d, along), dot(d, across)) / (2 * pi) + 0.5);
				};
				add(grid, u.c);
				add(wrong_grid, u.c * u.c);
			}
			const std::string name = "radius / distance " + std::to_string(ratio);
			family.add(name, grid.p());
			wrong.add(name, wrong_grid.p());
			INFO(name);
			CHECK(widest < 1 + 6e-7 / ratio + 1e-6);
			CHECK(longest < 4e-7);
		}
	CHECK_FAMILY(family);
	CHECK(wrong.p() < level);
}

TEST_CASE("lamps as small as a direction's rounding lose no light")
{
	std::mt19937_64 engine(4);
	std::normal_distribution<double> normal;
	const rt_u32 id = 0;
	for (const double ratio : {1e-3, 1e-5, 1e-6, 2e-7}) {
		double gathered = 0, gathered_narrow = 0;
		constexpr std::uint32_t places = 200, draws = 4000;
		for (std::uint32_t place = 0; place < places; ++place) {
			const rt_vec3 m = in_float(scaled(10, unit({normal(engine), normal(engine), normal(engine)})));
			const rt_sphere sphere{m.x, m.y, m.z, static_cast<float>(10 * ratio)};
			rt_scene scene{};
			scene.sphere_count = 1;
			scene.bvh_root = RT_BVH_NONE;
			rt_scene_view view{};
			view.scene = &scene;
			view.spheres = &sphere;
			view.sphere_ids = &id;
			rt_ray ray{};
			ray.reach = 1;
			ray.from = -1;
			ray.chord = -1;
			const rt_light_cone cone = rt_light_seen(view, ray, 0);
			REQUIRE(cone.outside);
			// The control: a cone just as wide as the lamp.
			rt_light_cone narrow = cone;
			const double truth =
			    true_height(static_cast<double>(sphere.radius) / std::sqrt(dot(in_double(m), in_double(m))));
			narrow.height = static_cast<float>(truth);
			for (std::uint32_t i = 0; i < draws; ++i) {
				const rt_random4 u = rt_random(6, place, i, 1);
				ray.dir = rt_light_direction(cone, u.c, u.d);
				if (rt_closest_hit(view, ray, RT_TRUE).index == 0)
					gathered += static_cast<double>(cone.height) / truth;
				ray.dir = rt_light_direction(narrow, u.c, u.d);
				if (rt_closest_hit(view, ray, RT_TRUE).index == 0)
					gathered_narrow += 1;
			}
		}
		INFO("radius / distance " << ratio << ": " << gathered / (places * draws) << " of the light; "
		                          << gathered_narrow / (places * draws) << " by a cone that is not widened");
		CHECK(gathered / (places * draws) == Approx(1).epsilon(0.01));
		if (ratio < 5e-7)
			CHECK(gathered_narrow / (places * draws) < 0.98);
	}
}

// ---- the choice among lamps ----

namespace {

Scene many_lamps(std::uint32_t count)
{
	std::mt19937_64 engine(count);
	const auto uniform = [&] { return static_cast<double>(engine() >> 11) * 0x1p-53; };
	Builder builder({0, 0, 0}, {0, 0, 1}, 60);
	builder.add({0, -1001, 0}, 1000, matte(0.5));
	for (const double emission : {1.0, 1e-6, 1e9, 20.0})
		builder.scene.materials.push_back(light({emission, 0.5 * emission, 0}));
	for (std::uint32_t i = 0; i < count; ++i)
		builder.scene.spheres.push_back({{10 * uniform() - 5, 10 * uniform() - 5, 10 * uniform() + 2},
		                                 std::pow(10, 3 * uniform() - 4),
		                                 static_cast<std::uint32_t>(1 + engine() % 4)});
	return builder.scene;
}

} // namespace

TEST_CASE("lamps are chosen as often as their probability says")
{
	TestFamily family;
	for (const std::uint32_t count : {1u, 2u, 3u, 7u, 1000u, 100000u}) {
		INFO(count << " lamps");
		const PackedScene packed = pack(many_lamps(count), Estimator::Nee);
		REQUIRE(packed.scene.light_count == count);
		REQUIRE(packed.lights.size() == count);
		CHECK((packed.features & RT_FEATURE_LIGHTS) != 0);
		rt_scene_view view{};
		view.scene = &packed.scene;
		view.spheres = packed.spheres.data();
		view.sphere_materials = packed.sphere_materials.data();
		view.materials = packed.materials.data();

		// Rows by a search, as a check of the kernel's integers: the least k of each.
		std::vector<rt_light> own(count);
		for (std::uint32_t i = 0; i < count; ++i)
			own[i] = {i, i, 1, 0};
		view.lights = own.data();
		const auto row_of = [&](std::uint32_t k) {
			rt_random4 u{};
			u.a = static_cast<float>(k) * 0x1p-24f;
			return static_cast<std::uint32_t>(rt_light_choice(view, u));
		};
		std::mt19937 engine(1);
		for (int i = 0; i < 10000; ++i) {
			const auto k = static_cast<std::uint32_t>(engine() >> 8);
			REQUIRE(row_of(k) == (std::uint64_t(k) * count) >> 24);
		}
		CHECK(row_of(0xffffff) == count - 1);

		// What the table gives each sphere, exactly, is what the weight divides by.
		view.lights = packed.lights.data();
		std::vector<double> given(packed.spheres.size());
		for (std::uint64_t row = 0; row < count; ++row) {
			const auto first = [&](std::uint64_t r) { return ((r << 24) + count - 1) / count; };
			const double chance = std::ldexp(static_cast<double>(first(row + 1) - first(row)), -24);
			const auto threshold = static_cast<double>(packed.lights[row].threshold);
			given[packed.lights[row].sphere] += chance * threshold;
			given[packed.lights[row].other] += chance * (1 - threshold);
		}
		double total = 0, worst = 0;
		for (std::uint32_t i = 0; i < packed.spheres.size(); ++i) {
			const rt_vec3 emission = rt_emission(view, static_cast<rt_int>(i));
			if (!(emission.x > 0)) {
				CHECK(given[i] == 0);
				continue;
			}
			const auto chance = static_cast<double>(rt_light_chance(view.scene, emission, packed.spheres[i].radius));
			worst = std::fmax(worst, std::fabs(given[i] / chance - 1));
			total += chance;
			CHECK(chance >= 0.499 / count);
		}
		CHECK(worst < 2e-6);
		CHECK(total == Approx(1).epsilon(1e-6));

		if (count > 1000)
			continue;
		std::vector<double> counts(packed.spheres.size());
		constexpr std::uint32_t draws = 1u << 20;
		for (std::uint32_t i = 0; i < draws; ++i)
			counts[static_cast<std::size_t>(rt_light_choice(view, rt_random(3, i, 1, 1u | RT_LAMP_BLOCK)))] += 1;
		double statistic = 0;
		for (std::size_t i = 0; i < counts.size(); ++i)
			if (given[i] > 0)
				statistic += (counts[i] - draws * given[i]) * (counts[i] - draws * given[i]) / (draws * given[i]);
		if (count > 1)
			family.add(std::to_string(count), chi_squared_p(statistic, count - 1.0));
	}
	CHECK_FAMILY(family);
}

TEST_CASE("a scene without lamps, or with nothing matte, does not aim")
{
	for (const char* name : {"three-spheres", "floating", "one-sphere"}) {
		const Scene scene = shipped(name);
		for (const Estimator estimator : aiming) {
			const PackedScene plain = pack(scene, Estimator::Path), packed = pack(scene, estimator);
			CHECK(packed.features == plain.features);
			CHECK(packed.lights.empty());
			CHECK(render(packed, reference_device(), {}, 2).hash().hex() ==
			      render(plain, reference_device(), {}, 2).hash().hex());
		}
	}
	const Scene mirrors = Builder({0, 0, 5}, {0, 0, 0}, 40)
	                          .add({0, 0, 0}, 1, kind_of(Material::Kind::Metal))
	                          .add({2, 2, 0}, 1, light({1, 1, 1}))
	                          .scene;
	CHECK((pack(mirrors, Estimator::Nee).features & RT_FEATURE_LIGHTS) == 0);
	CHECK((pack(ground_scene(), Estimator::Path).features & RT_FEATURE_LIGHTS) == 0);
	CHECK((pack(ground_scene(), Estimator::Mis).features & RT_FEATURE_LIGHTS) != 0);
}

// ---- means ----

TEST_CASE("the light on a plane is that of the closed form")
{
	// E = pi L (r / d)^2 cos, and a matte surface of albedo a shows a E / pi.
	struct Case {
		double radius, distance, cosine, emission, ground;
	};
	for (const Case& c : {Case{1, 2, 1, 1, 1e5}, Case{0.5, 3, 0.6, 20, 1e5}, Case{1e-2, 1, 0.8, 1e3, 1e5},
	                      Case{1e-4, 1, 1, 1e9, 1e5}, Case{1e-3, 10, 0.5, 1e9, 1e5}, Case{1e4, 1.2e4, 1, 1e-6, 1e9},
	                      Case{1e4, 3e4, 0.7, 1e9, 1e9}, Case{1, 1.2, 1, 1, 1e6}}) {
		INFO("r " << c.radius << ", d " << c.distance << ", cos " << c.cosine << ", L " << c.emission);
		const double sine = std::sqrt(1 - c.cosine * c.cosine);
		// The camera looks along the ground's surface from the other side than the lamp stands.
		const double d = c.distance, back = 0.5 * d;
		Builder builder({-back, 0.3 * back, 0}, {0, 0, 0}, 0.001);
		builder.add({0, -c.ground, 0}, c.ground, matte(0.5));
		builder.add({sine * d, c.cosine * d, 0}, c.radius, light({c.emission, c.emission, c.emission}));
		builder.scene.render.width = 8;
		builder.scene.render.height = 8;
		builder.scene.render.max_depth = 2;
		const double expected = 0.5 * c.emission * c.radius * c.radius / (d * d) * c.cosine;
		for (const Estimator estimator : aiming) {
			const Film film = render(pack(builder.scene, estimator), reference_device(), {}, 4096);
			CHECK(film.rejected == 0);
			INFO(estimator_name(estimator) << ": " << mean_of(film, 0) << ", expected " << expected);
			// 2.6e5 samples; where nearly every ray meets the lamp and all weigh the same, they say more.
			CHECK(std::fabs(mean_of(film, 0) / expected - 1) < 0.01);
		}
	}
}

TEST_CASE("aimed, weighed and chance light agree in the mean")
{
	struct Case {
		const char* name;
		Scene scene;
		std::uint32_t path_samples, samples;
	};
	TestFamily family;
	for (const Case& c : {Case{"ground", ground_scene(), 512, 256}, Case{"horizon", horizon_scene(), 512, 256},
	                      Case{"lamps", lamps_scene(), 512, 256}, Case{"huge", huge_scene(), 256, 128},
	                      Case{"inside", inside_scene(), 256, 128}, Case{"cornell", shipped("cornell"), 512, 128},
	                      Case{"weekend", weekend_scene(), 128, 64}}) {
		const Film path = render(pack(c.scene, Estimator::Path, 1), reference_device(), {}, c.path_samples);
		const Film nee = render(pack(c.scene, Estimator::Nee, 2), reference_device(), {}, c.samples);
		const Film mis = render(pack(c.scene, Estimator::Mis, 3), reference_device(), {}, c.samples);
		INFO(c.name);
		CHECK(path.rejected + nee.rejected + mis.rejected == 0);
		compare(family, std::string(c.name) + ", path and nee", path, nee);
		compare(family, std::string(c.name) + ", path and mis", path, mis);
		compare(family, std::string(c.name) + ", nee and mis", nee, mis);
	}
	CHECK_FAMILY(family);
}

TEST_CASE("inside of a lamp nothing changes")
{
	// Nothing can be aimed at from within: every sample is that of the path estimator.
	const Scene scene = shipped("closed");
	const Film path = render(pack(scene, Estimator::Path), reference_device(), {}, 4);
	for (const Estimator estimator : aiming) {
		const Film film = render(pack(scene, estimator), reference_device(), {}, 4);
		CHECK(film.segments == path.segments);
		CHECK(film.rejected == 0);
		for (std::size_t i = 0; i < film.sums().size(); ++i)
			REQUIRE(std::ldexp(static_cast<double>(film.sums()[i]), -film.exponent()) ==
			        std::ldexp(static_cast<double>(path.sums()[i]), -path.exponent()));
	}
	// The eye in a light sees the light.
	const Scene eye =
	    Builder({0, 0, 0}, {0, 0, 1}, 60).add({0, 0, 0}, 2, light({3, 3, 3})).add({0, 0, 9}, 1, matte(0.5)).scene;
	for (const Estimator estimator : aiming) {
		const Film film = render(pack(eye, estimator), reference_device(), {}, 2);
		for (int channel = 0; channel < 3; ++channel)
			CHECK(mean_of(film, channel) == 3);
	}
}

TEST_CASE("no sample exceeds the bound, and the bound is not idle")
{
	// A matte plane right below a lamp that fills half of all directions: W comes near 2.
	Builder builder({0, 1e-3, 2}, {0, 0, 0}, 10);
	builder.add({0, -1e3, 0}, 1e3, matte(1)).add({0, 1e3 + 2e-3, 0}, 1e3, light({1, 1, 1}));
	for (const Estimator estimator : aiming) {
		const PackedScene packed = pack(builder.scene, estimator);
		const Film film = render(packed, reference_device(), {}, 64);
		CHECK(film.rejected == 0);
		CHECK(packed.scene.radiance_limit >= (estimator == Estimator::Nee ? 2.0f : 0.5f));
	}
	// 1000 faint lamps: W may be thousands, but what it weighs is bounded.
	const PackedScene many = pack(many_lamps(1000), Estimator::Mis);
	CHECK(many.film_exponent >= RT_FILM_BITS - 33); // 1e9 < 2^30, times 1 + 12 / 2
	for (const Estimator estimator : aiming)
		CHECK(render(pack(many_lamps(1000), estimator), reference_device(), {}, 8).rejected == 0);
}

// ---- the same bits ----

namespace {

std::vector<std::pair<std::string, Scene>> identity_scenes()
{
	std::vector<std::pair<std::string, Scene>> scenes = {{"lamps", lamps_scene()},        {"horizon", horizon_scene()},
	                                                     {"inside", inside_scene()},      {"huge", huge_scene()},
	                                                     {"cornell", shipped("cornell")}, {"crowd", many_lamps(60)}};
	for (auto& [name, scene] : scenes) {
		scene.render.width = 30;
		scene.render.height = 23;
	}
	return scenes;
}

constexpr std::uint32_t identity_samples = 3;

SessionOptions generic(std::uint32_t lanes)
{
	SessionOptions options;
	options.specialise = false;
	options.lanes = lanes;
	return options;
}

} // namespace

TEST_CASE("aimed rays give the same film on every device, however it is asked", "[identity]")
{
	for (const auto& [name, scene] : identity_scenes())
		for (const Estimator estimator : aiming) {
			const PackedScene packed = pack(scene, estimator);
			const Film oracle = render(packed, reference_device(), generic(1), identity_samples);
			const std::string hash = oracle.hash().hex();
			CHECK(oracle.rejected == 0);
			CHECK(hash !=
			      render(pack(scene, Estimator::Path), reference_device(), generic(1), identity_samples).hash().hex());
			std::vector<std::uint32_t> order(packed.spheres.size());
			std::iota(order.begin(), order.end(), 0u);
			const auto narrow = order.begin() + static_cast<std::ptrdiff_t>(packed.wide.size());
			std::reverse(order.begin(), narrow);
			std::reverse(narrow, order.end());
			const PackedScene reversed = permute_spheres(packed, order);

			for (const TestDevice& device : test_devices()) {
				INFO(name << ", " << estimator_name(estimator) << ", " << device.name);
				const auto check = [&](const char* how, const PackedScene& what, const SessionOptions& options) {
					INFO(how);
					const Film film = render(what, device, options, identity_samples);
					CHECK(film.hash().hex() == hash);
					CHECK(film.segments == oracle.segments);
				};
				check("specialised", packed, {});
				check("generic", packed, generic(0));
				check("reversed", reversed, {});
				SessionOptions options;
				options.bvh = Acceleration::Always;
				check("through a tree", packed, options);
				options.bvh = Acceleration::Never;
				check("trying all", packed, options);
				options = {};
				options.slices = 3;
				options.rows_per_launch = 7;
				options.samples_per_launch = 2;
				check("in slices", packed, options);
				options = {};
				options.software_roots = true;
				check("software roots", packed, options);
				if (device.has_lanes() && (name == "lamps" || device.is_reference()))
					for (const std::uint32_t lanes : {1u, 4u, 8u, 16u}) {
						check("lanes", packed, generic(lanes));
						options = generic(lanes);
						options.bvh = Acceleration::Always;
						check("lanes through a tree", packed, options);
					}
			}
		}
}

// Of contract 2. A change of the contract brings new ones, as render/golden.json says of the path estimator's.
TEST_CASE("rule 22: films of aimed rays have their golden hashes", "[golden]")
{
	Scene scene = shipped("cornell");
	scene.render.width = 30;
	scene.render.height = 23;
	scene.render.max_depth = 50;
	for (const auto& [estimator, hash] : {std::pair(Estimator::Nee, "e0951c2c9980cfb22862d43bf7300985"),
	                                      std::pair(Estimator::Mis, "8219ae27070c68f531e8c3a2b702f53b")}) {
		INFO(estimator_name(estimator));
		CHECK(render(pack(scene, estimator, 6), reference_device(), generic(1), 3).hash().hex() == hash);
		for (const TestDevice& device : test_devices()) {
			INFO(device.name);
			CHECK(render(pack(scene, estimator, 6), device, generic(0), 3).hash().hex() == hash);
		}
	}
}

TEST_CASE("the other rungs aim as well", "[identity]")
{
	Scene scene = ground_scene();
	scene.render.width = 32;
	scene.render.height = 24;
	for (const Estimator estimator : aiming) {
		const PackedScene packed = pack(scene, estimator);
		const Film exact = render(packed, reference_device(), {}, 64);
		for (const TestDevice& device : test_devices())
			for (const Precision precision : {Precision::Fast, Precision::Double}) {
				if (!check_precision(device.device->info(), precision))
					continue;
				SessionOptions options;
				options.precision = precision;
				const Film film = render(packed, device, options, 64);
				INFO(device.name << ", " << precision_name(precision) << ", " << estimator_name(estimator));
				CHECK(film.rejected == 0);
				for (int channel = 0; channel < 3; ++channel)
					CHECK(mean_of(film, channel) == Approx(mean_of(exact, channel)).epsilon(1e-3));
			}
	}
}

TEST_CASE("rule 9: aimed rays have no scale", "[identity]")
{
	for (const Estimator estimator : aiming)
		for (const auto& [name, scene] : identity_scenes()) {
			const auto film_at = [&, &unscaled = scene](int k, double radius_factor, const TestDevice& device) {
				Scene other = unscaled;
				for (Vec3d* v : {&other.camera.from, &other.camera.at})
					*v = scaled(std::ldexp(1.0, k), *v);
				for (Sphere& sphere : other.spheres) {
					sphere.center = scaled(std::ldexp(1.0, k), sphere.center);
					sphere.radius = std::ldexp(sphere.radius, k) * radius_factor;
				}
				return render(pack(other, estimator), device, generic(0), 2).hash().hex();
			};
			const std::string expected = film_at(0, 1, reference_device());
			for (const TestDevice& device : test_devices()) {
				INFO(name << ", " << device.name);
				for (const int k : device.is_reference() ? std::vector<int>{-12, -5, 3, 12} : std::vector<int>{-12})
					CHECK(film_at(k, 1, device) == expected);
				if (device.is_reference())
					CHECK(film_at(0, 1.01, device) != expected);
			}
		}
}

// ---- the tests above can fail ----

TEST_CASE("wrong weights, a missing shadow and a lamp counted twice are found")
{
	struct Mistake {
		Estimator estimator;
		Fault fault;
	};
	const std::vector<Mistake> mistakes = {
	    {Estimator::Nee, {"no fault", {{"kernels/light.h", "return (cosine + cosine)", "return (cosine + cosine)"}}}},
	    {Estimator::Nee,
	     {"a density one percent too small",
	      {{"kernels/light.h", "return (cosine + cosine)", "return 1.01f * (cosine + cosine)"}}}},
	    {Estimator::Nee,
	     {"no shadows",
	      {{"kernels/path.h", "mask & (hit.index == path.aim.lamp)", "mask & (hit.index == hit.index)"}}}},
	    {Estimator::Nee,
	     {"lamps counted twice",
	      {{"kernels/path.h", "rt_float part = rt_splat(0.0f);", "rt_float part = rt_splat(1.0f);"}}}},
	    {Estimator::Mis,
	     {"chance light not weighed",
	      {{"kernels/path.h", "weight = rt_sel(aimed & cone.outside, part, weight);", ";"}}}}};
	bool shown = false;
	for (const TestDevice& device : test_devices()) {
		if (device.is_reference())
			continue;
		shown = true;
		const Scene scene = ground_scene();
		// Of one percent only the less noisy of the two can tell.
		const Film path = render(pack(scene, Estimator::Path, 1), device, {}, 256);
		const Film sound = render(pack(scene, Estimator::Mis, 3), device, {}, 512);
		for (const Mistake& mistake : mistakes) {
			TestDevice faulty = device;
			faulty.device = make_faulty(device.device, mistake.fault);
			TestFamily family;
			const Film film = render(pack(scene, mistake.estimator, 2), faulty, {}, 512);
			compare(family, mistake.fault.name, path, film);
			compare(family, mistake.fault.name, sound, film);
			INFO(device.name << ", " << mistake.fault.name << ", family p " << family.p());
			if (mistake.fault.name == "no fault")
				CHECK(family.p() > level);
			else
				CHECK(family.p() < level);
		}
	}
	if (!shown)
		WARN("skipped: no device here compiles the kernels' text");
}
