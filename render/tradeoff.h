// tradeoff.h: what accuracy costs. One scene, rendered in several ways: times and errors as points, the front of those
// that nothing beats, and the way to take for an error or a time.
//
// Nothing here renders or measures a time (tools/tradeoff_run does). Errors are held against a converged reference of
// other random numbers, whose own error is known and taken off. What lies between measured numbers of samples is
// interpolated on logarithms; what lies beyond is told as such.
#pragma once

#include "backends/backend.h"
#include "backends/precision.h"
#include "render/film.h"
#include "render/scene.h"
#include "render/session.h"
#include "support/result.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace rt {

// One way to render, but for the number of samples.
struct Configuration {
	Precision precision = Precision::Exact;
	Sampler sampler = Sampler::Independent;
	Estimator estimator = Estimator::Path;
	std::uint32_t roulette = 0;

	void apply(RenderSettings& settings, SessionOptions& session) const;
	// "exact", "fast sobol nee": the precision, then what is not as plain as can be.
	std::string name() const;
	// "--precision exact --sampler sobol": as rt render takes it.
	std::string arguments() const;

	friend bool operator==(const Configuration& a, const Configuration& b)
	{
		return a.precision == b.precision && a.sampler == b.sampler && a.estimator == b.estimator &&
		       a.roulette == b.roulette;
	}
	friend bool operator!=(const Configuration& a, const Configuration& b) { return !(a == b); }
};

// Has the scene anything that shines, and a matte surface that could aim at it?
bool aims_at_lamps(const Scene& scene);

// All that are worth measuring for a scene on a device, the plain exact one first. Estimators differ only where lamps
// are aimed at; the double rung, the oracle, is measured plain, and roulette with nothing else.
std::vector<Configuration> configurations_for(const Scene& scene, const DeviceInfo& device);

// The one with the least noise that the double rung has for this scene: what a reference is rendered with.
Configuration reference_configuration(const Scene& scene);

// ---- errors -----------------------------------------------------------------------------------------------------

// Of all values of an image against the reference: radiances, and relative to the reference's (mean of
// (a - b)^2 / (b^2 + 0.01), and its root).
struct Noise {
	double mse = 0, rel_mse = 0;
	double rmse() const;
	double rel_rmse() const;
};

// A converged image: the sum of two halves of other random numbers, which differ by its error.
struct ConvergedFilm {
	Film film;
	std::uint32_t samples = 0;
	Noise noise; // its own: a fourth of the halves' difference
};
Result<ConvergedFilm> converged_film(const Film& half, const Film& other_half);

struct ChannelBias {
	double relative = 0; // of the mean radiance
	double z = 0;        // mean difference over its standard error, of the reference's noise too; 0 if none differs
};

struct ImageError {
	Noise noise; // without the reference's own
	// The reference is not good enough to tell: `noise` is the reference's own, an upper bound.
	bool is_bound = false;
	double rel_mse_trimmed = 0; // without the worst 0.1 % of the pixels; with the reference's own error
	double flip = 0;            // mean LDR-FLIP error; with the reference's own
	std::array<ChannelBias, 3> bias;

	const ChannelBias& clearest_bias() const; // of the largest |z|
};
Result<ImageError> error_against(const Film& film, const ConvergedFilm& reference);

// ---- points and their front -------------------------------------------------------------------------------------

struct TradePoint {
	std::size_t device = 0; // index into the list of devices that were measured
	Configuration configuration;
	std::uint32_t samples = 0;
	double seconds = 0;      // of rendering alone, the least of the repeats: whatever else runs only adds
	double most_seconds = 0; // the worst of them
	std::uint32_t repeats = 1;
	// The least that cores spent on it, all together; only of devices whose work they do. What else runs on the machine
	// hardly adds to it, so that ratios hold where those of `seconds` do not.
	std::optional<double> cpu_seconds;
	ImageError error;
	std::string film_hash;
	bool on_front = false;
};

// Rungs of the same random numbers have the same noise to many digits: what is nearer by less than this share of the
// error is not nearer.
constexpr double clearly_nearer = 0.01;

// Sorts by time and marks the points that are clearly nearer than all on the front that take no longer.
void mark_front(std::vector<TradePoint>& points);

// ---- the choice -------------------------------------------------------------------------------------------------

// One of the two.
struct TradeGoal {
	std::optional<double> rel_rmse; // at most
	std::optional<double> seconds;  // at most
};

struct Recommendation {
	std::size_t device = 0;
	Configuration configuration;
	std::uint32_t samples = 0;
	double seconds = 0, rel_rmse = 0; // expected
	bool extrapolated = false;        // the number of samples lies beyond those that were measured
};

// Exact is taken where it is at most this much slower than the fastest for the same error: bits that are the same
// everywhere are worth something, and times are measured no better.
constexpr double price_of_identity = 1.1;

// The quickest way to an error, or the best within a time; nothing if no way is known, which is so beyond the most
// samples that can be rendered, and below a bias. `scale` times the pixels of what was measured are to be rendered:
// times grow with them, errors do not.
std::optional<Recommendation> recommend(const std::vector<TradePoint>& points, const TradeGoal& goal, double scale = 1);

// What a configuration is expected to give at a number of samples; nothing if it was not measured.
std::optional<Recommendation> expectation(const std::vector<TradePoint>& points, std::size_t device,
                                          const Configuration& configuration, std::uint32_t samples, double scale = 1);

} // namespace rt
