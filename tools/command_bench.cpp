#include "tools/command_bench.h"

#include "backends/kernel_text.h"
#include "common/rt_contract.h"
#include "render/peak.h"
#include "support/files.h"
#include "support/thread_pool.h"
#include "tools/bench_run.h"
#include "tools/bench_sweep.h"
#include "tools/progress.h"
#include "tools/render_stats.h"
#include "tools/report.h"
#include "version.h"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <ctime>
#include <string>
#include <utility>
#include <vector>

namespace rt {

namespace {

using Json = nlohmann::ordered_json;

Json spread_json(const Spread& spread) { return {{"min", spread.min}, {"median", spread.median}, {"max", spread.max}}; }

// The rate of a time: the smallest time is the largest rate.
Spread rate_of(std::uint64_t count, const Spread& seconds)
{
	const auto rate = [count](double time) { return static_cast<double>(count) / std::max(time, 1e-9); };
	return {rate(seconds.max), rate(seconds.median), rate(seconds.min)};
}

Json build_json(const BuildReport& build)
{
	Json kernels = Json::array();
	for (const KernelUse& use : build.kernels) {
		Json kernel = {{"entry", use.entry}, {"group_size", use.group_size}};
		kernel["registers"] = use.registers ? Json(*use.registers) : Json();
		kernel["private_bytes"] = use.private_bytes ? Json(*use.private_bytes) : Json();
		kernel["occupancy"] = use.occupancy ? Json(*use.occupancy) : Json();
		kernels.push_back(std::move(kernel));
	}
	return {{"seconds", build.seconds}, {"from_cache", build.from_cache}, {"embedded", build.embedded},
	        {"variant", build.variant}, {"options", build.options},       {"kernels", kernels}};
}

// What was measured of one scene; with a sweep, of each of its points.
Json measured_json(const BenchRun& run)
{
	Json first = Json::object(), phases = Json::object();
	for (std::size_t phase = 0; phase < bench_phase_names.size(); ++phase) {
		first[bench_phase_names[phase]] = run.first[phase];
		phases[bench_phase_names[phase]] = spread_json(run.phases[phase]);
	}
	return {{"scene", run.scene},
	        {"spheres", run.spheres},
	        {"width", run.settings.width},
	        {"height", run.settings.height},
	        {"samples", run.settings.samples},
	        {"seed", run.settings.seed},
	        {"max_depth", run.settings.max_depth},
	        {"sampler", sampler_name(run.settings.sampler)},
	        {"estimator", estimator_name(run.settings.estimator)},
	        {"roulette", run.settings.roulette},
	        {"load_seconds", run.load_seconds},
	        {"pack_seconds", run.pack_seconds},
	        {"first", first},
	        {"phases", phases},
	        {"render_seconds", spread_json(run.render_seconds)},
	        {"samples_rendered", run.samples},
	        {"segments_rendered", run.segments},
	        {"samples_per_second", spread_json(rate_of(run.samples, run.render_seconds))},
	        {"segments_per_second", spread_json(rate_of(run.segments, run.render_seconds))},
	        {"launches", run.stats.launches},
	        {"lanes", run.stats.lanes},
	        {"bvh", run.stats.bvh},
	        {"film_hash", run.film_hash}};
}

class BenchCommand {
public:
	explicit BenchCommand(const BenchOptions& options)
	    : options_(options), display_(options.quiet ? ProgressMode::None : ProgressMode::Auto)
	{
	}

