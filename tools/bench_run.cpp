#include "tools/bench_run.h"

#include "backends/self_test.h"
#include "render/image_file.h"
#include "render/pack.h"
#include "render/scene_file.h"
#include "support/clock.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace rt {

namespace {

using PhaseSeconds = std::array<double, bench_phase_names.size()>;

// One render, from the packed scene to the bytes of a PNG.
struct OneRender {
	PhaseSeconds seconds{};
	SessionResult result;
};

Result<OneRender> render_once(const PackedScene& packed, const BenchDevice& device, const SessionOptions& options)
{
	OneRender one;
	const auto phase = [&one](BenchPhase which) -> double& { return one.seconds[static_cast<std::size_t>(which)]; };
	const Clock::time_point start = Clock::now();
	RT_TRY_ASSIGN(one.result, render_scene(packed, {device.handle}, options));
	const double session = seconds_since(start);
	const DeviceStats& stats = one.result.devices.front();
	phase(BenchPhase::Build) = stats.build.seconds;
	phase(BenchPhase::Upload) = stats.upload_seconds;
	phase(BenchPhase::Launches) = stats.launch_seconds;
	phase(BenchPhase::ReadBack) = stats.read_seconds;
	phase(BenchPhase::Bvh) = one.result.bvh_seconds;
	phase(BenchPhase::Rest) = std::max(0.0, session - one.result.bvh_seconds - stats.build.seconds -
	                                            stats.upload_seconds - stats.launch_seconds - stats.read_seconds);
	const Clock::time_point encode = Clock::now();
	RT_TRY(encode_image(one.result.film, ImageFormat::Png, {}, {}));
	phase(BenchPhase::Encode) = seconds_since(encode);
	phase(BenchPhase::Total) = seconds_since(start);
	return one;
}

} // namespace

Spread spread_of(std::vector<double> values)
{
	std::sort(values.begin(), values.end());
	const std::size_t middle = values.size() / 2;
	const double median = values.size() % 2 ? values[middle] : (values[middle - 1] + values[middle]) * 0.5;
	return {values.front(), median, values.back()};
}

Result<BenchDevice> open_bench_device(const RenderOptions& options,
                                      const std::function<void(const std::string&)>& status)
{
	BenchDevice device;
	Clock::time_point start = Clock::now();
	RT_TRY_ASSIGN(const std::vector<DeviceInfo> chosen, find_devices(options.device));
	device.enumerate_seconds = seconds_since(start);
	if (chosen.size() != 1)
		return Error{ErrorKind::Usage, "a benchmark is of one device", "--device", "name one of them", ""};
	start = Clock::now();
	RT_TRY_ASSIGN(device.handle, open_device(chosen.front()));
	device.open_seconds = seconds_since(start);
	status("testing " + chosen.front().name);
	start = Clock::now();
	RT_TRY_ASSIGN(const SelfTestReport report, self_test(device.handle, !options.self_test_afresh, options.precision));
	device.self_test_seconds = seconds_since(start);
	device.software_roots = report.needs_software_roots;
	if (!report.passed && !options.force_unverified)
		return failed_self_test(chosen.front(), report, "measures it all the same");
	return device;
}

Result<BenchRun> bench_scene(const std::string& scene_name, const RenderOptions& options, const BenchDevice& device,
                             std::uint32_t repeats, const std::function<void(const std::string&)>& status)
{
	BenchRun run;
	run.scene = scene_name;
	status("reading " + scene_name);
	Clock::time_point start = Clock::now();
	RT_TRY_ASSIGN(const SceneFile file, open_scene(scene_name));
	RT_TRY_ASSIGN(const Scene scene, file.at_frame(0));
	run.load_seconds = seconds_since(start);
	run.scene_hash = scene.hash;
	run.settings = options.settings_over(scene.render);
	start = Clock::now();
	RT_TRY_ASSIGN(const PackedScene packed,
	              pack_scene(scene, run.settings, {0, 0, run.settings.width, run.settings.height}));
	run.pack_seconds = seconds_since(start);
	run.features = packed.features;
	run.spheres = packed.spheres.size();

	SessionOptions session;
	session.samples = run.settings.samples;
	session.specialise = options.specialise;
	session.lanes = options.lanes;
	session.bvh = options.bvh;
	session.precision = options.precision;
	session.software_roots = device.software_roots;
	std::array<std::vector<double>, bench_phase_names.size()> seconds;
	std::vector<double> render_seconds;
	for (std::uint32_t repeat = 0; repeat <= repeats; ++repeat) {
		status(repeat == 0 ? scene_name + ": first render"
		                   : fmt::format("{}: render {} of {}", scene_name, repeat, repeats));
		RT_TRY_ASSIGN(OneRender one, render_once(packed, device, session));
		const std::string hash = one.result.film.hash().hex();
		run.stats = std::move(one.result.devices.front());
		if (repeat == 0) {
			run.first = one.seconds;
			run.first_build = run.stats.build;
			run.film_hash = hash;
			run.samples = one.result.film.pixels() * run.settings.samples;
			run.segments = one.result.film.segments;
			continue;
		}
		if (hash != run.film_hash)
			return Error{
			    ErrorKind::Failure,
			    fmt::format("render {} of {} gave film {}, the first one {}", repeat, repeats, hash, run.film_hash),
			    device.handle->info().name,
			    "a device must give the same bits each time: look at its memory and cooling, or report a bug", ""};
		for (std::size_t phase = 0; phase < seconds.size(); ++phase)
			seconds[phase].push_back(one.seconds[phase]);
		render_seconds.push_back(run.stats.launch_seconds + run.stats.read_seconds);
	}
	for (std::size_t phase = 0; phase < seconds.size(); ++phase)
		run.phases[phase] = spread_of(std::move(seconds[phase]));
	run.render_seconds = spread_of(std::move(render_seconds));
	return run;
}

} // namespace rt
