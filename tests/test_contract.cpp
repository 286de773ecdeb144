// The contract's arithmetic, rule by rule, on every device found (docs/contract.md). Images are test_identity's affair.
#include "tests/catch.h"
#include "tests/devices.h"
#include "tests/faulty_device.h"

#include "backends/kernel_text.h"
#include "common/rt_contract.h"
#include "common/rt_features.h"
#include "support/float_environment.h"
#include "support/hash.h"

namespace {
thread_local unsigned rt_host_global_id = 0;
}
#include "kernels/probe.cl"

#include <cfenv>
#include <cmath>
#include <limits>
#if defined(__x86_64__)
#include <xmmintrin.h>
#endif

using namespace rt;

namespace {

using Words = std::vector<std::uint32_t>;

struct Pair {
	std::uint32_t first, second;
};

// One operation of kernels/probe.cl on a device, two words an item.
class Probe {
public:
	Probe(const TestDevice& device, bool software_roots, bool contract = false, std::uint32_t lanes = 0)
	    : device_(*device.device)
	{
		ProgramSpec spec;
		spec.root = "kernels/probe.cl";
		spec.entries = {"rt_probe"};
		lanes_ = lanes ? lanes : device_.info().native_lanes;
		spec.defines = {{"RT_LANES", std::to_string(lanes_)},
		                {"RT_DEF_NATIVE_ROOTS", software_roots ? "0" : "1"},
		                {"RT_DEF_CONTRACT", contract ? "1" : "0"}};
		Result<ProgramHandle> program = device_.build(spec);
		if (!program)
			FAIL(device.name << ": " << program.error().message << '\n' << program.error().log);
		program_ = *program;
	}

	std::vector<Pair> ask(std::uint32_t operation, const Words& a, const Words& b, const Words& c)
	{
		const auto count = static_cast<std::uint32_t>(a.size());
		const BufferHandle as = upload(a), bs = upload(b), cs = upload(c),
		                   out = upload(Words(a.size() * 2, 0xdeadbeefu));
		REQUIRE(
		    device_.launch(program_, "rt_probe", (count + lanes_ - 1) / lanes_, {as, bs, cs, out, operation, count}));
		REQUIRE(device_.wait());
		Words words(a.size() * 2);
		REQUIRE(device_.read(out, 0, words.data(), words.size() * sizeof(std::uint32_t)));
		std::vector<Pair> pairs(a.size());
		for (std::size_t i = 0; i < pairs.size(); ++i)
			pairs[i] = {words[2 * i], words[2 * i + 1]};
		return pairs;
	}

private:
	BufferHandle upload(const Words& words)
	{
		Result<BufferHandle> buffer = device_.alloc(words.size() * sizeof(std::uint32_t));
		REQUIRE(buffer);
		REQUIRE(device_.write(*buffer, 0, words.data(), words.size() * sizeof(std::uint32_t)));
		return *buffer;
	}

	Device& device_;
	ProgramHandle program_;
	std::uint32_t lanes_ = 1;
};

// Counts the items where `expected(i)` is not what came back, and shows the first.
template <class Expected>
void check_answers(const std::vector<Pair>& answers, const Words& a, Expected expected, const std::string& what)
{
	std::size_t wrong = 0, first = 0;
	for (std::size_t i = 0; i < answers.size(); ++i)
		if (answers[i].first != expected(i) && wrong++ == 0)
			first = i;
	INFO(what);
	if (wrong)
		FAIL_CHECK(wrong << " of " << answers.size() << " wrong; first operand " << std::hex << a[first] << " gave "
		                 << answers[first].first << ", the contract says " << expected(first));
	SUCCEED();
}

double distance_in_ulps(float value, double truth)
{
	int exponent = 0;
	std::frexp(truth, &exponent);
	return std::fabs((static_cast<double>(value) - truth) / std::ldexp(1.0, exponent - 24));
}

// Every device as it is, and with the roots it does not use by default.
template <class Body>
void for_each_device_and_roots(Body body)
{
	for (const TestDevice& device : test_devices())
		for (const bool software : {false, true}) {
			if (!software && device.needs_software_roots)
				continue;
			body(device, software, device.name + (software ? ", software roots" : ", native roots"));
		}
}

} // namespace

