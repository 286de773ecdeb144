#include "render/peak.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>

namespace rt {

namespace {

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start) { return std::chrono::duration<double>(Clock::now() - start).count(); }

// What one round of kernels/peak.cl does a lane: 12 chains, 8 times.
constexpr double operations_per_round = 12 * 8;
// Long against a launch's overhead, short for a user.
constexpr double launch_seconds = 0.02;
constexpr int timed_launches = 4;
constexpr std::uint32_t max_rounds = 1u << 30;

// Enough to fill a GPU whatever its registers allow, and pieces enough for the threads of a processor to even out.
std::uint32_t items_for(const DeviceInfo& info)
{
	const std::uint32_t units = std::max(1u, info.compute_units);
	return units * (info.kind == DeviceKind::Gpu || info.kind == DeviceKind::Accelerator ? 4096u : 1024u);
}

// Operations a second of one probe: the fastest of some launches, because whatever else runs can only slow one down.
Result<double> measure(Device& device, const ProgramHandle& program, const char* entry, std::uint32_t lanes)
{
	const std::uint32_t items = items_for(device.info());
	RT_TRY_ASSIGN(const BufferHandle out, device.alloc(std::size_t(items) * sizeof(std::uint32_t)));
	const auto time = [&](std::uint32_t rounds) -> Result<double> {
		const Clock::time_point start = Clock::now();
		RT_TRY(device.launch(program, entry, items, {out, items, rounds}));
		RT_TRY(device.wait());
		return std::max(seconds_since(start), 1e-9);
	};
	std::uint32_t rounds = 1;
	RT_TRY(time(rounds)); // the first launch of a kernel may compile it
	RT_TRY_ASSIGN(double seconds, time(rounds));
	while (seconds < launch_seconds / 8 && rounds < max_rounds / 8) {
		rounds *= 8;
		RT_TRY_ASSIGN(seconds, time(rounds));
	}
	if (seconds < launch_seconds)
		rounds = static_cast<std::uint32_t>(std::min(double(rounds) * launch_seconds / seconds, double(max_rounds)));
	double best = 0;
	for (int i = 0; i < timed_launches; ++i) {
		RT_TRY_ASSIGN(seconds, time(rounds));
		best = std::max(best, double(items) * lanes * rounds * operations_per_round / seconds);
		if (seconds > 8 * launch_seconds)
			break; // an interpreter, or a device shared with others: one launch says enough
	}
	return best;
}

} // namespace

Result<DevicePeak> measure_peak(Device& device)
{
	const Clock::time_point start = Clock::now();
	DevicePeak peak;
	peak.lanes = device.info().native_lanes;
	ProgramSpec spec;
	spec.root = "kernels/peak.cl";
	spec.defines = {{"RT_LANES", fmt::format("{}", peak.lanes)}};
	spec.entries = {"rt_peak_fma", "rt_peak_integer"};
	RT_TRY_ASSIGN(const ProgramHandle program, device.build(spec));
	peak.build_seconds = program->report().seconds;
	RT_TRY_ASSIGN(peak.fma_per_second, measure(device, program, "rt_peak_fma", peak.lanes));
	RT_TRY_ASSIGN(peak.integer_per_second, measure(device, program, "rt_peak_integer", peak.lanes));
	peak.seconds = seconds_since(start);
	return peak;
}

} // namespace rt
