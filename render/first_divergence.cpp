#include "render/first_divergence.h"

#include "backends/self_test.h"

#include <algorithm>
#include <chrono>
#include <fmt/format.h>

namespace rt {
namespace {

using Clock = std::chrono::steady_clock;

// A pass: samples, taken by launches of so many each.
struct Pass {
	std::uint32_t first_sample, samples, launch_samples;
};

std::vector<Pass> passes_of(std::uint32_t samples)
{
	std::vector<Pass> passes;
	for (std::uint32_t first = 0, size = 1; first < samples; first += size, size = 3 * first) {
		const std::uint32_t taken = std::min(size, samples - first);
		// At least three launches where there are three samples.
		const std::uint32_t launch = std::clamp((taken + 2) / 3, 1u, RT_MAX_SAMPLES_PER_LAUNCH);
		passes.push_back({first, taken, launch});
		size = taken;
	}
	return passes;
}

class Search {
public:
	Search(const PackedScene& packed, const TracedDevice& judged, const TracedDevice& against,
	       const DivergenceOptions& options)
	    : packed_(packed), judged_(judged), against_(against), options_(options)
	{
	}

	Result<Divergence> run()
	{
		RT_TRY(prepare());
		if (options_.pixel) {
			RT_TRY(search_pixel(options_.pixel->first, options_.pixel->second));
			return std::move(result_);
		}
		RT_TRY(search_image());
		if (result_.images_differ())
			RT_TRY(search_differing_pixels());
		return std::move(result_);
	}

private:
	// ---- both devices ----

	SessionOptions session_options(const TracedDevice& device) const
	{
		SessionOptions session;
		session.specialise = options_.specialise;
		session.lanes = device.device->info().native_lanes > 1 ? options_.lanes : 0;
		session.software_roots = device.software_roots;
		session.stop = options_.stop;
		return session;
	}

	Status prepare()
	{
		const auto start = begin("compiling the programs");
		RT_TRY_ASSIGN(judged_tracer_, tracer_of(judged_));
		RT_TRY_ASSIGN(against_tracer_, tracer_of(against_));
		RT_TRY(check_program(*judged_tracer_));
		RT_TRY(check_program(*against_tracer_));
		end("programs", start);
		return success();
	}

	Result<std::optional<Tracer>> tracer_of(const TracedDevice& device) const
	{
		RT_TRY_ASSIGN(Tracer tracer, Tracer::make(device.device, packed_, session_options(device)));
		return std::optional<Tracer>(std::move(tracer));
	}

	// Is the program that runs the one that was asked for?
	Status check_program(Tracer& tracer)
	{
		RT_TRY_ASSIGN(const std::uint32_t id, tracer.program_id());
		if (id != 0 && id != tracer.expected_program_id() && result_.stale_device.empty()) {
			result_.stale_device = tracer.info().name;
			result_.stale_id = id;
			result_.expected_id = tracer.expected_program_id();
		}
		return success();
	}

	Clock::time_point begin(const std::string& what) const
	{
		if (options_.status)
			options_.status(what);
		return Clock::now();
	}

	void end(const char* what, Clock::time_point start)
	{
		result_.steps.push_back({what, std::chrono::duration<double>(Clock::now() - start).count()});
	}

	Status check_stop() const
	{
		if (options_.stop && options_.stop->load())
			return Error{ErrorKind::Interrupted, "the search was stopped", {}, {}, {}};
		return success();
	}

	// ---- image to pixel ----

	Result<Film> image(const TracedDevice& device, const Pass& pass) const
	{
		SessionOptions session = session_options(device);
		session.first_sample = pass.first_sample;
		session.samples = pass.samples;
		session.samples_per_launch = pass.launch_samples;
		RT_TRY_ASSIGN(SessionResult rendered, render_scene(packed_, {device.device}, session));
		RT_TRY(check_stop());
		return std::move(rendered.film);
	}

	Status search_image()
	{
		auto start = begin("comparing the images");
		result_.pixels = std::uint64_t(packed_.scene.window_width) * packed_.scene.window_height;
		for (const Pass& pass : passes_of(options_.samples)) {
			RT_TRY_ASSIGN(const Film mine, image(judged_, pass));
			RT_TRY_ASSIGN(const Film theirs, image(against_, pass));
			result_.samples_compared = pass.first_sample + pass.samples;
			for (std::uint64_t i = 0; i < result_.pixels; ++i)
				if (!std::equal(mine.sums().begin() + static_cast<std::ptrdiff_t>(3 * i),
				                mine.sums().begin() + static_cast<std::ptrdiff_t>(3 * i + 3),
				                theirs.sums().begin() + static_cast<std::ptrdiff_t>(3 * i)))
					different_.push_back(i);
			if (!different_.empty()) {
				pass_ = pass;
				break;
			}
			if (pass.first_sample == 0) {
				// Before the rest of the image: a difference that rounding hides would cost all of its samples, and
				// might not show then.
				end("images", start);
				RT_TRY(trace_sample_of_pixels());
				if (result_.operation)
					return success();
				start = Clock::now();
			}
			if (options_.status)
				options_.status(fmt::format("the images are the same with {} of {} samples", result_.samples_compared,
				                            options_.samples));
		}
		result_.different_pixels = different_.size();
		end("images", start);
		return success();
	}