TEST_CASE("rule 1: every device passes its self-test, by name of item", "[contract]")
{
	for (const TestDevice& device : test_devices()) {
		const Result<SelfTestReport> report = self_test(device.device, false);
		REQUIRE(report);
		for (const SelfTestItem& item : report->items) {
			INFO(device.name << ": " << item.name << ": " << item.detail);
			if (item.required)
				CHECK(item.passed);
			else if (!item.passed)
				WARN(device.name << ": " << item.name << ": " << item.detail << " (second tier: rule 5)");
		}
		CHECK(report->items.size() >= 20);
		CHECK(report->passed);
	}
}

TEST_CASE("rule 1: a device passes its self-test with any number of lanes and with either roots", "[contract]")
{
	bool shown = false;
	for (const TestDevice& device : test_devices()) {
		if (!device.has_lanes())
			continue;
		shown = true;
		for (const std::uint32_t lanes : {1u, 4u, 8u, 16u})
			for (const bool software_roots : {false, true}) {
				if (software_roots && device.is_reference())
					continue; // its kernels are no text into which a fault could be planted
				INFO(device.name << ", " << lanes << " lanes, " << (software_roots ? "software" : "native")
				                 << " roots");
				Fault fault{std::to_string(lanes) + " lanes", {}};
				fault.native_lanes = lanes;
				if (software_roots) // where its own are wrong, ours carry it
					fault.edits = {
					    {"kernels/math.h", "{ return rt_native_sqrt(x); }", "{ return 2.0f * rt_native_sqrt(x); }"}};
				const DeviceHandle tested = make_faulty(device.device, fault);
				REQUIRE(tested->info().native_lanes == lanes);
				const Result<SelfTestReport> report = self_test(tested, false);
				REQUIRE(report);
				CHECK(report->first_failure().empty());
				CHECK(report->passed);
				CHECK(report->needs_software_roots == software_roots);
			}
	}
	if (!shown)
		WARN("skipped: no device here has vector lanes");
}

namespace {

// A driver that lies: answers pass through, except that what is read back after one operation has a bit flipped.
class LyingDevice final : public Device {
public:
	LyingDevice(DeviceHandle honest, std::uint32_t operation) : honest_(std::move(honest)), operation_(operation)
	{
		info_ = honest_->info();
	}
	Result<ProgramHandle> build(const ProgramSpec& spec) override { return honest_->build(spec); }
	Status launch(const ProgramHandle& program, const std::string& entry, std::uint64_t items,
	              const std::vector<Argument>& arguments, std::uint32_t group_size) override
	{
		lie_ = entry == "rt_probe" ? std::get<std::uint32_t>(arguments[4]) == operation_
		                           : operation_ == (entry == "rt_render" ? tile : layout);
		return honest_->launch(program, entry, items, arguments, group_size);
	}
	Result<BufferHandle> alloc(std::size_t bytes) override { return honest_->alloc(bytes); }
	Status write(const BufferHandle& buffer, std::size_t offset, const void* data, std::size_t bytes) override
	{
		return honest_->write(buffer, offset, data, bytes);
	}
	Status read(const BufferHandle& buffer, std::size_t offset, void* data, std::size_t bytes) override
	{
		Status status = honest_->read(buffer, offset, data, bytes);
		if (lie_)
			static_cast<unsigned char*>(data)[bytes / 2 / 8 * 8] ^= 1;
		return status;
	}
	Status wait() override { return honest_->wait(); }

	static constexpr std::uint32_t tile = 1000, layout = 1001;

private:
	DeviceHandle honest_;
	std::uint32_t operation_;
	bool lie_ = false;
};

} // namespace

