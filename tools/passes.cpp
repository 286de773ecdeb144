#include "tools/passes.h"

#include "support/clock.h"

#include <algorithm>
#include <numeric>
#include <utility>

namespace rt {

namespace {

// A stop loses at most about this much work, and the start of a pass costs some milliseconds.
constexpr double pass_seconds = 10;

std::uint64_t total_samples(const Film& film)
{
	return std::accumulate(film.samples().begin(), film.samples().end(), std::uint64_t(0));
}

class Passes {
public:
	Passes(const PackedScene& packed, const std::vector<DeviceHandle>& devices, PassOptions options)
	    : packed_(packed), devices_(devices), options_(std::move(options)),
	      pixels_(std::uint64_t(packed.scene.window_width) * packed.scene.window_height)
	{
	}

	// All passes in one session: programs, lists and trees are made once.
	Result<PassResult> run()
	{
		SessionOptions wanted = options_.session;
		wanted.progress = [this](const Progress& progress) { tell_progress(progress); };
		wanted.snapshot = [this](const Film& film) {
			if (options_.snapshot)
				options_.snapshot(film);
		};
		if (options_.start) {
			wanted.start = &*options_.start;
			done_ = before_ = wanted.start->min_samples();
			segments_before_ = wanted.start->segments;
		}
		if (done_ >= options_.samples) {
			result_.film = std::move(options_.start).value_or(Film());
			return std::move(result_);
		}
		RT_TRY_ASSIGN(Session session, Session::open(packed_, devices_, wanted));
		options_.start.reset();
		last_checkpoint_ = Clock::now();
		while (done_ < options_.samples && !result_.interrupted) {
			const std::uint32_t count = next_count();
			if (count == 0) {
				result_.timed_out = true;
				options_.samples = done_;
			} else {
				RT_TRY(run_pass(session, count));
			}
			RT_TRY(checkpoint(session.film()));
		}
		return finish(std::move(session).finish());
	}

	// All in one, where tiles stop at an error.
	Result<PassResult> run_adaptive(double error)
	{
		AdaptiveOptions adaptive;
		adaptive.session = options_.session;
		adaptive.session.progress = [this](const Progress& progress) {
			if (options_.progress)
				options_.progress(progress, 0);
		};
		adaptive.session.snapshot = options_.snapshot;
		adaptive.error = error;
		adaptive.limit = options_.samples;
		adaptive.seconds = options_.seconds;
		RT_TRY_ASSIGN(AdaptiveResult rendered, render_adaptive(packed_, devices_, adaptive));
		result_.seconds = rendered.session.render_seconds;
		result_.interrupted = rendered.session.interrupted;
		result_.timed_out = rendered.report.timed_out;
		result_.adaptive = std::move(rendered.report);
		return finish(std::move(rendered.session));
	}

private:
	// The first pass of a render that is cut is one sample: it tells how many fit into the time of a pass. 0 if the
	// time is over.
	std::uint32_t next_count() const
	{
		const std::uint32_t left = options_.samples - done_;
		if (!options_.resumable && !options_.seconds)
			return left;
		if (done_ == before_)
			return 1;
		const std::uint32_t taken = done_ - before_;
		const double each = std::max(result_.seconds, 1e-6) / taken;
		double count = left;
		if (options_.resumable)
			count = std::clamp(std::min(pass_seconds, double(options_.checkpoint_seconds)) / each, 1.0, count);
		// Few samples are a poor measure of how long many take.
		if (options_.seconds)
			count = std::min({count, (*options_.seconds - result_.seconds) / each, 4.0 * taken});
		return static_cast<std::uint32_t>(std::max(count, 0.0));
	}

	Status run_pass(Session& session, std::uint32_t count)
	{
		// What a stop would leave of this pass cannot be told from the passes before it.
		std::optional<Film> even;
		if (options_.resumable && done_ > 0)
			even = session.film();
		pass_start_ = Clock::now();
		const Window& window = session.film().window();
		RT_TRY_ASSIGN(const bool is_complete, session.take(done_, count, {{0, 0, window.width, window.height}}));
		result_.seconds += seconds_since(*pass_start_);
		pass_start_.reset();
		result_.interrupted = !is_complete;
		if (is_complete)
			done_ += count;
		else
			result_.even = std::move(even);
		return success();
	}

	// Now and then, and at the end however it came.
	Status checkpoint(const Film& film)
	{
		if (!options_.checkpoint)
			return success();
		if (result_.interrupted)
			return result_.even ? options_.checkpoint(*result_.even) : success();
		if (done_ < options_.samples && seconds_since(last_checkpoint_) < options_.checkpoint_seconds)
			return success();
		RT_TRY(options_.checkpoint(film));
		last_checkpoint_ = Clock::now();
		return success();
	}

	PassResult finish(SessionResult session)
	{
		result_.bvh_seconds = session.bvh_seconds;
		result_.samples = total_samples(session.film) - before_ * pixels_;
		result_.segments = session.film.segments - segments_before_;
		result_.devices = std::move(session.devices);
		result_.film = std::move(session.film);
		return std::move(result_);
	}

	void tell_progress(const Progress& here) const
	{
		if (!options_.progress)
			return;
		Progress total;
		total.samples_done = before_ * pixels_ + here.samples_done;
		total.samples_total = options_.samples * pixels_;
		total.seconds = result_.seconds + (pass_start_ ? seconds_since(*pass_start_) : 0.0);
		if (options_.seconds) { // as many as it will be at this rate
			const double rate = std::max(1.0, *options_.seconds / std::max(total.seconds, 1e-6));
			const auto expected = static_cast<std::uint64_t>(double(here.samples_done) * rate);
			total.samples_total = std::min(total.samples_total, before_ * pixels_ + expected);
		}
		options_.progress(total, before_ * pixels_);
	}

	const PackedScene& packed_;
	const std::vector<DeviceHandle>& devices_;
	PassOptions options_;
	std::uint64_t pixels_;
	PassResult result_;
	std::uint32_t done_ = 0, before_ = 0; // samples a pixel: by now, and before this run
	std::uint64_t segments_before_ = 0;
	std::optional<Clock::time_point> pass_start_; // while one is under way
	Clock::time_point last_checkpoint_;
};

} // namespace

Result<PassResult> render_in_passes(const PackedScene& packed, const std::vector<DeviceHandle>& devices,
                                    PassOptions options)
{
	const std::optional<double> error = options.error;
	Passes passes(packed, devices, std::move(options));
	return error ? passes.run_adaptive(*error) : passes.run();
}

} // namespace rt
