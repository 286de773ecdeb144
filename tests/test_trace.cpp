// Faults planted one at a time in a device's program: the search for the first divergence names the operation, its file
// and its line, with no hint. Without a fault it says that there is none.
#include "tests/catch.h"
#include "tests/devices.h"
#include "tests/faulty_device.h"

#include "backends/embedded_text.h"
#include "backends/kernel_text.h"
#include "common/rt_contract.h"
#include "render/first_divergence.h"
#include "render/trace_file.h"
#include "render/trace_path.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <set>
#include <string_view>

using namespace rt;

namespace {

struct Planted {
	Fault fault;
	std::set<std::string> operations; // any of these is right
	std::string scene = "weekend";
	std::string file = {}; // of the operation, where it is not the edit's; "*": wherever a value of it is used
};

const char* const math = "kernels/math.h";
const char* const film = "kernels/film.h";

std::vector<Planted> planted_faults(const TestDevice& device)
{
	const bool own_roots = device.needs_software_roots;
	const TextEdit approximate_division =
	    own_roots ? TextEdit{math, "rt_from_bits(0x7f000000u - rt_bits(x)), y);",
	                         "rt_from_bits(0x7f000000u - rt_bits(x)), rt_from_bits(rt_bits(y) ^ 1u));"}
	              : TextEdit{math, "{ return rt_native_rcp(x); }",
	                         "{ rt_float y = rt_from_bits(0x7ef311c7u - rt_bits(x)); y = rt_fma(rt_fma(-x, y, "
	                         "rt_splat(1.0f)), y, y); y = rt_fma(rt_fma(-x, y, rt_splat(1.0f)), y, y); y = y * "
	                         "rt_fma(-x, y, rt_splat(2.0f)); return y; }"};
	return {
	    {{"a contraction",
	      {{"kernels/material.h", "rt_float ring = (p.s + p.s) * p.q;",
	        "rt_float ring = rt_fma(p.s, p.q, p.s * p.q);"}}},
	     {"addition", "multiplication"}},
	    {{"an fma that rounds twice", {{"kernels/material.h", "rt_fma(w.x, n.x, w.y * n.y)", "w.x * n.x + w.y * n.y"}}},
	     {"fma"}},
	    {{"an approximate division", {approximate_division}}, {"reciprocal"}, "weekend", "*"},
	    {{"a wrong constant", {{math, "rt_splat(0x1.03c1ep-2f)", "rt_splat(0x1.03c1e2p-2f)"}}}, {"fma"}},
	    {{"a swapped comparison",
	      {{"kernels/path.h", "rt_mask front = projection < rt_splat(0.0f);",
	        "rt_mask front = projection > rt_splat(0.0f);"}}},
	     {"comparison <"}},
	    {{"a flushed subnormal",
	      {{"common/rt_compat.h", "/* The one static assertion that every target takes.",
	        "#define rt_flushed(x) rt_sel(((x) < 0x1p-126f) & ((x) > -0x1p-126f), rt_splat(0.0f), (x))\n/* The one "
	        "static assertion that every target takes."},
	       {"kernels/vec.h", "return v3(a.x * b.x, a.y * b.y, a.z * b.z);",
	        "return v3(rt_flushed(a.x * b.x), a.y * b.y, a.z * b.z);"}}},
	     {"multiplication"},
	     "subnormal"},
	    {{"a truncated integer addition",
	      {{film, "sum.low += rt_sel(mask, other.low, rt_splat_u(0u));",
	        "sum.low = (sum.low + rt_sel(mask, other.low, rt_splat_u(0u))) & rt_splat_u(0x7fffffffu);"}}},
	     {"addition"}},
	    {{"a layout shift",
	      {{"common/rt_structs.h", "float albedo_r, albedo_g, albedo_b; /* in [0, 1]; dielectric: 1 */",
	        "float albedo_g, albedo_r, albedo_b; /* in [0, 1]; dielectric: 1 */"}}},
	     {"read"},
	     "weekend",
	     "kernels/path.h"},
	    {{"a lost sign of the film's low sum", {{film, "(rt_i64)(rt_i32)(low - bias)", "(rt_i64)(low - bias)"}}},
	     {"conversion"}},
	    {{"a lost carry in the film",
	      {// Each pixel with one owner, also where the lanes of a warp share them.
	       {"kernels/tile.h", "#define RT_MAX_ROUNDS 6u", "#define RT_MAX_ROUNDS 1u"},
	       {film, "#if RT_WARP > 1", "#if 0"},
	       {film, "pixel->g += g;",
	        "pixel->g = (((pixel->g >> 32) + (g >> 32)) << 32) | (rt_i64)((rt_u32)pixel->g + (rt_u32)g);"}}},
	     {"addition"}},
	    {{"a wrong random dimension", {{"kernels/path.h", "rt_to_uint(path->depth + 1)", "rt_to_uint(path->depth)"}}},
	     {"addition"}},
	    {{"another random number for the lens",
	      {{"kernels/camera.h", "rt_float distance = rt_sqrt(u.c);", "rt_float distance = rt_sqrt(u.d);"}}},
	     {"call"}},
	    {{"a hash of too few rounds", {{"kernels/rng.h", "w ^= w >> 16;", "w ^= w >> 15;"}}}, {"shift right"}},
	};
}

// Throughput that the contract makes 0 before it is subnormal, and products on the way that are.
const char* const subnormal_scene = R"({"rt": 1, "camera": {"from": [0, 0, 5], "at": [0, 0, 0], "vfov": 30},
	"sky": {"kind": "constant", "color": [1, 1, 1]},
	"materials": {"dark": {"kind": "lambertian", "albedo": [2e-18, 0.5, 0.5]},
		"darker": {"kind": "lambertian", "albedo": [1e-22, 0.5, 0.5]}},
	"spheres": [{"center": [0, 0, 0], "radius": 1, "material": "darker"},
		{"center": [0, 0, 0], "radius": 50, "material": "dark"}]})";