TEST_CASE("rule 1: one flipped bit in one operation fails the self-test and names it", "[contract]")
{
	struct Lie {
		std::uint32_t operation;
		const char* name;
	};
	for (const Lie& lie : {Lie{RT_PROBE_ADD, "addition"}, Lie{RT_PROBE_FMA, "fma"}, Lie{RT_PROBE_ROOT, "square root"},
	                       Lie{RT_PROBE_RECIPROCAL, "reciprocal"}, Lie{RT_PROBE_COMPARE, "comparison"},
	                       Lie{RT_PROBE_LONG_ADD, "64-bit addition"}, Lie{RT_PROBE_SHIFT, "shifts"},
	                       Lie{RT_PROBE_FILM, "radiance to integer"}, Lie{LyingDevice::tile, "stress tile"},
	                       Lie{LyingDevice::layout, "layout of the shared structs"}}) {
		for (const TestDevice& honest : test_devices()) {
			const auto device = std::make_shared<LyingDevice>(honest.device, lie.operation);
			const Result<SelfTestReport> report = self_test(device, false);
			REQUIRE(report);
			INFO(honest.name << ", " << lie.name << ": " << report->first_failure());
			CHECK_FALSE(report->passed);
			CHECK(report->first_failure().rfind(lie.name, 0) == 0);
		}
	}
}

TEST_CASE("rule 3: permission to contract changes no film, and would change a bare a * b + c", "[contract]")
{
	// a = b = 1 + 2^-12, c = -(1 + 2^-11): fused 2^-24, unfused 0.
	const Words a{0x3f800800u}, b{0x3f800800u}, c{0xbf801000u};
	for (const TestDevice& device : test_devices()) {
		INFO(device.name);
		const std::uint32_t forbidden = Probe(device, false, false).ask(RT_PROBE_BARE, a, b, c)[0].first;
		const std::uint32_t allowed = Probe(device, false, true).ask(RT_PROBE_BARE, a, b, c)[0].first;
		CHECK(forbidden == 0x00000000u);
		// The control. A device without fma hardware may well leave the product alone.
		if (allowed != 0x33800000u)
			WARN(device.name << " does not fuse even where it may: the comparison below shows nothing there");
		std::vector<TestScene> scenes;
		for (const TestScene& scene : test_scenes()) {
			scenes.push_back(scene);
			if (scene.name == "cornell") // with rays aimed at its lamp
				scenes.push_back({scene.name, 30, 23, 3, 6, {}, Sampler::Sobol, Estimator::Mis, 2});
		}
		for (const TestScene& scene : scenes) {
			INFO(scene.name << ", " << settings_text(scene));
			const PackedScene packed = pack_test_scene(scene);
			SessionOptions options;
			options.specialise = false;
			const Film strict = render(packed, device, options, scene.samples);
			options.allow_contraction = true;
			CHECK(render(packed, device, options, scene.samples).hash().hex() == strict.hash().hex());
		}
	}
}

TEST_CASE("rule 4: square root and reciprocal are correctly rounded, native and by fma", "[contract]")
{
	// Every 1024th float of the range, and all mantissas of two binades in steps that hit the last ones.
	Words roots, reciprocals;
	for (std::uint64_t bits = rt_bits(0x1p-99f); bits < rt_bits(0x1p62f); bits += 1021)
		roots.push_back(static_cast<std::uint32_t>(bits));
	for (std::uint64_t bits = rt_bits(0x1p-99f); bits < rt_bits(0x1p99f); bits += 1021) {
		reciprocals.push_back(static_cast<std::uint32_t>(bits));
		reciprocals.push_back(static_cast<std::uint32_t>(bits) | 0x80000000u);
	}
	for (std::uint32_t exponent = 60; exponent < 180; ++exponent) // all ones: Markstein's exception
		for (std::uint32_t mantissa : {0x7fffffu, 0x7ffffeu, 0u, 1u}) {
			roots.push_back(exponent << 23 | mantissa);
			reciprocals.push_back(exponent << 23 | mantissa);
		}
	for_each_device_and_roots([&](const TestDevice& device, bool software, const std::string& what) {
		Probe probe(device, software);
		check_answers(
		    probe.ask(RT_PROBE_ROOT, roots, roots, roots), roots,
		    [&](std::size_t i) { return rt_bits(std::sqrt(rt_from_bits(roots[i]))); }, what + ": square root");
		check_answers(
		    probe.ask(RT_PROBE_RECIPROCAL, reciprocals, reciprocals, reciprocals), reciprocals,
		    [&](std::size_t i) { return rt_bits(1.0f / rt_from_bits(reciprocals[i])); }, what + ": reciprocal");
	});
}

