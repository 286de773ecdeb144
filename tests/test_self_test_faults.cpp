// The self-test can fail: faults of drivers and compilers, planted one at a time, are each caught and named by the item
// that they belong to. Without a fault the same wrapper passes.
#include "tests/catch.h"
#include "tests/devices.h"
#include "tests/faulty_device.h"

#include "backends/self_test.h"

#include <algorithm>

using namespace rt;

namespace {

// Devices whose kernels are compiled from text: only in those can a fault be planted.
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

SelfTestReport test_with(const TestDevice& device, const Fault& fault)
{
	const Result<SelfTestReport> report = self_test(make_faulty(device.device, fault), false);
	if (!report)
		FAIL(device.name << ", " << fault.name << ": " << report.error().message << " | " << report.error().where
		                 << '\n'
		                 << report.error().log);
	return *report;
}

std::vector<std::string> failures(const SelfTestReport& report)
{
	std::vector<std::string> names;
	for (const SelfTestItem& item : report.items)
		if (!item.passed)
			names.push_back(item.name);
	return names;
}

void check_caught(const TestDevice& device, const Fault& fault, const std::string& item_name)
{
	const SelfTestReport report = test_with(device, fault);
	INFO(device.name << ", " << fault.name << ": " << report.first_failure());
	CHECK_FALSE(report.passed);
	CHECK_FALSE(report.from_cache);
	const std::vector<std::string> names = failures(report);
	CHECK(std::find(names.begin(), names.end(), item_name) != names.end());
	CHECK(report.first_failure().rfind(item_name + ": ", 0) == 0);
	CHECK(report.first_failure().size() > item_name.size() + 10); // it says what, not only that
}

const char* const math = "kernels/math.h";
const char* const probe = "kernels/probe.cl";

struct NamedFault {
	const char* item; // the first required item that must fail
	Fault fault;
};

// What compilers and drivers have been seen to do to arithmetic, and what it must be called.
std::vector<NamedFault> faults()
{
	return {
	    {"stress tile",
	     {"bare products, contracted",
	      {{"kernels/vec.h", "return rt_fma(a.x, b.x, rt_fma(a.y, b.y, a.z * b.z));",
	        "return a.x * b.x + a.y * b.y + a.z * b.z;"}},
	      {},
	      true}},
	    {"sine and cosine",
	     {"a product and a sum instead of fma",
	      {{math, "return f * rt_fma(f2, s, rt_splat(0x1.921fb6p+0f));", "return f * (f2 * s + 0x1.921fb6p+0f);"}}}},
	    {"fma",
	     {"fma that rounds twice",
	      {{probe, "first = rt_fma(a, b, c);", "{ rt_float product = a * b; first = product + c; }"}}}},
	    {"addition",
	     {"an addition off by one ulp", {{probe, "first = a + b;", "first = rt_from_bits(rt_bits(a + b) ^ 1u);"}}}},
	    {"multiplication",
	     {"a product truncated instead of rounded",
	      {{probe, "first = a * b;",
	        "{ first = a * b; rt_float rest = rt_fma(a, b, -first); first = rt_sel((rest < rt_splat(0.0f)) == "
	        "(first < rt_splat(0.0f)), first, rt_from_bits(rt_bits(first) - rt_sel(rest == rt_splat(0.0f), "
	        "rt_splat_u(0u), rt_splat_u(1u)))); }"}}}},
	    {"layout of the shared structs",
	     {"two members change places",
	      {{"common/rt_structs.h", "float albedo_r, albedo_g, albedo_b; /* in [0, 1]; dielectric: 1 */",
	        "float albedo_g, albedo_r, albedo_b;"}}}},
	    {"64-bit addition",
	     {"a 64-bit sum truncated to 32",
	      {{probe, "return (high + a) + (high + b);", "return (rt_u64)(rt_u32)((high + a) + (high + b));"}}}},
	    {"64-bit multiplication",
	     {"a 64-bit product of which the low half is kept",
	      {{probe, "return (rt_u64)a * b;", "return (rt_u64)(a * b);"}}}},
	    {"radiance to integer",
	     {"a lost carry in the film", {{"kernels/film.h", "(rt_i64)(rt_i32)(low - bias)", "(rt_i64)(low - bias)"}}}},
	    {"stress tile",
	     {"a miscompiled branch",
	      {{"kernels/sphere.h", "rt_sel(ahead, f.b + half_chord, f.b - half_chord)",
	        "rt_sel(ahead, f.b - half_chord, f.b + half_chord)"}}}},
	    {"comparison and minimum, with NaN and zeros",
	     {"a minimum that returns the number beside a NaN",
	      {{math, "RT_FN rt_float rt_min(rt_float a, rt_float b) { return rt_sel(a < b, a, b); }",
	        "RT_FN rt_float rt_min(rt_float a, rt_float b) { return rt_sel((a < b) | (b != b), a, b); }"}}}},
	    {"float to int",
	     {"a conversion that rounds to nearest",
	      {{probe, "x = rt_to_uint(rt_to_int(a));",
	        "x = rt_to_uint(rt_to_int(a + rt_sel(a < rt_splat(0.0f), rt_splat(-0.5f), rt_splat(0.5f))));"}}}},
	    {"shifts",
	     {"an arithmetic shift",
	      {{probe, "x = a_bits >> (b_bits & 31u);", "x = rt_to_uint(rt_to_int(a_bits) >> rt_to_int(b_bits & 31u));"}}}},
	    {"Sobol points",
	     {"a struct that a second call's argument overwrites", // Mesa 22.3.6
	      {{"kernels/sampler.h", "u.a = ab.a;", "u.a = rt_splat(0.0f);"}}}},
	    {"random numbers", {"a wrong constant", {{"kernels/rng.h", "v * 1664525u", "v * 1664527u"}}}},
	    {"atan2", {"a swapped comparison", {{math, "rt_mask steep = ay > ax;", "rt_mask steep = ay < ax;"}}}},
	};
}

// The device's own square root and reciprocal, where kernels use them.
const TextEdit approximate_root = {
    math, "RT_FN rt_float rt_root(rt_float x) { return rt_native_sqrt(x); }",
    "RT_FN rt_float rt_root(rt_float x) { rt_float y = rt_from_bits(0x5f375a86u - (rt_bits(x) >> 1)); rt_float h = "
    "-0.5f * x; y = y * rt_fma(h * y, y, rt_splat(1.5f)); y = y * rt_fma(h * y, y, rt_splat(1.5f)); y = y * rt_fma(h * "
    "y, y, rt_splat(1.5f)); return x * y; }"};
const TextEdit division_of_2_5_ulp = {
    math, "RT_FN rt_float rt_rcp(rt_float x) { return rt_native_rcp(x); }",
    "RT_FN rt_float rt_rcp(rt_float x) { rt_float y = rt_from_bits(0x7ef311c7u - rt_bits(x)); y = rt_fma(rt_fma(-x, y, "
    "rt_splat(1.0f)), y, y); y = rt_fma(rt_fma(-x, y, rt_splat(1.0f)), y, y); y = y * rt_fma(-x, y, rt_splat(2.0f)); "
    "return y; }"};

} // namespace

