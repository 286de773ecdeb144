// measure_rungs.cpp: what the rungs cost and how far they lie apart, on one device and scene.
//
// usage: rt_measure_rungs SCENE [--device X] [--size WxH] [--spp N] [--rounds N] [--against exact|double]
//
// Renders the scene in each rung, and in the fast rung with each of its approximations alone, in turns so that a
// change of the machine's speed meets them all. The rungs take the same random numbers, so differences are taken pixel
// by pixel: the signed mean with its z-score tells a bias, the root mean square the size of the scatter. Most of the
// scatter is paths that a last bit sends another way.
#include "backends/registry.h"
#include "backends/self_test.h"
#include "render/scene_file.h"
#include "render/session.h"
#include "tools/report.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <string>
#include <vector>

namespace rt {
namespace {

struct Configuration {
	std::string name;
	Precision precision;
	std::uint32_t fast_parts;
	std::vector<double> seconds;
	Film film;
};

struct Wanted {
	std::string scene = "three-spheres";
	DeviceRequest device;
	std::uint32_t width = 320, height = 180, samples = 16, rounds = 5;
	std::string against = "exact";
};

Result<Wanted> read_arguments(int argc, char** argv)
{
	Wanted wanted;
	for (int i = 1; i < argc; ++i) {
		const std::string name = argv[i];
		if (name.rfind("--", 0) != 0) {
			wanted.scene = name;
			continue;
		}
		const char* value = i + 1 < argc ? argv[++i] : "";
		bool good = *value != '\0';
		if (name == "--device")
			wanted.device.device = value;
		else if (name == "--backend")
			wanted.device.backend = value;
		else if (name == "--size")
			good = std::sscanf(value, "%ux%u", &wanted.width, &wanted.height) == 2;
		else if (name == "--spp")
			good = std::sscanf(value, "%u", &wanted.samples) == 1;
		else if (name == "--rounds")
			good = std::sscanf(value, "%u", &wanted.rounds) == 1;
		else if (name == "--against") {
			wanted.against = value;
			good = wanted.against == "exact" || wanted.against == "double";
		} else
			good = false;
		if (!good)
			return Error{ErrorKind::Usage, fmt::format("{} '{}' is not understood", name, value), "command line",
			             "the head of tools/measure_rungs.cpp lists the options", ""};
	}
	return wanted;
}

std::vector<Configuration> configurations(const DeviceInfo& info)
{
	std::vector<Configuration> all = {{"exact", Precision::Exact, RT_FAST_ALL, {}, {}},
	                                  {"fast", Precision::Fast, RT_FAST_ALL, {}, {}}};
	if (info.kind != DeviceKind::Host) // it has the fast rung as a whole
		for (const auto& [name, part] :
		     {std::pair("  roots alone", RT_FAST_ROOTS), std::pair("  reciprocals alone", RT_FAST_RECIPROCALS),
		      std::pair("  sincos alone", RT_FAST_SINCOS), std::pair("  contraction alone", RT_FAST_CONTRACT),
		      std::pair("  flushing alone", RT_FAST_FLUSH), std::pair("  none of them", 0u)})
			all.push_back({name, Precision::Fast, part, {}, {}});
	if (info.reports_fp64)
		all.push_back({"double", Precision::Double, RT_FAST_ALL, {}, {}});
	return all;
}

double cpu_seconds() { return static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

double median(std::vector<double> values)
{
	std::sort(values.begin(), values.end());
	return values[values.size() / 2];
}

// Steps between neighbouring floats from a to b; both are radiances, so neither is negative.
std::uint32_t float_steps(float a, float b)
{
	std::uint32_t x, y;
	std::memcpy(&x, &a, sizeof x);
	std::memcpy(&y, &b, sizeof y);
	return x > y ? x - y : y - x;
}

// Differences of two films of the same paths.
std::vector<std::string> difference_cells(const Film& film, const Film& base)
{
	const double count = static_cast<double>(film.pixels());
	std::array<double, 3> mean{}, deviation{}, brightness{};
	std::array<double, 6> histogram{}; // 0, 1, 2-3, 4-15, 16-255, more float steps
	double square = 0;
	for (int pass = 0; pass < 2; ++pass)
		for (std::uint32_t y = 0; y < film.window().height; ++y)
			for (std::uint32_t x = 0; x < film.window().width; ++x)
				for (int channel = 0; channel < 3; ++channel) {
					const auto c = static_cast<std::size_t>(channel);
					const double difference = film.radiance(x, y, channel) - base.radiance(x, y, channel);
					if (pass == 1) {
						deviation[c] += (difference - mean[c]) * (difference - mean[c]) / count;
						continue;
					}
					mean[c] += difference / count;
					brightness[c] += base.radiance(x, y, channel) / count;
					square += difference * difference / (3 * count);
					const std::uint32_t steps =
					    float_steps(film.radiance_float(x, y, channel), base.radiance_float(x, y, channel));
					const std::size_t bin = steps < 2 ? steps : steps < 4 ? 2 : steps < 16 ? 3 : steps < 256 ? 4 : 5;
					histogram[bin] += 100 / (3 * count);
				}
	std::vector<std::string> cells;
	for (std::size_t c = 0; c < 3; ++c) {
		const double error = std::sqrt(deviation[c] / count);
		cells.push_back(fmt::format("{:+.1e} ({:+.1f})", brightness[c] > 0 ? mean[c] / brightness[c] : 0.0,
		                            error > 0 ? mean[c] / error : 0.0));
	}
	cells.push_back(fmt::format("{:.1e}", std::sqrt(square)));
	for (const double share : histogram)
		cells.push_back(fmt::format("{:.1f}", share));
	return cells;
}

Status run(const Wanted& wanted)
{
	RT_TRY_ASSIGN(const SceneFile file, open_scene(wanted.scene));
	RT_TRY_ASSIGN(const Scene scene, file.at_frame(0));
	RenderSettings settings = scene.render;
	settings.width = wanted.width;
	settings.height = wanted.height;
	settings.samples = wanted.samples;
	RT_TRY_ASSIGN(const PackedScene packed, pack_scene(scene, settings, {0, 0, settings.width, settings.height}));
	RT_TRY_ASSIGN(const std::vector<DeviceInfo> chosen, select_devices(wanted.device, enumerate_all()));
	RT_TRY_ASSIGN(const DeviceHandle device, open_device(chosen.front()));
	RT_TRY_ASSIGN(const SelfTestReport tested, self_test(device));
	std::vector<Configuration> all = configurations(device->info());

	// A processor's time is counted on all cores, and not while others have them.
	const bool on_processor = device->info().kind == DeviceKind::Host || device->info().kind == DeviceKind::Cpu;
	// The first round compiles and warms up.
	for (std::uint32_t round = 0; round <= wanted.rounds; ++round)
		for (Configuration& configuration : all) {
			SessionOptions options;
			options.samples = settings.samples;
			const double start = cpu_seconds();
			options.precision = configuration.precision;
			options.fast_parts = configuration.fast_parts;
			options.software_roots = tested.needs_software_roots;
			RT_TRY_ASSIGN(SessionResult result, render_scene(packed, {device}, options));
			if (round > 0)
				configuration.seconds.push_back(on_processor ? cpu_seconds() - start : result.render_seconds);
			configuration.film = std::move(result.film);
			print_message(fmt::format("\r\033[Kround {} of {}: {}", round, wanted.rounds, configuration.name));
		}
	print_message("\r\033[K");

	const Configuration& exact = all.front();
	const Configuration& base = wanted.against == "double" ? all.back() : exact;
	std::vector<std::vector<std::string>> rows = {{"rung", on_processor ? ">CPU seconds" : ">seconds", ">of exact",
	                                               ">R bias (z)", ">G bias (z)", ">B bias (z)", ">RMSE", ">0 ulp %",
	                                               ">1", ">2-3", ">4-15", ">16-255", ">more"}};
	for (const Configuration& configuration : all) {
		std::vector<double> ratios;
		for (std::size_t i = 0; i < configuration.seconds.size(); ++i)
			ratios.push_back(configuration.seconds[i] / exact.seconds[i]);
		std::vector<std::string> row = {configuration.name, fmt::format("{:.3f}", median(configuration.seconds)),
		                                fmt::format("{:.3f}", median(ratios))};
		const std::vector<std::string> cells = difference_cells(configuration.film, base.film);
		row.insert(row.end(), cells.begin(), cells.end());
		rows.push_back(std::move(row));
	}
	print_result(fmt::format("{}, {}x{}, {} samples a pixel, {} ({}), {} rounds, differences from {}\n", wanted.scene,
	                         settings.width, settings.height, settings.samples, device->info().name,
	                         device->info().backend, wanted.rounds, base.name));
	print_result(format_table(rows, ""));
	return flush_results();
}

} // namespace
} // namespace rt

int main(int argc, char** argv)
{
	const rt::Result<rt::Wanted> wanted = rt::read_arguments(argc, argv);
	if (!wanted)
		return rt::report_error(wanted.error());
	const rt::Status done = rt::run(*wanted);
	return done ? 0 : rt::report_error(done.error());
}
