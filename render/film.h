// film.h: the image as integers.
//
// Each sample's radiance v becomes the integer round-half-even(v * 2^exponent) on the device and is added to a
// 64-bit sum, so films of the same scene may be added in any order. The exponent comes from the scene alone
// (contract rule 15). The film's hash is what two people compare.
#pragma once

#include "support/hash.h"
#include "support/result.h"
#include "support/zeroed.h"

#include <cstddef>
#include <cstdint>

namespace rt {

// The part of the image that a film holds, in pixels of the whole image; row 0 is at the top.
struct Window {
	std::uint32_t x = 0, y = 0, width = 0, height = 0;
};

class Film {
public:
	Film() = default;
	Film(std::uint32_t image_width, std::uint32_t image_height, Window window, std::int32_t exponent);

	std::uint32_t image_width() const { return image_width_; }
	std::uint32_t image_height() const { return image_height_; }
	const Window& window() const { return window_; }
	std::int32_t exponent() const { return exponent_; }
	std::uint64_t pixels() const { return std::uint64_t(window_.width) * window_.height; }

	// Sums of R, G, B a pixel, window rows from the top: 3 * pixels().
	Zeroed<std::int64_t>& sums() { return sums_; }
	const Zeroed<std::int64_t>& sums() const { return sums_; }
	// Samples taken a pixel: pixels(). Uneven only in a film that was interrupted, or rendered to an error.
	Zeroed<std::uint32_t>& samples() { return samples_; }
	const Zeroed<std::uint32_t>& samples() const { return samples_; }

	bool is_even() const;              // every pixel has the same number of samples
	std::uint32_t min_samples() const; // of all pixels; 0 for an empty film
	std::uint32_t max_samples() const;

	std::uint64_t segments = 0; // path segments traced
	std::uint64_t rejected = 0; // samples that were NaN, infinite or above the limit (must be 0)

	// Adds another film of the same image, window and exponent; Usage error otherwise, or if a sum would overflow.
	Status add(const Film& other);

	// XXH3-128 over u32 width, u32 height (of the window), u32 samples, i32 exponent, then the sums as i64, R G B a
	// pixel, rows from the top; all little-endian. An uneven film hashes samples as 0xffffffff and appends the
	// u32 counts. docs/formats.md gives the same in words.
	Hash128 hash() const;

	// Mean radiance of a pixel's channel (0, 1, 2), window coordinates, correctly rounded; 0 where no sample was taken.
	double radiance(std::uint32_t x, std::uint32_t y, int channel) const;
	float radiance_float(std::uint32_t x, std::uint32_t y, int channel) const;

private:
	std::size_t pixel_index(std::uint32_t x, std::uint32_t y) const { return std::size_t(y) * window_.width + x; }

	std::uint32_t image_width_ = 0, image_height_ = 0;
	Window window_;
	std::int32_t exponent_ = 0;
	Zeroed<std::int64_t> sums_;
	Zeroed<std::uint32_t> samples_;
};

} // namespace rt
