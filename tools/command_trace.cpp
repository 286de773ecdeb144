#include "tools/command_trace.h"

#include "backends/kernel_text.h"
#include "backends/self_test.h"
#include "common/rt_contract.h"
#include "render/first_divergence.h"
#include "render/scene_file.h"
#include "render/trace_file.h"
#include "render/trace_path.h"
#include "support/files.h"
#include "tools/progress.h"
#include "tools/report.h"
#include "tools/signals.h"

#include <fmt/format.h>

#include <cstring>
#include <utility>

namespace rt {

namespace {

using Type = KernelType::Kind;

// One sample's notes: a few thousand, with many spheres millions. A saved trace holds this many at most.
constexpr std::uint64_t most_saved_notes = std::uint64_t(1) << 21;

std::string decimal(std::uint64_t bits, Type type)
{
	const auto low = static_cast<std::uint32_t>(bits);
	switch (type) {
	case Type::Real: {
		float value;
		std::memcpy(&value, &low, sizeof value);
		return fmt::format("{:.9g}", value);
	}
	case Type::Int:
		return fmt::format("{}", static_cast<std::int32_t>(low));
	case Type::Long:
		return fmt::format("{}", static_cast<std::int64_t>(bits));
	default:
		return fmt::format("{}", bits);
	}
}

std::string hex(std::uint64_t bits, Type type)
{
	return type == Type::Long || type == Type::Ulong ? fmt::format("{:016x}", bits) : fmt::format("{:08x}", bits);
}

// Arguments of several types are told in hex alone.
std::string both(std::uint64_t bits, Type type)
{
	return type == Type::Unknown ? hex(bits, type) : fmt::format("{} ({})", hex(bits, type), decimal(bits, type));
}

Type operand_type(const TraceNote& note, std::size_t i)
{
	if (note.code.kind == TraceKind::Select)
		return i == 0 ? Type::Int : note.code.result;
	return note.code.operand;
}

// "fma of 3f800000 (1), ... gives ...": an operation with its numbers.
std::string note_text(const TraceNote& note, const TraceSite* site)
{
	std::string text = name_of(note.code.kind);
	std::string operands;
	for (std::size_t i = 0; i < 3; ++i) {
		const bool there =
		    site && site->code.kind == note.code.kind ? !site->operands[i].empty() : note.operands[i] != 0;
		if (there)
			operands += (operands.empty() ? " of " : ", ") + both(note.operands[i], operand_type(note, i));
	}
	text += operands;
	if (note.code.kind != TraceKind::Call && note.code.kind != TraceKind::MoreArguments)
		text += " gives " + both(note.result, note.code.result);
	return text;
}

std::string film_text(const rt_film_pixel& pixel) { return fmt::format("{} {} {}", pixel.r, pixel.g, pixel.b); }

std::string launch_text(const PixelLaunch& launch)
{
	if (launch.samples == 1)
		return fmt::format("pixel {},{}, sample {}", launch.x, launch.y, launch.first_sample);
	return fmt::format("pixel {},{}, samples {} to {} in one launch", launch.x, launch.y, launch.first_sample,
	                   launch.first_sample + launch.samples - 1);
}

std::string path_text(const Trace& trace)
{
	std::string text;
	for (const PathStep& step : path_of(trace)) {
		text += step.title + "\n";
		std::vector<std::vector<std::string>> rows;
		for (const PathValue& value : step.values) {
			std::string numbers, words;
			for (const std::uint64_t bits : value.bits) {
				numbers += (numbers.empty() ? "" : " ") + decimal(bits, value.type);
				words += (words.empty() ? "" : " ") + hex(bits, value.type);
			}
			rows.push_back({value.name, numbers, words});
		}
		text += format_table(rows, "  ");
	}
	return text;
}

std::string difference_text(const TraceDifference& difference, const std::string& judged, const std::string& against)
{
	const TraceNote& expected = difference.expected;
	const TraceSite* site = trace_site(expected.code);
	std::string text = fmt::format("first different operation: {} in {}, {}:{}\n", name_of(expected.code.kind),
	                               site ? site->function : "?", site ? site->file : "?", expected.code.line);
	if (site)
		text += fmt::format("  {}{}\n", site->target.empty() ? "" : site->target + " <- ", site->source);
	if (difference.bounce == 0)
		text += "  bounce 0 (the camera's ray and what it meets)\n";
	else
		text += fmt::format("  bounce {}\n", difference.bounce);
	for (const std::string& frame : difference.stack)
		text += "  " + frame + "\n";
	for (std::size_t i = 0; i < 3; ++i)
		if (site && !site->operands[i].empty())
			text += fmt::format("  operand {}: {}\n", site->operands[i],
			                    both(expected.operands[i], operand_type(expected, i)));
	if (difference.kind == Difference::Result) {
		text += fmt::format("  {}: {}\n", judged, both(difference.got.result, difference.got.code.result));
		text += fmt::format("  {}: {}\n", against, both(expected.result, expected.code.result));
		if (difference.correct) {
			const bool judged_right = *difference.correct == difference.got.result;
			const bool against_right = *difference.correct == expected.result;
			text += fmt::format("  contract: {}: {}\n", both(*difference.correct, expected.code.result),
			                    judged_right    ? against + " is wrong"
			                    : against_right ? judged + " is wrong"
			                                    : "both are wrong");
		} else if (expected.code.kind == TraceKind::Load) {
			text += "  what is read differs: the memory, its layout, or the index\n";
		}
		return text;
	}
	text += difference.kind == Difference::Operands
	            ? "  the operation is the same and gets other operands, though all before it agrees:\n"
	            : "  the programs do not run the same operations here, though all before agrees:\n";
	const auto list = [&](const std::string& name, const std::vector<TraceNote>& notes, const TraceNote& one) {
		text += "  " + name + "\n";
		for (const TraceNote& note : notes.empty() ? std::vector<TraceNote>{one} : notes)
			text += "    " + note_text(note, trace_site(note.code)) + "\n";
	};
	list(judged, difference.got_line, difference.got);
	list(against, difference.expected_line, expected);
	if (difference.correct)
		text += fmt::format("  contract: {}\n", both(*difference.correct, expected.code.result));
	return text;
}

std::string divergence_text(const Divergence& found, const std::string& judged, const std::string& against)
{
	std::string text;
	if (!found.stale_device.empty())
		text += fmt::format("stale program: {} runs a program that was made from another text ({:08x}, not {:08x}): "
		                    "clear the driver's cache of binaries\n",
		                    found.stale_device, found.stale_id, found.expected_id);
	if (!found.images_differ()) {
		text += fmt::format("{} the same after {}\n", found.pixels == 1 ? "the pixel is" : "the images are",
		                    plural(found.samples_compared, "sample"));
		if (found.operation)
			text += "an operation differs all the same, without changing the film:\n";
	} else if (found.pixels > 1) {
		text += fmt::format("image: {} of {} pixels differ after {}\n", found.different_pixels, found.pixels,
		                    plural(found.samples_compared, "sample"));
	}
	if (found.launch) {
		text += launch_text(*found.launch) + "\n";
		if (found.images_differ() && found.alone)
			text += fmt::format("  {}: film {}\n  {}: film {}\n", judged, film_text(found.judged), against,
			                    film_text(found.against));
	}
	if (found.operation)
		return text + difference_text(*found.operation, judged, against) +
		       (found.layout_failure.empty() ? "" : "  layout: " + found.layout_failure + "\n");
	text += fmt::format("{} of {} compared: the same\n", plural(found.notes_compared, "operation"),
	                    plural(found.traces_compared, "trace"));
	if (!found.images_differ())
		return text + (found.stale_device.empty() ? "identical\n" : "");
	if (!found.alone)
		return text +
		       "the pixel differs in the image and not when it is rendered alone: look at how work-items and lanes "
		       "are mapped to pixels (kernels/render.cl), or at the driver's copying\n";
	text += "the traced programs agree and the ordinary ones do not: the compiler makes something else of the ordinary "
	        "program\n";
	if (found.differing_depth)
		text += fmt::format("  they differ from --max-depth {} on: in what {}\n", *found.differing_depth,
		                    *found.differing_depth == 1 ? "happens up to the first scattering"
		                                                : fmt::format("scattering {} adds", *found.differing_depth));
	if (found.one_lane_agrees)
		text += *found.one_lane_agrees ? "  with --lanes 1 the ordinary program agrees: its vectors are at fault\n"
		                               : "  with --lanes 1 it differs too\n";
	return text;
}

class TraceCommand {
public:
	explicit TraceCommand(const TraceOptions& options) : options_(options), display_(options.render.progress) {}

