#include "render/peak.h"

#include "support/clock.h"

#include <fmt/format.h>

#include <algorithm>

namespace rt {

namespace {

// What one round of kernels/peak.cl does a lane: 12 chains, 8 times.
constexpr double operations_per_round = 12 * 8;
// Long against a launch's overhead, short for a user.
constexpr double launch_seconds = 0.015;
constexpr int timed_launches = 4;
constexpr std::uint32_t max_rounds = 1u << 28;

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
	RT_TRY(time(1)); // the first launch of a kernel may compile it
	double best = 0;
	std::uint32_t rounds = 1;
	for (int timed = 0; timed < timed_launches;) {
		RT_TRY_ASSIGN(const double seconds, time(rounds));
		if (seconds < launch_seconds / 2 && rounds < max_rounds) {
			// Too short to say anything. No large step: a launch that was held up by others looks long.
			rounds = std::min(static_cast<std::uint32_t>(rounds * std::clamp(launch_seconds / seconds, 2.0, 8.0)),
			                  max_rounds);
			continue;
		}
		best = std::max(best, double(items) * lanes * rounds * operations_per_round / seconds);
		// An interpreter, or a device shared with others: few launches say enough.
		timed += seconds > 8 * launch_seconds ? timed_launches : 1;
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

PeakShare peak_share(std::uint64_t segments, std::uint64_t spheres, bool through_tree, double seconds,
                     const DevicePeak& peak)
{
	PeakShare share;
	share.tests_per_segment = through_tree ? 0 : static_cast<double>(spheres);
	share.operations_per_second =
	    static_cast<double>(segments) * share.tests_per_segment * share.operations_per_test / std::max(seconds, 1e-9);
	share.share = peak.fma_per_second > 0 ? share.operations_per_second / peak.fma_per_second : 0;
	return share;
}

} // namespace rt
