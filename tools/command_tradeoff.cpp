#include "tools/command_tradeoff.h"

#include "support/files.h"
#include "tools/progress.h"
#include "tools/report.h"
#include "tools/signals.h"
#include "tools/tradeoff_json.h"
#include "tools/tradeoff_run.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

namespace rt {

namespace {

// ---- what is shown while it is measured -------------------------------------------------------------------------

TradeoffHooks hooks_of(ProgressDisplay& display)
{
	// Milliseconds take the place of samples: what counts is the time that is left.
	display.set_unit("");
	TradeoffHooks hooks;
	hooks.status = [&display](const std::string& text) {
		catch_stop_signals();
		display.status(text);
	};
	hooks.progress = [&display, before = std::string()](const std::string& what, double gone, double all) mutable {
		catch_stop_signals();
		if (what != before)
			display.begin(what, 1);
		before = what;
		Progress progress;
		progress.samples_done = static_cast<std::uint64_t>(gone * 1000);
		progress.samples_total = std::max(static_cast<std::uint64_t>(all * 1000), progress.samples_done);
		progress.seconds = gone;
		display.update(progress, 0);
	};
	hooks.stop = &stop_requested();
	return hooks;
}

// ---- the screen -------------------------------------------------------------------------------------------------

std::string percent(double share) { return fmt::format("{:.3g} %", 100 * share); }

class TradeoffText {
public:
	TradeoffText(const Tradeoff& measured, const TradeoffAdvice& advice) : measured_(measured), advice_(advice) {}

	std::string text() const
	{
		return measured_.points.empty() ? head() + left_out() : head() + '\n' + table() + legend() + advice();
	}

private:
	bool several_devices() const { return measured_.devices.size() > 1; }

	std::string head() const
	{
		const RenderSettings& settings = measured_.settings;
		std::string text = fmt::format("{}, {}x{}, seed {}, depth {}\n", measured_.scene, settings.width,
		                               settings.height, settings.seed, settings.max_depth);
		for (std::size_t i = 0; i < measured_.devices.size(); ++i)
			text += fmt::format("{}{} ({}), driver {}\n", several_devices() ? fmt::format("{}: ", i) : "",
			                    measured_.devices[i].name, measured_.devices[i].backend, measured_.devices[i].driver);
		const TradeoffReference& reference = measured_.reference;
		if (reference.samples == 0)
			return text + "no reference yet\n";
		return text + fmt::format("reference: {}, {} samples of other seeds{}, known to {}\n",
		                          reference.configuration.name(), reference.samples,
		                          reference.remembered == 0                   ? ""
		                          : reference.remembered >= reference.samples ? ", remembered"
		                                                                      : ", some of them remembered",
		                          percent(reference.noise.rel_rmse()));
	}

	std::string table() const
	{
		std::vector<std::vector<std::string>> rows = {
		    {"", "configuration", ">samples", ">time", ">error", ">RMSE", ">FLIP", ">bias (z)"}};
		if (several_devices())
			rows[0].insert(rows[0].begin() + 1, "device");
		for (const TradePoint& point : measured_.points) {
			const ImageError& error = point.error;
			const ChannelBias& bias = error.clearest_bias();
			const char* most = error.is_bound ? "<" : "";
			std::vector<std::string> row = {point.on_front ? "*" : "",
			                                point.configuration.name(),
			                                std::to_string(point.samples),
			                                format_seconds(point.seconds),
			                                most + percent(error.noise.rel_rmse()),
			                                fmt::format("{}{:.3g}", most, error.noise.rmse()),
			                                fmt::format("{:.4f}", error.flip),
			                                fmt::format("{:+.2g} % ({:+.1f})", 100 * bias.relative, bias.z)};
			if (several_devices())
				row.insert(row.begin() + 1, std::to_string(point.device));
			rows.push_back(std::move(row));
		}
		return format_table(rows);
	}

	std::string legend() const
	{
		return "\n*: nothing else here is as quick and as near to the reference. error: relative RMSE, without the\n"
		       "reference's own (<: no more can be told than that it is below). bias: of the channel where it is\n"
		       "clearest; chance gives |z| up to 3.\n" +
		       left_out() + '\n';
	}

	std::string left_out() const
	{
		std::string text;
		for (const std::string& what : measured_.left_out)
			text += fmt::format("left out: {}\n", what);
		return text;
	}

	std::string expected(const Recommendation& way) const
	{
		return fmt::format("error about {}, about {} at {}x{}{}", percent(way.rel_rmse), format_seconds(way.seconds),
		                   measured_.image_width, measured_.image_height,
		                   way.extrapolated ? " (extrapolated: so many samples were not measured)" : "");
	}

