#include "render/tradeoff.h"

#include "common/rt_contract.h"
#include "render/compare.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace rt {

namespace {

const RenderSettings plain;

// Scatterings after which roulette begins where it is measured: enough for what is bright to be seen first.
constexpr std::uint32_t grid_roulette = 4;

// ---- errors ---------------------------------------------------------------------------------------------------------

Result<Comparison> compared(const Film& a, const Film& b, bool flip)
{
	CompareSettings settings;
	settings.flip = flip;
	RT_TRY_ASSIGN(Comparison comparison,
	              compare_images(image_of(a, {}, "image"), image_of(b, {}, "reference"), settings));
	if (comparison.verdict == Verdict::DifferentSize)
		return Error{ErrorKind::Usage, "films of different sizes cannot be held against each other", "", "", ""};
	return comparison;
}

Noise noise_of(const Comparison& comparison) { return {comparison.rmse * comparison.rmse, comparison.rel_mse}; }

// ---- curves ---------------------------------------------------------------------------------------------------------

// A bias that chance would not give once in ten thousand images.
constexpr double clear_z = 4;

// Error and time of one configuration on one device over the number of samples.
class Curve {
public:
	// Of the points of that configuration, in any order.
	explicit Curve(std::vector<const TradePoint*> points) : points_(std::move(points))
	{
		std::sort(points_.begin(), points_.end(),
		          [](const TradePoint* a, const TradePoint* b) { return a->samples < b->samples; });
		// Beyond the reference's own error there is nothing to read off.
		while (points_.size() > 1 && points_[points_.size() - 1]->error.is_bound &&
		       points_[points_.size() - 2]->error.is_bound)
			points_.pop_back();
		const ChannelBias& bias = points_.back()->error.clearest_bias();
		if (std::fabs(bias.z) >= clear_z)
			floor_ = std::fabs(bias.relative);
	}

	const TradePoint& first() const { return *points_.front(); }
	bool is_measured(double samples) const
	{
		return samples >= points_.front()->samples && samples <= points_.back()->samples;
	}

	double error_at(double samples) const
	{
		// Beyond what was measured at the rate of independent samples: the slowest there is.
		const auto beyond = [samples](const TradePoint& point) {
			return point.error.noise.rel_rmse() * std::sqrt(point.samples / samples);
		};
		if (samples <= points_.front()->samples)
			return beyond(*points_.front());
		if (samples >= points_.back()->samples)
			return std::max(beyond(*points_.back()), floor_);
		const auto [before, after] = around(samples);
		const double part = std::log(samples / before->samples) / std::log(double(after->samples) / before->samples);
		const double low = std::max(before->error.noise.rel_rmse(), tiny), high = after->error.noise.rel_rmse();
		return low * std::pow(std::max(high, tiny) / low, part);
	}

	double seconds_at(double samples) const
	{
		// Fewer samples than were measured take no longer, and how much less is not known.
		if (samples <= points_.front()->samples)
			return points_.front()->seconds;
		if (samples >= points_.back()->samples)
			return points_.back()->seconds * samples / points_.back()->samples;
		const auto [before, after] = around(samples);
		const double part = (samples - before->samples) / (double(after->samples) - before->samples);
		return before->seconds + part * (after->seconds - before->seconds);
	}

	// The least number of samples that meets the goal `is_met(samples)`, false below some number and true above; or
	// nothing.
	template <class IsMet>
	std::optional<std::uint32_t> least(IsMet is_met) const
	{
		std::uint32_t low = 0, high = RT_MAX_SAMPLES;
		if (!is_met(high))
			return std::nullopt;
		while (high - low > 1) {
			const std::uint32_t middle = low + (high - low) / 2;
			(is_met(middle) ? high : low) = middle;
		}
		return high;
	}

private:
	static constexpr double tiny = 1e-300;

	std::pair<const TradePoint*, const TradePoint*> around(double samples) const
	{
		const auto after = std::find_if(points_.begin(), points_.end(),
		                                [samples](const TradePoint* point) { return point->samples > samples; });
		return {*(after - 1), *after};
	}

