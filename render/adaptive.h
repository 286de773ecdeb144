// adaptive.h: when a tile of an image has been sampled enough (contract rule 20). Integers in, decisions out.
//
// Samples are taken in stages of fixed lengths, each in two halves. If a and b are the sums of a pixel's luminance over
// the halves of a stage, (a - b)^2 estimates the variance of a + b without bias, whatever the pixel's distribution; and
// variances of stages add up. So the sum of the squares, over the stages and over a tile's pixels, estimates the square
// of the error of the tile's pixels. Its own error, and that of the squared error about its mean, follow from the sum
// of the squares of the pixels' shares. To it is added what one pixel may have missed altogether.
//
// All sums are exact integers. They become an estimate by a handful of correctly rounded operations in double, so the
// same films give the same decisions on every machine.
//
// An estimate is a bound: with a confidence of 95 % the tile's RMS error of luminance, divided by its mean luminance
// + 0.01, is below it. tests/test_adaptive.cpp says how well that holds.
#pragma once

#include "render/film.h"

#include <cstddef>
#include <cstdint>
#include <vector>

namespace rt {

// Pixels a side. Large enough for an estimate from few samples, small enough to leave a quiet neighbour alone.
constexpr std::uint32_t adaptive_tile = 16;
// No tile stops with fewer samples: 8192 paths, of which a feature that one in a thousand meets is met eight times.
constexpr std::uint32_t adaptive_least_samples = 32;
// Where the user names no limit.
constexpr std::uint32_t adaptive_sample_limit = 4096;

// The length of the stage that begins with `samples` samples a pixel: 4 up to 32 samples, then an eighth to a quarter
// of them, a power of two. Decisions fall at 32, 40, 48, 56, 64, 80, 96, ... samples.
constexpr std::uint32_t stage_length(std::uint32_t samples)
{
	std::uint32_t length = 4;
	while (length * 8 <= samples)
		length *= 2;
	return length;
}

__extension__ typedef unsigned __int128 UnsignedWide;
__extension__ typedef __int128 SignedWide;

// What is known of a tile. Luminance is 54 R + 183 G + 19 B: Rec. 709 in 256ths, so one unit is 2^-8 of a film's.
struct TileSums {
	std::uint32_t pixels = 0;
	std::uint32_t samples = 0;  // a pixel
	std::uint32_t half = 0;     // samples of half the last stage
	UnsignedWide luminance = 0; // of all samples
	UnsignedWide variance = 0;  // sum over pixels of their variances V: of the sums of samples, over half^2
	UnsignedWide squares = 0;   // sum over pixels of (V >> squares_shift)^2
	unsigned squares_shift = 0;
};

// The bound described above; infinite before the first stage.
double relative_error_bound(const TileSums& sums, std::int32_t film_exponent);

// The tiles of an image and what is known of them.
class TileStatistics {
public:
	TileStatistics(std::uint32_t width, std::uint32_t height);
	static std::uint64_t bytes_needed(std::uint32_t width, std::uint32_t height)
	{
		return std::uint64_t(width) * height * sizeof(Pixel);
	}

	std::uint32_t across() const { return across_; }
	std::uint32_t down() const { return down_; }
	std::size_t count() const { return std::size_t(across_) * down_; }
	Window tile(std::size_t index) const; // cut off at the image's edges
	const TileSums& sums(std::size_t index) const { return sums_[index]; }

	// To be called in turn, when the film holds the first half of a stage more, and when it holds all of it; for the
	// tiles that took part, which are those with active[index].
	void end_half(const Film& film, const std::vector<bool>& active);
	void end_stage(const Film& film, const std::vector<bool>& active);

private:
	struct Pixel {
		SignedWide mark = 0; // the luminance before the stage; after its half 2 * (that of now) - mark
		UnsignedWide variance = 0;
	};
	void update_tile(const Film& film, std::size_t index);

	std::uint32_t width_, height_, across_, down_;
	std::vector<Pixel> pixels_; // rows from the top
	std::vector<TileSums> sums_;
};

// Those tiles of `active` that go on: with a noisy tile among themselves and their eight neighbours. A rare feature at
// the edge of a tile is thus looked for on both sides.
std::vector<bool> still_active(const std::vector<bool>& active, const std::vector<bool>& noisy, std::uint32_t across);

// The active tiles as few windows that do not overlap.
std::vector<Window> windows_of(const std::vector<bool>& active, const TileStatistics& tiles);

} // namespace rt
