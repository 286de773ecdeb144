// The tree leaves out work and never a hit: films and hits through it equal those of trying every sphere, over random
// and adversarial sets; and where its boxes are made too small, they do not.
#include "tests/catch.h"
#include "tests/devices.h"

#include "common/rt_features.h"
#include "kernels/path.h"
#include "render/bvh.h"
#include "support/hash.h"

#include <cmath>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <limits>
#include <random>
#include <set>

using namespace rt;

namespace {

struct Random {
	std::mt19937_64 engine;
	explicit Random(std::uint64_t seed) : engine(seed) {}
	double uniform() { return static_cast<double>(engine() >> 11) * 0x1p-53; }
	double between(double low, double high) { return std::fma(uniform(), high - low, low); }
	Vec3d direction()
	{
		const double z = between(-1, 1), angle = between(0, 6.283185307179586), r = std::sqrt(1 - z * z);
		return {r * std::cos(angle), r * std::sin(angle), z};
	}
};

Material material_of(Material::Kind kind, Vec3d albedo)
{
	Material material;
	material.kind = kind;
	material.albedo = albedo;
	return material;
}

// Matte, mirror and glass under a gradient; the camera at the origin looks along +z.
Scene scene_of(std::vector<Sphere> spheres)
{
	Scene scene;
	scene.materials = {
	    material_of(Material::Kind::Lambertian, {0.5, 0.6, 0.7}), material_of(Material::Kind::Metal, {0.9, 0.8, 0.7}),
	    material_of(Material::Kind::Dielectric, {1, 1, 1}), material_of(Material::Kind::Lambertian, {0.9, 0.1, 0.3})};
	scene.sky.kind = Sky::Kind::Gradient;
	scene.sky.bottom = {1, 1, 1};
	scene.sky.top = {0.5, 0.7, 1};
	scene.camera.vfov = 60;
	scene.spheres = std::move(spheres);
	return scene;
}

struct Set {
	const char* name;
	Scene scene;
};

std::vector<Set> sphere_sets()
{
	std::vector<Set> sets;
	Random random(1);
	const auto any = [&] { return static_cast<std::uint32_t>(random.engine() % 4); };
	std::vector<Sphere> list;

	for (int i = 0; i < 300; ++i)
		list.push_back(
		    {{random.between(-3, 3), random.between(-2, 2), random.between(2, 9)}, random.between(0.05, 0.4), any()});
	sets.push_back({"random", scene_of(list)});

	std::vector<Sphere> doubled = list;
	for (Sphere sphere : list) {
		sphere.material = (sphere.material + 1) % 4;
		doubled.insert(doubled.begin() + static_cast<std::ptrdiff_t>(random.engine() % doubled.size()), sphere);
	}
	sets.push_back({"duplicates", scene_of(doubled)});

	list.clear();
	for (int i = 0; i < 100; ++i)
		list.push_back({{0, 0, 6}, 2.5 - 0.025 * i, i % 2 ? 2u : 0u});
	for (std::uint32_t i = 0; i < list.size(); ++i)
		list[i].material = i + 1 == list.size() ? 0 : 2;
	sets.push_back({"nested shells", scene_of(list)});

	list.clear();
	for (int x = 0; x < 7; ++x)
		for (int y = 0; y < 5; ++y)
			for (int z = 0; z < 4; ++z)
				list.push_back({{x - 3.0, y - 2.0, z + 4.0}, 0.5, any()});
	sets.push_back({"touching lattice", scene_of(list)});

	// Ten decades of radius; the largest ones are wide or far.
	list.clear();
	for (int i = 0; i < 200; ++i) {
		const double radius = std::pow(10.0, random.between(-4, 6));
		const double distance = radius * random.between(1.5, 1000);
		const Vec3d d = random.direction();
		list.push_back({{distance * d[0], distance * d[1], distance * std::fabs(d[2])}, radius, any()});
	}
	sets.push_back({"ten decades", scene_of(list)});

	list.clear();
	for (int i = 0; i < 100; ++i)
		list.push_back({{0, 0, 3.0 + i}, 0.49, any()});
	sets.push_back({"in a row", scene_of(list)});

	list.assign(100, {{0, 0, 5}, 1, 0});
	for (std::uint32_t i = 0; i < list.size(); ++i)
		list[i].material = i % 4;
	sets.push_back({"all the same", scene_of(list)});

	// Radii and gaps that grow without end: the heuristic would cut off one sphere at a time.
	list.clear();
	for (int i = 0; i < 60; ++i)
		list.push_back({{std::exp2(i / 3.0), 0, 4 + std::exp2(i / 3.0)}, 0.3 * std::exp2(i / 3.0), any()});
	sets.push_back({"geometric", scene_of(list)});

	list.clear();
	for (int i = 0; i < 200; ++i)
		list.push_back({{random.between(-2, 2) + 1e5, random.between(-2, 2), random.between(2, 6) - 1e5}, 0.3, any()});
	Scene far_away = scene_of(list);
	far_away.camera.from = {1e5, 0, -1e5};
	far_away.camera.at = {1e5, 0, -1e5 + 1};
	sets.push_back({"far from the origin", far_away});

	for (Sphere& sphere : list)
		sphere.center = {sphere.center[0] - 1e5, sphere.center[1], sphere.center[2] + 1e5 + 2e4};
	Scene telescope = scene_of(list);
	telescope.camera.vfov = 0.012;
	sets.push_back({"far from the camera", telescope});

	sets.push_back({"one sphere", scene_of({{{0, 0, 5}, 1, 0}})});
	return sets;
}

PackedScene pack(const Scene& scene, std::uint32_t width = 32, std::uint32_t height = 24)
{
	RenderSettings settings = scene.render;
	settings.width = width;
	settings.height = height;
	settings.max_depth = 20;
	Result<PackedScene> packed = pack_scene(scene, settings, {0, 0, width, height});
	if (!packed)
		FAIL(packed.error().message);
	return std::move(packed).value();
}

PackedScene treed(const PackedScene& packed, std::uint32_t lanes, BvhStats* stats = nullptr)
{
	Result<PackedScene> result = with_bvh(packed, lanes, stats);
	if (!result)
		FAIL(result.error().message);
	return std::move(result).value();
}

std::string film_hash(const PackedScene& packed, const TestDevice& device, Acceleration bvh, std::uint32_t lanes)
{
	SessionOptions options;
	options.bvh = bvh;
	options.lanes = lanes;
	const Film film = render(packed, device, options, 2);
	CHECK(film.rejected == 0);
	return film.hash().hex();
}

rt_scene_view view_of(const PackedScene& packed)
{
	rt_scene_view view{};
	view.scene = &packed.scene;
	view.spheres = packed.spheres.data();
	view.wide = packed.wide.data();
	view.sphere_ids = packed.sphere_ids.data();
	view.bvh = packed.bvh.data();
	return view;
}

std::uint32_t bits(float value)
{
	std::uint32_t word = 0;
	std::memcpy(&word, &value, sizeof word);
	return word;
}

// The words of a tree, by the layout of rt_row4.
class Tree {
public:
	Tree(const PackedScene& packed, std::uint32_t lanes)
	    : packed_(packed), lanes_(lanes), width_(RT_BVH_WIDTH(lanes)), words_(packed.bvh.size() * 4)
	{
		if (!words_.empty())
			std::memcpy(words_.data(), packed.bvh.data(), words_.size() * sizeof(float));
	}

