// Rules of the contract that belong to no part of rt alone: the language of the kernels (2, 17), the range (5), what a
// film says of its making (17), and what becomes of a film that a device made (19, 21), on every device found. The
// other rules' tests are listed in docs/contract.md.
#include "tests/catch.h"
#include "tests/devices.h"
#include "tests/faulty_device.h"
#include "tests/run_command.h"

#include "backends/kernel_text.h"
#include "common/rt_contract.h"
#include "render/display.h"
#include "render/image_file.h"
#include "tools/film_provenance.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <functional>

using namespace rt;

namespace {

// ---- the lint ----

Outcome lint(const std::string& options)
{
	return run_command("python3 '" RT_SOURCE_DIR "/tools/lint_kernels.py' --text-only " + options + " 2>&1");
}

// ---- seeds ----

// The kernels with both seeds changed: `by` is an expression of the seed's bits or of the seed.
Fault changed_seeds(const std::string& name, const std::string& before, const std::string& behind)
{
	Fault fault;
	fault.name = name;
	for (const char* const seed : {"rt_seed_rsqrt(x)", "rt_seed_rcp(x)"})
		fault.edits.push_back({"kernels/math.h", "\trt_float y = " + std::string(seed) + ";\n",
		                       "\trt_float y = " + before + seed + behind + ";\n"});
	fault.only_root = "kernels/render.cl";
	return fault;
}

std::string film_hash(const DeviceHandle& device, const TestScene& scene)
{
	SessionOptions options;
	options.specialise = false;
	options.software_roots = true; // the seeds are in these
	options.samples = scene.samples;
	const Result<SessionResult> result = render_scene(pack_test_scene(scene), {device}, options);
	if (!result)
		FAIL(device->info().name << ": " << result.error().message << '\n' << result.error().log);
	return result->film.hash().hex();
}

// ---- scenes at the ends of the range ----

// One matte sphere before a grey sky, seen along the z axis.
struct Lengths {
	double radius = 1, distance = 4;
	double aperture = 0, focus = 4, vfov = 40;
	double camera_offset = 0; // of everything
};

Scene scene_of(const Lengths& lengths)
{
	Scene scene;
	scene.camera.from = {lengths.camera_offset, 0, 0};
	scene.camera.at = {lengths.camera_offset, 0, -1};
	scene.camera.vfov = lengths.vfov;
	scene.camera.aperture = lengths.aperture;
	scene.camera.focus = lengths.focus;
	scene.sky.kind = Sky::Kind::Constant;
	scene.sky.bottom = {0.5, 0.5, 0.5};
	Material matte;
	matte.kind = Material::Kind::Lambertian;
	matte.albedo = {0.25, 0.5, 0.75};
	scene.materials = {matte};
	Sphere sphere;
	sphere.center = {lengths.camera_offset, 0, -lengths.distance};
	sphere.radius = lengths.radius;
	sphere.material = 0;
	scene.spheres = {sphere};
	return scene;
}

Result<PackedScene> pack(const Scene& scene)
{
	RenderSettings settings;
	settings.width = 12;
	settings.height = 8;
	settings.samples = 4;
	return pack_scene(scene, settings, Window{0, 0, settings.width, settings.height});
}

// ---- codes of a texture ----

constexpr std::uint32_t coded = 120; // texels, in which each of the 256 codes is one channel's or another's

std::array<std::uint8_t, 3> codes_of_texel(std::uint32_t i)
{
	return {static_cast<std::uint8_t>(i), static_cast<std::uint8_t>(coded + i),
	        static_cast<std::uint8_t>(2 * coded + i % 16)};
}

// A matte ball under a sky of 1, with an image of which any side shows all coded texels and black ones: a sample of it
// has the texel's colour as its radiance.
Scene coded_ball()
{
	constexpr std::uint32_t columns = 12, rows = 10, margin = 3;
	Texture image;
	image.kind = Texture::Kind::Image;
	image.width = 36;
	image.height = rows + 2 * margin;
	image.texels.assign(std::size_t(image.width) * image.height, 0u);
	for (std::uint32_t y = margin; y < margin + rows; ++y)
		for (std::uint32_t x = 0; x < image.width; ++x) {
			const auto codes = codes_of_texel((x % columns) * rows + y - margin);
			image.texels[y * image.width + x] =
			    codes[0] | static_cast<std::uint32_t>(codes[1]) << 8 | static_cast<std::uint32_t>(codes[2]) << 16;
		}
	Scene scene;
	scene.camera.from = {0, 0, -4};
	scene.camera.at = {0, 0, 0};
	scene.sky.kind = Sky::Kind::Constant;
	scene.sky.bottom = {1, 1, 1};
	scene.textures = {image};
	Material matte;
	matte.texture = 0;
	scene.materials = {matte};
	scene.spheres = {{{0, 0, 0}, 1, 0}};
	return scene;
}

struct Codes {
	std::vector<bool> seen = std::vector<bool>(coded); // texels
	std::size_t wrong = 0;                             // pixels that are of no texel
};

Codes codes_of(const Film& film)
{
	const std::vector<std::uint8_t> bytes = to_8bit(film, {Transfer::Srgb, 0});
	Codes codes;
	for (std::size_t i = 0; i + 2 < bytes.size(); i += 3) {
		const std::array<std::uint8_t, 3> pixel = {bytes[i], bytes[i + 1], bytes[i + 2]};
		if (pixel[0] < coded && pixel == codes_of_texel(pixel[0]))
			codes.seen[pixel[0]] = true;
		else if (pixel != std::array<std::uint8_t, 3>{0, 0, 0} && pixel != std::array<std::uint8_t, 3>{255, 255, 255})
			++codes.wrong;
	}
	return codes;
}

} // namespace