TEST_CASE("rule 4: rt_sqrt is 0 for zero, tiny, negative and NaN", "[contract]")
{
	const Words odd{0u, 0x80000000u, rt_bits(0x1p-101f), rt_bits(-1.0f), 0x7fc00000u, 0xff800000u, 1u};
	for_each_device_and_roots([&](const TestDevice& device, bool software, const std::string& what) {
		check_answers(
		    Probe(device, software).ask(RT_PROBE_ROOT, odd, odd, odd), odd, [](std::size_t) { return 0u; }, what);
	});
}

TEST_CASE("rules 5 and 18: a flushing host thread changes nothing", "[contract]")
{
#if defined(__x86_64__)
	const TestScene& scene = test_scenes().front();
	const PackedScene packed = pack_test_scene(scene);
	const Film expected = render(packed, reference_device(), {}, scene.samples);
	std::vector<Film> films;
	test_devices(); // opened as they are in any program
	const unsigned saved = _mm_getcsr();
	_mm_setcsr(saved | 0x8040); // flush to zero, denormals are zero
	volatile float small = 0x1p-100f;
	volatile float product = small * 0x1p-40f; // the control: this thread does flush (volatile: it must happen here)
	std::fesetround(FE_UPWARD);
	for (const TestDevice& device : test_devices())
		films.push_back(render(packed, device, {}, scene.samples));
	const PackedScene packed_again = pack_test_scene(scene);
	std::fesetround(FE_TONEAREST);
	_mm_setcsr(saved);
	CHECK(rt_bits(product) == 0u);
	for (std::size_t i = 0; i < films.size(); ++i) {
		INFO(test_devices()[i].name);
		CHECK(films[i].hash().hex() == expected.hash().hex());
	}
	const auto bytes_hash = [](const PackedScene& p) {
		Hasher hasher;
		hasher.add(&p.scene, sizeof p.scene);
		hasher.add(p.spheres.data(), p.spheres.size() * sizeof(rt_sphere));
		hasher.add(p.wide.data(), p.wide.size() * sizeof(rt_wide));
		return hasher.result().hex();
	};
	CHECK(bytes_hash(packed_again) == bytes_hash(packed));
#else
	WARN("skipped: written for x86-64");
#endif
}

TEST_CASE("rule 6: a throughput below 2^-60 is nothing, and a path without throughput ends", "[contract]")
{
	// Inside a glowing sphere of albedo a the throughput after k scatterings is a^k.
	const auto segments_a_sample = [](float albedo, const TestDevice& device) {
		const TestScene scene{"closed", 8, 4, 2, 0};
		PackedScene packed = pack_test_scene(scene);
		packed.scene.max_depth = 50;
		for (rt_material& material : packed.materials)
			material.albedo_r = material.albedo_g = material.albedo_b = albedo;
		const Film film = render(packed, device, {}, scene.samples);
		CHECK(film.segments % (film.pixels() * scene.samples) == 0);
		return film.segments / (film.pixels() * scene.samples);
	};
	for (const TestDevice& device : test_devices()) {
		INFO(device.name);
		CHECK(segments_a_sample(0x1p-20f, device) == 4);        // 2^-60 is kept, 2^-80 is not
		CHECK(segments_a_sample(0x1.fffffep-21f, device) == 3); // just below 2^-60
		CHECK(segments_a_sample(0.0f, device) == 1);
		CHECK(segments_a_sample(0.5f, device) == 50);
	}
}