	// Visits every leaf once; `enclosing` are the boxes on the way.
	void walk(std::uint32_t link, const std::vector<std::array<float, 6>>& enclosing)
	{
		REQUIRE(link != RT_BVH_NONE);
		if (link & RT_BVH_LEAF) {
			std::uint32_t first = link & RT_BVH_FIRST_MASK;
			std::uint32_t count = ((link >> RT_BVH_COUNT_SHIFT) & RT_BVH_COUNT_MASK) + 1;
			if (lanes_ > 1) {
				const float* block = &words_[(packed_.scene.bvh_blocks + first * RT_BVH_BLOCK_ROWS(width_)) * 4];
				first = bits(block[0]);
				count = bits(block[1]);
				REQUIRE(count >= 1);
				REQUIRE(count <= width_);
				for (std::uint32_t k = 0; k < width_; ++k) {
					const float radius = block[4 + 3 * width_ + k];
					if (k >= count)
						CHECK(std::isnan(radius));
					else
						CHECK(radius == packed_.spheres[first + k].radius);
				}
			}
			for (std::uint32_t i = first; i < first + count; ++i) {
				REQUIRE(i < packed_.spheres.size());
				CHECK(seen.insert(i).second);
				const rt_sphere& s = packed_.spheres[i];
				const rt_scene& scene = packed_.scene;
				const float center[3] = {s.cx - scene.bvh_x, s.cy - scene.bvh_y, s.cz - scene.bvh_z};
				bool inside = true;
				for (const auto& box : enclosing)
					for (std::size_t a = 0; a < 3; ++a)
						inside = inside && box[2 * a] <= center[a] - s.radius &&
						         box[2 * a + 1] >= center[a] + s.radius &&
						         std::max(-box[2 * a], box[2 * a + 1]) <= scene.bvh_extent;
				CHECK(inside);
			}
			return;
		}
		const float* node = &words_[link * RT_BVH_NODE_ROWS(width_) * 4];
		++nodes;
		for (std::uint32_t k = 0; k < width_; ++k) {
			const std::uint32_t child = bits(node[6 * width_ + k]);
			if (child == RT_BVH_NONE)
				continue;
			std::array<float, 6> box{};
			for (std::size_t plane = 0; plane < 6; ++plane)
				box[plane] = node[plane * width_ + k];
			std::vector<std::array<float, 6>> inner = enclosing;
			inner.push_back(box);
			walk(child, inner);
		}
	}

