// display.h: from film integers to 8-bit pixels, by integer thresholds (contract rule 19).
//
// A channel's 8-bit value is the number of thresholds that its mean radiance reaches. The comparison is exact
// (128-bit integers), so files are identical wherever the film is.
#pragma once

#include "render/film.h"

#include <cstdint>
#include <vector>

namespace rt {

enum class Transfer {
	Srgb,   // IEC 61966-2-1
	Gamma2, // square root: the seed's and the book's
	Linear,
};

struct DisplaySettings {
	Transfer transfer = Transfer::Srgb;
	double exposure_stops = 0; // radiance is multiplied by exposure_factor() first
};

// "srgb", "gamma2" or "linear": a transfer as --transfer takes it.
const char* transfer_name(Transfer transfer);

// 2^stops with 32 fractional bits, to 0.53 of the last; whole stops are exact. Stops are rounded to 2^-24 and clamped
// to the range below first. docs/formats.md gives the steps.
inline constexpr int exposure_factor_bits = 32;
inline constexpr double max_exposure_stops = 20;
std::uint64_t exposure_factor(double stops);

// RGB, 3 bytes a pixel, rows from the top. Values above the range are clamped to 255; pixels without samples are 0.
std::vector<std::uint8_t> to_8bit(const Film& film, const DisplaySettings& settings);

// The same for one channel's radiance. To the last bit what the film's integers give, unless the radiance was rounded
// on its way here: then, about once in a million, its neighbour.
std::uint8_t to_8bit(double radiance, const DisplaySettings& settings);

// The encoding's inverse on [0, 1], as the standard has it: for metrics, not for films.
double decode_transfer(double encoded, Transfer transfer);

} // namespace rt
