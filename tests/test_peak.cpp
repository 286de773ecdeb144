// The measured peak of a device: there is one, and it is no artefact of a compiler that left the work out.
#include "render/peak.h"
#include "tests/catch.h"
#include "tests/devices.h"

#include <cmath>
#include <cstring>

using namespace rt;

TEST_CASE("Every device has a peak of fma and of integer multiply-adds")
{
	for (const TestDevice& device : test_devices()) {
		INFO(device.name);
		const Result<DevicePeak> peak = measure_peak(*device.device);
		if (!peak)
			FAIL(peak.error().message << "\n" << peak.error().log);
		CHECK(peak->fma_per_second > 1e5);
		CHECK(peak->integer_per_second > 1e5);
		// Had a compiler seen through the chains, the rate would know no bound: no device of today reaches 1e16.
		CHECK(peak->fma_per_second < 1e16);
		CHECK(peak->integer_per_second < 1e16);
		CHECK(peak->lanes == device.device->info().native_lanes);
		CHECK(peak->seconds > 0);
	}
}

namespace {

std::vector<std::uint32_t> chain_ends(const TestDevice& device, const char* entry, std::uint32_t rounds)
{
	constexpr std::uint32_t items = 64;
	ProgramSpec spec;
	spec.root = "kernels/peak.cl";
	spec.entries = {entry};
	const Result<ProgramHandle> program = device.device->build(spec);
	REQUIRE(program);
	const Result<BufferHandle> out = device.device->alloc(items * sizeof(std::uint32_t));
	REQUIRE(out);
	REQUIRE(device.device->launch(*program, entry, items, {*out, items, rounds}));
	REQUIRE(device.device->wait());
	std::vector<std::uint32_t> ends(items);
	REQUIRE(device.device->read(*out, 0, ends.data(), items * sizeof(std::uint32_t)));
	return ends;
}

} // namespace

TEST_CASE("The chains of the integer probe end where they must")
{
	for (const TestDevice& device : test_devices()) {
		INFO(device.name);
		for (const std::uint32_t rounds : {0u, 1u, 5u}) {
			const std::vector<std::uint32_t> ends = chain_ends(device, "rt_peak_integer", rounds);
			for (std::uint32_t item = 0; item < ends.size(); ++item) {
				std::uint32_t all = 0;
				for (std::uint32_t chain = 0; chain < 12; ++chain) {
					std::uint32_t x = item + chain;
					for (std::uint32_t step = 0; step < 8 * rounds; ++step)
						x = x * x + 0x9e3779b9u;
					all ^= x;
				}
				REQUIRE(ends[item] == all);
			}
		}
	}
}

TEST_CASE("The chains of the fma probe end where they must")
{
	for (const TestDevice& device : test_devices()) {
		INFO(device.name);
		for (const std::uint32_t rounds : {0u, 1u, 5u}) {
			const std::vector<std::uint32_t> ends = chain_ends(device, "rt_peak_fma", rounds);
			for (std::uint32_t item = 0; item < ends.size(); ++item) {
				std::uint32_t all = 0;
				for (std::uint32_t chain = 0; chain < 12; ++chain) {
					float x = static_cast<float>((item & 15u) + chain) * 0x1p-5f;
					for (std::uint32_t step = 0; step < 8 * rounds; ++step)
						x = std::fma(x, x, -1.5f);
					std::uint32_t bits;
					std::memcpy(&bits, &x, sizeof bits);
					all ^= bits;
				}
				REQUIRE(ends[item] == all);
			}
		}
	}
}