	std::set<std::uint32_t> seen;
	std::uint64_t nodes = 0;

private:
	const PackedScene& packed_;
	std::uint32_t lanes_, width_;
	std::vector<float> words_;
};

void check_structure(const Set& set, std::uint32_t lanes)
{
	INFO(set.name << ", " << lanes << " lanes");
	const PackedScene packed = pack(set.scene);
	BvhStats stats;
	const PackedScene tree = treed(packed, lanes, &stats);
	const std::size_t listed = packed.spheres.size() - packed.wide.size();
	Tree walk(tree, lanes);
	if (listed == 0)
		return;
	walk.walk(tree.scene.bvh_root, {});
	CHECK(walk.seen.size() == listed);
	CHECK(walk.seen.count(static_cast<std::uint32_t>(packed.wide.size())) == 1);
	CHECK(walk.nodes == stats.nodes);
	CHECK(stats.stack <= RT_BVH_STACK(lanes));
	CHECK(tree.bvh.size() * sizeof(rt_row4) <= bvh_bytes_needed(listed, lanes) + 512);
	std::vector<std::uint32_t> ids = tree.sphere_ids;
	std::sort(ids.begin(), ids.end());
	CHECK(std::adjacent_find(ids.begin(), ids.end()) == ids.end());
}

} // namespace

TEST_CASE("every sphere is in one leaf, inside every box on the way, and no walk overflows its stack")
{
	for (const Set& set : sphere_sets())
		for (const std::uint32_t lanes : {1u, 4u, 8u, 16u})
			check_structure(set, lanes);
}

TEST_CASE("so it is where ranges are cut by several threads, however the spheres are stored")
{
	Random random(2);
	std::vector<Sphere> list;
	for (std::uint32_t i = 0; i < 12000; ++i)
		list.push_back(
		    {{random.between(-3, 3), random.between(-1, 1), random.between(4, 5)}, random.between(0.001, 0.02), i % 4});
	check_structure({"shuffled", scene_of(list)}, 1);
	check_structure({"shuffled", scene_of(list)}, 8);
	const auto by_x = [](const Sphere& a, const Sphere& b) { return a.center[0] < b.center[0]; };
	std::sort(list.begin(), list.end(), by_x);
	check_structure({"in order", scene_of(list)}, 8);
	std::reverse(list.begin(), list.end());
	check_structure({"in the opposite order", scene_of(list)}, 8);
	std::rotate(list.begin(), list.begin() + 5000, list.end());
	check_structure({"in two runs", scene_of(list)}, 1);
	// Most of a piece goes one way and the next one's the other.
	for (std::size_t i = 0; i < list.size(); ++i)
		list[i].center[0] = i / 4096 % 2 == 0 ? 3 : -3;
	check_structure({"piece by piece", scene_of(list)}, 8);
}

TEST_CASE("a tree changes no bit of a film, on any device, with any number of lanes")
{
	for (const Set& set : sphere_sets()) {
		const PackedScene packed = pack(set.scene);
		const std::string expected = film_hash(packed, reference_device(), Acceleration::Never, 1);
		for (const TestDevice& device : test_devices()) {
			std::set<std::uint32_t> lane_counts = {1u};
			if (device.has_lanes())
				lane_counts.insert({4u, 8u});
			for (const std::uint32_t lanes : lane_counts) {
				INFO(set.name << " on " << device.name << ", " << lanes << " lanes");
				CHECK(film_hash(packed, device, Acceleration::Always, lanes) == expected);
			}
		}
	}
}

