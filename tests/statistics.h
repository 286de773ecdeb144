// statistics.h: p-values, for tests that compare random quantities.
//
// Every such test has fixed seeds, so it passes or fails for ever. Its significance level says how probable a failure
// would be for a correct program if the random numbers were drawn anew, as they are when the contract's change.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace rt {

// Probability that a standard normal variable is further from 0 than z.
inline double normal_p(double z) { return std::erfc(std::fabs(z) / std::sqrt(2.0)); }

// Probability that a chi-squared variable exceeds `statistic`: the regularised incomplete gamma function
// Q(dof / 2, statistic / 2) by its power series below the mean and by Legendre's continued fraction above it
// (Abramowitz and Stegun, 6.5.29 and 6.5.31).
inline double chi_squared_p(double statistic, double dof)
{
	const double a = dof / 2, x = statistic / 2;
	if (x <= 0)
		return 1;
	const double front = std::exp(a * std::log(x) - x - std::lgamma(a));
	if (x < a + 1) {
		double term = 1 / a, sum = term;
		for (int k = 1; k < 100000 && term > sum * 1e-16; ++k) {
			term *= x / (a + k);
			sum += term;
		}
		return 1 - front * sum;
	}
	// b0 = x + 1 - a, then a_k = -k (k - a), b_k = b0 + 2 k; convergents by Lentz's ratios.
	double b = x + 1 - a;
	double c = 1e300, d = 1 / b, fraction = d;
	for (int k = 1; k < 100000; ++k) {
		const double numerator = -k * (k - a);
		b += 2;
		d = 1 / (numerator * d + b);
		c = b + numerator / c;
		fraction *= c * d;
		if (std::fabs(c * d - 1) < 1e-15)
			break;
	}
	return front * fraction;
}

// p of `count` hits in `trials` against a known probability, by the normal approximation with a correction for
// continuity. Certain outcomes must be certain.
inline double binomial_p(double count, double trials, double probability)
{
	const double variance = trials * probability * (1 - probability);
	const double distance = std::fabs(count - trials * probability);
	if (variance < 1e-6)
		return distance < 1e-3 ? 1 : 0;
	return normal_p(std::max(0.0, distance - 0.5) / std::sqrt(variance));
}

// Counts in a grid over the unit square (or, with one column, the unit interval) where all cells should be equal.
class EvenGrid {
public:
	explicit EvenGrid(std::size_t rows, std::size_t columns = 1)
	    : rows_(rows), columns_(columns), counts_(rows * columns)
	{
	}
	void add(double x, double y = 0)
	{
		++counts_[cell(x, rows_) * columns_ + cell(y, columns_)];
		++total_;
	}
	// Two-sided: numbers that are too even are not random either.
	double p() const
	{
		const double expected = static_cast<double>(total_) / static_cast<double>(counts_.size());
		double statistic = 0;
		for (const std::uint64_t count : counts_) {
			const double excess = static_cast<double>(count) - expected;
			statistic += excess * excess / expected;
		}
		const double above = chi_squared_p(statistic, static_cast<double>(counts_.size() - 1));
		return std::min(1.0, 2 * std::min(above, 1 - above));
	}

private:
	static std::size_t cell(double x, std::size_t count)
	{
		return std::min(static_cast<std::size_t>(std::max(x, 0.0) * static_cast<double>(count)), count - 1);
	}
	std::size_t rows_, columns_;
	std::vector<std::uint64_t> counts_;
	std::uint64_t total_ = 0;
};

// Several tests that should all pass. Sidak's correction: with n tests the smallest p is below p' with probability
// 1 - (1 - p')^n at most, also where two-sided normal tests depend on each other (Sidak 1967).
class TestFamily {
public:
	void add(const std::string& name, double p)
	{
		++tests_;
		if (!(p >= smallest_)) { // NaN counts as the worst
			smallest_ = p >= 0 ? p : 0;
			worst_ = name;
		}
	}
	double p() const { return -std::expm1(static_cast<double>(tests_) * std::log1p(-std::min(smallest_, 1 - 1e-16))); }
	const std::string& worst() const { return worst_; }
	std::size_t tests() const { return tests_; }

private:
	double smallest_ = 1;
	std::size_t tests_ = 0;
	std::string worst_ = "none";
};

} // namespace rt
