#include "tools/options.h"

#include "backends/kernel_text.h"
#include "common/rt_contract.h"
#include "render/adaptive.h"
#include "render/closest_match.h"
#include "render/image_file.h"
#include "render/scene_ranges.h"
#include "version.h"

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <string_view>
#include <utility>
#include <vector>

namespace rt {

namespace {

Error usage(std::string message, std::string cure, std::string where = "command line")
{
	return Error{ErrorKind::Usage, std::move(message), std::move(where), std::move(cure), ""};
}

// ---- values ------------------------------------------------------------------------------------------------------

struct Range {
	std::uint32_t min, max;
};

// The command line may ask for what a scene file may ask for.
constexpr Range range_of(const NumberRange& range)
{
	return {static_cast<std::uint32_t>(range.least), static_cast<std::uint32_t>(range.most)};
}

constexpr Range image_side = range_of(range::image_size);

std::optional<std::uint32_t> whole_number(std::string_view text, Range range)
{
	std::uint32_t value = 0;
	const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
	if (error != std::errc() || end != text.data() + text.size() || value < range.min || value > range.max)
		return std::nullopt;
	return value;
}

Result<std::uint32_t> parse_number(const char* option, const std::string& text, Range range)
{
	if (const auto value = whole_number(text, range))
		return *value;
	return usage(fmt::format("{} takes a whole number from {} to {}, not '{}'", option, range.min, range.max, text),
	             fmt::format("write digits only, for example {} {}", option, std::clamp(128u, range.min, range.max)));
}

// Cuts "a,b,c" at every separator; empty items are kept and fail as numbers.
std::vector<std::string_view> split(std::string_view text, char separator)
{
	std::vector<std::string_view> parts;
	for (;;) {
		const std::size_t end = text.find(separator);
		parts.push_back(text.substr(0, end));
		if (end == std::string_view::npos)
			return parts;
		text.remove_prefix(end + 1);
	}
}

// Exactly N whole numbers in their range between separators; nothing otherwise.
template <std::size_t N>
std::optional<std::array<std::uint32_t, N>> numbers_in(std::string_view text, char separator, Range range)
{
	const std::vector<std::string_view> parts = split(text, separator);
	std::array<std::uint32_t, N> values{};
	if (parts.size() != N)
		return std::nullopt;
	for (std::size_t i = 0; i < N; i++) {
		const auto value = whole_number(parts[i], range);
		if (!value)
			return std::nullopt;
		values[i] = *value;
	}
	return values;
}

Result<std::optional<double>> parse_positive(const char* option, const std::string& text)
{
	if (text.empty())
		return std::optional<double>();
	double value = 0;
	const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
	if (error != std::errc() || end != text.data() + text.size() || !(value >= 0) || !std::isfinite(value))
		return usage(fmt::format("{} takes a number that is not negative, not '{}'", option, text),
		             fmt::format("for example {} 0.004", option));
	return std::optional(value);
}

// The same without 0.
Result<std::optional<double>> parse_amount(const char* option, const std::string& text, const char* example)
{
	RT_TRY_ASSIGN(const std::optional<double> value, parse_positive(option, text));
	if (value && !(*value > 0))
		return usage(fmt::format("{} takes a number above 0, not '{}'", option, text),
		             fmt::format("for example {} {}", option, example));
	return value;
}

Result<Window> parse_crop(const std::string& text)
{
	const auto sides = numbers_in<4>(text, ',', {0, image_side.max});
	if (!sides || (*sides)[0] >= (*sides)[1] || (*sides)[2] >= (*sides)[3])
		return usage(fmt::format("--crop takes x0,x1,y0,y1 with x0 < x1 and y0 < y1, not '{}'", text),
		             "columns x0 to x1 - 1 and rows y0 to y1 - 1 are rendered, row 0 at the top: --crop 0,100,0,50");
	const auto [x0, x1, y0, y1] = *sides;
	return Window{x0, y0, x1 - x0, y1 - y0};
}

Result<Window> parse_pixel(const std::string& text)
{
	const auto position = numbers_in<2>(text, ',', {0, image_side.max - 1});
	if (!position)
		return usage(fmt::format("--pixel takes x,y, not '{}'", text),
		             "two whole numbers, row 0 at the top: --pixel 320,240");
	return Window{(*position)[0], (*position)[1], 1, 1};
}

Status parse_frames(const std::string& text, RenderOptions& options)
{
	if (const auto frame = whole_number(text, {0, max_frame})) {
		options.first_frame = options.last_frame = *frame;
		return success();
	}
	const auto ends = numbers_in<2>(text, ':', {0, max_frame});
	if (!ends || (*ends)[0] > (*ends)[1])
		return usage(
		    fmt::format("--frames takes A:B with A <= B, both from 0 to {}, or one number, not '{}'", max_frame, text),
		    "frames A to B are rendered, both included: --frames 0:23");
	options.first_frame = (*ends)[0];
	options.last_frame = (*ends)[1];
	return success();
}

Result<double> parse_exposure(const std::string& text)
{
	double value = 0;
	const char* first = text.data() + (text.size() > 1 && text[0] == '+' ? 1 : 0);
	const auto [end, error] = std::from_chars(first, text.data() + text.size(), value);
	if (error != std::errc() || end != text.data() + text.size() || !(std::fabs(value) <= max_exposure_stops))
		return usage(
		    fmt::format("--exposure takes a number of stops from -{0} to {0}, not '{1}'", max_exposure_stops, text),
		    "one stop doubles the brightness: --exposure 1.5");
	return value;
}

Result<double> parse_real(const char* option, const std::string& text, double least, double most, const char* example)
{
	double value = 0;
	const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
	if (error != std::errc() || end != text.data() + text.size() || !(value >= least && value <= most))
		return usage(fmt::format("{} takes a number from {} to {}, not '{}'", option, least, most, text), example);
	return value;
}

template <class T>
Result<T> parse_word(const char* option, const std::string& text,
                     std::initializer_list<std::pair<const char*, T>> words)
{
	std::string known;
	for (const auto& [word, value] : words) {
		if (text == word)
			return value;
		known += (known.empty() ? "" : ", ") + std::string(word);
	}
	return usage(fmt::format("{} does not know '{}'", option, text), "choose one of: " + known);
}

// The same for a list whose words have their home elsewhere.
template <class T, std::size_t count>
Result<T> parse_named(const char* option, const std::string& text, const std::array<T, count>& all,
                      const char* (*name)(T))
{
	if (const std::optional<T> found = find_named(text, all, name))
		return *found;
	std::string known;
	for (const T value : all)
		known += (known.empty() ? "" : ", ") + std::string(name(value));
	return usage(fmt::format("{} does not know '{}'", option, text), "choose one of: " + known);
}

Result<ProgressMode> parse_progress(const std::string& text)
{
	return parse_word<ProgressMode>("--progress", text,
	                                {{"auto", ProgressMode::Auto},
	                                 {"plain", ProgressMode::Plain},
	                                 {"json", ProgressMode::Json},
	                                 {"none", ProgressMode::None}});
}

// ---- texts -------------------------------------------------------------------------------------------------------

std::string version_text()
{
	return fmt::format("rt {} (revision {})\nnumeric contract {}\nkernels {}\n", RT_VERSION, RT_REVISION,
	                   RT_CONTRACT_VERSION, kernel_hash());
}

constexpr const char* commands_text = "Commands (each has its own --help):\n"
                                      "  render     render a scene to an image; the default, its name may be left out\n"
                                      "  devices    list what rt can run on, what is missing, and how to get it\n"
                                      "  info       what a scene contains and needs\n"
                                      "  tradeoff   speed against accuracy: measured, and a command line at the end\n"
                                      "  bench      how fast a device renders a scene, part by part\n"
                                      "  verify     are the devices and drivers here right? For bug reports\n"
                                      "  trace      one path with all its numbers; where two devices first differ\n"
                                      "  compare    two images: the same or not, where, by how much, and why\n"
                                      "  reproduce  an image rendered again from its own metadata, and compared\n";

constexpr const char* examples_text =
    "Examples:\n"
    "  rt                                      the default scene on the best device: three-spheres.png\n"
    "  rt weekend --size 1200x675 --spp 100 -o weekend.png\n"
    "  rt my.json -o my.exr -d 1               on device 1 of `rt devices`\n"
    "  rt my.json --frames 0:23 -o film        film_000000000.png to film_000000023.png\n"
    "  rt my.json --error 0.02 --time-limit 600    until the error is 2 %, or ten minutes have passed\n"
    "  rt my.json --spp 4096 --checkpoint my.rtfilm -o my.png\n"
    "  rt my.json --spp 4096 --resume my.rtfilm --checkpoint my.rtfilm -o my.png\n"
    "  rt --pixel 320,240 --spp 1000 -o - | file -\n"
    "\n"
    "Exit status: 0 done; 1 failure; 2 usage; 3 no usable device; 4 self-test failed; 5 kernel\n"
    "build failed; 6 out of memory; 7 input or output; 130 interrupted.";

// ---- the parser --------------------------------------------------------------------------------------------------

// CLI11 with this program's manners: what it does not know is kept for a message of our own.
void set_manners(CLI::App& app, const char* name)
{
	app.name(name);
	app.set_help_flag("-h,--help", "this text");
	app.set_version_flag("--version", version_text, "version, revision, numeric contract, kernels");
	app.allow_extras();
	app.get_formatter()->column_width(32);
	app.get_formatter()->label("OPTIONS", "options");
	app.get_formatter()->label("Options", "Other");
	app.get_formatter()->label("Positionals", "Scene");
}

Error unknown_argument(const CLI::App& app, const std::string& argument)
{
	const std::string help = app.get_name() + " --help lists what it takes";
	if (argument.size() < 2 || argument[0] != '-')
		return usage(fmt::format("'{}' is one argument too many", argument), help);
	const std::string name = argument.substr(0, argument[1] == '-' ? argument.find('=') : argument.npos);
	std::vector<std::string> known;
	for (const CLI::Option* option : app.get_options())
		for (const std::string& long_name : option->get_lnames())
			known.push_back("--" + long_name);
	const std::string nearest = closest_match(name, known);
	return usage(fmt::format("there is no option '{}'", name),
	             (nearest.empty() ? "" : "did you mean " + nearest + "? ") + help);
}

// Nothing when the options are to be used, or what to print instead.
Result<std::optional<TextRequest>> parse(CLI::App& app, std::vector<std::string> arguments)
{
	std::reverse(arguments.begin(), arguments.end()); // CLI11 takes them from the back
	try {
		app.parse(std::move(arguments));
	} catch (const CLI::CallForHelp&) {
		std::string text = app.help();
		for (std::size_t at; (at = text.find("\n\n\n")) != std::string::npos;)
			text.erase(at, 1); // CLI11 is generous with blank lines
		return std::optional(TextRequest{std::move(text)});
	} catch (const CLI::CallForVersion&) {
		return std::optional(TextRequest{version_text()});
	} catch (const CLI::ArgumentMismatch& error) {
		// "--samples: 1 required N missing", "--samples: At Most 1 required but received 2"
		const std::string what = error.what();
		const std::string option = what.substr(0, what.find(':'));
		const bool missing = what.find("missing") != std::string::npos;
		return usage(option + (missing ? " needs a value" : " is given more than once"),
		             app.get_name() + " --help lists what it takes");
	} catch (const CLI::ParseError& error) {
		return usage(error.what(), app.get_name() + " --help lists what it takes");
	}
	if (const std::vector<std::string> extras = app.remaining(); !extras.empty())
		return unknown_argument(app, extras.front());
	return std::optional<TextRequest>();
}

// What was typed, before it is checked.
struct RawRender {
	std::string width, height, size, samples, seed, max_depth, sampler, estimator, roulette, frames, pixel, crop,
	    checkpoint_seconds;
	std::string error, time_limit;
	bool generic = false;
	std::string transfer = "srgb", exposure = "0", precision = "exact", progress = "auto", lanes = "auto", bvh = "auto";
};

// The scene and what may change the time of a render.
void add_scene_options(CLI::App& app, RenderOptions& options, RawRender& raw)
{
	const RenderSettings defaults;
	app.add_option("scene", options.scene,
	               "a scene file, a shipped scene's name, or cloud-N;\n" + options.scene + " if none is named")
	    ->type_name("");
	const auto add = [&app](const char* name, std::string& value, const char* type, const std::string& text) {
		app.add_option(name, value, text)->type_name(type)->group("Image");
	};
	add("--width", raw.width, "N", fmt::format("pixels a row ({} unless the scene says otherwise)", defaults.width));
	add("--height", raw.height, "N", fmt::format("rows ({})", defaults.height));
	add("--size", raw.size, "WxH", "both at once");
	add("--samples,--spp", raw.samples, "N", fmt::format("samples a pixel ({})", defaults.samples));
	add("--seed", raw.seed, "N", fmt::format("of the random numbers ({})", defaults.seed));
	add("--max-depth", raw.max_depth, "N", fmt::format("scatterings after which a path ends ({})", defaults.max_depth));
	add("--sampler", raw.sampler, "NAME",
	    fmt::format("of the random numbers: independent, stratified or\nsobol ({})", sampler_name(defaults.sampler)));
	add("--estimator", raw.estimator, "NAME",
	    fmt::format("path: lamps are met by chance; nee: they are aimed\nat; mis: both, weighed ({})",
	                estimator_name(defaults.estimator)));
	add("--roulette", raw.roulette, "N", "scatterings after which chance may end dim paths; 0: it\nnever does (0)");
}

void add_image_options(CLI::App& app, RenderOptions& options, RawRender& raw)
{
	add_scene_options(app, options, raw);
	const auto add = [&app](const char* name, std::string& value, const char* type, const std::string& text) {
		app.add_option(name, value, text)->type_name(type)->group("Image");
	};
	add("--error", raw.error, "E",
	    fmt::format("stop each tile when its relative error is below E;\n--samples is then the most that one may get\n"
	                "({})",
	                adaptive_sample_limit));
	add("--time-limit", raw.time_limit, "S", "stop after S seconds of rendering, or at --samples");
	add("--frames", raw.frames, "A:B", "frames A to B, both included, or one frame (0)");
	add("--pixel", raw.pixel, "X,Y", "only this pixel, with the bits it has in the whole");
	add("--crop", raw.crop, "X0,X1,Y0,Y1", "only columns X0 to X1 - 1 and rows Y0 to Y1 - 1");
}

void add_output_options(CLI::App& app, RenderOptions& options, RawRender& raw)
{
	const auto add = [&app](const char* name, std::string& value, const char* type, const std::string& text) {
		app.add_option(name, value, text)->type_name(type)->group("Output");
	};
	add("-o,--output,--outfile", options.output, "FILE",
	    ".png, .exr, .pfm or .rtfilm; without extension\nFILE_000000000.png, numbered by frame; - for\n"
	    "PNG on standard output (SCENE.png)");
	add("--transfer", raw.transfer, "NAME", "srgb, gamma2 or linear, for 8-bit files (srgb)");
	add("--exposure", raw.exposure, "EV", "stops brighter or darker, for 8-bit files (0)");
	add("--checkpoint", options.checkpoint, "FILE", "keep what has been rendered in this .rtfilm");
	add("--checkpoint-every", raw.checkpoint_seconds, "S",
	    fmt::format("seconds between checkpoints ({})", options.checkpoint_seconds));
	add("--resume", options.resume, "FILE", "go on from this .rtfilm");
	add("--stats", options.stats, "FILE", "times, rates and circumstances as JSON; - for\nstandard output");
}

void add_device_options(CLI::App& app, RenderOptions& options, RawRender& raw)
{
	const auto add = [&app](const char* name, std::string& value, const char* type, const std::string& text) {
		app.add_option(name, value, text)->type_name(type)->group("Device");
	};
	add("--backend", options.device.backend, "NAME", "auto, cuda, opencl or reference (auto)");
	add("-d,--device", options.device.device, "X",
	    "index, part of a name, pci:... or uuid:...;\nseveral with commas share the work");
	add("--precision", raw.precision, "NAME",
	    "exact: the same bits on every device; fast: what\nthe device does best, no such promise; double:\n64-bit, "
	    "slow, "
	    "to check the others (exact)");
	app.add_flag("--self-test", options.self_test_afresh, "test the device now, whatever is remembered")
	    ->group("Device");
	app.add_flag("--force-unverified", options.force_unverified,
	             "use a device that fails its self-test; the image\nsays so")
	    ->group("Device");
	app.add_flag("--generic", raw.generic, "a kernel for all scenes, not for this one")->group("Device");
	add("--bvh", raw.bvh, "auto|always|never", "find spheres through a tree (where it is faster)");
	add("--lanes", raw.lanes, "N", "paths a work-item: 1, 4, 8 or 16 (by device and scene)");
}

void add_report_options(CLI::App& app, RenderOptions& options, RawRender& raw)
{
	app.add_option("--progress", raw.progress, "auto (a bar on a terminal), plain, json or none")
	    ->type_name("HOW")
	    ->group("Progress");
	app.add_flag("-q,--quiet", options.quiet, "no progress; of the results only the film's hash")->group("Progress");
	app.add_flag("-v,--verbose", options.verbose, "device, kernel and scene in detail")->group("Progress");
}

Status check_size(const RawRender& raw, RenderOptions& options)
{
	const Range side = image_side;
	if (!raw.size.empty()) {
		if (!raw.width.empty() || !raw.height.empty())
			return usage("--size and --width or --height say the same thing twice", "give one or the other");
		const auto size = numbers_in<2>(raw.size, 'x', side);
		if (!size)
			return usage(fmt::format("--size takes WxH, each from {} to {}, not '{}'", side.min, side.max, raw.size),
			             "two whole numbers with an x between: --size 1920x1080");
		options.width = (*size)[0];
		options.height = (*size)[1];
	}
	if (!raw.width.empty()) {
		RT_TRY_ASSIGN(options.width, parse_number("--width", raw.width, side));
	}
	if (!raw.height.empty()) {
		RT_TRY_ASSIGN(options.height, parse_number("--height", raw.height, side));
	}
	return success();
}

Status check_image(const RawRender& raw, RenderOptions& options)
{
	RT_TRY(check_size(raw, options));
	if (!raw.samples.empty()) {
		RT_TRY_ASSIGN(options.samples, parse_number("--samples", raw.samples, range_of(range::samples)));
	}
	if (!raw.seed.empty()) {
		RT_TRY_ASSIGN(options.seed, parse_number("--seed", raw.seed, range_of(range::seed)));
	}
	if (!raw.max_depth.empty()) {
		RT_TRY_ASSIGN(options.max_depth, parse_number("--max-depth", raw.max_depth, range_of(range::max_depth)));
	}
	if (!raw.sampler.empty()) {
		RT_TRY_ASSIGN(options.sampler, parse_named("--sampler", raw.sampler, all_samplers, sampler_name));
	}
	if (!raw.estimator.empty()) {
		RT_TRY_ASSIGN(options.estimator, parse_named("--estimator", raw.estimator, all_estimators, estimator_name));
	}
	if (!raw.roulette.empty()) {
		RT_TRY_ASSIGN(options.roulette, parse_number("--roulette", raw.roulette, range_of(range::roulette)));
	}
	if (!raw.error.empty()) {
		RT_TRY_ASSIGN(options.error,
		              parse_real("--error", raw.error, 1e-5, 1, "0.1 is a preview, 0.02 a picture: --error 0.02"));
	}
	if (!raw.time_limit.empty()) {
		RT_TRY_ASSIGN(options.time_limit,
		              parse_real("--time-limit", raw.time_limit, 0.1, 1e7, "in seconds: --time-limit 60"));
	}
	if (!raw.frames.empty())
		RT_TRY(parse_frames(raw.frames, options));
	if (!raw.pixel.empty() && !raw.crop.empty())
		return usage("--pixel and --crop exclude each other", "give one or the other");
	if (!raw.pixel.empty()) {
		RT_TRY_ASSIGN(options.window, parse_pixel(raw.pixel));
	}
	if (!raw.crop.empty()) {
		RT_TRY_ASSIGN(options.window, parse_crop(raw.crop));
	}
	return success();
}

Status check_rest(const RawRender& raw, RenderOptions& options)
{
	RT_TRY_ASSIGN(
	    options.display.transfer,
	    parse_word<Transfer>("--transfer", raw.transfer,
	                         {{"srgb", Transfer::Srgb}, {"gamma2", Transfer::Gamma2}, {"linear", Transfer::Linear}}));
	RT_TRY_ASSIGN(options.display.exposure_stops, parse_exposure(raw.exposure));
	RT_TRY_ASSIGN(
	    options.precision,
	    parse_word<Precision>("--precision", raw.precision,
	                          {{"exact", Precision::Exact}, {"fast", Precision::Fast}, {"double", Precision::Double}}));
	options.device.precision = options.precision;
	RT_TRY_ASSIGN(options.progress, parse_progress(raw.progress));
	RT_TRY_ASSIGN(options.bvh, parse_word<Acceleration>("--bvh", raw.bvh,
	                                                    {{"auto", Acceleration::Auto},
	                                                     {"always", Acceleration::Always},
	                                                     {"never", Acceleration::Never}}));
	RT_TRY_ASSIGN(options.lanes, parse_word<std::uint32_t>("--lanes", raw.lanes,
	                                                       {{"auto", 0}, {"1", 1}, {"4", 4}, {"8", 8}, {"16", 16}}));
	if (!raw.checkpoint_seconds.empty()) {
		RT_TRY_ASSIGN(options.checkpoint_seconds,
		              parse_number("--checkpoint-every", raw.checkpoint_seconds, {1, 86400}));
	}
	if (options.precision == Precision::Double && options.lanes > 1)
		return usage(fmt::format("--precision double has one lane, not {}", options.lanes), "leave --lanes out");
	options.specialise = !raw.generic;
	if (options.quiet && options.verbose)
		return usage("--quiet and --verbose exclude each other", "give one or the other");
	if (options.quiet)
		options.progress = ProgressMode::None;
	return success();
}

// Options that are right one by one and wrong together.
Status check_together(const RenderOptions& options)
{
	if (options.frame_count() > 1) {
		if (options.output == "-")
			return usage("several frames cannot go to standard output", "name a file: --output film.png");
		if (!options.checkpoint.empty() || !options.resume.empty())
			return usage("--checkpoint and --resume are for one frame", "render the frames one by one: --frames 7");
	}
	if (options.error) {
		if (options.window)
			return usage("--error is for whole images, not for --crop or --pixel",
			             "when a tile stops depends on its neighbours: give --samples, or leave the part out");
		if (!options.checkpoint.empty() || !options.resume.empty())
			return usage(
			    "--error cannot be combined with --checkpoint or --resume",
			    "a film does not hold what the decisions are made from: leave --error or the file out. An image "
			    "rendered to an error is rendered again by rt reproduce");
	}
	if (options.output == "-" && options.stats == "-")
		return usage("the image and the statistics cannot both go to standard output", "name a file for one of them");
	for (const std::string* file : {&options.checkpoint, &options.resume})
		if (*file == "-")
			return usage("a checkpoint cannot go through standard input or output",
			             "name a file: --checkpoint my.rtfilm");
	return success();
}

Status check_no_empty_value(const CLI::App& app)
{
	for (const CLI::Option* option : app.get_options())
		if (option->get_type_size() > 0 && option->count() > 0 && option->results().back().empty())
			return usage(option->get_name() + " has an empty value", "leave it out or give it a value");
	return success();
}

Result<CommandLine> parse_render(std::vector<std::string> arguments, bool named)
{
	RenderOptions options;
	RawRender raw;
	std::string target_error;
	CLI::App app("Path tracer for spheres: same scene, same seed, same image, bit for bit, on every device.");
	set_manners(app, named ? "rt render" : "rt");
	add_image_options(app, options, raw);
	add_output_options(app, options, raw);
	add_device_options(app, options, raw);
	app.add_flag("--auto-precision", options.auto_precision,
	             "what is quickest for --target-error: precision,\nsampler, estimator and samples, as `rt tradeoff`\n"
	             "measures them, now or before")
	    ->group("Device");
	app.add_option("--target-error", target_error, "relative RMSE that the image may have: 0.02")
	    ->type_name("E")
	    ->group("Device");
	add_report_options(app, options, raw);
	app.footer(named ? examples_text : std::string(commands_text) + "\n" + examples_text);
	RT_TRY_ASSIGN(const auto text, parse(app, std::move(arguments)));
	if (text)
		return CommandLine(*text);
	RT_TRY(check_no_empty_value(app));
	RT_TRY(check_image(raw, options));
	RT_TRY(check_rest(raw, options));
	RT_TRY(check_together(options));
	RT_TRY_ASSIGN(options.target_error, parse_amount("--target-error", target_error, "0.02"));
	if (options.auto_precision != options.target_error.has_value())
		return usage("--auto-precision and --target-error go together",
		             "give both: --auto-precision --target-error 0.02");
	if (options.auto_precision && options.device.device.find(',') != std::string::npos)
		return usage("--auto-precision measures one device", "name one of them with --device");
	for (const char* chosen :
	     {"--precision", "--samples", "--sampler", "--estimator", "--roulette", "--resume", "--error"})
		if (options.auto_precision && app.count(chosen) > 0)
			return usage(fmt::format("--auto-precision chooses what {} says", chosen), "give one or the other");
	return CommandLine(std::move(options));
}

Result<CommandLine> parse_devices(std::vector<std::string> arguments)
{
	DevicesOptions options;
	CLI::App app("Every device of every backend, what is missing, and which package brings it.");
	set_manners(app, "rt devices");
	app.add_flag("-v,--verbose", options.verbose,
	             "test each device and tell all that is known of it,\nand the environment");
	app.add_flag("--json", options.json, "for programs");
	app.add_flag("--self-test", options.self_test_afresh, "with -v: test now, whatever is remembered");
	app.footer("Exit status: 0 if there is a usable device, 3 otherwise.");
	RT_TRY_ASSIGN(const auto text, parse(app, std::move(arguments)));
	if (text)
		return CommandLine(*text);
	return CommandLine(options);
}

Result<CommandLine> parse_info(std::vector<std::string> arguments)
{
	InfoOptions options;
	CLI::App app("What a scene contains, which features of the kernel it needs, and how much memory.");
	set_manners(app, "rt info");
	app.add_option("scene", options.scene, "a scene file, a shipped scene's name, or cloud-N")->type_name("");
	app.add_flag("--json", options.json, "for programs");
	app.add_option("--spheres", options.spheres,
	               "also write the spheres to FILE (f32le-xyzr) and their\nmaterials to FILE.materials (u32le), as "
	               "sphere_sets has\nthem; --json lists the materials")
	    ->type_name("FILE");
	RT_TRY_ASSIGN(const auto text, parse(app, std::move(arguments)));
	if (text)
		return CommandLine(*text);
	if (options.scene.empty())
		return usage("rt info needs a scene", "name a file or a shipped scene: rt info three-spheres");
	return CommandLine(std::move(options));
}

// The options of OpenImageIO's idiff have one dash and many letters.
std::string as_long_option(const std::string& argument)
{
	static constexpr std::string_view names[] = {"fail",          "failpercent", "hardfail",      "failulp", "warn",
	                                             "warnpercent",   "hardwarn",    "warnulp",       "od",      "abs",
	                                             "allowfailures", "scale",       "allowwarnings", "json"};
	const std::string_view name = std::string_view(argument).substr(0, argument.find('='));
	for (const std::string_view known : names)
		if (name.size() == known.size() + 1 && name[0] == '-' && name.substr(1) == known)
			return "-" + argument;
	return argument;
}

// What was typed for a tolerance, before it is checked.
struct RawTolerance {
	std::string value, steps, percent, pixels, hard;
};

Status check_tolerance(const RawTolerance& raw, const std::string& word, Tolerance& tolerance)
{
	RT_TRY_ASSIGN(tolerance.value, parse_positive(("-" + word).c_str(), raw.value));
	RT_TRY_ASSIGN(tolerance.hard, parse_positive(("-hard" + word).c_str(), raw.hard));
	RT_TRY_ASSIGN(const std::optional<double> percent, parse_positive(("-" + word + "percent").c_str(), raw.percent));
	tolerance.percent = percent.value_or(0);
	constexpr Range any = {0, UINT32_MAX};
	if (!raw.steps.empty()) {
		RT_TRY_ASSIGN(tolerance.steps, parse_number(("-" + word + "ulp").c_str(), raw.steps, any));
	}
	if (!raw.pixels.empty()) {
		const std::string option = word == "fail" ? "-allowfailures" : "-allowwarnings";
		RT_TRY_ASSIGN(tolerance.pixels, parse_number(option.c_str(), raw.pixels, any));
	}
	return success();
}

void add_tolerance_options(CLI::App& app, const std::string& word, RawTolerance& raw)
{
	const bool fails = word == "fail";
	const auto add = [&](const std::string& name, std::string& value, const char* type, const std::string& text) {
		app.add_option(name, value, text)->type_name(type)->group(fails ? "Failure" : "Warning");
	};
	add("--" + word, raw.value, "X",
	    fails ? "a pixel fails if it differs by more (in any bit)" : "the same for a warning (in any bit)");
	add("--" + word + "ulp", raw.steps, "N",
	    "by more than N ULPs, codes or units of a film; with\n--" + word + ": by more than both");
	add("--" + word + "percent", raw.percent, "P", "of the pixels may do so (0)");
	add(fails ? "--allowfailures" : "--allowwarnings", raw.pixels, "N", "or so many pixels (0)");
	add("--hard" + word, raw.hard, "X", "but no pixel may differ by more");
}

Result<CommandLine> parse_compare(std::vector<std::string> arguments)
{
	std::transform(arguments.begin(), arguments.end(), arguments.begin(), as_long_option);
	CompareOptions options;
	RawTolerance fail, warn;
	std::string scale;
	bool absolute = false, no_flip = false;
	CLI::App app("Whether two images (PNG, EXR, PFM, .rtfilm) are the same, where they differ, by how much, and\n"
	             "whether that was to be expected. B is the reference.");
	set_manners(app, "rt compare");
	app.get_formatter()->label("Positionals", "Images");
	app.add_option("a", options.a, "an image")->type_name("");
	app.add_option("b", options.b, "the image to hold it against")->type_name("");
	add_tolerance_options(app, "fail", fail);
	add_tolerance_options(app, "warn", warn);
	app.add_flag("-p", options.settings.by_flip, "judge by FLIP, which is what is seen, instead of by values")
	    ->group("Failure");
	const auto output = [](CLI::Option* option) { option->group("Difference image"); };
	output(app.add_option("-o", options.output, "a PNG of |A - B|, or with -p of FLIP")->type_name("FILE"));
	output(app.add_flag("--od", options.output_if_different, "write it only if there is a difference"));
	output(app.add_option("--scale", scale, "times X (so that the largest difference is white)")->type_name("X"));
	output(app.add_flag("--abs", absolute, "for idiff's sake: differences are always absolute"));
	app.add_option("--html", options.html, "the report and the pictures as one page")->type_name("FILE");
	app.add_flag("--hdr-flip", options.settings.hdr_flip, "HDR-FLIP too, over many exposures: takes its time");
	app.add_flag("--no-flip", no_flip, "leave FLIP out");
	app.add_flag("--json", options.json, "for programs");
	app.add_flag("-q,--quiet", options.quiet, "only the verdict");
	app.footer("-fail and so on may be written with one dash, as in OpenImageIO's idiff.\n\n"
	           "Exit status, as idiff's: 0 match; 1 warning; 2 failure, or a wrong command line; 3 different\n"
	           "size; 4 a file cannot be read or written.");
	RT_TRY_ASSIGN(const auto text, parse(app, std::move(arguments)));
	if (text)
		return CommandLine(*text);
	if (options.a.empty() || options.b.empty())
		return usage("rt compare needs two images", "name both: rt compare mine.png yours.png");
	options.settings.flip = !no_flip;
	RT_TRY(check_tolerance(fail, "fail", options.settings.fail));
	RT_TRY(check_tolerance(warn, "warn", options.settings.warn));
	RT_TRY_ASSIGN(options.scale, parse_positive("-scale", scale));
	if (options.html == "-")
		return usage("the page cannot go to standard output", "name a file: --html report.html");
	if (!options.output.empty()) {
		RT_TRY_ASSIGN(const ImageFormat format, image_format_of(options.output));
		if (format != ImageFormat::Png)
			return usage("the difference image is a PNG", "give it such a name: -o difference.png",
			             "-o " + options.output);
	}
	return CommandLine(std::move(options));
}

Result<CommandLine> parse_reproduce(std::vector<std::string> arguments)
{
	ReproduceOptions options;
	RawRender raw;
	CLI::App app("Renders an image again from what it says about itself, on any device, and compares film and pixels.");
	set_manners(app, "rt reproduce");
	app.get_formatter()->label("Positionals", "Image");
	app.add_option("image", options.image, "a PNG, EXR or .rtfilm that rt wrote")->type_name("");
	app.add_option("--scene", options.scene, "the scene's file, if it is not where the image says")->type_name("PATH");
	app.add_option("-o,--output", options.output, "write what was rendered here")->type_name("FILE");
	app.add_flag("--json", options.json, "for programs");
	add_device_options(app, options.render, raw);
	app.remove_option(app.get_option("--precision")); // the image's
	add_report_options(app, options.render, raw);
	app.footer("Exit status: 0 if the film and every pixel are the same to the last bit; 1 if not; others as\n"
	           "rt render's.");
	RT_TRY_ASSIGN(const auto text, parse(app, std::move(arguments)));
	if (text)
		return CommandLine(*text);
	if (options.image.empty())
		return usage("rt reproduce needs an image", "name a file that rt wrote: rt reproduce three-spheres.png");
	RT_TRY(check_rest(raw, options.render));
	return CommandLine(std::move(options));
}

Result<CommandLine> parse_verify(std::vector<std::string> arguments)
{
	VerifyOptions options;
	bool quick = false, full = false;
	std::string progress = "auto";
	CLI::App app(
	    "Are the devices and drivers here right? Their arithmetic by operation, films by hash, devices against\n"
	    "each other, speed. One screen, made for pasting into a bug report.");
	set_manners(app, "rt verify");
	app.add_flag("--quick", quick, "each scene once, with the kernel for all scenes");
	app.add_flag("--full", full, "all shipped scenes, kernels for all and for each,\nour own square roots too");
	app.add_flag("--probe-only", options.probe_only, "the arithmetic alone: a verdict on the driver");
	const auto add = [&app](const char* name, std::string& value, const char* type, const char* text,
	                        const char* group) { app.add_option(name, value, text)->type_name(type)->group(group); };
	add("--json", options.json, "FILE", "everything, for programs; - for standard output", "Output");
	add("--html", options.html, "FILE", "one page with pictures and differences", "Output");
	add("--ledger", options.ledger, "FILE", "add rows to this ledger (docs/ledger.json)", "Output");
	add("--backend", options.device.backend, "NAME", "auto, cuda, opencl or reference (auto: all)", "Device");
	add("-d,--device", options.device.device, "X",
	    "only these: index, part of a name, pci:... or\nuuid:..., with commas", "Device");
	add("--progress", progress, "HOW", "auto (on a terminal), plain, json or none", "Progress");
	app.footer("Exit status: 0 if everything that was asked for passed; 4 if a device computes otherwise\n"
	           "than the numeric contract says; 3, 5, 6 or 1 if one could not be asked; 2 usage; 7 files.");
	RT_TRY_ASSIGN(const auto text, parse(app, std::move(arguments)));
	if (text)
		return CommandLine(*text);
	if (quick && full)
		return usage("--quick and --full exclude each other", "give one or the other, or neither");
	if (options.probe_only && (quick || full))
		return usage("--probe-only leaves out what --quick and --full choose", "give one of them");
	options.depth = quick ? VerifyDepth::Quick : full ? VerifyDepth::Full : VerifyDepth::Standard;
	for (const CLI::Option* option : app.get_options())
		if (option->get_type_size() > 0 && option->count() > 0 && option->results().back().empty())
			return usage(option->get_name() + " has an empty value", "leave it out or give it a value");
	for (const std::string* file : {&options.html, &options.ledger})
		if (*file == "-")
			return usage("only --json can go to standard output", "name a file");
	RT_TRY_ASSIGN(options.progress, parse_progress(progress));
	return CommandLine(std::move(options));
}

Result<CommandLine> parse_trace(std::vector<std::string> arguments)
{
	TraceOptions options;
	RawRender raw;
	raw.transfer = "srgb";
	raw.exposure = "0";
	raw.precision = "exact";
	raw.progress = "auto";
	raw.lanes = "auto";
	std::string sample;
	CLI::App app("One path with all its numbers, or the first operation in which two devices differ.");
	set_manners(app, "rt trace");
	app.add_option("scene", options.render.scene, "a scene file, a shipped scene's name, or cloud-N")->type_name("");
	const auto add = [&app](const char* name, std::string& value, const char* type, const char* group,
	                        const std::string& text) {
		app.add_option(name, value, text)->type_name(type)->group(group);
	};
	add("--pixel", raw.pixel, "X,Y", "Path", "the pixel, row 0 at the top");
	add("--sample", sample, "N", "Path", "which of its samples, from 0 (0; with --against all)");
	add("--width", raw.width, "N", "Path", "size of the image, which decides what a pixel sees");
	add("--height", raw.height, "N", "Path", "rows");
	add("--size", raw.size, "WxH", "Path", "both at once");
	add("--samples,--spp", raw.samples, "N", "Path", "samples a pixel that --against compares");
	add("--seed", raw.seed, "N", "Path", "of the random numbers");
	add("--max-depth", raw.max_depth, "N", "Path", "scatterings after which a path ends");
	add("--sampler", raw.sampler, "NAME", "Path", "independent, stratified or sobol");
	add("--estimator", raw.estimator, "NAME", "Path", "path, nee or mis");
	add("--roulette", raw.roulette, "N", "Path", "scatterings after which chance may end dim paths");
	add("--frames", raw.frames, "N", "Path", "frame of an animated scene (0)");
	add("--against", options.against, "X", "Comparison",
	    "a device or backend (as for --device, --backend), or a trace\nthat was saved with --json: FILE.json");
	add("--json", options.json, "FILE", "Comparison", "save the trace; with --against the one that differs");
	add("--backend", options.render.device.backend, "NAME", "Device", "auto, cuda, opencl or reference (auto)");
	add("-d,--device", options.render.device.device, "X", "Device", "index, part of a name, pci:... or uuid:...");
	add("--lanes", raw.lanes, "N", "Device", "of the ordinary program (by device and scene)");
	app.add_flag("--generic", raw.generic, "a kernel for all scenes, not for this one")->group("Device");
	app.add_flag("-q,--quiet", options.render.quiet, "no progress")->group("Progress");
	app.add_flag("-v,--verbose", options.render.verbose, "how long each step took")->group("Progress");
	app.footer("Exit status: 0 if there is no difference, 1 if there is one; others as for rt render.");
	RT_TRY_ASSIGN(const auto text, parse(app, std::move(arguments)));
	if (text)
		return CommandLine(*text);
	RT_TRY(check_image(raw, options.render));
	RT_TRY(check_rest(raw, options.render));
	if (!sample.empty()) {
		RT_TRY_ASSIGN(options.sample, parse_number("--sample", sample, {0, RT_MAX_SAMPLES - 1}));
		if (!options.render.window)
			return usage("--sample needs a pixel", "rt trace SCENE --pixel 320,240 --sample 0");
	}
	return CommandLine(std::move(options));
}

Result<CommandLine> parse_tradeoff(std::vector<std::string> arguments)
{
	TradeoffOptions options;
	RawRender raw, measured;
	RenderOptions measured_size;
	std::string budget, target_error, limit, reference;
	CLI::App app("Speed against accuracy: renders a scene in every precision, with every sampler and estimator and at "
	             "several numbers of samples, holds the images against a converged one, and names the command line for "
	             "a time or an error.");
	set_manners(app, "rt tradeoff");
	app.add_option("scene", options.render.scene,
	               "a scene file, a shipped scene's name, or cloud-N;\n" + options.render.scene + " if none is named")
	    ->type_name("");
	const auto add = [&app](const char* name, std::string& value, const char* type, const char* group,
	                        const std::string& text) {
		app.add_option(name, value, text)->type_name(type)->group(group);
	};
	add("--budget", budget, "T", "Goal", "seconds that the image may take");
	add("--target-error", target_error, "E", "Goal",
	    "relative RMSE that it may have: 0.02 (without a goal:\nthat of the scene's own settings)");
	add("--for", raw.size, "WxH", "Goal", "size of the image that is wanted (the scene's)");
	add("--size", measured.size, "WxH", "Measuring", "of the images that are measured (320 pixels wide)");
	add("--limit", limit, "S", "Measuring",
	    fmt::format("seconds for all of it; what no longer fits is left\nout, and told ({})", options.limit_seconds));
	add("--reference", reference, "N", "Measuring",
	    fmt::format("samples of the converged image, which is kept for\nlater runs ({})", options.reference_samples));
	add("--seed", raw.seed, "N", "Measuring", "of the random numbers of what is measured (0)");
	add("--max-depth", raw.max_depth, "N", "Measuring", "scatterings after which a path ends");
	add("--frames", raw.frames, "N", "Measuring", "frame of an animated scene (0)");
	add("--json", options.json, "FILE", "Output", "all of it for programs; - for standard output");
	add("--csv", options.csv, "FILE", "Output", "the table; tools/plot_tradeoff.py draws the JSON");
	add_device_options(app, options.render, raw);
	app.remove_option(app.get_option("--precision")); // all of them
	add_report_options(app, options.render, raw);
	app.footer("Examples:\n"
	           "  rt tradeoff weekend --target-error 0.02\n"
	           "  rt tradeoff cornell --budget 5 --for 1920x1080 --json cornell.json\n"
	           "\n"
	           "Ctrl-C keeps what was measured: the table and the files are written, exit status 130.");
	RT_TRY_ASSIGN(const auto text, parse(app, std::move(arguments)));
	if (text)
		return CommandLine(*text);
	RT_TRY(check_no_empty_value(app));
	RT_TRY(check_image(raw, options.render));
	RT_TRY(check_rest(raw, options.render));
	RT_TRY(check_size(measured, measured_size));
	options.width = measured_size.width;
	options.height = measured_size.height;
	RT_TRY_ASSIGN(options.budget, parse_amount("--budget", budget, "10"));
	RT_TRY_ASSIGN(options.target_error, parse_amount("--target-error", target_error, "0.02"));
	if (options.budget && options.target_error)
		return usage("--budget and --target-error exclude each other", "give one or the other");
	if (!limit.empty()) {
		RT_TRY_ASSIGN(options.limit_seconds, parse_number("--limit", limit, {1, 864000}));
	}
	if (!reference.empty()) {
		RT_TRY_ASSIGN(options.reference_samples, parse_number("--reference", reference, {64, RT_MAX_SAMPLES}));
	}
	if (options.render.frame_count() > 1)
		return usage("rt tradeoff measures one frame", "name one: --frames 7");
	if (options.json == "-" && options.csv == "-")
		return usage("only one of --json and --csv can go to standard output", "name a file for the other");
	return CommandLine(std::move(options));
}

Result<CommandLine> parse_bench(std::vector<std::string> arguments)
{
	BenchOptions options;
	RawRender raw;
	std::string repeats, sweep = "none", limit;
	CLI::App app("How fast a device renders a scene: samples and rays a second, the time of each part, and the share "
	             "of the device's measured peak. Renders once to warm up, then again and again; writes no image.");
	set_manners(app, "rt bench");
	add_scene_options(app, options.render, raw);
	add_device_options(app, options.render, raw);
	const auto add = [&app](const char* name, std::string& value, const char* type, const std::string& text) {
		app.add_option(name, value, text)->type_name(type)->group("Benchmark");
	};
	add("--repeats", repeats, "N", fmt::format("renders after the first one ({})", options.repeats));
	add("--sweep", sweep, "WHAT",
	    "how time grows with pixels, samples, spheres (of\ncloud-N), depth, or threads of a processor; sizes\n"
	    "given by other options are the largest");
	add("--limit", limit, "S", fmt::format("a sweep ends before renders longer than this ({})", options.limit_seconds));
	add("--json", options.json, "FILE", "all of it for programs; - for standard output");
	app.add_flag("-q,--quiet", options.quiet, "no table and no progress")->group("Benchmark");
	app.footer("Examples:\n"
	           "  rt bench weekend --size 1200x675 --spp 100\n"
	           "  rt bench --backend reference --sweep threads\n"
	           "  rt bench --sweep spheres --size 400x225 --spp 16 --json spheres.json");
	RT_TRY_ASSIGN(const auto text, parse(app, std::move(arguments)));
	if (text)
		return CommandLine(*text);
	RT_TRY(check_no_empty_value(app));
	RT_TRY(check_image(raw, options.render));
	RT_TRY(check_rest(raw, options.render));
	if (!repeats.empty()) {
		RT_TRY_ASSIGN(options.repeats, parse_number("--repeats", repeats, {1, 1000}));
	}
	if (!limit.empty()) {
		RT_TRY_ASSIGN(options.limit_seconds, parse_number("--limit", limit, {1, 86400}));
	}
	RT_TRY_ASSIGN(options.sweep, parse_word<Sweep>("--sweep", sweep,
	                                               {{sweep_name(Sweep::None), Sweep::None},
	                                                {sweep_name(Sweep::Pixels), Sweep::Pixels},
	                                                {sweep_name(Sweep::Samples), Sweep::Samples},
	                                                {sweep_name(Sweep::Spheres), Sweep::Spheres},
	                                                {sweep_name(Sweep::Depth), Sweep::Depth},
	                                                {sweep_name(Sweep::Threads), Sweep::Threads}}));
	return CommandLine(std::move(options));
}

} // namespace

const char* sweep_name(Sweep sweep)
{
	switch (sweep) {
	case Sweep::None:
		return "none";
	case Sweep::Pixels:
		return "pixels";
	case Sweep::Samples:
		return "samples";
	case Sweep::Spheres:
		return "spheres";
	case Sweep::Depth:
		return "depth";
	case Sweep::Threads:
		return "threads";
	}
	return "";
}

RenderSettings RenderOptions::settings_over(const RenderSettings& scene_settings) const
{
	RenderSettings settings = scene_settings;
	settings.width = width.value_or(settings.width);
	settings.height = height.value_or(settings.height);
	settings.samples = samples.value_or(time_limit ? std::uint32_t(RT_MAX_SAMPLES)
	                                    : error    ? adaptive_sample_limit
	                                               : settings.samples);
	settings.seed = seed.value_or(settings.seed);
	settings.max_depth = max_depth.value_or(settings.max_depth);
	settings.sampler = sampler.value_or(settings.sampler);
	settings.estimator = estimator.value_or(settings.estimator);
	settings.roulette = roulette.value_or(settings.roulette);
	return settings;
}

Result<CommandLine> parse_command_line(int argc, const char* const* argv)
{
	std::vector<std::string> arguments(argv + std::min(argc, 1), argv + argc);
	const std::string command = arguments.empty() ? "" : arguments.front();
	const auto rest = [&arguments] { return std::vector<std::string>(arguments.begin() + 1, arguments.end()); };
	if (command == "render")
		return parse_render(rest(), true);
	if (command == "devices")
		return parse_devices(rest());
	if (command == "info")
		return parse_info(rest());
	if (command == "compare")
		return parse_compare(rest());
	if (command == "reproduce")
		return parse_reproduce(rest());
	if (command == "verify")
		return parse_verify(rest());
	if (command == "trace")
		return parse_trace(rest());
	if (command == "tradeoff")
		return parse_tradeoff(rest());
	if (command == "bench")
		return parse_bench(rest());
	if (command == "help")
		return parse_render({"--help"}, false);
	return parse_render(std::move(arguments), false);
}

} // namespace rt