TEST_CASE("rule 7: NaN is a miss, and a radiance that is no number counts as black and is tallied", "[contract]")
{
	const TestScene& scene = test_scenes().front();
	const float nan = std::numeric_limits<float>::quiet_NaN(), infinity = std::numeric_limits<float>::infinity();
	for (const TestDevice& device : test_devices()) {
		INFO(device.name);
		// A sphere with a NaN in it is not there.
		PackedScene without = pack_test_scene(scene);
		for (rt_sphere& sphere : without.spheres)
			sphere.radius = nan;
		const Film sky = render(without, device, {}, 1);
		CHECK(sky.segments == sky.pixels());
		CHECK(sky.rejected == 0);
		// Nor does a ray that is no number meet anything, tried against every sphere or through a tree.
		PackedScene lost = pack_test_scene(scene);
		lost.scene.corner_x = nan;
		for (const Acceleration bvh : {Acceleration::Never, Acceleration::Always}) {
			SessionOptions options;
			options.specialise = false;
			options.bvh = bvh;
			const Film film = render(lost, device, options, 1);
			CHECK(film.segments == film.pixels());
			CHECK(film.rejected == 0);
		}
		// Skies that are no number: every sample that ends there is rejected.
		for (const float bad : {nan, infinity, -1.0f, 1e9f}) {
			PackedScene packed = without;
			packed.scene.sky_bottom_g = bad;
			packed.scene.sky_delta_g = 0.0f;
			const Film film = render(packed, device, {}, 3);
			CHECK(film.rejected == film.pixels() * 3);
			CHECK(std::all_of(film.sums().begin(), film.sums().end(), [](std::int64_t sum) { return sum == 0; }));
		}
		if (device.is_reference())
			continue;
		// The control: tests written the other way round meet what is not there.
		TestDevice careless = device;
		careless.device =
		    make_faulty(device.device, {"NaN is a hit",
		                                {{"kernels/sphere.h", "rt_mask candidate = (discriminant >= rt_splat(0.0f)) &",
		                                  "rt_mask candidate = rt_not(discriminant < rt_splat(0.0f)) &"}}});
		const Film film = render(without, careless, {}, 1);
		CHECK(film.segments > film.pixels());
	}
}

TEST_CASE("rule 13: sine and cosine over all 2^24 numbers, within 2 ulp and 1e-7", "[contract]")
{
	double largest = 0, largest_ulps = 0;
	for (std::uint32_t k = 0; k < (1u << 24); ++k) {
		const float u = static_cast<float>(k) * 0x1p-24f;
		float sine, cosine;
		rt_sincos_turns(u, &sine, &cosine);
		const double angle = 2 * 3.14159265358979323846 * static_cast<double>(u);
		const double s = std::sin(angle), c = std::cos(angle);
		largest =
		    std::max({largest, std::fabs(static_cast<double>(sine) - s), std::fabs(static_cast<double>(cosine) - c)});
		// At the zeros the library's angle is itself rounded.
		if (k % (1u << 22) != 0)
			largest_ulps = std::max({largest_ulps, distance_in_ulps(sine, s), distance_in_ulps(cosine, c)});
	}
	CHECK(largest < 1e-7);
	CHECK(largest_ulps < 2);
	CHECK(largest_ulps > 0.5); // the comparison sees rounding at all
}