TEST_CASE("the wrapper without a fault passes", "[faults]")
{
	for (const TestDevice& device : compiling_devices()) {
		const SelfTestReport report = test_with(device, {"none", {}});
		INFO(device.name << ": " << report.first_failure());
		CHECK(report.passed);
		CHECK(report.needs_software_roots == device.needs_software_roots);
	}
}

TEST_CASE("each fault is caught, by the item that it belongs to", "[faults]")
{
	for (const TestDevice& device : compiling_devices())
		for (const NamedFault& named : faults())
			check_caught(device, named.fault, named.item);
}

TEST_CASE("an edit that does not apply is an error, not a sound device", "[faults]")
{
	for (const TestDevice& device : compiling_devices()) {
		const Result<SelfTestReport> report =
		    self_test(make_faulty(device.device, {"misspelt", {{math, "rt_fmma(", "rt_fma("}}}), false);
		REQUIRE_FALSE(report);
		CHECK(report.error().kind == ErrorKind::Build);
		CHECK(report.error().message.find(math) != std::string::npos);
	}
	const Result<SelfTestReport> report =
	    self_test(make_faulty(reference_device().device, {"no text", {{math, "rt_fma(", "rt_fma("}}}), false);
	REQUIRE_FALSE(report);
	CHECK(report.error().kind == ErrorKind::Build);
}

