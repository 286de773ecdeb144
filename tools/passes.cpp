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

void add_stats(std::vector<DeviceStats>& sum, const std::vector<DeviceStats>& pass)
{
	if (sum.empty()) {
		sum = pass;
		return;
	}
	for (std::size_t i = 0; i < std::min(sum.size(), pass.size()); i++) {
		sum[i].launches += pass[i].launches;
		sum[i].samples += pass[i].samples;
		sum[i].upload_seconds += pass[i].upload_seconds;
		sum[i].launch_seconds += pass[i].launch_seconds;
		sum[i].read_seconds += pass[i].read_seconds;
	}
}

class Passes {
public:
	Passes(const PackedScene& packed, const std::vector<DeviceHandle>& devices, PassOptions options)
	    : packed_(packed), devices_(devices), options_(std::move(options)),
	      pixels_(std::uint64_t(packed.scene.window_width) * packed.scene.window_height)
	{
	}

	Result<PassResult> run()
	{
		if (options_.start) {
			done_ = options_.start->min_samples();
			result_.film = std::move(*options_.start);
			options_.start.reset();
			have_film_ = true;
		}
		before_ = done_;
		last_checkpoint_ = Clock::now();
		while (done_ < options_.samples && !result_.interrupted) {
			const std::uint32_t count = next_count();
			if (count == 0) {
				result_.timed_out = true;
				options_.samples = done_;
				RT_TRY(checkpoint());
				break;
			}
			RT_TRY(run_pass(count));
		}
		return std::move(result_);
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
		SessionResult& session = rendered.session;
		result_.bvh_seconds = session.bvh_seconds;
		result_.seconds = session.render_seconds;
		result_.samples = total_samples(session.film);
		result_.segments = session.film.segments;
		result_.interrupted = session.interrupted;
		result_.timed_out = rendered.report.timed_out;
		result_.devices = std::move(session.devices);
		result_.film = std::move(session.film);
		result_.adaptive = std::move(rendered.report);
		return std::move(result_);
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

	Status run_pass(std::uint32_t count)
	{
		SessionOptions session = options_.session;
		session.first_sample = done_;
		session.samples = count;
		if (done_ > before_)
			session.status = nullptr; // the kernel is compiled by now
		session.progress = [this](const Progress& progress) { tell_progress(progress); };
		session.snapshot = [this](const Film& film) { show_snapshot(film); };
		RT_TRY_ASSIGN(SessionResult pass, render_scene(packed_, devices_, session));
		result_.bvh_seconds += pass.bvh_seconds;
		result_.seconds += pass.render_seconds;
		result_.samples += total_samples(pass.film);
		result_.segments += pass.film.segments;
		result_.interrupted = pass.interrupted;
		add_stats(result_.devices, pass.devices);
		if (pass.interrupted && options_.resumable && done_ > 0)
			result_.even = result_.film;
		if (have_film_) {
			RT_TRY(result_.film.add(pass.film));
		} else {
			result_.film = std::move(pass.film);
		}
		have_film_ = true;
		if (!pass.interrupted)
			done_ += count;
		return checkpoint();
	}

	// Now and then, and at the end however it came.
	Status checkpoint()
	{
		if (!options_.checkpoint)
			return success();
		if (result_.interrupted)
			return result_.even ? options_.checkpoint(*result_.even) : success();
		if (done_ < options_.samples && seconds_since(last_checkpoint_) < options_.checkpoint_seconds)
			return success();
		RT_TRY(options_.checkpoint(result_.film));
		last_checkpoint_ = Clock::now();
		return success();
	}

	void tell_progress(const Progress& pass) const
	{
		if (!options_.progress)
			return;
		Progress whole;
		whole.samples_done = done_ * pixels_ + pass.samples_done;
		whole.samples_total = options_.samples * pixels_;
		whole.seconds = result_.seconds + pass.seconds;
		if (options_.seconds) { // as many as it will be at this rate
			const std::uint64_t here = whole.samples_done - before_ * pixels_;
			const double expected = double(here) * std::max(1.0, *options_.seconds / std::max(whole.seconds, 1e-6));
			whole.samples_total =
			    std::min(whole.samples_total, before_ * pixels_ + static_cast<std::uint64_t>(expected));
		}
		options_.progress(whole, before_ * pixels_);
	}

	void show_snapshot(const Film& pass) const
	{
		if (!options_.snapshot)
			return;
		Film whole = pass;
		// Cannot fail: both are films of this scene, and the last pass will add them just so.
		if (have_film_ && !whole.add(result_.film))
			return;
		options_.snapshot(whole);
	}

	const PackedScene& packed_;
	const std::vector<DeviceHandle>& devices_;
	PassOptions options_;
	std::uint64_t pixels_;
	PassResult result_;
	bool have_film_ = false;
	std::uint32_t done_ = 0, before_ = 0; // samples a pixel: in result_.film, and before this run
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
