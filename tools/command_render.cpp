#include "tools/command_render.h"

#include "backends/self_test.h"
#include "common/rt_contract.h"
#include "render/image_file.h"
#include "render/scene_file.h"
#include "render/session.h"
#include "support/files.h"
#include "tools/film_provenance.h"
#include "tools/passes.h"
#include "tools/render_stats.h"
#include "tools/report.h"
#include "tools/signals.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <cstdio>
#include <filesystem>
#include <future>
#include <optional>
#include <utility>

#include <unistd.h>

namespace rt {

namespace {

struct OutputFile {
	std::string path;
	ImageFormat format = ImageFormat::Png;
};

// The file of a frame: FILE.ext as it is, numbered where there are several frames; PREFIX_000000000.png without one.
Result<OutputFile> output_file(const RenderOptions& options, const std::string& scene_name, std::uint32_t frame)
{
	const std::string asked = options.output.empty() ? scene_name + ".png" : options.output;
	if (asked == "-")
		return OutputFile{asked, ImageFormat::Png};
	const std::filesystem::path path(asked);
	if (!path.has_filename())
		return Error{ErrorKind::Usage, fmt::format("'{}' is a directory, not a file", asked), "--output",
		             "add a file's name to it", ""};
	if (!path.has_extension())
		return OutputFile{fmt::format("{}_{:09}.png", asked, frame), ImageFormat::Png};
	RT_TRY_ASSIGN(const ImageFormat format, image_format_of(asked));
	if (options.frame_count() == 1)
		return OutputFile{asked, format};
	std::filesystem::path numbered = path;
	numbered.replace_filename(fmt::format("{}_{:09}{}", path.stem().string(), frame, path.extension().string()));
	return OutputFile{numbered.string(), format};
}

// The part of the image to render, which must lie in it.
Result<Window> window_in(const RenderOptions& options, const RenderSettings& settings)
{
	if (!options.window)
		return Window{0, 0, settings.width, settings.height};
	const Window& window = *options.window;
	// No sum overflows: the command line's numbers are far below 2^31.
	if (window.x + window.width > settings.width || window.y + window.height > settings.height)
		return Error{ErrorKind::Usage,
		             fmt::format("columns {} to {} and rows {} to {} are not all in an image of {}x{}", window.x,
		                         window.x + window.width - 1, window.y, window.y + window.height - 1, settings.width,
		                         settings.height),
		             "--crop or --pixel",
		             fmt::format("columns go from 0 to {}, rows from 0 to {}, row 0 at the top", settings.width - 1,
		                         settings.height - 1),
		             ""};
	return window;
}

class RenderCommand {
public:
	// With `keep` the film goes there and into no file.
	explicit RenderCommand(const RenderOptions& options, RenderedFilm* keep = nullptr)
	    : options_(options), keep_(keep), display_(options.progress)
	{
	}

	Status run()
	{
		times_.begin("load_scene");
		RT_TRY_ASSIGN(scene_file_, open_scene(options_.scene));
		if (scene_file_.coarse_spheres > 0)
			report_warning(
			    fmt::format("the scene's files round the coordinates of {} by more than 1e-4 of the radius",
			                plural(scene_file_.coarse_spheres, "sphere")),
			    "write the scene, camera and all, nearer to the origin; rt itself loses nothing by an offset");
		RT_TRY(check_outputs());
		// The first frame is checked before a device is touched: most mistakes are in the scene.
		RT_TRY(prepare(options_.first_frame));
		RT_TRY(open_devices());
		catch_signals();
		for (std::uint32_t frame = options_.first_frame;; frame++) {
			if (frame != options_.first_frame)
				RT_TRY(prepare(frame));
			RT_TRY(render());
			if (frame == options_.last_frame)
				return success();
			if (stop_requested())
				return Error{ErrorKind::Interrupted, fmt::format("after frame {}", frame), output_path(),
				             fmt::format("go on with --frames {}:{}", frame + 1, options_.last_frame), ""};
		}
	}

private:
	// Nothing is rendered that could not be kept.
	Status check_outputs() const
	{
		if (options_.output == "-" && isatty(STDOUT_FILENO) == 1)
			return Error{ErrorKind::Usage, "a PNG file is not shown on a terminal", "--output -",
			             "send standard output to a file or a program, or name a file", ""};
		for (const std::string* file : {&options_.stats, &options_.checkpoint})
			if (!file->empty())
				RT_TRY(check_writable(*file));
		return success();
	}