PackedScene pack(const std::string& scene, std::uint32_t width, std::uint32_t height)
{
	const Result<SceneFile> file =
	    scene == "subnormal" ? parse_scene(subnormal_scene, "subnormal.json") : open_scene(scene);
	if (!file)
		FAIL(scene << ": " << file.error().message << " | " << file.error().where);
	RenderSettings settings = file->base.render;
	settings.width = width;
	settings.height = height;
	Result<PackedScene> packed = pack_scene(file->base, settings, {0, 0, width, height});
	if (!packed)
		FAIL(scene << ": " << packed.error().message << " | " << packed.error().where);
	return std::move(packed).value();
}

// Where text stands in the kernels of this binary.
std::pair<std::string, unsigned> place_of(const TextEdit& edit)
{
	for (unsigned i = 0; i < embedded_text_count; ++i) {
		const std::string_view text(embedded_texts[i].text, embedded_texts[i].bytes);
		if (edit.file != embedded_texts[i].path)
			continue;
		const std::size_t at = text.find(edit.find);
		REQUIRE(at != std::string_view::npos);
		return {edit.file,
		        static_cast<unsigned>(std::count(text.begin(), text.begin() + static_cast<std::ptrdiff_t>(at), '\n')) +
		            1};
	}
	FAIL("no kernel file " << edit.file);
	return {};
}

std::vector<TestDevice> compiling_devices()
{
	std::vector<TestDevice> devices;
	for (const TestDevice& device : test_devices())
		if (!device.is_reference())
			devices.push_back(device);
	if (devices.empty())
		WARN("skipped: no device here compiles the kernels' text");
	return devices;
}

Divergence search(const PackedScene& packed, const TestDevice& device, const DeviceHandle& judged,
                  const TestDevice& against, const DivergenceOptions& options)
{
	const Result<Divergence> found = find_divergence(packed, {judged, device.needs_software_roots},
	                                                 {against.device, against.needs_software_roots}, options);
	if (!found)
		FAIL(device.name << ": " << found.error().message << " | " << found.error().where << '\n' << found.error().log);
	return *found;
}

std::string described(const Divergence& found)
{
	std::string text = fmt::format("{} of {} pixels differ after {} samples", found.different_pixels, found.pixels,
	                               found.samples_compared);
	if (found.launch)
		text += fmt::format("; pixel {},{} samples {}+{}{}", found.launch->x, found.launch->y,
		                    found.launch->first_sample, found.launch->samples, found.alone ? "" : ", not alone");
	if (found.operation) {
		const TraceSite* site = trace_site(found.operation->expected.code);
		text += fmt::format("; {} at {}:{} `{}`, bounce {}", name_of(found.operation->expected.code.kind),
		                    site ? site->file : "?", found.operation->expected.code.line, site ? site->source : "?",
		                    found.operation->bounce);
	}
	if (found.differing_depth)
		text += fmt::format("; depth {}", *found.differing_depth);
	for (const DivergenceStep& step : found.steps)
		text += fmt::format("; {} {:.2f} s", step.what, step.seconds);
	return text;
}

void check_named(const Planted& planted, const Divergence& found)
{
	INFO(planted.fault.name << ": " << described(found));
	REQUIRE(found.operation);
	const TraceSite* site = trace_site(found.operation->expected.code);
	REQUIRE(site);
	CHECK(planted.operations.count(name_of(site->code.kind)) == 1);
	if (planted.file == "*")
		return;
	const auto [file, line] = place_of(planted.fault.edits.back());
	CHECK(site->file == (planted.file.empty() ? file : planted.file));
	if (planted.file.empty())
		CHECK(site->code.line == line);
}

} // namespace

TEST_CASE("without a fault, devices and their traces are identical", "[trace]")
{
	for (const TestDevice& device : test_devices())
		for (const char* scene : {"weekend", "planets", "cornell"}) {
			DivergenceOptions options;
			options.samples = 5;
			const Divergence found = search(pack(scene, 45, 30), device, device.device, reference_device(), options);
			INFO(device.name << ", " << scene << ": " << described(found));
			CHECK(found.is_identical());
			CHECK(found.samples_compared == 5);
			CHECK(found.traces_compared == options.pixels_to_trace);
			CHECK(found.notes_compared > 10000);
		}
}