	std::vector<const TradePoint*> points_;
	double floor_ = 0; // a bias that more samples do not take away
};

std::vector<Curve> curves_of(const std::vector<TradePoint>& points)
{
	std::vector<std::vector<const TradePoint*>> groups;
	for (const TradePoint& point : points) {
		const auto group = std::find_if(groups.begin(), groups.end(), [&point](const auto& other) {
			return other.front()->device == point.device && other.front()->configuration == point.configuration;
		});
		if (group == groups.end())
			groups.push_back({&point});
		else
			group->push_back(&point);
	}
	return {groups.begin(), groups.end()};
}

// Sobol points are evenest where their number is a power of two.
std::uint32_t power_of_two_up(std::uint32_t samples)
{
	std::uint32_t power = 1;
	while (power < samples && power <= RT_MAX_SAMPLES / 2)
		power *= 2;
	return power;
}

Recommendation recommendation_of(const Curve& curve, std::uint32_t samples, double scale)
{
	return {curve.first().device,    curve.first().configuration, samples, curve.seconds_at(samples) * scale,
	        curve.error_at(samples), !curve.is_measured(samples)};
}

std::optional<Recommendation> best_of(const Curve& curve, const TradeGoal& goal, double scale)
{
	const bool in_powers = curve.first().configuration.sampler == Sampler::Sobol;
	if (goal.rel_rmse) {
		const auto samples = curve.least([&](std::uint32_t count) { return curve.error_at(count) <= *goal.rel_rmse; });
		if (!samples)
			return std::nullopt;
		return recommendation_of(curve, in_powers ? power_of_two_up(*samples) : *samples, scale);
	}
	const double limit = goal.seconds.value_or(0);
	const auto too_many = curve.least([&](std::uint32_t count) { return curve.seconds_at(count) * scale > limit; });
	std::uint32_t samples = too_many ? *too_many - 1 : RT_MAX_SAMPLES;
	if (samples == 0)
		return std::nullopt;
	if (in_powers && power_of_two_up(samples) != samples)
		samples = power_of_two_up(samples) / 2;
	return recommendation_of(curve, samples, scale);
}

} // namespace

void Configuration::apply(RenderSettings& settings, SessionOptions& session) const
{
	settings.sampler = sampler;
	settings.estimator = estimator;
	settings.roulette = roulette;
	session.precision = precision;
}

std::string Configuration::name() const
{
	std::string text = precision_name(precision);
	if (sampler != plain.sampler)
		text += fmt::format(" {}", sampler_name(sampler));
	if (estimator != plain.estimator)
		text += fmt::format(" {}", estimator_name(estimator));
	if (roulette != plain.roulette)
		text += fmt::format(" roulette {}", roulette);
	return text;
}

std::string Configuration::arguments() const
{
	std::string text = fmt::format("--precision {}", precision_name(precision));
	if (sampler != plain.sampler)
		text += fmt::format(" --sampler {}", sampler_name(sampler));
	if (estimator != plain.estimator)
		text += fmt::format(" --estimator {}", estimator_name(estimator));
	if (roulette != plain.roulette)
		text += fmt::format(" --roulette {}", roulette);
	return text;
}

bool aims_at_lamps(const Scene& scene)
{
	const auto any_sphere = [&scene](auto is_such) {
		return std::any_of(scene.spheres.begin(), scene.spheres.end(),
		                   [&](const Sphere& sphere) { return is_such(scene.materials[sphere.material]); });
	};
	return any_sphere([](const Material& material) { return material.kind == Material::Kind::Lambertian; }) &&
	       any_sphere([](const Material& material) {
		       return material.emission[0] > 0 || material.emission[1] > 0 || material.emission[2] > 0;
	       });
}

std::vector<Configuration> configurations_for(const Scene& scene, const DeviceInfo& device)
{
	std::vector<Configuration> all;
	const bool aims = aims_at_lamps(scene);
	for (const Precision precision : {Precision::Exact, Precision::Fast, Precision::Double}) {
		if (!check_precision(device, precision))
			continue;
		for (const Sampler sampler : all_samplers)
			for (const Estimator estimator : all_estimators) {
				const bool is_plain = sampler == plain.sampler && estimator == plain.estimator;
				if ((precision != Precision::Double || is_plain) && (aims || estimator == plain.estimator))
					all.push_back({precision, sampler, estimator, plain.roulette});
			}
		if (precision == Precision::Exact)
			all.push_back({precision, plain.sampler, plain.estimator, grid_roulette});
	}
	return all;
}