	// From the scene file to what the kernels read, for one frame.
	Status prepare(std::uint32_t frame)
	{
		RT_TRY_ASSIGN(output_, output_file(options_, scene_file_.base.name, frame));
		if (!keep_)
			RT_TRY(check_writable(output_.path));
		if (options_.precision == Precision::Fast && output_.format == ImageFormat::Pfm &&
		    frame == options_.first_frame)
			report_warning("a .pfm file has no room for the mark that its image is of precision fast",
			               "write .png, .exr or .rtfilm, which carry it");
		times_.begin("pack_scene");
		RT_TRY_ASSIGN(const Scene scene, scene_file_.at_frame(frame));
		origin_.scene = options_.scene;
		origin_.scene_hash = scene.hash;
		origin_.frame = frame;
		origin_.settings = options_.settings_over(scene.render);
		origin_.display = options_.display;
		origin_.precision = options_.precision;
		origin_.error.reset();
		origin_.time_limit.reset();
		RT_TRY_ASSIGN(origin_.window, window_in(options_, origin_.settings));
		RT_TRY_ASSIGN(packed_, pack_scene(scene, origin_.settings, origin_.window));
		times_.end();
		if (options_.verbose)
			note(fmt::format("{}: {}, {}; features {}", options_.scene, plural(packed_.spheres.size(), "sphere"),
			                 format_bytes(packed_.bytes()), fmt::join(feature_names(packed_.features), " ")));
		return success();
	}

	Status open_devices()
	{
		times_.begin("enumerate");
		RT_TRY_ASSIGN(const std::vector<DeviceInfo> chosen, find_devices(options_.device));
		display_.set_device(device_label(chosen));
		for (const DeviceInfo& info : chosen) {
			times_.begin("open_device");
			RT_TRY_ASSIGN(DeviceHandle device, open_device(info));
			times_.begin("self_test");
			RT_TRY(test(device->info()));
			origin_.devices.push_back(std::move(device));
		}
		times_.end();
		return success();
	}

	static std::string device_label(const std::vector<DeviceInfo>& chosen)
	{
		return chosen.size() == 1 ? chosen[0].name : fmt::format("{} devices", chosen.size());
	}

	// On a device's first start its test takes a compiler's time. Meanwhile the session is made ready for it: the
	// scene's tree, its program, its lists on the device. So the test is run beside that, by a handle of its own, and
	// heard before anything is launched.
	Status test(const DeviceInfo& info)
	{
		const bool afresh = options_.self_test_afresh;
		const Precision precision = options_.precision;
		if (!afresh)
			if (const std::optional<SelfTestReport> known = remembered_self_test(info, precision))
				return judge(info, *known);
		auto report = std::async(std::launch::async, [=]() -> Result<SelfTestReport> {
			RT_TRY_ASSIGN(const DeviceHandle own, open_device(info));
			return self_test(own, !afresh, precision);
		});
		tests_.emplace_back(info, std::move(report));
		return success();
	}

	// True if a device needs software roots.
	Result<bool> hear_tests()
	{
		if (!tests_.empty())
			times_.begin("self_test");
		for (auto& [info, report] : std::exchange(tests_, {})) {
			display_.status("testing " + describe(info));
			RT_TRY(judge(info, report.get()));
		}
		return software_roots_;
	}