	Status run()
	{
		RT_TRY(load_scene());
		const Enumeration found = enumerate_all();
		RT_TRY_ASSIGN(judged_, open(options_.render.device, found));
		catch_stop_signals();
		if (options_.against.empty())
			return trace_alone();
		if (is_file(options_.against))
			return trace_against_file();
		DeviceRequest request;
		for (const Backend* backend : backends())
			if (options_.against == backend->name())
				request.backend = options_.against;
		if (request.backend == "auto")
			request.device = options_.against;
		RT_TRY_ASSIGN(const TracedDevice against, open(request, found));
		return trace_against(against);
	}

private:
	static bool is_file(const std::string& name)
	{
		return name.size() > 5 && name.compare(name.size() - 5, 5, ".json") == 0;
	}

	Status load_scene()
	{
		RT_TRY_ASSIGN(const SceneFile file, open_scene(options_.render.scene));
		RT_TRY_ASSIGN(const Scene scene, file.at_frame(options_.render.first_frame));
		settings_ = options_.render.settings_over(scene.render);
		RT_TRY_ASSIGN(packed_, pack_scene(scene, settings_, {0, 0, settings_.width, settings_.height}));
		if (options_.render.window)
			if (const Window& pixel = *options_.render.window;
			    pixel.x >= settings_.width || pixel.y >= settings_.height)
				return Error{ErrorKind::Usage,
				             fmt::format("pixel {},{} is not in an image of {}x{}", pixel.x, pixel.y, settings_.width,
				                         settings_.height),
				             "--pixel", "columns and rows count from 0, row 0 at the top", ""};
		return success();
	}

