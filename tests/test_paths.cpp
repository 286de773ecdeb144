// Whole paths, step by step, through programs that each device's compiler made: their vectors are unit vectors, their
// weights in range, no ray meets the sphere that it left, and every step has the bits of this test's own compilation of
// the kernels, whose correctness test_geometry, test_samplers and test_sobol show. Faults planted in the kernels are
// found by these means.
#include "tests/catch.h"
#include "tests/devices.h"
#include "tests/faulty_device.h"
#include "tests/scene_builders.h"

namespace {
thread_local unsigned rt_host_global_id = 0;
}
#include "kernels/probe_paths.cl"

#include <algorithm>
#include <array>

using namespace rt;

namespace {

// ---- scenes ----

struct Paths {
	std::string name;
	PackedScene packed;
	std::uint32_t count; // of paths
};

Paths paths_of(const TestScene& golden, Estimator estimator = Estimator::Path)
{
	TestScene scene = golden;
	scene.width = 24;
	scene.height = 16;
	scene.estimator = estimator;
	return {scene.name + ", " + settings_text(scene), pack_test_scene(scene), 24 * 16 * 2};
}

TestScene golden(const std::string& name)
{
	for (const TestScene& scene : test_scenes())
		if (scene.name == name)
			return scene;
	FAIL("there is no golden scene " << name);
	return {};
}

Paths paths_of(const std::string& name, const Scene& scene, Sampler sampler = Sampler::Independent,
               std::uint32_t roulette = 0)
{
	RenderSettings settings = settings_of(24, 16, 2, 20, 3);
	settings.sampler = sampler;
	settings.roulette = roulette;
	Result<PackedScene> packed = pack_scene(scene, settings, {0, 0, 24, 16});
	if (!packed)
		FAIL(name << ": " << packed.error().message);
	return {name, std::move(*packed), 24 * 16 * 2};
}

// From inside a matte sphere one looks along the z axis at the seam of the frame: normals at and beside (0, 0, 1) or
// (0, 0, -1).
Paths seam(const std::string& name, double z)
{
	Camera camera;
	camera.from = {0, 0, 0};
	camera.at = {0, 0, z};
	camera.vfov = 0.02;
	return paths_of(name, scene_of(camera, 0.5, {material_of(Material::Kind::Lambertian, 0.75)}, {{{0, 0, 0}, 3, 0}}));
}

// A ball on a wide ground, both matte, of an albedo with digits below 2^-24.
Scene ball_on_ground()
{
	Camera camera;
	camera.from = {0, 1, 4};
	camera.at = {0, 0.5, 0};
	return scene_of(camera, 0.5, {material_of(Material::Kind::Lambertian, 0.15)},
	                {{{0, -1000, 0}, 1000, 0}, {{0, 1, 0}, 1, 0}});
}

// Inside a glowing sphere that leaves 2^-19 at each scattering: the fourth weight would be 2^-76.
Paths dim()
{
	Paths paths = paths_of(golden("closed"));
	paths.name = "dim";
	for (rt_material& material : paths.packed.materials)
		material.albedo_r = material.albedo_g = material.albedo_b = 0x1p-19f;
	return paths;
}

const std::vector<Paths>& all_paths()
{
	static const std::vector<Paths> all = [] {
		std::vector<Paths> paths;
		for (const TestScene& scene : test_scenes())
			paths.push_back(paths_of(scene));
		TestScene cornell = golden("cornell");
		paths.push_back(paths_of(cornell, Estimator::Nee));
		cornell.sampler = Sampler::Sobol;
		cornell.roulette = 2;
		paths.push_back(paths_of(cornell, Estimator::Mis));
		paths.push_back(seam("seam at (0, 0, 1)", -1));
		paths.push_back(seam("seam at (0, 0, -1)", 1));
		paths.push_back(paths_of("ball", ball_on_ground()));
		paths.push_back(paths_of("sobol ball", ball_on_ground(), Sampler::Sobol, 1));
		paths.push_back(dim());
		return paths;
	}();
	return all;
}

const Paths& paths_named(const std::string& beginning)
{
	for (const Paths& paths : all_paths())
		if (paths.name.rfind(beginning, 0) == 0)
			return paths;
	FAIL("there are no paths " << beginning);
	return all_paths().front();
}

// ---- a device's paths ----

using Words = std::vector<std::uint32_t>; // RT_PATHS_WORDS a path

class Tracer {
public:
	Tracer(DeviceHandle device, std::uint32_t lanes, bool software_roots, std::uint32_t features)
	    : device_(std::move(device)), lanes_(lanes)
	{
		ProgramSpec spec;
		spec.root = "kernels/probe_paths.cl";
		spec.entries = {"rt_probe_paths"};
		spec.defines = {{"RT_LANES", std::to_string(lanes)},
		                {"RT_FEATURES", std::to_string(features) + "u"},
		                {"RT_DEF_NATIVE_ROOTS", software_roots ? "0" : "1"}};
		const Result<ProgramHandle> program = device_->build(spec);
		if (!program)
			FAIL(device_->info().name << ": " << program.error().message << '\n' << program.error().log);
		program_ = *program;
	}