	Status judge(const DeviceInfo& info, const Result<SelfTestReport>& report)
	{
		if (!report) {
			if (!options_.force_unverified)
				return report.error();
			take_unverified(info, "the self-test could not be run: " + report.error().message);
			return success();
		}
		software_roots_ = software_roots_ || report->needs_software_roots;
		if (options_.verbose)
			note(fmt::format("{}: driver {}, self-test {} in {}{}{}", describe(info), info.driver,
			                 report->passed ? "passed" : "failed", format_seconds(report->seconds),
			                 report->from_cache ? " (remembered)" : "",
			                 report->needs_software_roots ? ", our own square root and reciprocal" : ""));
		if (report->passed) {
			if (origin_.self_test.empty())
				origin_.self_test = "passed";
			return success();
		}
		if (options_.force_unverified) {
			take_unverified(info, report->first_failure());
			return success();
		}
		std::string failures; // all of them, where the message does not say it all
		unsigned count = 0;
		for (const SelfTestItem& item : report->items)
			if (!item.passed && item.required) {
				failures += fmt::format("{}: {}\n", item.name, item.detail);
				count++;
			}
		if (count == 1)
			failures.clear();
		Error failed = failed_self_test(info, *report, "renders all the same, and the image will say so");
		failed.log = failures;
		return failed;
	}

	void take_unverified(const DeviceInfo& info, const std::string& failure)
	{
		if (origin_.self_test.empty() || origin_.self_test == "passed")
			origin_.self_test = "failed: " + failure;
		display_.clear();
		report_warning(fmt::format("{} is not verified: {}", describe(info), failure),
		               "compare its image with that of a verified device before you trust it");
	}

	// What chooses the program.
	SessionOptions session_options() const
	{
		SessionOptions session;
		session.precision = options_.precision;
		session.specialise = options_.specialise;
		session.software_roots = software_roots_;
		session.bvh = options_.bvh;
		session.lanes = options_.lanes;
		return session;
	}

	bool is_resumable() const
	{
		return !options_.error && (!options_.checkpoint.empty() || output_.format == ImageFormat::RtFilm);
	}

	Status render()
	{
		PassOptions passes;
		passes.samples = origin_.settings.samples;
		passes.resumable = is_resumable();
		passes.error = options_.error;
		passes.seconds = options_.time_limit;
		passes.checkpoint_seconds = options_.checkpoint_seconds;
		passes.session = session_options();
		passes.session.stop = &stop_requested();
		passes.session.status = [this](const std::string& text) { display_.status(text); };
		passes.session.snapshot_wanted = take_snapshot_request;
		passes.session.late_software_roots = [this] {
			const Result<bool> needed = hear_tests();
			times_.begin("render");
			return needed;
		};
		passes.snapshot = [this](const Film& film) { write_snapshot(film); };
		passes.progress = [this](const Progress& progress, std::uint64_t before) {
			catch_signals(); // the kernel's compilation lies between the last call and the first progress
			display_.update(progress, before);
		};
		if (!options_.checkpoint.empty())
			passes.checkpoint = [this](const Film& film) {
				return write_image(film, options_.checkpoint, ImageFormat::RtFilm, options_.display,
				                   provenance_of(origin_, film, {}));
			};
		if (!options_.resume.empty()) {
			times_.begin("resume");
			RT_TRY_ASSIGN(LoadedFilm loaded, load_film_to_resume(options_.resume, origin_, packed_.film_exponent));
			origin_.resumed = std::move(loaded.provenance);
			passes.start = std::move(loaded.film);
		}
		display_.begin(title(), std::uint64_t(origin_.window.width) * origin_.window.height);
		times_.begin("render");
		Result<PassResult> rendered = render_in_passes(packed_, origin_.devices, std::move(passes));
		display_.clear();
		RT_TRY(hear_tests()); // if nothing was left to render, or it failed before: the device's fault comes first
		if (!rendered)
			return rendered.error();
		times_.begin("write_image");
		const PassResult& result = *rendered;
		if (result.interrupted)
			return finish_interrupted(result);
		origin_.error = options_.error;
		origin_.time_limit = options_.time_limit;
		if (result.adaptive)
			origin_.sample_limit = result.adaptive->limit;
		if (keep_)
			*keep_ = {result.film, provenance_of(origin_, result.film, result.devices)};
		else
			RT_TRY(write_output(result.film, result.devices));
		times_.end();
		if (result.film.rejected > 0)
			report_warning(fmt::format("{} were rejected: they were not finite or far too bright",
			                           plural(result.film.rejected, "sample")),
			               "this is a bug of rt or of the device's driver; please report it with the output of "
			               "`rt devices -v`");
		return keep_ ? success() : finish(result, result.film);
	}