	std::string advice() const
	{
		std::string text;
		if (advice_.as_it_is)
			text += fmt::format("as it is ({}, {}): {}\n", advice_.as_it_is->configuration.name(),
			                    plural(advice_.as_it_is->samples, "sample"), expected(*advice_.as_it_is));
		if (advice_.goal.seconds)
			text += fmt::format("within {}", format_seconds(*advice_.goal.seconds));
		else if (advice_.goal.rel_rmse)
			text += fmt::format("for an error of {}", percent(*advice_.goal.rel_rmse));
		if (!advice_.way)
			return text + ": no way is known\n";
		return text + fmt::format(": {}\n\n    {}\n", expected(*advice_.way), command_line(measured_, *advice_.way));
	}

	const Tradeoff& measured_;
	const TradeoffAdvice& advice_;
};

Status write_files(const Tradeoff& measured, const TradeoffAdvice& advice, const TradeoffOptions& options)
{
	if (!options.csv.empty())
		RT_TRY(write_file(options.csv, tradeoff_csv(measured)));
	if (options.json.empty())
		return success();
	nlohmann::ordered_json json = tradeoff_json(measured);
	json["advice"] = advice_json(measured, advice);
	if (options.json != "-")
		return write_file(options.json, to_text(json));
	print_result(to_text(json));
	return success();
}

Error interrupted(const Tradeoff& measured)
{
	return Error{ErrorKind::Interrupted,
	             measured.points.empty()
	                 ? "before anything was measured"
	                 : fmt::format("after {} that were measured", plural(measured.points.size(), "render")),
	             "rt tradeoff",
	             measured.reference.samples > 0
	                 ? fmt::format("the reference is remembered, {} samples of it: the next run goes on from there",
	                               measured.reference.samples)
	                 : "",
	             ""};
}

Error nothing_measured(std::uint32_t limit_seconds)
{
	return Error{ErrorKind::Failure,
	             fmt::format("{} do not suffice to measure anything", format_seconds(limit_seconds)), "rt tradeoff",
	             "give it more with --limit, or a smaller image with --size; the reference is remembered", ""};
}

} // namespace

Status run_tradeoff(const TradeoffOptions& options)
{
	for (const std::string* file : {&options.json, &options.csv})
		if (!file->empty())
			RT_TRY(check_writable(*file));
	ProgressDisplay display(options.render.progress);
	RT_TRY_ASSIGN(const Tradeoff measured, measure_tradeoff(options, hooks_of(display)));
	display.clear();
	const TradeoffAdvice advice = advice_for(measured, options);
	const std::string text = TradeoffText(measured, advice).text();
	if (options.json == "-")
		print_message(text);
	else
		print_result(text);
	RT_TRY(write_files(measured, advice, options));
	RT_TRY(flush_results());
	if (measured.interrupted)
		return interrupted(measured);
	if (measured.points.empty())
		return nothing_measured(options.limit_seconds);
	if (!advice.way && (options.budget || options.target_error))
		return Error{ErrorKind::Failure,
		             options.budget ? "not even one sample a pixel fits into that time"
		                            : "no number of samples is known to come so near to the truth",
		             options.budget ? "--budget" : "--target-error",
		             options.budget ? "allow more time, or a smaller image with --for"
		                            : "allow a larger error, or measure more: --limit and --reference",
		             ""};
	return success();
}

Result<RenderOptions> with_auto_precision(const RenderOptions& options)
{
	TradeoffOptions tradeoff;
	tradeoff.render = options;
	tradeoff.target_error = options.target_error;
	std::optional<Tradeoff> measured = remembered_tradeoff(tradeoff);
	const bool remembered = measured.has_value();
	if (!measured) {
		if (!options.quiet)
			report_note(fmt::format("{} was not measured on this device yet: measuring, for at most {}", options.scene,
			                        format_seconds(tradeoff.limit_seconds)));
		ProgressDisplay display(options.progress);
		RT_TRY_ASSIGN(measured, measure_tradeoff(tradeoff, hooks_of(display)));
		display.clear();
		if (measured->interrupted)
			return interrupted(*measured);
		if (measured->points.empty())
			return nothing_measured(tradeoff.limit_seconds);
	}
	const TradeoffAdvice advice = advice_for(*measured, tradeoff);
	if (!advice.way)
		return Error{ErrorKind::Failure, "no number of samples is known to come so near to the truth", "--target-error",
		             fmt::format("allow a larger error; `rt tradeoff {}` shows what was measured", options.scene), ""};
	const Recommendation& way = *advice.way;
	RenderOptions chosen = options;
	chosen.auto_precision = false;
	chosen.precision = way.configuration.precision;
	chosen.device.precision = chosen.precision;
	chosen.sampler = way.configuration.sampler;
	chosen.estimator = way.configuration.estimator;
	chosen.roulette = way.configuration.roulette;
	chosen.samples = way.samples;
	if (!options.quiet)
		report_note(fmt::format("for an error of {}, by {} of {}: {} --spp {}{}", percent(*options.target_error),
		                        remembered ? "what was measured" : "this measurement", measured->date,
		                        way.configuration.arguments(), way.samples,
		                        way.extrapolated ? " (extrapolated: so many samples were not measured)" : ""));
	return chosen;
}

} // namespace rt