TEST_CASE("rule 13: atan2 within 4 ulp", "[contract]")
{
	double largest_ulps = 0;
	std::uint32_t state = 1;
	for (std::uint32_t k = 0; k < (1u << 22); ++k) {
		state = state * 1664525u + 1013904223u;
		const float y = static_cast<float>(static_cast<std::int32_t>(state)) * 0x1p-31f;
		state = state * 1664525u + 1013904223u;
		const float x = static_cast<float>(static_cast<std::int32_t>(state)) * 0x1p-31f;
		const double turns = std::atan2(static_cast<double>(y), static_cast<double>(x)) / (2 * 3.14159265358979323846);
		largest_ulps = std::max(largest_ulps, distance_in_ulps(rt_atan2_turns(y, x), turns));
	}
	CHECK(largest_ulps < 4);
	CHECK(largest_ulps > 0.5);
}

TEST_CASE("rule 13: every device computes the same sines, cosines and angles", "[contract]")
{
	Words turns, ys, xs;
	std::uint32_t state = 7;
	for (std::uint32_t k = 0; k < (1u << 24); k += 13) {
		turns.push_back(rt_bits(static_cast<float>(k) * 0x1p-24f));
		state = state * 1664525u + 1013904223u;
		ys.push_back(rt_bits(static_cast<float>(static_cast<std::int32_t>(state)) * 0x1p-31f));
		state = state * 1664525u + 1013904223u;
		xs.push_back(rt_bits(static_cast<float>(static_cast<std::int32_t>(state)) * 0x1p-31f));
	}
	for_each_device_and_roots([&](const TestDevice& device, bool software, const std::string& what) {
		Probe probe(device, software);
		const auto sincos = [&](std::size_t i) {
			float sine, cosine;
			rt_sincos_turns(rt_from_bits(turns[i]), &sine, &cosine);
			return Pair{rt_bits(sine), rt_bits(cosine)};
		};
		std::vector<Pair> answers = probe.ask(RT_PROBE_SINCOS, turns, turns, turns);
		check_answers(
		    answers, turns, [&](std::size_t i) { return sincos(i).first; }, what + ": sine");
		for (Pair& answer : answers)
			std::swap(answer.first, answer.second);
		check_answers(
		    answers, turns, [&](std::size_t i) { return sincos(i).second; }, what + ": cosine");
		check_answers(
		    probe.ask(RT_PROBE_ATAN2, ys, xs, xs), ys,
		    [&](std::size_t i) { return rt_bits(rt_atan2_turns(rt_from_bits(ys[i]), rt_from_bits(xs[i]))); },
		    what + ": atan2");
	});
}

TEST_CASE("rule 14: random numbers are a pure function, below 1, and the same on every device", "[contract]")
{
	Words pixels, samples, blocks;
	for (std::uint32_t i = 0; i < (1u << 18); ++i) {
		pixels.push_back(i * 2654435761u);
		samples.push_back(i % 129);
		blocks.push_back(i % 51);
	}
	// The ends: the largest number is 1 - 2^-24.
	CHECK(rt_unit(0xffffffffu) == 0x1.fffffep-1f);
	CHECK(rt_unit(0u) == 0.0f);
	const auto of = [&](std::size_t i) { return rt_random(0x2545f491u, pixels[i], samples[i], blocks[i]); };
	for (const TestDevice& device : test_devices()) {
		std::vector<Pair> answers = Probe(device, false).ask(RT_PROBE_RANDOM, pixels, samples, blocks);
		check_answers(
		    answers, pixels, [&](std::size_t i) { return rt_bits(of(i).a); }, device.name + ": first");
		for (Pair& answer : answers)
			std::swap(answer.first, answer.second);
		check_answers(
		    answers, pixels, [&](std::size_t i) { return rt_bits(of(i).d); }, device.name + ": last");
	}
}

