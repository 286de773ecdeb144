// bench_sweep.h: how the time of a render grows with one thing that it is made of.
#pragma once

#include "tools/bench_run.h"
#include "tools/options.h"

#include <functional>
#include <optional>
#include <string>
#include <vector>

namespace rt {

struct SweepPoint {
	double x = 0; // pixels, samples a pixel, spheres, depth or threads
	BenchRun run;
	// The least: whatever else runs on the machine only adds.
	double seconds() const { return run.render_seconds.min; }
};

struct SweepResult {
	std::string of; // "pixels"
	std::vector<SweepPoint> points;
	std::string left_out; // why the larger points were not measured; empty if all were
	// seconds ~ x^exponent, by least squares on logarithms: over all points, and over the upper half of them, where
	// fixed costs no longer count. Empty with fewer than two points.
	std::optional<double> exponent, upper_exponent;
};

// The exponent of a power law through the points [first, end), or nothing.
std::optional<double> fitted_exponent(const std::vector<SweepPoint>& points, std::size_t first);

// Points from small to large, until one would take longer than options.limit_seconds a render.
Result<SweepResult> run_sweep(const BenchOptions& options, const BenchDevice& device,
                              const std::function<void(const std::string&)>& status);

} // namespace rt