	// ---- pixel to sample ----

	struct Pair {
		rt_film_pixel mine{}, theirs{};
		bool same() const { return same_sums(mine, theirs); }
	};

	Result<Pair> render_both(const PixelLaunch& launch, std::uint32_t max_depth = 0)
	{
		RT_TRY(check_stop());
		Pair pair;
		RT_TRY_ASSIGN(pair.mine, judged_tracer_->render(launch, max_depth));
		RT_TRY_ASSIGN(pair.theirs, against_tracer_->render(launch, max_depth));
		return pair;
	}

	// The launch of the pass after which the pixel differs, made as small as it can be; nothing if none does.
	Result<std::optional<PixelLaunch>> differing_launch(std::uint32_t x, std::uint32_t y)
	{
		PixelLaunch launch;
		launch.x = x;
		launch.y = y;
		const std::uint32_t end = pass_.first_sample + pass_.samples;
		for (std::uint32_t first = pass_.first_sample; first < end; first += pass_.launch_samples) {
			launch.first_sample = first;
			launch.samples = std::min(pass_.launch_samples, end - first);
			RT_TRY_ASSIGN(const Pair pair, render_both(launch));
			if (!pair.same()) {
				RT_TRY_ASSIGN(launch, smallest(launch));
				RT_TRY_ASSIGN(const Pair smaller, render_both(launch));
				result_.judged = smaller.mine;
				result_.against = smaller.theirs;
				return std::optional<PixelLaunch>(launch);
			}
			launch.before = pair.theirs;
		}
		return std::optional<PixelLaunch>();
	}

	Result<PixelLaunch> smallest(PixelLaunch launch)
	{
		PixelLaunch smaller = launch;
		smaller.before = {};
		smaller.samples = 1;
		for (; smaller.first_sample < launch.first_sample + launch.samples; ++smaller.first_sample) {
			RT_TRY_ASSIGN(const Pair pair, render_both(smaller));
			if (!pair.same())
				return smaller; // one sample alone
		}
		smaller.first_sample = launch.first_sample;
		for (; smaller.samples <= launch.samples; ++smaller.samples) {
			RT_TRY_ASSIGN(const Pair pair, render_both(smaller));
			if (!pair.same())
				return smaller; // samples of one launch
		}
		return launch; // on top of what the film held
	}

	// ---- sample to operation ----

	Result<bool> compare_traces(const PixelLaunch& launch)
	{
		RT_TRY(check_stop());
		TraceComparison comparison;
		for (std::uint64_t first = 0;; first += options_.most_notes) {
			RT_TRY_ASSIGN(const Trace mine, judged_tracer_->trace(launch, first, options_.most_notes));
			RT_TRY_ASSIGN(const Trace theirs, against_tracer_->trace(launch, first, options_.most_notes));
			if (!comparison.compare(mine, theirs)) {
				result_.launch = launch;
				result_.operation = comparison.difference();
				break;
			}
			if (first + options_.most_notes >= std::max(mine.note_count, theirs.note_count))
				break;
		}
		result_.notes_compared += comparison.compared();
		result_.traces_compared += 1;
		if (result_.operation && result_.operation->expected.code.kind == TraceKind::Load)
			RT_TRY(check_layout());
		return result_.operation.has_value();
	}

	// A read that differs: of a struct that the device lays out otherwise?
	Status check_layout()
	{
		for (const TracedDevice* device : {&judged_, &against_}) {
			RT_TRY_ASSIGN(const SelfTestItem item, test_layout(device->device));
			if (!item.passed)
				result_.layout_failure = item.detail;
		}
		return success();
	}

