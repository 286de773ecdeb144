// peak.h: how fast a device is at best, measured: the yardstick of `rt bench` and of a device's report.
//
// Two short probes (kernels/peak.cl): float fma, and 32-bit integer multiply-add. What a driver says of clocks and
// units is not asked: what counts is what this device does, here and now, beside whatever else runs on it.
#pragma once

#include "backends/backend.h"
#include "support/result.h"

#include <cstdint>

namespace rt {

struct DevicePeak {
	double fma_per_second = 0;     // float fma of one lane; two floating-point operations each
	double integer_per_second = 0; // 32-bit multiply-add of one lane
	std::uint32_t lanes = 1;       // of the program that was measured
	double build_seconds = 0;      // of the probes' program
	double seconds = 0;            // of all, build included
};

// How near a render came to a device's peak, by a model that is the same for every kernel: a ray-sphere test is 17
// float operations, 9 of them fma, if nothing is spent on accuracy, and a path segment tests every sphere (where a tree
// spares most tests there is no such figure). All other work (random numbers, surfaces, materials, the film) counts as
// nothing, and so does what makes our own test accurate: the figure is a lower bound of what the device was kept busy
// with, and comparable between programs.
struct PeakShare {
	double operations_per_test = 17;
	double tests_per_segment = 0; // 0: unknown, because there is a tree
	double operations_per_second = 0;
	double share = 0; // of the fma peak, an fma counted as one operation as a device issues it
};
// Of a render of so many path segments in so many seconds of launches.
PeakShare peak_share(std::uint64_t segments, std::uint64_t spheres, bool through_tree, double seconds,
                     const DevicePeak& peak);

// Takes about 0.2 s, and on a device slower than 1e9 fma/s as long as the smallest launches take. Errors: Build, and
// Failure from a driver.
Result<DevicePeak> measure_peak(Device& device);

} // namespace rt