	// A name that the user did not choose says it where a viewer shows nothing else and a copy has lost its metadata.
	std::string output_path() const
	{
		if (!options_.output.empty() || origin_.self_test == "passed")
			return output_.path;
		const std::filesystem::path path(output_.path);
		return (path.parent_path() / (path.stem().string() + "-unverified" + path.extension().string())).string();
	}

	std::string shown_path() const { return options_.output == "-" ? "standard output" : output_path(); }

	static void catch_signals()
	{
		catch_snapshot_signal();
		catch_stop_signals();
	}

	std::string title() const
	{
		if (options_.frame_count() == 1)
			return {};
		return fmt::format("frame {} of {}", origin_.frame - options_.first_frame + 1, options_.frame_count());
	}

	Status write_output(const Film& film, const std::vector<DeviceStats>& stats) const
	{
		return write_image(film, output_path(), output_.format, options_.display, provenance_of(origin_, film, stats));
	}

	// SIGUSR1. A failure is told and the render goes on: the disk may have room again when it ends.
	void write_snapshot(const Film& film)
	{
		display_.clear();
		if (keep_)
			report_warning("there is no file for the image so far");
		else if (options_.output == "-")
			report_warning("the image so far was asked for, and standard output takes only one image",
			               "name a file with --output");
		else if (const Status written = write_output(film, {}); !written)
			report_warning("the image so far could not be written: " + written.error().message, written.error().cure);
		else if (!options_.quiet)
			note(fmt::format("{} holds the image so far: {}", output_path(), progress_text(film)));
	}

	// "5 of 16 samples a pixel", or without the wanted number where nobody named one.
	std::string progress_text(const Film& film) const
	{
		const bool open = (options_.error || options_.time_limit) && !options_.samples;
		return open ? fmt::format("{} samples a pixel", samples_text(film))
		            : fmt::format("{} of {} samples a pixel", samples_text(film), origin_.settings.samples);
	}

	// Summary and statistics of a frame whose file is written and holds `kept`.
	Status finish(const PassResult& result, const Film& kept)
	{
		if (options_.verbose)
			for (const DeviceStats& device : result.devices)
				note(fmt::format("{}: kernel {} in {}{}, {}, {}, options {}", device.device,
				                 device.build.from_cache ? "from the cache"
				                 : device.build.embedded ? "as shipped"
				                                         : "built",
				                 format_seconds(device.build.seconds),
				                 device.build.variant.empty() ? "" : " (" + device.build.variant + ")",
				                 plural(device.lanes, "lane"), fmt::format("{} launches", device.launches),
				                 device.build.options.empty() ? "none" : device.build.options));
		RT_TRY(write_stats(result, kept));
		// The summary gives way where standard output carries the image or the statistics.
		const std::string text = summary(result, kept);
		if (options_.output == "-" || options_.stats == "-")
			print_message(text);
		else
			print_result(text);
		return flush_results();
	}

	std::string summary(const PassResult& result, const Film& kept) const
	{
		const std::string film = fmt::format("film {}\n", kept.hash().hex());
		if (options_.quiet)
			return film;
		const RenderSettings& settings = origin_.settings;
		std::string size = fmt::format("{}x{}", settings.width, settings.height);
		if (options_.window)
			size = fmt::format("{}x{} of {}", origin_.window.width, origin_.window.height, size);
		std::string text = fmt::format("{}: {}, {} {} a pixel, {}\n", shown_path(), size, samples_text(kept),
		                               kept.max_samples() == 1 ? "sample" : "samples", precision_text());
		std::vector<std::string> names;
		for (const DeviceHandle& device : origin_.devices)
			names.push_back(describe(device->info()));
		const double seconds = result.seconds > 0 ? result.seconds : 1e-9;
		text += fmt::format("{}samples in {} on {}: {}samples/s, {}rays/s{}\n",
		                    format_quantity(static_cast<double>(result.samples)), format_seconds(result.seconds),
		                    fmt::join(names, " and "), format_quantity(static_cast<double>(result.samples) / seconds),
		                    format_quantity(static_cast<double>(result.segments) / seconds),
		                    origin_.self_test == "passed" ? "" : ", NOT VERIFIED");
		return text + stop_text(result, kept) + film;
	}