TEST_CASE("rule 15: radiance becomes the nearest integer, ties to even, on every device", "[contract]")
{
	Words values;
	for (std::uint32_t bits = 0; bits <= rt_bits(1.0f); bits += 997)
		values.push_back(bits);
	// Ties: (k + 1/2) 2^-40
	for (std::uint32_t k = 0; k < 4096; ++k)
		values.push_back(rt_bits((static_cast<float>(k) + 0.5f) * 0x1p-40f));
	for (const TestDevice& device : test_devices()) {
		const std::vector<Pair> answers = Probe(device, false).ask(RT_PROBE_FILM, values, values, values);
		std::size_t wrong = 0;
		for (std::size_t i = 0; i < values.size(); ++i) {
			const auto expected =
			    static_cast<std::uint64_t>(std::llrint(static_cast<double>(rt_from_bits(values[i])) * 0x1p40));
			wrong += answers[i].first != static_cast<std::uint32_t>(expected) ||
			         answers[i].second != static_cast<std::uint32_t>(expected >> 32);
		}
		INFO(device.name);
		CHECK(wrong == 0);
	}
}

TEST_CASE("rule 15: a launch's partial sums hold the most samples of the brightest radiance", "[contract]")
{
	// A sky at the limit, in a launch of the largest size: one pixel, RT_MAX_SAMPLES_PER_LAUNCH samples.
	TestScene scene{"furnace", 1, 1, RT_MAX_SAMPLES_PER_LAUNCH, 0};
	PackedScene packed = pack_test_scene(scene);
	packed.scene.sphere_count = packed.scene.wide_count = 0;
	packed.spheres.clear();
	packed.wide.clear();
	packed.features = RT_FEATURE_SKY;
	packed.scene.sky_bottom_r = packed.scene.radiance_limit;
	packed.scene.sky_bottom_g = packed.scene.radiance_limit * 0x1.fffffep-1f;
	packed.scene.sky_bottom_b = 0x1.5p-39f;
	for (const TestDevice& device : test_devices()) {
		SessionOptions options;
		options.samples_per_launch = RT_MAX_SAMPLES_PER_LAUNCH;
		options.slices = 1;
		const Film film = render(packed, device, options, RT_MAX_SAMPLES_PER_LAUNCH);
		INFO(device.name);
		const auto exact = [&](float radiance) {
			return std::llrint(std::ldexp(static_cast<double>(radiance), packed.film_exponent)) *
			       std::int64_t(RT_MAX_SAMPLES_PER_LAUNCH);
		};
		CHECK(film.sums()[0] == exact(packed.scene.sky_bottom_r));
		CHECK(film.sums()[1] == exact(packed.scene.sky_bottom_g));
		CHECK(film.sums()[2] == exact(packed.scene.sky_bottom_b));
		CHECK(film.rejected == 0);
		if (device.is_reference())
			continue;
		// The control: the high word needs all its bits.
		TestDevice with_sign = device;
		with_sign.device =
		    make_faulty(device.device, {"a signed high word",
		                                {{"kernels/film.h", "(rt_i64)(high - bias)", "(rt_i64)(rt_i32)(high - bias)"},
		                                 // With one lane, all samples of the pixel in one task, as with several.
		                                 {"kernels/tile.h", "#define RT_MAX_ROUNDS 6u", "#define RT_MAX_ROUNDS 1u"}}});
		CHECK(render(packed, with_sign, options, RT_MAX_SAMPLES_PER_LAUNCH).sums() != film.sums());
	}
}

TEST_CASE("rule 16: texture coordinates that are no number or out of range stay inside the texture", "[contract]")
{
	const float infinity = std::numeric_limits<float>::infinity();
	for (const float x : {-infinity, -1.0f, -0.0f, 0.0f, std::numeric_limits<float>::quiet_NaN()})
		CHECK(rt_cell(x, 512.0f) == 0);
	for (const float x : {512.0f, 1e30f, infinity})
		CHECK(rt_cell(x, 512.0f) == 511);
	CHECK(rt_cell(511.99997f, 512.0f) == 511);
	CHECK(rt_cell(3.75f, 512.0f) == 3);
}