Configuration reference_configuration(const Scene& scene)
{
	return {Precision::Double, all_samplers.back(), aims_at_lamps(scene) ? all_estimators.back() : plain.estimator,
	        plain.roulette};
}

double Noise::rmse() const { return std::sqrt(mse); }
double Noise::rel_rmse() const { return std::sqrt(rel_mse); }

Result<ConvergedFilm> converged_film(const Film& half, const Film& other_half)
{
	RT_TRY_ASSIGN(const Comparison halves, compared(half, other_half, false));
	ConvergedFilm converged;
	converged.film = half;
	RT_TRY(converged.film.add(other_half));
	converged.samples = converged.film.min_samples();
	const Noise difference = noise_of(halves);
	converged.noise = {difference.mse / 4, difference.rel_mse / 4};
	return converged;
}

const ChannelBias& ImageError::clearest_bias() const
{
	return *std::max_element(bias.begin(), bias.end(), [](const ChannelBias& a, const ChannelBias& b) {
		return std::fabs(a.z) < std::fabs(b.z);
	});
}

Result<ImageError> error_against(const Film& film, const ConvergedFilm& reference)
{
	RT_TRY_ASSIGN(const Comparison comparison, compared(film, reference.film, true));
	ImageError error;
	const Noise both = noise_of(comparison);
	error.noise = {both.mse - reference.noise.mse, both.rel_mse - reference.noise.rel_mse};
	if (error.noise.rel_mse < reference.noise.rel_mse) {
		error.noise = reference.noise;
		error.is_bound = true;
	}
	error.noise.mse = std::max(error.noise.mse, 0.0);
	error.rel_mse_trimmed = comparison.rel_mse_trimmed;
	error.flip = comparison.flip.value_or(0);
	for (std::size_t c = 0; c < 3; ++c) {
		const ChannelMeans& means = comparison.means[c];
		error.bias[c] = {means.b > 0 ? means.difference / means.b : 0, means.z.value_or(0)};
	}
	return error;
}

void mark_front(std::vector<TradePoint>& points)
{
	std::stable_sort(points.begin(), points.end(), [](const TradePoint& a, const TradePoint& b) {
		return std::pair(a.seconds, a.error.noise.rel_mse) < std::pair(b.seconds, b.error.noise.rel_mse);
	});
	double best = std::numeric_limits<double>::infinity();
	for (TradePoint& point : points) {
		const double error = point.error.noise.rel_rmse();
		point.on_front = error < best * (1 - clearly_nearer);
		if (point.on_front)
			best = error;
	}
}

std::optional<Recommendation> recommend(const std::vector<TradePoint>& points, const TradeGoal& goal, double scale)
{
	std::vector<Recommendation> all;
	for (const Curve& curve : curves_of(points))
		if (const auto best = best_of(curve, goal, scale))
			all.push_back(*best);
	if (all.empty())
		return std::nullopt;
	// For an error the time counts, within a time the square of the error: both are what more samples cost.
	const auto cost = [&goal](const Recommendation& way) {
		return goal.rel_rmse ? way.seconds : way.rel_rmse * way.rel_rmse;
	};
	const auto cheaper = [&cost](const Recommendation& a, const Recommendation& b) { return cost(a) < cost(b); };
	const Recommendation best = *std::min_element(all.begin(), all.end(), cheaper);
	const auto too_dear = [&](const Recommendation& way) {
		return way.configuration.precision != Precision::Exact || cost(way) > price_of_identity * cost(best);
	};
	all.erase(std::remove_if(all.begin(), all.end(), too_dear), all.end());
	return all.empty() ? best : *std::min_element(all.begin(), all.end(), cheaper);
}

std::optional<Recommendation> expectation(const std::vector<TradePoint>& points, std::size_t device,
                                          const Configuration& configuration, std::uint32_t samples, double scale)
{
	for (const Curve& curve : curves_of(points))
		if (curve.first().device == device && curve.first().configuration == configuration)
			return recommendation_of(curve, samples, scale);
	return std::nullopt;
}

} // namespace rt