	// Where a render ended that was not told a number of samples, and how the same film is made without a clock.
	std::string stop_text(const PassResult& result, const Film& kept) const
	{
		std::string text, options;
		if (result.adaptive && !result.interrupted) {
			const AdaptiveReport& report = *result.adaptive;
			text =
			    fmt::format("relative error below {} in {} of {}, {:.1f} samples a pixel on average\n", *options_.error,
			                report.tiles.size() - report.unfinished, plural(report.tiles.size(), "tile"),
			                static_cast<double>(result.samples) / static_cast<double>(kept.pixels()));
			options = fmt::format("--error {} --samples {}", *options_.error, report.limit);
		} else {
			options = fmt::format("--samples {}", kept.min_samples());
		}
		if (result.timed_out)
			text += fmt::format("stopped by the time limit of {} s; the same film again: {}\n", *options_.time_limit,
			                    options);
		return text;
	}

	// What the image may be compared with.
	std::string precision_text() const
	{
		const std::string name = precision_name(options_.precision);
		return options_.precision == Precision::Fast ? name + ": other devices and versions make other bits" : name;
	}

	// One frame: everything in one object. Several: the frames in a list, written anew after each.
	Status write_stats(const PassResult& result, const Film& kept)
	{
		if (options_.stats.empty())
			return success();
		frames_.push_back(frame_json(origin_, packed_, result, kept, output_path()));
		nlohmann::ordered_json all = run_json(origin_, times_);
		if (options_.frame_count() == 1)
			all.update(frames_.front());
		else
			all["frames"] = frames_;
		if (options_.stats != "-")
			return write_file(options_.stats, to_text(all));
		if (origin_.frame == options_.last_frame || result.interrupted)
			print_result(to_text(all));
		return success();
	}

	Status finish_interrupted(const PassResult& result)
	{
		Error stopped{ErrorKind::Interrupted, "", output_path(), "", ""};
		if (keep_) {
			stopped.message = "before the render was complete; nothing was compared";
			stopped.where = "";
			return stopped;
		}
		if (result.film.max_samples() == 0) {
			stopped.message = "before the first sample; nothing was written";
			return stopped;
		}
		// A film to go on from is worth more in an .rtfilm than the few samples that came after it.
		const bool keep_even = output_.format == ImageFormat::RtFilm && result.even;
		const Film& kept = keep_even ? *result.even : result.film;
		RT_TRY(write_output(kept, result.devices));
		times_.end();
		RT_TRY(finish(result, kept));
		stopped.message = fmt::format("{} holds {}", shown_path(), progress_text(kept));
		const std::string from = options_.checkpoint.empty() ? output_path() : options_.checkpoint;
		if (result.even)
			stopped.cure =
			    fmt::format("go on from {} samples a pixel with --resume {}", samples_text(*result.even), from);
		else if (is_resumable())
			stopped.cure = "there is nothing to go on from: not one sample of every pixel was complete";
		else if (options_.error)
			stopped.cure = "it cannot be gone on from; --time-limit ends a render at a film that can be made again";
		else
			stopped.cure = "to be able to go on, render with --checkpoint FILE.rtfilm";
		return stopped;
	}

	void note(const std::string& text)
	{
		display_.clear();
		report_note(text);
	}

	const RenderOptions& options_;
	RenderedFilm* const keep_;
	ProgressDisplay display_;
	PhaseTimes times_;
	SceneFile scene_file_;
	OutputFile output_;
	FilmOrigin origin_;
	PackedScene packed_;
	bool software_roots_ = false;
	std::vector<std::pair<DeviceInfo, std::future<Result<SelfTestReport>>>> tests_; // not heard yet
	std::vector<nlohmann::ordered_json> frames_;
};

} // namespace

Status run_render(const RenderOptions& options)
{
	catch_snapshot_signal();
	return RenderCommand(options).run();
}

Result<RenderedFilm> render_film(const RenderOptions& options)
{
	RenderedFilm kept;
	RT_TRY(RenderCommand(options, &kept).run());
	return kept;
}

} // namespace rt