TEST_CASE("a wrong square root or reciprocal of the device is named, and ours carry it", "[faults]")
{
	for (const TestDevice& device : compiling_devices()) {
		if (device.needs_software_roots)
			continue; // its kernels use ours anyway
		for (const auto& [item, edit] :
		     {std::pair("square root", approximate_root), std::pair("reciprocal", division_of_2_5_ulp)}) {
			// Planted in the device's own, which disappears with the text that reaches for it.
			const SelfTestReport report = test_with(device, {item, {edit}});
			INFO(device.name << ": " << report.first_failure());
			CHECK(report.passed);
			CHECK(report.needs_software_roots);
			CHECK(report.native_roots_failure.rfind(std::string(item) + ": ", 0) == 0);
		}
	}
}

TEST_CASE("software roots that are wrong refuse the device", "[faults]")
{
	// One Newton step less: right within an ulp, and not the contract's.
	const TextEdit no_residual = {math, "return rt_fma(rt_fma(-g, g, x), h, g);", "return g;"};
	for (const TestDevice& device : compiling_devices()) {
		const SelfTestReport report = test_with(device, {"square root", {no_residual, approximate_root}});
		INFO(device.name);
		CHECK_FALSE(report.passed);
		CHECK(report.first_failure().rfind("square root: ", 0) == 0);
	}
}

TEST_CASE("flushed subnormals are told and do not refuse the device", "[faults]") // rule 5
{
	// Lane by lane, on whatever comes out of a float operation of the probe.
	const Fault flush = {"flush to zero",
	                     {{probe, "x = rt_sel(is_float, rt_bits(first), x);",
	                       "first = rt_sel(rt_abs(first) < rt_splat(0x1p-126f), rt_from_bits(rt_bits(first) & "
	                       "0x80000000u), first);\n\tx = rt_sel(is_float, rt_bits(first), x);"}}};
	for (const TestDevice& device : compiling_devices()) {
		const SelfTestReport report = test_with(device, flush);
		const std::vector<std::string> names = failures(report);
		INFO(device.name << ": " << report.first_failure());
		CHECK(report.passed);
		CHECK(names == std::vector<std::string>{"subnormal products", "subnormal fma"});
	}
}

TEST_CASE("a device that answers for another launch, or not at all, is caught", "[faults]")
{
	for (const TestDevice& device : test_devices()) { // no text is edited: the reference too
		// A transfer that loses the top bit of one word.
		Fault flip = {"a bit lost in transfer", {}};
		flip.tamper = [](std::size_t, unsigned char* data, std::size_t bytes) {
			if (bytes > 1000)
				data[bytes / 2] ^= 0x80u;
		};
		CHECK_FALSE(test_with(device, flip).passed);
		// A transfer that brings nothing: the pattern that was written before the launch stays.
		Fault nothing = {"a launch that does nothing", {}};
		nothing.tamper = [](std::size_t, unsigned char* data, std::size_t bytes) {
			for (std::size_t i = 0; i < bytes; ++i)
				data[i] = std::uint8_t(0xdeadbeefu >> (8 * (i % 4)));
		};
		const SelfTestReport report = test_with(device, nothing);
		CHECK_FALSE(report.passed);
		CHECK(failures(report).size() == report.items.size());
	}
}