TEST_CASE("lanes are the device's own, and no more than eight through a tree")
{
	const auto cloud_of = [](std::uint32_t count) {
		const Result<Scene> cloud = make_cloud(count);
		REQUIRE(cloud);
		return pack(*cloud);
	};
	const PackedScene few = cloud_of(20), some = cloud_of(32), many = cloud_of(100);
	const auto lanes = [](const PackedScene& packed, std::uint32_t native, const SessionOptions& options) {
		DeviceInfo device;
		device.native_lanes = native;
		return render_lanes(packed, device, options);
	};
	const SessionOptions plain;
	for (const std::uint32_t native : {1u, 4u, 8u})
		for (const PackedScene* packed : {&few, &some, &many})
			CHECK(lanes(*packed, native, plain) == native);
	CHECK(lanes(few, 16, plain) == 16);
	CHECK(lanes(some, 16, plain) == 16); // tried one after the other, and through a tree only by fewer lanes
	CHECK(wants_bvh(some, 8, Acceleration::Auto));
	CHECK(lanes(many, 16, plain) == 8);
	CHECK(lanes(treed(many, 8), 16, plain) == 8);
	SessionOptions options;
	options.bvh = Acceleration::Never;
	CHECK(lanes(many, 16, options) == 16);
	options.bvh = Acceleration::Always;
	CHECK(lanes(few, 16, options) == 8);
	options.lanes = 16;
	CHECK(lanes(many, 8, options) == 16);
	options = plain;
	options.precision = Precision::Double;
	CHECK(lanes(many, 16, options) == 1);
}

TEST_CASE("a tree whose boxes are too small changes the film")
{
	const PackedScene packed = pack(sphere_sets().front().scene);
	PackedScene tree = treed(packed, 1);
	const std::string expected = film_hash(packed, reference_device(), Acceleration::Never, 1);
	CHECK(film_hash(tree, reference_device(), Acceleration::Auto, 1) == expected);
	for (std::size_t row = 0; row < tree.scene.bvh_blocks; ++row)
		if (row % 7 < 6) {
			rt_row4& r = tree.bvh[row];
			for (float* plane : {&r.a, &r.b, &r.c, &r.d})
				*plane += row % 2 ? -0.1f : 0.1f;
		}
	CHECK(film_hash(tree, reference_device(), Acceleration::Auto, 1) != expected);
}