	Status search_differing_pixels()
	{
		auto start = begin("looking for the sample");
		const std::uint32_t width = packed_.scene.window_width;
		// Of a fault that the traced program does not show in one pixel it may show another.
		constexpr std::size_t most_pixels = 8;
		const std::size_t step = std::max<std::size_t>(1, different_.size() / most_pixels);
		std::optional<PixelLaunch> first;
		rt_film_pixel first_judged{}, first_against{};
		for (std::size_t i = 0; i < different_.size() && !result_.operation; i += step) {
			const auto x = static_cast<std::uint32_t>(different_[i] % width);
			const auto y = static_cast<std::uint32_t>(different_[i] / width);
			RT_TRY_ASSIGN(const std::optional<PixelLaunch> launch, differing_launch(x, y));
			if (i == 0)
				end("pixel and sample", start);
			if (!launch) {
				if (!first) {
					PixelLaunch whole;
					whole.x = x;
					whole.y = y;
					whole.first_sample = pass_.first_sample;
					whole.samples = pass_.samples;
					result_.launch = whole;
				}
				continue;
			}
			if (!first) {
				first = launch;
				first_judged = result_.judged;
				first_against = result_.against;
			}
			const auto trace_start = begin("comparing operations");
			RT_TRY(compare_traces(*launch));
			end("operations", trace_start);
		}
		result_.alone = first.has_value();
		if (result_.operation || !first)
			return success();
		result_.launch = first;
		result_.judged = first_judged;
		result_.against = first_against;
		return result_.stale_device.empty() ? narrow_ordinary_program() : success();
	}

	// The traced programs agree and the ordinary ones do not: what can be told from outside.
	Status narrow_ordinary_program()
	{
		const auto start = begin("limiting the depth");
		for (std::uint32_t depth = 1; depth <= packed_.scene.max_depth && !result_.differing_depth; ++depth) {
			RT_TRY_ASSIGN(const Pair pair, render_both(*result_.launch, depth));
			if (!pair.same())
				result_.differing_depth = depth;
		}
		SessionOptions session = session_options(judged_);
		if (render_lanes(packed_, judged_.device->info(), session) > 1) {
			session.lanes = 1;
			RT_TRY_ASSIGN(Tracer one_lane, Tracer::make(judged_.device, packed_, session));
			RT_TRY_ASSIGN(const rt_film_pixel pixel, one_lane.render(*result_.launch));
			result_.one_lane_agrees = same_sums(pixel, result_.against);
		}
		end("narrowing", start);
		return success();
	}

	// ---- without an image ----

	Status search_pixel(std::uint32_t x, std::uint32_t y)
	{
		const auto start = begin("comparing the pixel");
		result_.pixels = 1;
		result_.samples_compared = options_.sample ? 1 : options_.samples;
		pass_ = options_.sample ? Pass{*options_.sample, 1, 1}
		                        : Pass{0, options_.samples, std::clamp((options_.samples + 2) / 3, 1u, 64u)};
		RT_TRY_ASSIGN(const std::optional<PixelLaunch> launch, differing_launch(x, y));
		end("pixel and sample", start);
		result_.different_pixels = launch ? 1 : 0;
		result_.launch = launch;
		const auto trace_start = begin("comparing operations");
		if (launch) {
			RT_TRY(compare_traces(*launch));
		} else {
			PixelLaunch one;
			one.x = x;
			one.y = y;
			one.first_sample = pass_.first_sample;
			RT_TRY(compare_traces(one));
		}
		end("operations", trace_start);
		return launch && !result_.operation ? narrow_ordinary_program() : success();
	}

	// The images are the same; so should be the operations, also those whose differences no image shows.
	Status trace_sample_of_pixels()
	{
		const auto start = begin("comparing operations");
		for (std::uint32_t i = 0; i < options_.pixels_to_trace && !result_.operation; ++i) {
			const std::uint64_t pixel = (2 * std::uint64_t(i) + 1) * result_.pixels / (2 * options_.pixels_to_trace);
			PixelLaunch launch;
			// Along the rows' pixels by the golden section, so that columns are tried evenly too.
			launch.y = static_cast<std::uint32_t>(pixel / packed_.scene.window_width);
			launch.x =
			    static_cast<std::uint32_t>((std::uint64_t(i) * 40503u % 65536u) * packed_.scene.window_width >> 16);
			RT_TRY(compare_traces(launch));
		}
		end("operations", start);
		return success();
	}

	const PackedScene& packed_;
	const TracedDevice &judged_, &against_;
	const DivergenceOptions& options_;
	Divergence result_;
	std::optional<Tracer> judged_tracer_, against_tracer_;
	std::vector<std::uint64_t> different_; // pixels
	Pass pass_{};                          // in which they differ
};

} // namespace

Result<Divergence> find_divergence(const PackedScene& packed, const TracedDevice& judged, const TracedDevice& against,
                                   const DivergenceOptions& options)
{
	return Search(packed, judged, against, options).run();
}

} // namespace rt
