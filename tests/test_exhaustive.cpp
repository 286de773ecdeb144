// tools/exhaust in small: a stride through the inputs of every function on every device, and faults that must be found.
// The whole is a run of rt_exhaust (docs/contract.md).
#include "tests/catch.h"
#include "tests/devices.h"
#include "tests/faulty_device.h"
#include "verify/exhaustive.h"

#include <cmath>
#include <cstring>

using namespace rt;

namespace {

float float_of(std::uint32_t bits)
{
	float x;
	std::memcpy(&x, &bits, sizeof x);
	return x;
}

// The 24-bit mantissa of a float in [1, 4).
std::uint64_t mantissa_of(float x) { return static_cast<std::uint64_t>(std::ldexp(static_cast<double>(x), 23)); }

ExhaustiveResult run(const DeviceHandle& device, const std::string& name, std::uint64_t stride, std::uint64_t count,
                     bool software_roots)
{
	const ExhaustiveFunction* const function = find_exhaustive(name);
	REQUIRE(function);
	ExhaustiveRun exhaustive(device);
	ExhaustiveResult result = ExhaustiveRun::begin(*function, stride, count, software_roots);
	while (!result.finished()) {
		const Status done = exhaustive.advance(*function, result);
		if (!done)
			FAIL(done.error().message << "\n" << done.error().log);
	}
	return result;
}

// A device that compiles the kernels' text; null where there is none.
const TestDevice* text_device()
{
	for (const TestDevice& device : test_devices())
		if (!device.is_reference())
			return &device;
	return nullptr;
}

} // namespace

TEST_CASE("rule 4: roots and reciprocals taken in double round correctly, by integers", "[exhaustive]")
{
	// y = (float)sqrt((double)x) has |y - sqrt(x)| < ulp / 2 exactly if (2 m - 1)^2 < 4 x / ulp^2 < (2 m + 1)^2, where
	// m is y's mantissa; no root of a float lies in the middle. All mantissas, both parities of the exponent.
	std::uint64_t wrong_roots = 0, wrong_reciprocals = 0;
	for (std::uint32_t bits = 0x3f800000u; bits < 0x40800000u; ++bits) {
		const float x = float_of(bits);
		const auto y = static_cast<float>(std::sqrt(static_cast<double>(x)));
		const std::uint64_t m = mantissa_of(y);            // y in [1, 2): ulp 2^-23
		const std::uint64_t scaled = mantissa_of(x) << 25; // 4 x 2^46
		wrong_roots += !((2 * m - 1) * (2 * m - 1) < scaled && scaled < (2 * m + 1) * (2 * m + 1));
	}
	// y = (float)(1 / (double)x), x = n 2^-23 in (1, 2), y = m 2^-24 in (1/2, 1): |m n - 2^47| < n / 2.
	for (std::uint32_t bits = 0x3f800001u; bits < 0x40000000u; ++bits) {
		const float x = float_of(bits);
		const auto y = static_cast<float>(1 / static_cast<double>(x));
		const std::uint64_t n = mantissa_of(x), product = 2 * mantissa_of(y * 2) * n, one = std::uint64_t(1) << 48;
		wrong_reciprocals += (product > one ? product - one : one - product) >= n;
	}
	CHECK(wrong_roots == 0);
	CHECK(wrong_reciprocals == 0);
}

TEST_CASE("rules 4, 6, 13, 14, 15 and 16: a stride through all inputs finds no wrong result on any device",
          "[exhaustive]")
{
	struct Part {
		const char* name;
		std::uint64_t stride, count;
	};
	const Part parts[] = {
	    {"root", 16381, 0},        {"reciprocal", 16381, 0},  {"quotient", 1, 1u << 17}, {"add", 1, 1u << 17},
	    {"multiply", 1, 1u << 17}, {"fma", 1, 1u << 17},      {"sincos", 127, 0},        {"atan2", 1, 1u << 17},
	    {"asin", 1, 1u << 17},     {"film", 8191, 0},         {"to-int", 16381, 0},      {"to-float", 16381, 0},
	    {"cell", 16381, 0},        {"roulette", 1, 1u << 17}, {"random", 1, 1u << 17},   {"sobol", 1, 1u << 17}};
	for (const TestDevice& device : test_devices())
		for (const Part& part : parts)
			for (const bool ours : {false, true}) {
				const ExhaustiveFunction& function = *find_exhaustive(part.name);
				if (ours ? !function.uses_roots : function.uses_roots && device.needs_software_roots)
					continue;
				const ExhaustiveResult result = run(device.device, part.name, part.stride, part.count, ours);
				INFO(device.name << ", " << part.name << ": " << result.first_failure);
				CHECK(result.failures == 0);
				CHECK(result.tried > (1u << 16));
				if (function.uses_roots || result.max_ulp < 0)
					continue;
				CHECK(result.max_ulp > 0.5); // it is measured
				CHECK(result.max_ulp <= 2);
				CHECK(result.max_error <= 1e-7);
			}
	for (const char* const name : {"atan2", "asin"}) {
		INFO(name);
		CHECK(run(reference_device().device, name, 1, 1u << 17, false).max_ulp <= 4);
	}
}

