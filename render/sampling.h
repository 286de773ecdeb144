// sampling.h: how a render estimates light: where its random numbers come from, how it looks for lamps, when it gives a
// path up. Each choice has the same expected image and another noise (docs/tradeoff.md); the defaults are the plainest.
#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <string_view>

namespace rt {

// The values are those of RT_SAMPLER_* (common/rt_structs.h).
enum class Sampler {
	Independent, // hashed random numbers
	Stratified,  // the film's numbers from a jittered grid, the rest independent
	Sobol,       // Owen-scrambled Sobol points, padded two dimensions at a time
};
constexpr std::array<Sampler, 3> all_samplers{Sampler::Independent, Sampler::Stratified, Sampler::Sobol};

// The values are those of RT_ESTIMATOR_*.
enum class Estimator {
	Path, // lamps are met by chance
	Nee,  // next-event estimation: every diffuse bounce aims a ray at a lamp, and lamps met by chance there count
	      // nothing
	Mis,  // both, weighed by the power heuristic (multiple importance sampling)
};
constexpr std::array<Estimator, 3> all_estimators{Estimator::Path, Estimator::Nee, Estimator::Mis};

// The one of a list that is called so, or nothing.
template <class Choice, std::size_t count>
std::optional<Choice> find_named(std::string_view text, const std::array<Choice, count>& all,
                                 const char* (*name)(Choice))
{
	for (const Choice choice : all)
		if (text == name(choice))
			return choice;
	return std::nullopt;
}

// As options, scene files and provenance spell them.
const char* sampler_name(Sampler sampler);
const char* estimator_name(Estimator estimator);

} // namespace rt