	Status run()
	{
		if (!options_.json.empty())
			RT_TRY(check_writable(options_.json));
		const auto status = [this](const std::string& text) { display_.status(text); };
		RT_TRY_ASSIGN(device_, open_bench_device(options_.render, status));
		status("measuring the peak of " + info().name);
		RT_TRY_ASSIGN(peak_, measure_peak(*device_.handle));
		if (options_.sweep == Sweep::None)
			return run_one(status);
		RT_TRY_ASSIGN(const SweepResult sweep, run_sweep(options_, device_, status));
		Json json = run_facts();
		Json points = Json::array();
		for (const SweepPoint& point : sweep.points) {
			Json entry = {{"x", point.x}};
			entry.update(measured_json(point.run));
			points.push_back(std::move(entry));
		}
		json["sweep"] = {{"of", sweep.of},
		                 {"points", points},
		                 {"exponent", sweep.exponent ? Json(*sweep.exponent) : Json()},
		                 {"upper_exponent", sweep.upper_exponent ? Json(*sweep.upper_exponent) : Json()},
		                 {"left_out", sweep.left_out}};
		return report(sweep_text(sweep), json);
	}

private:
	const DeviceInfo& info() const { return device_.handle->info(); }

	template <class StatusText>
	Status run_one(const StatusText& status)
	{
		RT_TRY_ASSIGN(const BenchRun run,
		              bench_scene(options_.render.scene, options_.render, device_, options_.repeats, status));
		const PeakShare share =
		    peak_share(run.segments, run.spheres, run.stats.bvh, run.phase(BenchPhase::Launches).median, peak_);
		Json json = run_facts();
		json.update(measured_json(run));
		json["scene_hash"] = run.scene_hash.hex();
		json["features"] = feature_names(run.features);
		json["first_build"] = build_json(run.first_build);
		json["build"] = build_json(run.stats.build);
		json["model"] = nullptr; // a tree spares most of the tests that it counts
		if (share.tests_per_segment > 0)
			json["model"] = {{"operations_per_test", share.operations_per_test},
			                 {"tests_per_segment", share.tests_per_segment},
			                 {"operations_per_second", share.operations_per_second},
			                 {"share_of_fma_peak", share.share}};
		return report(run_text(run, share), json);
	}

	// Facts of the program, the machine and the device.
	Json run_facts() const
	{
		return {{"version", RT_VERSION},
		        {"revision", RT_REVISION},
		        {"contract", RT_CONTRACT_VERSION},
		        {"kernel_hash", kernel_hash()},
		        {"precision", precision_name(options_.render.precision)},
		        {"date", fmt::format("{:%Y-%m-%dT%H:%M:%SZ}", fmt::gmtime(std::time(nullptr)))},
		        {"threads", thread_count()},
		        {"device", device_json(info())},
		        {"seconds",
		         {{"enumerate", device_.enumerate_seconds},
		          {"open_device", device_.open_seconds},
		          {"self_test", device_.self_test_seconds},
		          {"peak", peak_.seconds}}},
		        {"peak",
		         {{"fma_per_second", peak_.fma_per_second},
		          {"integer_per_second", peak_.integer_per_second},
		          {"lanes", peak_.lanes}}},
		        {"repeats", options_.repeats}};
	}

	Status report(const std::string& text, const Json& json)
	{
		display_.clear();
		if (!options_.quiet) {
			if (options_.json == "-")
				print_message(text);
			else
				print_result(text);
		}
		if (options_.json == "-")
			print_result(to_text(json));
		else if (!options_.json.empty())
			return write_file(options_.json, to_text(json));
		return success();
	}

	std::string device_text() const
	{
		return fmt::format("{} ({}), driver {}\npeak: {}fma/s, {}integer multiply-adds/s\n", info().name,
		                   info().backend, info().driver, format_quantity(peak_.fma_per_second),
		                   format_quantity(peak_.integer_per_second));
	}

