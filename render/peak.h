// peak.h: how fast a device is at best, measured: the yardstick of `rt bench` and of a device's report.
//
// Two short probes (kernels/peak.cl): float fma, and 32-bit integer multiply-add. What a driver says of clocks and
// units is not asked: what counts is what this device does, here and now, beside whatever else runs on it.
#pragma once

#include "backends/backend.h"
#include "support/result.h"

namespace rt {

struct DevicePeak {
	double fma_per_second = 0;     // float fma of one lane; two floating-point operations each
	double integer_per_second = 0; // 32-bit multiply-add of one lane
	std::uint32_t lanes = 1;       // of the program that was measured
	double build_seconds = 0;      // of the probes' program
	double seconds = 0;            // of all, build included
};

// Takes about 0.2 s, and on a device slower than 1e9 fma/s as long as the smallest launches take. Errors: Build, and
// Failure from a driver.
Result<DevicePeak> measure_peak(Device& device);

} // namespace rt
