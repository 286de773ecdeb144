// tradeoff_run.h: one scene rendered in every configuration and at several numbers of samples, on some devices.
//
// First the reference: two halves of seeds that nobody else uses, in double, doubled until they have the samples asked
// for or half of the time is gone. It lies in the program cache, whole as far as it came, and is gone on from by the
// next run that wants more. Then the grid, a number of samples after the other, so that a stop leaves every
// configuration with something. What was measured whole is remembered too, for --auto-precision, unless an older
// measurement got further.
#pragma once

#include "backends/backend.h"
#include "render/scene.h"
#include "render/tradeoff.h"
#include "support/result.h"
#include "tools/options.h"

#include <atomic>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

namespace rt {

struct TradeoffReference {
	std::uint32_t samples = 0;
	Noise noise;
	Configuration configuration;
	std::string device; // that rendered it, or would have gone on with it
	std::string film_hash;
	std::uint32_t remembered = 0; // of the samples came from the cache
	double seconds = 0;
};

struct Tradeoff {
	std::string scene; // as the user named it
	Hash128 scene_hash;
	RenderSettings settings;                         // of what was measured, without samples
	std::uint32_t image_width = 0, image_height = 0; // of the image that is to be rendered with what is recommended
	std::uint32_t image_samples = 0;                 // the same: what it would have otherwise
	std::vector<DeviceInfo> devices;
	std::vector<std::string> device_arguments; // "--backend opencl": how rt render is told each; empty if it need not
	TradeoffReference reference;
	std::vector<TradePoint> points; // sorted by time, the front marked
	bool interrupted = false;
	std::vector<std::string> left_out; // "double, 1024 samples: about 80 s"
	std::string date;
	double seconds = 0; // of measuring, all in all

	double scale() const; // pixels of the image over those that were measured
};

struct TradeoffHooks {
	std::function<void(const std::string&)> status; // what takes a while and has no measure
	// What is under way, the seconds gone since measuring began and those that it will take as far as is known.
	std::function<void(const std::string&, double gone, double all)> progress;
	const std::atomic<bool>* stop = nullptr;
};

// Where a stop was asked for, what was measured until then comes back, marked as interrupted.
Result<Tradeoff> measure_tradeoff(const TradeoffOptions& options, const TradeoffHooks& hooks);

// What a whole measurement of this scene on one device left behind; nothing if there was none, or of other kernels, or
// if a bit of the file has changed.
std::optional<Tradeoff> remembered_tradeoff(const TradeoffOptions& options);

// What `rt tradeoff` recommends: for the goal, or, without one, for the error that the image's own settings give.
struct TradeoffAdvice {
	TradeGoal goal;
	std::optional<Recommendation> way;
	std::optional<Recommendation> as_it_is; // the image's own settings on the first device
};
TradeoffAdvice advice_for(const Tradeoff& measured, const TradeoffOptions& options);

// "rt render weekend --precision fast --spp 300"
std::string command_line(const Tradeoff& measured, const Recommendation& way);

} // namespace rt