TEST_CASE("planted faults are named", "[trace]")
{
	const char* only = std::getenv("RT_TEST_FAULT");
	for (const TestDevice& device : compiling_devices())
		for (const Planted& planted : planted_faults(device)) {
			if (only && planted.fault.name.find(only) == std::string::npos)
				continue;
			DivergenceOptions options;
			options.samples = 16;
			const Divergence found = search(pack(planted.scene, 48, 32), device,
			                                make_faulty(device.device, planted.fault), reference_device(), options);
			if (only)
				fmt::print("{}\n", described(found));
			check_named(planted, found);
			if (planted.fault.name == "a layout shift")
				CHECK(found.layout_failure.find("rt_material.albedo") != std::string::npos);
		}
}

TEST_CASE("a stale program is named", "[trace]")
{
	for (const TestDevice& device : compiling_devices()) {
		Fault fault{"a stale program", {}};
		fault.stale_program = true;
		const DeviceHandle judged = make_faulty(device.device, fault);
		// The program of another scene, which the device goes on to run.
		REQUIRE(judged->build(render_program(pack("three-spheres", 48, 32), judged->info(), {})));
		DivergenceOptions options;
		options.samples = 4;
		const Divergence found = search(pack("weekend", 48, 32), device, judged, reference_device(), options);
		INFO(described(found));
		CHECK(found.images_differ());
		CHECK(found.stale_device == judged->info().name);
		CHECK(found.stale_id != found.expected_id);
	}
}

TEST_CASE("a saved trace is the trace, and tells a path", "[trace]")
{
	const PackedScene packed = pack("weekend", 48, 32);
	Result<Tracer> tracer = Tracer::make(reference_device().device, packed, {});
	REQUIRE(tracer);
	PixelLaunch launch;
	launch.x = 20;
	launch.y = 25;
	const Result<Trace> trace = tracer->trace(launch, 0, 1u << 20);
	REQUIRE(trace);
	REQUIRE(trace->notes.size() == trace->note_count);
	const Result<rt_film_pixel> ordinary = tracer->render(launch);
	REQUIRE(ordinary);
	CHECK(same_sums(*ordinary, trace->after));

	std::set<std::string> named;
	for (const PathStep& step : path_of(*trace))
		for (const PathValue& value : step.values)
			named.insert(step.title.substr(0, step.title.find(' ')) + ": " + value.name);
	for (const char* name :
	     {"camera: random numbers", "camera: ray direction", "segment: t", "segment: sphere, as stored",
	      "scattering: normal", "scattering: material", "scattering: random numbers", "scattering: throughput",
	      "scattering: ray direction", "film: radiance"}) {
		INFO(name);
		CHECK(named.count(name) == 1);
	}

	SavedTrace saved;
	saved.kernels = kernel_hash();
	saved.contract = RT_CONTRACT_VERSION;
	saved.inputs = inputs_hash(packed);
	saved.trace = *trace;
	const Result<SavedTrace> loaded = read_trace(write_trace(saved), "memory");
	REQUIRE(loaded);
	CHECK(loaded->inputs == saved.inputs);
	TraceComparison comparison;
	CHECK(comparison.compare(loaded->trace, *trace));
	CHECK(comparison.compared() == trace->note_count);

	// One bit of one result.
	Trace changed = *trace;
	TraceNote& note = changed.notes[changed.notes.size() / 2];
	note.result ^= 1;
	TraceComparison other;
	CHECK_FALSE(other.compare(changed, *trace));
	REQUIRE(other.difference());
	CHECK(other.difference()->index == changed.notes.size() / 2);

	saved.kernels = "another";
	const Result<SavedTrace> refused = read_trace(write_trace(saved), "memory");
	REQUIRE(!refused);
	CHECK(refused.error().kind == ErrorKind::Usage);
	CHECK_FALSE(read_trace("{}", "memory"));
	CHECK_FALSE(read_trace("not JSON", "memory"));
}

// What users do: 640x480x128 of the default scene. Slow, and its answers are the test's above.
TEST_CASE("times at 640x480x128", "[.timing]")
{
	for (const TestDevice& device : compiling_devices()) {
		std::vector<double> times;
		const auto run = [&](const std::string& scene, const Fault& fault, const TestDevice& against) {
			const auto start = std::chrono::steady_clock::now();
			DivergenceOptions options;
			options.samples = 128;
			const Divergence found =
			    search(pack(scene, 640, 480), device, make_faulty(device.device, fault), against, options);
			times.push_back(std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
			fmt::print("{:6.2f} s  {}: {}\n", times.back(), fault.name, described(found));
		};
		for (const Planted& planted : planted_faults(device))
			run(planted.scene, planted.fault, reference_device());
		std::sort(times.begin(), times.end());
		fmt::print("median {:.2f} s\n", times[times.size() / 2]);
		run("weekend", {"none", {}}, device);
	}
}
