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
	// What is measured unless the command line says otherwise.
	MeasuringOptions(std::uint32_t w, std::uint32_t h, std::uint32_t spp, std::uint32_t times)
	    : width(w), height(h), samples(spp), rounds(times)
	{
	}

	std::vector<std::string> scenes; // "three-spheres" if none was named
	DeviceRequest device;
	std::uint32_t width, height, samples;
	std::uint32_t rounds; // at least 1
	std::string json;     // file, or empty
	bool help = false;    // wants the usage and nothing else
};

// The lines of a usage about the options below; `defaults` are the program's.
std::string measuring_usage(const MeasuringOptions& defaults);

// What an option that only one program has does with its value; false if it is not that program's, or the value is
// wrong.
using OwnOption = std::function<bool(const std::string& name, const char* value)>;

// SCENE..., --device, --backend, --size, --spp, --rounds, --json and --help, on top of the defaults in `options`. Usage
// error, which sends to the help of `program`.
Status read_measuring_options(int argc, char** argv, const char* program, const OwnOption& own,
                              MeasuringOptions& options);

struct MeasuredDevice {
	DeviceHandle handle;
	bool software_roots = false;
};

// The device asked for, the first if that is several, after its self-test.
Result<MeasuredDevice> open_measured_device(const DeviceRequest& request);

// The middle one; of an even number the larger of the two in the middle. There must be one.
double median(std::vector<double> values);

// Version, revision, date, device, and the sizes above.
nlohmann::ordered_json measuring_head(const MeasuringOptions& options, const DeviceInfo& info);

} // namespace rt
