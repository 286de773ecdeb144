// measuring.h: what the programs that measure rt have in common: a command line, a device, the head of their JSON.
#pragma once

#include "backends/registry.h"
#include "support/result.h"

#include <nlohmann/json_fwd.hpp>

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

namespace rt {

struct MeasuringOptions {
	std::vector<std::string> scenes; // "three-spheres" if none was named
	DeviceRequest device;
	std::uint32_t width = 0, height = 0, samples = 0;
	std::uint32_t rounds = 0; // at least 1
	std::string json;         // file, or empty
};

// What an option that only one program has does with its value; false if it is not that program's, or the value is
// wrong.
using OwnOption = std::function<bool(const std::string& name, const char* value)>;

// SCENE..., --device, --backend, --size, --spp, --rounds and --json, on top of the defaults in `options`. Usage error;
// `source` is the file whose head lists the options.
Status read_measuring_options(int argc, char** argv, const char* source, const OwnOption& own,
                              MeasuringOptions& options);

struct MeasuredDevice {
	DeviceHandle handle;
	bool software_roots = false;
};

// The device asked for, the first if that is several, after its self-test.
Result<MeasuredDevice> open_measured_device(const DeviceRequest& request);

// Version, revision, date, device, and the sizes above.
nlohmann::ordered_json measuring_head(const MeasuringOptions& options, const DeviceInfo& info);

} // namespace rt
