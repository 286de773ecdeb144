#include "render/display.h"

#include "render/display_table.h"
#include "support/thread_pool.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

namespace rt {

namespace {

__extension__ typedef unsigned __int128 Wide;

const std::uint64_t* thresholds_of(Transfer transfer)
{
	switch (transfer) {
	case Transfer::Gamma2:
		return gamma2_thresholds;
	case Transfer::Linear:
		return linear_thresholds;
	case Transfer::Srgb:
		break;
	}
	return srgb_thresholds;
}

// floor(sum exposure / (samples 2^(exponent + 32)) 2^48), or any number above all thresholds if it is. The thresholds
// are integers in units of 2^-48, so what the floor drops decides nothing.
std::uint64_t scaled_radiance(std::uint64_t sum, std::uint64_t exposure, std::uint32_t samples, std::int32_t exponent)
{
	const Wide light = static_cast<Wide>(sum) * exposure; // < 2^116: 63 bits and 53
	const int shift = exponent + exposure_factor_bits - threshold_bits;
	if (shift >= 128)
		return 0;
	// Left of bit 127, even 2^32 samples leave more than 2^48.
	if (shift <= -128 || (shift < 0 && light >> (127 + shift) != 0))
		return light == 0 ? 0 : UINT64_MAX;
	const Wide quotient = (shift >= 0 ? light >> shift : light << -shift) / samples;
	return quotient > UINT64_MAX ? UINT64_MAX : static_cast<std::uint64_t>(quotient);
}

// For one number of samples: edges[k] is the least sum whose code is more than k; above all sums where there is none.
using SumEdges = std::array<std::uint64_t, 255>;
constexpr std::uint64_t min_pixels_for_edges = 1 << 15;

// By bisection, because scaled_radiance never falls as the sum grows: whatever it rounds, the codes are the same.
SumEdges edges_of(const std::uint64_t* thresholds, std::uint64_t exposure, std::uint32_t samples, std::int32_t exponent)
{
	SumEdges edges;
	std::uint64_t below = 0;
	for (std::size_t k = 0; k < edges.size(); ++k) {
		std::uint64_t low = below, high = std::uint64_t(1) << 63;
		while (low < high) {
			const std::uint64_t middle = low + (high - low) / 2;
			if (scaled_radiance(middle, exposure, samples, exponent) >= thresholds[k])
				high = middle;
			else
				low = middle + 1;
		}
		edges[k] = below = low;
	}
	return edges;
}

// How many edges the sum reaches. Without branches: an image's noise would have half of them guessed wrongly.
std::uint8_t code_of(const SumEdges& edges, std::uint64_t sum)
{
	std::size_t reached = 0;
	for (int bit = 7; bit >= 0; --bit)
		reached |= static_cast<std::size_t>(edges[reached + (std::size_t(1) << bit) - 1] <= sum) << bit;
	return static_cast<std::uint8_t>(reached);
}

} // namespace

const char* transfer_name(Transfer transfer)
{
	switch (transfer) {
	case Transfer::Srgb:
		return "srgb";
	case Transfer::Gamma2:
		return "gamma2";
	case Transfer::Linear:
		return "linear";
	}
	return "";
}

std::uint64_t exposure_factor(double stops)
{
	if (std::isnan(stops))
		return exposure_factor(0);
	stops = std::clamp(stops, -max_exposure_stops, max_exposure_stops);

	// 2^stops = 2^whole times one root of two for each bit of the fraction; integers, so every libm agrees.
	const double steps = std::nearbyint(std::ldexp(stops, exposure_bits));
	const std::int64_t fixed = static_cast<std::int64_t>(steps);
	const std::int64_t whole = fixed >> exposure_bits;
	std::uint64_t power = std::uint64_t(1) << root_bits;
	for (int i = 0; i < exposure_bits; ++i)
		if (fixed >> (exposure_bits - 1 - i) & 1)
			power = static_cast<std::uint64_t>(static_cast<Wide>(power) * roots_of_two[i] >> root_bits);
	const int drop = root_bits - exposure_factor_bits - static_cast<int>(whole);
	return (power + (std::uint64_t(1) << (drop - 1))) >> drop;
}

std::vector<std::uint8_t> to_8bit(const Film& film, const DisplaySettings& settings)
{
	const std::uint64_t* const thresholds = thresholds_of(settings.transfer);
	const std::uint64_t exposure = exposure_factor(settings.exposure_stops);
	std::vector<std::uint8_t> bytes(film.sums().size());
	// Most pixels have as many samples as the first. For those the thresholds are turned into sums, once; a small film
	// would not repay it.
	const std::uint32_t usual = film.pixels() < min_pixels_for_edges ? 0 : film.samples()[0];
	const SumEdges edges = usual ? edges_of(thresholds, exposure, usual, film.exponent()) : SumEdges();
	constexpr std::uint64_t piece_pixels = std::uint64_t(1) << 13;
	parallel_for(film.samples().size(), piece_pixels, [&](std::uint64_t begin, std::uint64_t end) {
		for (std::size_t pixel = begin; pixel < end; ++pixel) {
			const std::uint32_t samples = film.samples()[pixel];
			if (samples == 0)
				continue;
			for (std::size_t i = 3 * pixel; i < 3 * pixel + 3; ++i) {
				const std::int64_t sum = film.sums()[i];
				if (sum <= 0)
					continue;
				if (samples == usual) {
					bytes[i] = code_of(edges, static_cast<std::uint64_t>(sum));
					continue;
				}
				const std::uint64_t radiance =
				    scaled_radiance(static_cast<std::uint64_t>(sum), exposure, samples, film.exponent());
				bytes[i] =
				    static_cast<std::uint8_t>(std::upper_bound(thresholds, thresholds + 255, radiance) - thresholds);
			}
		}
	});
	return bytes;
}

std::uint8_t to_8bit(double radiance, const DisplaySettings& settings)
{
	if (!(radiance > 0))
		return 0;
	const std::uint64_t* const thresholds = thresholds_of(settings.transfer);
	const double light = radiance * static_cast<double>(exposure_factor(settings.exposure_stops));
	const double scaled = std::ldexp(light, threshold_bits - exposure_factor_bits);
	return static_cast<std::uint8_t>(
	    std::upper_bound(thresholds, thresholds + 255, scaled,
	                     [](double value, std::uint64_t edge) { return value < static_cast<double>(edge); }) -
	    thresholds);
}

double decode_transfer(double encoded, Transfer transfer)
{
	switch (transfer) {
	case Transfer::Gamma2:
		return encoded * encoded;
	case Transfer::Linear:
		return encoded;
	case Transfer::Srgb:
		break;
	}
	return encoded <= 0.04045 ? encoded / 12.92 : std::pow((encoded + 0.055) / 1.055, 2.4);
}

} // namespace rt