	Result<TracedDevice> open(const DeviceRequest& request, const Enumeration& found)
	{
		RT_TRY_ASSIGN(const std::vector<DeviceInfo> chosen, select_devices(request, found));
		if (chosen.size() != 1)
			return Error{ErrorKind::Usage, "a trace is of one device", "--device",
			             "name one; --against takes the other", ""};
		TracedDevice traced;
		RT_TRY_ASSIGN(traced.device, open_device(chosen[0]));
		display_.status("testing " + describe(chosen[0]));
		const Result<SelfTestReport> report = self_test(traced.device);
		traced.software_roots = report && report->needs_software_roots;
		display_.clear();
		// No reason to refuse: such devices are what traces are for.
		if (!report)
			report_warning(
			    fmt::format("the self-test of {} could not be run: {}", describe(chosen[0]), report.error().message));
		else if (!report->passed)
			report_warning(fmt::format("{} fails its self-test: {}", describe(chosen[0]), report->first_failure()));
		return traced;
	}

	PixelLaunch launch() const
	{
		PixelLaunch launch;
		launch.x = options_.render.window->x;
		launch.y = options_.render.window->y;
		launch.first_sample = options_.sample.value_or(0);
		return launch;
	}

	Result<SavedTrace> saved_trace(const PixelLaunch& wanted)
	{
		SessionOptions session;
		session.specialise = options_.render.specialise;
		session.lanes = options_.render.lanes;
		session.software_roots = judged_.software_roots;
		display_.status("compiling the programs");
		RT_TRY_ASSIGN(Tracer tracer, Tracer::make(judged_.device, packed_, session));
		SavedTrace saved;
		RT_TRY_ASSIGN(saved.trace, tracer.trace(wanted, 0, most_saved_notes));
		RT_TRY_ASSIGN(saved.ordinary, tracer.render(wanted));
		display_.clear();
		saved.kernels = kernel_hash();
		saved.contract = RT_CONTRACT_VERSION;
		saved.backend = tracer.info().backend;
		saved.device = tracer.info().name;
		saved.driver = tracer.info().driver;
		saved.scene = options_.render.scene;
		saved.inputs = inputs_hash(packed_);
		saved.width = settings_.width;
		saved.height = settings_.height;
		if (saved.trace.note_count > saved.trace.notes.size())
			report_warning(fmt::format("the trace has {} operations, of which the first {} are kept",
			                           saved.trace.note_count, saved.trace.notes.size()));
		if (!options_.json.empty())
			RT_TRY(write_file(options_.json, write_trace(saved)));
		return saved;
	}