// Rays that graze: only the padding keeps the hits that rounding makes.
TEST_CASE("no grazing ray loses its hit, and without padding some do")
{
	std::uint64_t rays = 0, hits = 0, lost = 0, lost_without = 0;
	for (const Set& set : sphere_sets()) {
		const PackedScene packed = pack(set.scene);
		const PackedScene tree = treed(packed, 1);
		if (tree.bvh.empty())
			continue;
		PackedScene bare = tree;
		Random random(7);
		for (int k = 0; k < 40000; ++k) {
			// From a random sphere towards the rim of another.
			const auto from = static_cast<std::uint32_t>(random.engine() % packed.spheres.size());
			const rt_sphere& target = packed.spheres[random.engine() % packed.spheres.size()];
			const rt_sphere& start = packed.spheres[from];
			const Vec3d n = random.direction(), side = random.direction();
			Vec3d origin{}, to{};
			for (std::size_t a = 0; a < 3; ++a) {
				const double center = double(a == 0 ? start.cx : a == 1 ? start.cy : start.cz);
				const double goal = double(a == 0 ? target.cx : a == 1 ? target.cy : target.cz);
				origin[a] = k % 2 ? center + double(start.radius) * n[a] : 0.0;
				to[a] = goal - origin[a];
			}
			const double distance = std::sqrt(to[0] * to[0] + to[1] * to[1] + to[2] * to[2]);
			const double along = (side[0] * to[0] + side[1] * to[1] + side[2] * to[2]) / (distance * distance);
			Vec3d across{side[0] - along * to[0], side[1] - along * to[1], side[2] - along * to[2]};
			const double length = std::sqrt(across[0] * across[0] + across[1] * across[1] + across[2] * across[2]);
			const double rim = double(target.radius) * (1 + random.between(-3e-7, 3e-7)) / length;
			rt_ray ray;
			ray.base = k % 2 ? v3(start.cx, start.cy, start.cz) : v3(0, 0, 0);
			ray.arm = k % 2 ? v3(float(n[0]), float(n[1]), float(n[2])) : v3(0, 0, 0);
			ray.reach = k % 2 ? start.radius : 1.0f;
			ray.dir = v3_normalize(
			    v3(float(to[0] + rim * across[0]), float(to[1] + rim * across[1]), float(to[2] + rim * across[2])),
			    v3(0, 0, 1));
			ray.from = -1;
			ray.chord = -1;
			rt_ray stored = ray;
			if (k % 2) {
				ray.from = static_cast<rt_i32>(from);
				for (std::uint32_t i = 0; i < tree.sphere_ids.size(); ++i)
					if (tree.sphere_ids[i] == packed.sphere_ids[from])
						stored.from = static_cast<rt_i32>(i);
			}
			const rt_hit all = rt_closest_hit(view_of(packed), ray, RT_TRUE);
			const rt_hit through = rt_closest_hit(view_of(tree), stored, RT_TRUE);
			// Padding is a multiple of extent + reach of the ray: this takes it away.
			const rt_vec3 at = v3_fma(stored.reach, stored.arm,
			                          v3_sub(stored.base, v3(tree.scene.bvh_x, tree.scene.bvh_y, tree.scene.bvh_z)));
			bare.scene.bvh_extent =
			    -rt_max(rt_max(rt_abs(at.x), rt_abs(at.y)), rt_max(rt_abs(at.z), rt_abs(stored.reach)));
			const rt_hit unpadded = rt_closest_hit(view_of(bare), stored, RT_TRUE);
			const auto same = [&](const rt_hit& hit) {
				return bits(hit.t) == bits(all.t) &&
				       (all.index < 0 ? hit.index < 0
				                      : hit.index >= 0 && tree.sphere_ids[static_cast<std::size_t>(hit.index)] ==
				                                              packed.sphere_ids[static_cast<std::size_t>(all.index)]);
			};
			++rays;
			hits += all.index >= 0 ? 1 : 0;
			lost += same(through) ? 0 : 1;
			lost_without += same(unpadded) ? 0 : 1;
		}
	}
	INFO(rays << " rays, " << hits << " hits, " << lost << " differ, " << lost_without << " without padding");
	CHECK(hits > rays / 4);
	CHECK(lost == 0);
	CHECK(lost_without > 0);
}

TEST_CASE("a ray that is no number meets nothing")
{
	const PackedScene packed = pack(sphere_sets().front().scene);
	const PackedScene tree = treed(packed, 1);
	const float nan = std::numeric_limits<float>::quiet_NaN(), infinity = std::numeric_limits<float>::infinity();
	for (const float bad : {nan, infinity, -infinity})
		for (int place = 0; place < 4; ++place) {
			rt_ray ray;
			ray.base = ray.arm = v3(0, 0, 0);
			ray.reach = place == 2 ? bad : 1.0f;
			ray.dir = v3(place == 0 ? bad : 0.0f, place == 3 ? bad : 0.0f, place == 3 ? bad : 1.0f);
			if (place == 1)
				ray.base.x = bad;
			ray.from = -1;
			ray.chord = -1;
			CHECK(rt_closest_hit(view_of(packed), ray, RT_TRUE).index == -1);
			CHECK(rt_closest_hit(view_of(tree), ray, RT_TRUE).index == -1);
		}
}

TEST_CASE("print the hash of a tree", "[.tree]")
{
	const Result<Scene> cloud = make_cloud(200000);
	REQUIRE(cloud);
	const PackedScene tree = treed(pack(*cloud), 8);
	Hasher hasher;
	hasher.add(tree.bvh.data(), tree.bvh.size() * sizeof(rt_row4));
	hasher.add(tree.sphere_ids.data(), tree.sphere_ids.size() * sizeof(std::uint32_t));
	std::printf("tree %s\n", hasher.result().hex().c_str());
}

TEST_CASE("a tree is the same for any number of threads")
{
	const std::string program = std::filesystem::read_symlink("/proc/self/exe").string();
	std::set<std::string> hashes;
	for (const char* threads : {"1", "2", "7"}) {
		const std::string command = std::string("RT_THREADS=") + threads + " '" + program + "' '[.tree]'";
		FILE* pipe = popen(command.c_str(), "r");
		REQUIRE(pipe != nullptr);
		char line[256];
		while (std::fgets(line, sizeof line, pipe))
			if (std::strncmp(line, "tree ", 5) == 0)
				hashes.insert(line);
		CHECK(pclose(pipe) == 0);
	}
	CHECK(hashes.size() == 1);
}