	Words trace(const Paths& paths)
	{
		const PackedScene& packed = paths.packed;
		Words words(std::size_t(paths.count) * RT_PATHS_WORDS, 0xdeadbeefu);
		const BufferHandle out = upload(words);
		REQUIRE(device_->launch(program_, "rt_probe_paths", (paths.count + lanes_ - 1) / lanes_,
		                        {by_value(packed.scene), by_value(rt_few_spheres{}), upload(packed.spheres),
		                         upload(packed.wide), upload(packed.sphere_ids), upload(packed.sphere_materials),
		                         upload(packed.bvh), upload(packed.materials), upload(packed.textures),
		                         upload(packed.texels), upload(packed.lights), out, 0u, paths.count}));
		REQUIRE(device_->wait());
		REQUIRE(device_->read(out, 0, words.data(), words.size() * sizeof words[0]));
		return words;
	}

private:
	template <class Row>
	BufferHandle upload(const std::vector<Row>& rows)
	{
		const std::size_t bytes = rows.size() * sizeof(Row);
		const Result<BufferHandle> buffer = device_->alloc(std::max<std::size_t>(bytes, 64));
		REQUIRE(buffer);
		if (bytes)
			REQUIRE(device_->write(*buffer, 0, rows.data(), bytes));
		return *buffer;
	}

	DeviceHandle device_;
	std::uint32_t lanes_;
	ProgramHandle program_;
};

// This file's own compilation: scalar, for no device.
const Words& expected(const Paths& paths)
{
	static std::vector<std::pair<std::string, Words>> known;
	for (const auto& [name, words] : known)
		if (name == paths.name)
			return words;
	const PackedScene& packed = paths.packed;
	Words words(std::size_t(paths.count) * RT_PATHS_WORDS);
	for (rt_host_global_id = 0; rt_host_global_id < paths.count; ++rt_host_global_id)
		rt_probe_paths(packed.scene, {}, packed.spheres.data(), packed.wide.data(), packed.sphere_ids.data(),
		               packed.sphere_materials.data(), packed.bvh.data(), packed.materials.data(),
		               packed.textures.data(), packed.texels.data(), packed.lights.data(), words.data(), 0u,
		               paths.count);
	known.emplace_back(paths.name, std::move(words));
	return known.back().second;
}

using Sums = std::array<std::uint64_t, RT_PATHS_WORDS>;

Sums sums_of(const Words& words)
{
	Sums sums{};
	for (std::size_t i = 0; i < words.size(); ++i)
		sums[i % RT_PATHS_WORDS] += words[i];
	return sums;
}

void check_paths(Tracer& tracer, const Paths& paths, const std::string& device)
{
	const Words words = tracer.trace(paths);
	const Sums sums = sums_of(words);
	INFO(device << ": " << paths.name);
	CHECK(sums[RT_PATHS_LENGTH_FAULTS] == 0);
	CHECK(sums[RT_PATHS_WEIGHT_FAULTS] == 0);
	CHECK(sums[RT_PATHS_DEPARTURE_FAULTS] == 0);
	const Words& want = expected(paths);
	const auto wrong = std::mismatch(words.begin(), words.end(), want.begin()).first - words.begin();
	if (words != want)
		FAIL_CHECK("path " << wrong / RT_PATHS_WORDS << " is another by word " << wrong % RT_PATHS_WORDS);
}

} // namespace