TEST_CASE("rules 2 and 19: seeds cannot reach our roots, and radiance is displayed as the formulas say", "[exhaustive]")
{
	for (const char* const name : {"seeds", "display"}) {
		const ExhaustiveResult result = run(reference_device().device, name, 2039, 0, false);
		INFO(name << ": " << result.first_failure);
		CHECK(result.failures == 0);
		CHECK(result.tried > 100000);
	}
}

TEST_CASE("rules 10, 11 and 12: on every device no ray meets the sphere that it left outward, normals and directions "
          "are the same unit vectors, and by the textbook many meet it",
          "[exhaustive]")
{
	std::uint64_t by_book = 0, bits = 0;
	for (const TestDevice& device : test_devices()) {
		const ExhaustiveResult result = run(device.device, "rehit", 1, 1u << 18, device.needs_software_roots);
		INFO(device.name << ": " << result.first_failure);
		CHECK(result.failures == 0);
		CHECK(result.tried > (1u << 18) * 9 / 10);
		CHECK(result.outward > (1u << 18) * 4 / 10);
		CHECK(result.controls > result.outward / 50);
		// The same rays on every device, and the same arithmetic.
		if (by_book != 0)
			CHECK(result.controls == by_book);
		by_book = result.controls;
		if (bits != 0)
			CHECK(result.bits == bits);
		bits = result.bits;
		CHECK(bits != 0);
	}
}

TEST_CASE("an exhaustive run finds a wrong expression and names the operands", "[exhaustive]")
{
	const TestDevice* const device = text_device();
	if (!device) {
		WARN("skipped: no device that compiles the kernels' text");
		return;
	}
	SECTION("a reciprocal whose exception, the divisor of all ones, is rounded down")
	{
		// That is what Newton's steps alone make of it from nearly all seeds. Leaving the exception out would be no
		// fault everywhere: the seed that is the right result stays as it is, and NVIDIA's hardware gives that one.
		const DeviceHandle faulty = make_faulty(
		    device->device,
		    {"the exception rounded down",
		     {{"kernels/math.h", "rt_from_bits(0x7f000000u - rt_bits(x))", "rt_from_bits(0x7effffffu - rt_bits(x))"}}});
		const ExhaustiveResult result = run(faulty, "quotient", 1, 1u << 14, true);
		CHECK(result.failures > (1u << 10));
		CHECK(result.first_failure.find("the contract says") != std::string::npos);
	}
	SECTION("a sphere that is not left out when a ray leaves it")
	{
		const DeviceHandle faulty = make_faulty(
		    device->device,
		    {"not left out",
		     {{"kernels/sphere.h", "rt_mask candidate = (discriminant >= rt_splat(0.0f)) & rt_not(is_from);",
		       "rt_mask candidate = (discriminant >= rt_splat(0.0f));"}}});
		CHECK(run(faulty, "rehit", 1, 1u << 16, device->needs_software_roots).failures > 100);
	}
	SECTION("vectors that are not brought back to length 1")
	{
		const DeviceHandle faulty = make_faulty(
		    device->device,
		    {"no unit vectors",
		     {{"kernels/vec.h", "return v3_scale(rt_fma(rt_splat(-0.5f), v3_dot(v, v), rt_splat(1.5f)), v); }",
		       "return v; }"}}});
		const ExhaustiveResult result = run(faulty, "rehit", 1, 1u << 16, device->needs_software_roots);
		CHECK(result.failures > 0);
		CHECK(result.bits != run(device->device, "rehit", 1, 1u << 16, device->needs_software_roots).bits);
	}
	SECTION(
	    "a sine with one coefficient off, no number in the last cell, a probability rounded down, a wrong constant of "
	    "each hash")
	{
		const DeviceHandle faulty = make_faulty(
		    device->device, {"wrong constants",
		                     {{"kernels/math.h", "-0x1.2d9302p-8f", "-0x1.2d9304p-8f"},
		                      {"kernels/texture.h", "rt_sel(x > rt_splat(0.0f), x, rt_splat(0.0f))",
		                       "rt_sel(x <= rt_splat(0.0f), rt_splat(0.0f), x)"},
		                      {"kernels/roulette.h", "rt_to_int(b * 0x1p24f) + 1)", "rt_to_int(b * 0x1p24f))"},
		                      {"kernels/rng.h", "v * 1664525u", "v * 1664527u"},
		                      {"kernels/sampler.h", "v ^= v * 0x3d20adeau;", "v ^= v * 0x3d20adebu;"}}});
		CHECK(run(faulty, "sincos", 127, 0, device->needs_software_roots).failures > 0);
		for (const char* const name : {"cell", "roulette", "random", "sobol"}) {
			INFO(name);
			const bool drawn = find_exhaustive(name)->samples;
			CHECK(run(faulty, name, drawn ? 1 : 65521, 1u << 14, device->needs_software_roots).failures > 100);
		}
	}
}