	Status trace_alone()
	{
		if (!options_.render.window)
			return Error{ErrorKind::Usage, "rt trace needs a pixel, or a device to compare with", "command line",
			             "rt trace SCENE --pixel 320,240 --sample 0, or rt trace SCENE --against reference", ""};
		RT_TRY_ASSIGN(const SavedTrace saved, saved_trace(launch()));
		std::string text =
		    fmt::format("{} of {} at {}x{} on {}, {}\n", launch_text(saved.trace.launch), saved.scene, saved.width,
		                saved.height, describe(judged_.device->info()), plural(saved.trace.note_count, "operation"));
		text += path_text(saved.trace);
		text += fmt::format("sums: {} (2^-{} a unit)\n", film_text(saved.trace.after), packed_.film_exponent);
		if (!same_sums(saved.trace.after, saved.ordinary))
			text += fmt::format("the ordinary program gives {}: the compiler makes something else of it\n",
			                    film_text(saved.ordinary));
		print_result(text);
		return success();
	}

	Status trace_against_file()
	{
		RT_TRY_ASSIGN(const std::vector<std::uint8_t> bytes, read_file(options_.against, std::size_t(1) << 30));
		RT_TRY_ASSIGN(const SavedTrace theirs, read_trace(std::string(bytes.begin(), bytes.end()), options_.against));
		if (theirs.inputs != inputs_hash(packed_))
			return Error{ErrorKind::Usage,
			             fmt::format("the trace is of {} at {}x{} with other inputs than this scene and its settings",
			                         theirs.scene, theirs.width, theirs.height),
			             options_.against, "give the same scene, --size, --seed and --max-depth", ""};
		RT_TRY_ASSIGN(const SavedTrace mine, saved_trace(theirs.trace.launch));
		TraceComparison comparison;
		const bool same = comparison.compare(mine.trace, theirs.trace);
		const std::string judged = describe(judged_.device->info());
		const std::string against = fmt::format("{} ({})", theirs.device, options_.against);
		std::string text = launch_text(mine.trace.launch) + "\n";
		text += fmt::format("  {}: film {}\n  {}: film {}\n", judged, film_text(mine.ordinary), against,
		                    film_text(theirs.ordinary));
		if (same) {
			text += fmt::format("{}: the same\n", plural(comparison.compared(), "operation"));
			text += same_sums(mine.ordinary, theirs.ordinary)
			            ? "identical\n"
			            : "the traced programs agree and the ordinary ones do not: a compiler makes something else of "
			              "the ordinary program\n";
		} else {
			text += difference_text(*comparison.difference(), judged, against);
		}
		print_result(text);
		return verdict(same && same_sums(mine.ordinary, theirs.ordinary));
	}

	Status trace_against(const TracedDevice& against)
	{
		DivergenceOptions search;
		search.samples = settings_.samples;
		search.specialise = options_.render.specialise;
		search.lanes = options_.render.lanes;
		if (options_.render.window)
			search.pixel = {options_.render.window->x, options_.render.window->y};
		search.sample = options_.sample;
		search.stop = &stop_requested();
		search.status = [this](const std::string& text) { display_.status(text); };
		Result<Divergence> found = find_divergence(packed_, judged_, against, search);
		display_.clear();
		if (!found)
			return found.error();
		std::string judged = describe(judged_.device->info()), other = describe(against.device->info());
		std::string text = divergence_text(*found, judged, other);
		if (options_.render.verbose)
			for (const DivergenceStep& step : found->steps)
				report_note(fmt::format("{}: {}", step.what, format_seconds(step.seconds)));
		print_result(text);
		if (!options_.json.empty() && found->launch) {
			const Result<SavedTrace> saved = saved_trace(*found->launch);
			if (!saved)
				return saved.error();
		}
		return verdict(found->is_identical());
	}

	static Status verdict(bool identical)
	{
		if (identical)
			return success();
		return Error{ErrorKind::Failure, "the two do not compute the same", "rt trace",
		             "standard output says where they first differ", ""};
	}

	const TraceOptions& options_;
	ProgressDisplay display_;
	RenderSettings settings_;
	PackedScene packed_;
	TracedDevice judged_;
};

} // namespace

Status run_trace(const TraceOptions& options) { return TraceCommand(options).run(); }

} // namespace rt
