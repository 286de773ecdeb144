#include "tests/devices.h"

#include "tests/catch.h"

#include <algorithm>
#include <cstdlib>
#include <sstream>

namespace rt {
namespace {

std::string describe(const Error& error)
{
	return error.message + " | " + error.where + " | " + error.cure + "\n" + error.log;
}

std::vector<TestDevice> open_devices()
{
	std::vector<TestDevice> devices;
	const Enumeration found = enumerate_all();
	for (const Absence& absence : found.absences)
		WARN("skipped: " << absence.backend << ": " << absence.reason);
	for (const DeviceInfo& info : found.devices) {
		const std::string name = info.backend + ": " + info.name;
		if (!info.usable) {
			WARN("skipped: " << name << ": " << info.why_not);
			continue;
		}
		if (info.only_if_named && !std::getenv("RT_TEST_SLOW_DEVICES")) {
			WARN("skipped: " << name << ": too slow for the suite; set RT_TEST_SLOW_DEVICES to include it");
			continue;
		}
		Result<DeviceHandle> device = open_device(info);
		if (!device)
			FAIL(name << ": " << describe(device.error()));
		const Result<SelfTestReport> report = self_test(*device);
		if (!report)
			FAIL(name << ": " << describe(report.error()));
		if (!report->passed)
			FAIL(name << " fails its self-test: " << report->first_failure());
		devices.push_back({*device, name, report->needs_software_roots});
	}
	if (const char* required = std::getenv("RT_REQUIRE")) {
		std::istringstream list(required);
		for (std::string backend; std::getline(list, backend, ',');) {
			const std::vector<Backend*>& known = backends();
			if (std::none_of(known.begin(), known.end(), [&](const Backend* one) { return backend == one->name(); }))
				continue; // other tests' words
			bool there = false;
			for (const TestDevice& device : devices)
				there = there || device.device->info().backend == backend;
			if (!there)
				FAIL("RT_REQUIRE asks for " << backend << " and no usable device of it was found");
		}
	}
	return devices;
}

} // namespace

bool TestDevice::has_lanes() const { return device->info().native_lanes > 1; }

const std::vector<TestDevice>& test_devices()
{
	static const std::vector<TestDevice> devices = open_devices();
	return devices;
}

const TestDevice& reference_device()
{
	for (const TestDevice& device : test_devices())
		if (device.is_reference())
			return device;
	FAIL("there is no reference device");
	return test_devices().front();
}

const std::vector<TestScene>& test_scenes()
{
	// Sizes are no multiples of a tile, sample counts no powers of two.
	static const std::vector<TestScene> scenes = [] {
		const Result<std::vector<TestScene>> table = golden_scenes();
		if (!table)
			FAIL(describe(table.error()));
		return *table;
	}();
	return scenes;
}

PackedScene pack_test_scene(const TestScene& scene)
{
	Result<PackedScene> packed = pack_golden_scene(scene);
	if (!packed)
		FAIL(scene.name << ": " << describe(packed.error()));
	return std::move(packed).value();
}

Film render(const PackedScene& packed, const TestDevice& device, SessionOptions options, std::uint32_t samples,
            std::uint32_t first_sample)
{
	options.samples = samples;
	options.first_sample = first_sample;
	options.software_roots = options.software_roots || device.needs_software_roots;
	Result<SessionResult> result = render_scene(packed, {device.device}, options);
	if (!result)
		FAIL(device.name << ": " << describe(result.error()));
	return std::move(result->film);
}

} // namespace rt
