// options.h: the command line, read and checked.
//
// Everything a user types is checked here and ends as one Usage error that names the option, the value and what would
// be right. An option that was not given stays empty: its default is the scene's (RenderSettings) or the renderer's.
#pragma once

#include "backends/precision.h"
#include "backends/registry.h"
#include "render/compare.h"
#include "render/display.h"
#include "render/film.h"
#include "render/scene.h"
#include "support/result.h"
#include "tools/progress.h"
#include "verify/verification.h"

#include <cstdint>
#include <optional>
#include <string>
#include <variant>

namespace rt {

// Frame numbers fill nine digits of a file's name.
constexpr std::uint32_t max_frame = 999999999;

struct RenderOptions {
	std::string scene = "three-spheres";
	std::optional<std::uint32_t> width, height, samples, seed, max_depth, roulette;
	std::optional<Sampler> sampler;
	std::optional<Estimator> estimator;
	std::uint32_t first_frame = 0, last_frame = 0; // inclusive
	std::optional<Window> window;                  // of --crop or --pixel; the whole image otherwise
	std::optional<double> error, time_limit;       // where to stop before `samples`; seconds

	std::string output; // empty: SCENE.png
	DisplaySettings display;
	std::string checkpoint, resume;
	std::uint32_t checkpoint_seconds = 60;

	DeviceRequest device;
	Acceleration bvh = Acceleration::Auto;
	Precision precision = Precision::Exact;
	bool specialise = true;
	std::uint32_t lanes = 0;
	bool self_test_afresh = false;
	bool force_unverified = false;
	bool auto_precision = false;        // take precision, sampler, estimator and samples from a measured tradeoff
	std::optional<double> target_error; // with it: relative RMSE

	ProgressMode progress = ProgressMode::Auto;
	bool quiet = false, verbose = false;
	std::string stats;

	std::uint32_t frame_count() const { return last_frame - first_frame + 1; }
	// The scene's settings with those of the command line on top. With an error or a time to stop at, the scene's
	// number of samples does not hold.
	RenderSettings settings_over(const RenderSettings& scene_settings) const;
};

struct DevicesOptions {
	bool verbose = false, json = false, self_test_afresh = false;
};

struct InfoOptions {
	std::string scene;
	std::string spheres; // file for the spheres themselves, or empty
	bool json = false;
};

struct CompareOptions {
	std::string a, b;
	CompareSettings settings;
	std::string output; // of the difference image; empty: none
	std::string html;   // the report with pictures; empty: none
	bool output_if_different = false;
	std::optional<double> scale;
	bool json = false, quiet = false;
};

struct ReproduceOptions {
	std::string image, scene; // no scene: the one that the image names
	std::string output;       // of the image rendered here; empty: none
	RenderOptions render;     // device and progress; the rest is the image's
	bool json = false;
};

struct VerifyOptions {
	DeviceRequest device; // without a device: all of the backend, all backends
	VerifyDepth depth = VerifyDepth::Standard;
	bool probe_only = false;
	std::string json, html, ledger; // files; empty: none
	ProgressMode progress = ProgressMode::Auto;
};

struct TraceOptions {
	RenderOptions render;                // scene, its settings, device; the window is the pixel
	std::optional<std::uint32_t> sample; // of that pixel
	std::string against;                 // a device, a backend, or a saved trace (.json)
	std::string json;                    // file for the trace
};

// What `rt bench --sweep` varies.
enum class Sweep { None, Pixels, Samples, Spheres, Depth, Threads };
const char* sweep_name(Sweep sweep);

struct BenchOptions {
	RenderOptions render; // of it: scene, size, samples, seed, depth, and everything of the device
	std::uint32_t repeats = 5;
	Sweep sweep = Sweep::None;
	std::uint32_t limit_seconds = 20; // a sweep's render that would take longer is left out
	std::string json;                 // file, "-", or empty
	bool quiet = false;
};

struct TradeoffOptions {
	RenderOptions render; // scene, device, and the settings of the image that is to be rendered in the end
	std::optional<std::uint32_t> width, height; // of what is measured; empty: small, of the image's shape
	std::optional<double> budget, target_error; // seconds, or relative RMSE; at most one of them
	std::uint32_t limit_seconds = 240;          // for measuring all of it
	std::uint32_t reference_samples = 4096;
	std::string json, csv; // files; "-" for one of them; empty: none
};

// --help and --version: text for standard output, and nothing else to do.
struct TextRequest {
	std::string text;
};

using CommandLine = std::variant<RenderOptions, DevicesOptions, InfoOptions, BenchOptions, CompareOptions,
                                 ReproduceOptions, VerifyOptions, TraceOptions, TradeoffOptions, TextRequest>;

Result<CommandLine> parse_command_line(int argc, const char* const* argv);

} // namespace rt
