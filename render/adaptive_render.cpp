#include "render/adaptive_render.h"

#include "support/clock.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace rt {

namespace {

class AdaptiveRender {
public:
	AdaptiveRender(Session session, const PackedScene& packed, const AdaptiveOptions& options)
	    : session_(std::move(session)), options_(options), exponent_(packed.film_exponent),
	      tiles_(packed.scene.width, packed.scene.height), active_(tiles_.count(), true)
	{
		report_.limit = options.limit;
		report_.tiles_across = tiles_.across();
		report_.tiles.resize(tiles_.count());
	}

	Result<AdaptiveResult> run()
	{
		bool going = true;
		while (going && samples_ < report_.limit && std::find(active_.begin(), active_.end(), true) != active_.end()) {
			const std::uint32_t length = std::min(stage_length(samples_), report_.limit - samples_);
			if (length < stage_length(samples_)) {
				// What the limit leaves is no stage, and nothing is to be decided after it.
				RT_TRY_ASSIGN(going, take(length));
				break;
			}
			RT_TRY_ASSIGN(going, take_stage(length));
			if (going)
				look_at_clock();
		}
		report_.unfinished = static_cast<std::size_t>(
		    std::count_if(report_.tiles.begin(), report_.tiles.end(),
		                  [this](const auto& tile) { return !(tile.bound <= options_.error); }));
		return AdaptiveResult{std::move(session_).finish(), std::move(report_)};
	}

private:
	Result<bool> take_stage(std::uint32_t length)
	{
		RT_TRY_ASSIGN(bool going, take(length / 2));
		if (!going)
			return false;
		tiles_.end_half(session_.film(), active_);
		RT_TRY_ASSIGN(going, take(length / 2));
		if (!going)
			return false;
		tiles_.end_stage(session_.film(), active_);
		decide();
		return true;
	}

	Result<bool> take(std::uint32_t count)
	{
		if (samples_ == 0)
			session_.expect_samples(session_.film().pixels() * options_.limit);
		RT_TRY_ASSIGN(const bool going, session_.take(samples_, count, windows_of(active_, tiles_)));
		if (going) {
			samples_ += count;
			for (std::size_t i = 0; i < active_.size(); ++i)
				if (active_[i])
					report_.tiles[i].samples = samples_;
		}
		return going;
	}

	void decide()
	{
		std::vector<bool> noisy(active_.size());
		for (std::size_t i = 0; i < active_.size(); ++i)
			if (active_[i]) {
				report_.tiles[i].bound = relative_error_bound(tiles_.sums(i), exponent_);
				noisy[i] = !(report_.tiles[i].bound <= options_.error);
			}
		if (samples_ >= adaptive_least_samples)
			active_ = still_active(active_, noisy, tiles_.across());
		expect();
	}

	// Progress: errors fall with the root of the number of samples.
	void expect()
	{
		double total = 0;
		for (std::size_t i = 0; i < active_.size(); ++i) {
			const TileResult& tile = report_.tiles[i];
			const double ratio = std::min(tile.bound / options_.error, 1e6);
			const double wanted = active_[i] ? std::max(samples_ * ratio * ratio, double(samples_)) : tile.samples;
			total += std::min(wanted, double(report_.limit)) * tiles_.sums(i).pixels;
		}
		session_.expect_samples(static_cast<std::uint64_t>(total));
	}

	// Ends the render here if the next stage would end too late, going by the time of this one.
	void look_at_clock()
	{
		const double now = seconds_since(start_);
		const double each = (now - last_) / stage_length(samples_ - 1);
		last_ = now;
		if (!options_.seconds || std::fma(each, stage_length(samples_), now) <= *options_.seconds)
			return;
		if (std::find(active_.begin(), active_.end(), true) == active_.end())
			return;
		report_.limit = samples_;
		report_.timed_out = true;
	}

	Session session_;
	const AdaptiveOptions& options_;
	std::int32_t exponent_;
	TileStatistics tiles_;
	std::vector<bool> active_;
	std::uint32_t samples_ = 0; // of the active tiles' pixels
	Clock::time_point start_ = Clock::now();
	double last_ = 0; // seconds at the last stage's end
	AdaptiveReport report_;
};

} // namespace

Result<AdaptiveResult> render_adaptive(const PackedScene& packed, const std::vector<DeviceHandle>& devices,
                                       const AdaptiveOptions& options)
{
	const rt_scene& scene = packed.scene;
	if (scene.window_width != scene.width || scene.window_height != scene.height)
		return Error{ErrorKind::Usage, "a part of an image cannot be rendered to an error", "",
		             "render the whole image", ""};
	SessionOptions with_tiles = options.session;
	with_tiles.host_bytes_beside = TileStatistics::bytes_needed(scene.width, scene.height);
	RT_TRY_ASSIGN(Session session, Session::open(packed, devices, with_tiles));
	return AdaptiveRender(std::move(session), packed, options).run();
}

} // namespace rt