TEST_CASE("rules 2 and 17: the lint finds nothing in the kernels, and each planted fault", "[rules]")
{
	// The controls: operations, types and constants that the language does not have.
	const Outcome planted = lint("--self-test");
	INFO(planted.out);
	CHECK(planted.status == 0);
	const Outcome kernels = lint("");
	INFO(kernels.out);
	CHECK(kernels.status == 0);
	CHECK(kernels.out.find(" 0 findings") != std::string::npos);
}

TEST_CASE("rule 2: seeds up to 4 ulp off change no film, and wrong ones do", "[rules]")
{
	// The seed is within 2 ulp by itself, so 2 more are within what the rule allows.
	const Fault high = changed_seeds("seeds 2 up", "rt_from_bits(rt_bits(", ") + 2u)");
	const Fault low = changed_seeds("seeds 2 down", "rt_from_bits(rt_bits(", ") - 2u)");
	const Fault wrong = changed_seeds("seeds a quarter off", "0.75f * ", "");
	bool shown = false;
	for (const TestDevice& device : test_devices()) {
		if (device.is_reference())
			continue; // its kernels are compiled with rt and take no edits; test_exhaustive tries its seeds
		shown = true;
		for (const TestScene& scene : test_scenes()) {
			if (scene.name != "three-spheres" && scene.name != "floating")
				continue;
			INFO(device.name << ", " << scene.name);
			const std::string hash = film_hash(device.device, scene);
			CHECK(film_hash(make_faulty(device.device, high), scene) == hash);
			CHECK(film_hash(make_faulty(device.device, low), scene) == hash);
			CHECK(film_hash(make_faulty(device.device, wrong), scene) != hash);
		}
	}
	if (!shown)
		WARN("skipped: no device here compiles the kernels' text");
}

TEST_CASE("rule 5: at the ends of the range devices agree, and a step beyond is refused", "[rules]")
{
	struct End {
		const char* what;
		std::function<void(Lengths&, double)> set;
		double end;
		bool is_lower;
		std::string error; // of the step beyond
	};
	const double least = RT_MIN_LENGTH, most = RT_MAX_LENGTH, radii = RT_MAX_DISTANCE_IN_RADII;
	const auto radius = [](Lengths& l, double x) { l = {x, 4 * x}; };
	const auto large_radius = [](Lengths& l, double x) { l = {x, x / 2}; }; // seen from within: 4 radii are too far
	const auto distance = [=](Lengths& l, double x) { l = {most / 2, x}; };
	const auto distance_in_radii = [](Lengths& l, double x) { l = {1, x, 0, 4, 1e-5}; };
	const auto focus = [=](Lengths& l, double x) { l.aperture = least, l.focus = x; };
	const auto far_focus = [](Lengths& l, double x) { l.aperture = 0.25, l.focus = x, l.vfov = 20; };
	const auto aperture = [](Lengths& l, double x) { l.aperture = x; };
	const End ends[] = {
	    {"least radius", radius, least, true, "sphere 0's radius"},
	    {"largest radius", large_radius, most, false, "sphere 0's radius"},
	    {"largest distance", distance, most, false, "sphere 0's distance from the camera is"},
	    {"most radii away", distance_in_radii, radii, false, "sphere 0's distance from the camera in its radii"},
	    {"least focus", focus, 4 * least, true, ""}, // below it the image plane is too small
	    {"largest focus", far_focus, most, false, "the camera's focus distance"},
	    {"least aperture", aperture, least, true, "the camera's aperture"},
	    {"largest aperture", aperture, most, false, "the camera's aperture"},
	};
	for (const End& end : ends) {
		INFO(end.what);
		Lengths lengths;
		end.set(lengths, end.end);
		const Result<PackedScene> packed = pack(scene_of(lengths));
		if (!packed)
			FAIL(packed.error().message);
		const Film film = render(*packed, reference_device(), {}, 4);
		CHECK(film.rejected == 0);
		for (const TestDevice& device : test_devices()) {
			INFO(device.name);
			CHECK(render(*packed, device, {}, 4).hash().hex() == film.hash().hex());
		}
		// The control: the sphere is in the picture.
		Scene empty = scene_of(lengths);
		empty.spheres.clear();
		const Result<PackedScene> sky = pack(empty);
		REQUIRE(sky);
		CHECK(render(*sky, reference_device(), {}, 4).hash().hex() != film.hash().hex());

		if (end.error.empty())
			continue;
		end.set(lengths, std::nextafter(end.end, end.is_lower ? 0 : HUGE_VAL));
		const Result<PackedScene> beyond = pack(scene_of(lengths));
		REQUIRE_FALSE(beyond);
		CHECK(beyond.error().kind == ErrorKind::Usage);
		CHECK(beyond.error().message.find(end.error) != std::string::npos);
		CHECK_FALSE(beyond.error().cure.empty());
	}
	// A world offset is taken away first: what counts is the distance from the camera.
	Lengths offset;
	offset.camera_offset = 1e12;
	CHECK(pack(scene_of(offset)));
	for (const double vfov : {1e-8, 179.9999999}) {
		Lengths narrow;
		narrow.vfov = vfov;
		INFO(vfov);
		const Result<PackedScene> refused = pack(scene_of(narrow));
		REQUIRE_FALSE(refused);
		CHECK(refused.error().message.find("field of view") != std::string::npos);
	}
}