TEST_CASE("rules 6, 10, 11, 12 and 14: every device's paths have unit vectors, weights in range, no hit of the sphere "
          "they left, and the same bits",
          "[paths]")
{
	// Trees are test_bvh's affair: they take most of the compilers' time.
	std::uint32_t features = 0;
	for (const Paths& paths : all_paths())
		features |= paths.packed.features;
	for (const TestDevice& device : test_devices()) {
		// As it renders, and with whatever else it has: one lane, our own roots.
		Tracer native(device.device, device.device->info().native_lanes, device.needs_software_roots, features);
		Tracer other(device.device, 1, true, features);
		for (const Paths& paths : all_paths()) {
			check_paths(native, paths, device.name);
			check_paths(other, paths, device.name + ", one lane, our own roots");
		}
	}
	Sums sums{};
	for (const Paths& paths : all_paths()) {
		const Sums part = sums_of(expected(paths));
		for (std::size_t i = 0; i < sums.size(); ++i)
			sums[i] += part[i];
	}
	// There is enough of everything.
	CHECK(sums[RT_PATHS_STEPS] > 90000);
	CHECK(sums[RT_PATHS_OUTWARD] > 60000);
	CHECK(sums[RT_PATHS_INWARD] > 20000);
	CHECK(sums[RT_PATHS_WIDE] > 50000);
	CHECK(sums[RT_PATHS_AIMED] > 20000);
}

TEST_CASE("faults of paths are found, each by what is counted of it", "[paths]")
{
	struct Sign {
		const char* paths; // in which a fault shows
		unsigned word;     // and where
	};
	struct Planted { // two faults at once where neither can touch the other's paths
		const char* faults;
		std::vector<TextEdit> edits;
		std::vector<Sign> signs;
		const char* sound; // paths that it leaves alone
	};
	const char* const sphere = "kernels/sphere.h";
	const char* const material = "kernels/material.h";
	const Planted all[] = {
	    {"a wide sphere that is not left out when a ray leaves it",
	     {{sphere, "two_roots & rt_not(is_from) & ", "two_roots & "}},
	     {{"ball", RT_PATHS_DEPARTURE_FAULTS}},
	     "closed"},
	    {"the normal as point minus centre",
	     {{sphere, "from_center = v3_sel(use_direct, direct, from_center);", "from_center = direct;"}},
	     {{"ball", RT_PATHS_BITS}},
	     nullptr},
	    {"Frisvad's frame",
	     {{material, "rt_float up = rt_abs(n.z);", "rt_float up = n.z;"},
	      {material, "rt_from_bits(rt_bits(z) ^ (rt_bits(n.z) & RT_SIGN_BIT))", "z"}},
	     {{"seam at (0, 0, -1)", RT_PATHS_LENGTH_FAULTS}},
	     nullptr},
	    {"no floor under the throughput; a roulette whose probability is rounded down",
	     {{"kernels/path.h", "return rt_sel(weight >= rt_splat(RT_MIN_THROUGHPUT), weight, rt_splat(0.0f));",
	       "return weight;"},
	      {"kernels/roulette.h", "rt_to_int(b * 0x1p24f) + 1)", "rt_to_int(b * 0x1p24f))"}},
	     {{"dim", RT_PATHS_WEIGHT_FAULTS}, {"sobol ball", RT_PATHS_WEIGHT_FAULTS}},
	     "ball"},
	    {"a sphere's far side forgotten; a sampler that takes all blocks for one",
	     {{sphere, "rt_mask inward = ray.chord > rt_splat(0.0f);", "rt_mask inward = RT_FALSE;"},
	      {"kernels/sampler.h", "rt_block_words(seed, pixel, scramble, block)",
	       "rt_block_words(seed, pixel, scramble, rt_splat_u(1u) + 0u * block)"}},
	     {{"closed", RT_PATHS_DEPARTURE_FAULTS}, {"sobol ball", RT_PATHS_BITS}},
	     "ball"},
	};
	bool shown = false;
	for (const TestDevice& device : test_devices()) {
		if (device.is_reference())
			continue; // its kernels are compiled with rt and take no edits
		shown = true;
		for (const Planted& planted : all) {
			INFO(device.name << ", " << planted.faults);
			std::uint32_t features = planted.sound ? paths_named(planted.sound).packed.features : 0;
			for (const Sign& sign : planted.signs)
				features |= paths_named(sign.paths).packed.features;
			Tracer faulty(make_faulty(device.device, {planted.faults, planted.edits}), 1, device.needs_software_roots,
			              features);
			for (const Sign& sign : planted.signs) {
				INFO(sign.paths);
				const Words words = faulty.trace(paths_named(sign.paths));
				CHECK(words != expected(paths_named(sign.paths)));
				if (sign.word != RT_PATHS_BITS)
					CHECK(sums_of(words)[sign.word] > 0);
			}
			if (planted.sound)
				CHECK(faulty.trace(paths_named(planted.sound)) == expected(paths_named(planted.sound)));
		}
	}
	if (!shown)
		WARN("skipped: no device here compiles the kernels' text");
}