	std::string run_text(const BenchRun& run, const PeakShare& share) const
	{
		const RenderSettings& settings = run.settings;
		std::string text =
		    fmt::format("{}: {}, {}x{}, {} a pixel, depth {}, {}\n", run.scene, plural(run.spheres, "sphere"),
		                settings.width, settings.height, plural(settings.samples, "sample"), settings.max_depth,
		                precision_name(options_.render.precision));
		text += device_text() + '\n';

		std::vector<std::vector<std::string>> rows = {{"", ">first", ">min", ">median", ">max"}};
		const auto once = [&rows](const char* name, double seconds) {
			rows.push_back({name, format_seconds(seconds), "", "", ""});
		};
		once("load scene", run.load_seconds);
		once("pack scene", run.pack_seconds);
		once("find devices", device_.enumerate_seconds);
		once("open device", device_.open_seconds);
		once("self-test", device_.self_test_seconds);
		constexpr std::array<const char*, bench_phase_names.size()> labels = {
		    "build tree", "build kernel",    "upload",     "launches",
		    "read back",  "rest of session", "encode PNG", "render and encode"};
		for (std::size_t phase = 0; phase < labels.size(); ++phase) {
			const Spread& spread = run.phases[phase];
			rows.push_back({labels[phase], format_seconds(run.first[phase]), format_seconds(spread.min),
			                format_seconds(spread.median), format_seconds(spread.max)});
		}
		const auto rate = [&](const char* name, std::uint64_t count) {
			const Spread spread = rate_of(count, run.render_seconds);
			rows.push_back(
			    {name, "", format_quantity(spread.min), format_quantity(spread.median), format_quantity(spread.max)});
		};
		rate("samples/s", run.samples);
		rate("rays/s", run.segments);
		text += format_table(rows) + '\n';

		const BuildReport& build = run.first_build;
		text += fmt::format("{} of {} rays; {}; first program {} in {}\n",
		                    fmt::format("{} launch", run.stats.launches) + (run.stats.launches == 1 ? "" : "es"),
		                    format_quantity(static_cast<double>(run.segments)),
		                    plural(run.stats.lanes, "lane") + (run.stats.bvh ? ", a tree" : ""),
		                    build.from_cache ? "from the cache"
		                    : build.embedded ? "as shipped"
		                                     : "built",
		                    format_seconds(build.seconds));
		for (const KernelUse& use : run.stats.build.kernels)
			text += kernel_text(use) + '\n';
		if (share.tests_per_segment > 0)
			text += fmt::format("sphere tests: {} of {} operations a ray: {}operations/s, {:.1f} % of the fma peak\n",
			                    share.tests_per_segment, share.operations_per_test,
			                    format_quantity(share.operations_per_second), 100 * share.share);
		return text + fmt::format("film {}\n", run.film_hash);
	}

	static std::string kernel_text(const KernelUse& use)
	{
		std::string text = fmt::format("{}: groups of {}", use.entry, use.group_size);
		if (use.registers)
			text += fmt::format(", {} registers", *use.registers);
		if (use.private_bytes)
			text += fmt::format(", {} outside of registers", format_bytes(*use.private_bytes));
		if (use.occupancy)
			text += fmt::format(", occupancy {:.0f} %", 100 * *use.occupancy);
		return text;
	}

	std::string sweep_text(const SweepResult& sweep) const
	{
		std::string text = device_text() + '\n';
		std::vector<std::vector<std::string>> rows = {
		    {'>' + sweep.of, "scene", ">load and tree", ">min", ">median", ">max", ">rays/s", "film"}};
		for (const SweepPoint& point : sweep.points) {
			const BenchRun& run = point.run;
			rows.push_back({fmt::format("{:.0f}", point.x), run.scene,
			                format_seconds(run.load_seconds + run.pack_seconds + run.phase(BenchPhase::Bvh).min),
			                format_seconds(run.render_seconds.min), format_seconds(run.render_seconds.median),
			                format_seconds(run.render_seconds.max),
			                format_quantity(rate_of(run.segments, run.render_seconds).median), run.film_hash});
		}
		text += format_table(rows);
		if (!sweep.left_out.empty())
			text += fmt::format("left out: {}\n", sweep.left_out);
		if (sweep.exponent)
			text += fmt::format("\ntime ~ {}^{:.2f}, in the upper half ^{:.2f}\n", sweep.of, *sweep.exponent,
			                    sweep.upper_exponent.value_or(*sweep.exponent));
		return text;
	}

	const BenchOptions& options_;
	ProgressDisplay display_;
	BenchDevice device_;
	DevicePeak peak_;
};

} // namespace

Status run_bench(const BenchOptions& options) { return BenchCommand(options).run(); }

} // namespace rt