TEST_CASE("rule 17: on every device a film says how it was built and computed", "[rules]")
{
	const TestScene& scene = test_scenes().front();
	const PackedScene packed = pack_test_scene(scene);
	for (const TestDevice& device : test_devices()) {
		INFO(device.name);
		SessionOptions options;
		options.samples = 1;
		options.software_roots = device.needs_software_roots;
		const Result<SessionResult> result = render_scene(packed, {device.device}, options);
		REQUIRE(result);
		FilmOrigin origin;
		origin.scene = scene.name;
		origin.devices = {device.device};
		const Provenance provenance = provenance_of(origin, result->film, result->devices);
		const DeviceInfo& info = device.device->info();
		for (const auto& [key, value] : Provenance{{"Contract", std::to_string(RT_CONTRACT_VERSION)},
		                                           {"KernelHash", kernel_hash()},
		                                           {"Backend", info.backend},
		                                           {"Device", info.name},
		                                           {"Driver", info.driver},
		                                           {"FilmHash", result->film.hash().hex()}}) {
			INFO(key);
			CHECK_FALSE(value.empty());
			CHECK(provenance_value(provenance, key) == value);
		}
		// The flag that forbids contraction is among the options, whatever the compiler calls it.
		const std::string built = provenance_value(provenance, "BuildOptions");
		INFO(built);
		if (info.backend == "opencl") // it has none: the pragma does it (rule 3)
			CHECK(built.find("-cl-std=") != std::string::npos);
		else
			CHECK((built.find("-ffp-contract=off") != std::string::npos ||
			       built.find("fmad=false") != std::string::npos));
		// The control: another build says something else.
		options.precision = origin.precision = Precision::Fast;
		const Result<SessionResult> fast = render_scene(packed, {device.device}, options);
		REQUIRE(fast);
		const Provenance other = provenance_of(origin, fast->film, fast->devices);
		CHECK(provenance_value(other, "BuildOptions") != built);
		CHECK(provenance_value(other, "Contract") != provenance_value(provenance, "Contract"));
	}
}

TEST_CASE("rule 19: on every device an image's codes come back from the film as they were", "[rules]")
{
	RenderSettings settings;
	settings.width = settings.height = 128;
	const Result<PackedScene> packed = pack_scene(coded_ball(), settings, {0, 0, 128, 128});
	REQUIRE(packed);
	for (const TestDevice& device : test_devices()) {
		INFO(device.name);
		const Codes codes = codes_of(render(*packed, device, {}, 1));
		CHECK(codes.wrong == 0);
		CHECK(std::count(codes.seen.begin(), codes.seen.end(), true) == coded);
		if (device.is_reference())
			continue;
		// The control: the middle between two codes for one of them.
		TestDevice faulty = device;
		faulty.device = make_faulty(device.device,
		                            {"a wrong table", {{"kernels/srgb_table.h", "0x1.be4d6cp-5f", "0x1.c50db3p-5f"}}});
		const Codes wrong = codes_of(render(*packed, faulty, {}, 1));
		CHECK(wrong.wrong > 0);
	}
}

TEST_CASE("rule 21: a checkpoint of any device is gone on from on any other", "[rules]")
{
	const TestScene& scene = test_scenes().front();
	const PackedScene packed = pack_test_scene(scene);
	const Film straight = render(packed, reference_device(), {}, 5);
	for (const TestDevice& first : test_devices())
		for (const TestDevice& second : test_devices()) {
			INFO(first.name << ", then " << second.name);
			const std::vector<std::uint8_t> checkpoint = encode_rtfilm(render(packed, first, {}, 2), {});
			Result<LoadedFilm> loaded = decode_rtfilm(checkpoint.data(), checkpoint.size(), "checkpoint");
			REQUIRE(loaded);
			CHECK(loaded->film.hash().hex() != straight.hash().hex());
			REQUIRE(loaded->film.add(render(packed, second, {}, 3, 2)));
			CHECK(loaded->film.hash().hex() == straight.hash().hex());
		}
}
