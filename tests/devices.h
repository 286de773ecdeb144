// devices.h: the devices that the tests run over: every usable device found, and why others are not there.
//
// RT_REQUIRE=cuda,opencl,... turns the absence of a backend into a failure, so that a machine without drivers cannot
// pass green. Devices that auto would not pick (Oclgrind, rusticl on llvmpipe) are left out unless RT_TEST_SLOW_DEVICES
// is set: their tests take hours.
#pragma once

#include "backends/backend.h"
#include "backends/registry.h"
#include "backends/self_test.h"
#include "render/golden_scenes.h"
#include "render/pack.h"
#include "render/scene_file.h"
#include "render/session.h"

#include <string>
#include <vector>

namespace rt {

struct TestDevice {
	DeviceHandle device;
	std::string name; // "opencl: pthread-haswell-..."
	bool needs_software_roots = false;
	bool is_reference() const { return device->info().backend == "reference"; }
	bool has_lanes() const; // its compiler takes RT_LANES > 1
};

// Opened and self-tested once a process. A device that fails is told by test_contract and is not in the list.
const std::vector<TestDevice>& test_devices();
const TestDevice& reference_device();

// Scenes small enough for a test: the golden ones.
using TestScene = GoldenScene;
const std::vector<TestScene>& test_scenes();
PackedScene pack_test_scene(const TestScene& scene);

// Renders and returns the film; a failure ends the test.
Film render(const PackedScene& packed, const TestDevice& device, SessionOptions options, std::uint32_t samples,
            std::uint32_t first_sample = 0);

} // namespace rt
