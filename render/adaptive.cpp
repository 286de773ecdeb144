#include "render/adaptive.h"

#include "support/thread_pool.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace rt {

namespace {

// For 95 % a normal distribution has 1.645. Sums of squares of few noisy pixels are skewed, and a tile stops when its
// estimate happens to be low: measured, 1.645 covers 94 % (three-spheres, error 0.1, 200 seeds).
constexpr double quantile = 2;
// The squared error of a pixel with the variance V is distributed like V times chi-squared with one degree of freedom,
// and has the variance 2 V^2. The estimate of V varies too, about a tenth as much; but so does the square of it by
// which V^2 is estimated here, upwards.
constexpr double spread_factor = 2 * quantile * quantile;
// What happens to a pixel three times in its samples, on average, is not seen at all in one of twenty renders (the rule
// of three, Hanley and Lippman-Hand 1983). One pixel of a tile may have missed that much of the tile's mean luminance;
// without it a tile of sky with a sphere's edge in a corner would be told to be free of error.
constexpr double unseen_events = 3;
// Added to the luminance that an error is divided by, so that a dark tile ends. It is 1 % of white: in a tile that is
// all but black, 10 % of it is 3 codes of 255 in sRGB.
constexpr double dark_luminance = 0.01;

constexpr int weight_r = 54, weight_g = 183, weight_b = 19; // of 256

SignedWide luminance_of(const std::int64_t* sums)
{
	return SignedWide(weight_r) * sums[0] + SignedWide(weight_g) * sums[1] + SignedWide(weight_b) * sums[2];
}

unsigned bit_width(UnsignedWide value)
{
	const auto high = static_cast<std::uint64_t>(value >> 64), low = static_cast<std::uint64_t>(value);
	if (high != 0)
		return 128 - static_cast<unsigned>(__builtin_clzll(high));
	return low == 0 ? 0 : 64 - static_cast<unsigned>(__builtin_clzll(low));
}

// Spelt out, because what a library's conversion from 128 bits does is its own affair.
double to_double(UnsignedWide value)
{
	return std::fma(static_cast<double>(static_cast<std::uint64_t>(value >> 64)), 0x1p64,
	                static_cast<double>(static_cast<std::uint64_t>(value)));
}

} // namespace

double relative_error_bound(const TileSums& sums, std::int32_t film_exponent)
{
	if (sums.half == 0)
		return std::numeric_limits<double>::infinity();
	const double pixels = sums.pixels;
	const double spread = std::sqrt(spread_factor * to_double(sums.squares));
	const double variance =
	    std::fma(spread, std::ldexp(1.0, static_cast<int>(sums.squares_shift)), to_double(sums.variance));
	const double dark = std::ldexp(dark_luminance, film_exponent + 8) * pixels;
	const double ratio =
	    std::sqrt(variance * pixels) * sums.half / std::fma(dark, sums.samples, to_double(sums.luminance));
	const double missed = unseen_events / sums.samples;
	return std::sqrt(std::fma(ratio, ratio, missed * missed / pixels));
}

TileStatistics::TileStatistics(std::uint32_t width, std::uint32_t height)
    : width_(width), height_(height), across_((width + adaptive_tile - 1) / adaptive_tile),
      down_((height + adaptive_tile - 1) / adaptive_tile), pixels_(std::size_t(width) * height), sums_(count())
{
	for (std::size_t i = 0; i < count(); ++i)
		sums_[i].pixels = tile(i).width * tile(i).height;
}

Window TileStatistics::tile(std::size_t index) const
{
	const auto x = static_cast<std::uint32_t>(index % across_) * adaptive_tile;
	const auto y = static_cast<std::uint32_t>(index / across_) * adaptive_tile;
	return {x, y, std::min(adaptive_tile, width_ - x), std::min(adaptive_tile, height_ - y)};
}

void TileStatistics::end_half(const Film& film, const std::vector<bool>& active)
{
	parallel_for(count(), 16, [&](std::uint64_t begin, std::uint64_t end) {
		for (std::uint64_t index = begin; index < end; ++index) {
			if (!active[index])
				continue;
			const Window window = tile(index);
			for (std::uint32_t y = window.y; y < window.y + window.height; ++y) {
				const std::size_t first = std::size_t(y) * width_ + window.x;
				for (std::size_t i = first; i < first + window.width; ++i)
					pixels_[i].mark = 2 * luminance_of(&film.sums()[3 * i]) - pixels_[i].mark;
			}
		}
	});
}

void TileStatistics::end_stage(const Film& film, const std::vector<bool>& active)
{
	parallel_for(count(), 16, [&](std::uint64_t begin, std::uint64_t end) {
		for (std::uint64_t index = begin; index < end; ++index)
			if (active[index])
				update_tile(film, index);
	});
}

void TileStatistics::update_tile(const Film& film, std::size_t index)
{
	TileSums& sums = sums_[index];
	const Window window = tile(index);
	const std::uint32_t length = stage_length(sums.samples);
	const unsigned half_bits = bit_width(length / 2) - 1;
	// Variances are kept over half^2, so that no number of samples makes them overflow: a sample is at most 2^40, its
	// luminance 2^48, V below 2^99 and the sum over a tile below 2^107.
	const unsigned rescale = sums.half != 0 && sums.half != length / 2 ? 2 : 0;
	sums.luminance = sums.variance = 0;
	UnsignedWide largest = 0;
	const auto for_pixels = [&](const auto& body) {
		for (std::uint32_t y = window.y; y < window.y + window.height; ++y) {
			const std::size_t first = std::size_t(y) * width_ + window.x;
			for (std::size_t i = first; i < first + window.width; ++i)
				body(i, pixels_[i]);
		}
	};
	for_pixels([&](std::size_t i, Pixel& pixel) {
		const SignedWide luminance = luminance_of(&film.sums()[3 * i]);
		const SignedWide difference = luminance - pixel.mark;
		const UnsignedWide magnitude =
		    static_cast<UnsignedWide>(difference < 0 ? -difference : difference) >> half_bits;
		pixel.mark = luminance;
		pixel.variance = (pixel.variance >> rescale) + magnitude * magnitude;
		sums.luminance += static_cast<UnsignedWide>(luminance);
		sums.variance += pixel.variance;
		largest = std::max(largest, pixel.variance);
	});
	// 59 bits of V leave the sum of 256 squares below 2^126.
	sums.squares_shift = std::max(bit_width(largest), 59u) - 59u;
	sums.squares = 0;
	for_pixels([&](std::size_t, const Pixel& pixel) {
		const UnsignedWide part = pixel.variance >> sums.squares_shift;
		sums.squares += part * part;
	});
	sums.half = length / 2;
	sums.samples += length;
}

std::vector<bool> still_active(const std::vector<bool>& active, const std::vector<bool>& noisy, std::uint32_t across)
{
	const std::size_t down = active.size() / across;
	std::vector<bool> next(active.size());
	for (std::size_t y = 0; y < down; ++y)
		for (std::size_t x = 0; x < across; ++x) {
			if (!active[y * across + x])
				continue;
			for (std::size_t v = y == 0 ? 0 : y - 1; v < std::min(y + 2, down); ++v)
				for (std::size_t u = x == 0 ? 0 : x - 1; u < std::min<std::size_t>(x + 2, across); ++u)
					if (noisy[v * across + u])
						next[y * across + x] = true;
		}
	return next;
}

std::vector<Window> windows_of(const std::vector<bool>& active, const TileStatistics& tiles)
{
	std::vector<Window> windows;
	std::vector<std::size_t> above, here; // windows that end with the row of tiles above, and with this one
	for (std::uint32_t y = 0; y < tiles.down(); ++y) {
		here.clear();
		for (std::uint32_t x = 0; x < tiles.across();) {
			const std::size_t row = std::size_t(y) * tiles.across();
			if (!active[row + x]) {
				++x;
				continue;
			}
			Window run = tiles.tile(row + x);
			for (++x; x < tiles.across() && active[row + x]; ++x)
				run.width += tiles.tile(row + x).width;
			const auto same = std::find_if(above.begin(), above.end(), [&](std::size_t i) {
				return windows[i].x == run.x && windows[i].width == run.width;
			});
			if (same != above.end()) {
				windows[*same].height += run.height;
				here.push_back(*same);
			} else {
				here.push_back(windows.size());
				windows.push_back(run);
			}
		}
		above = here;
	}
	return windows;
}

} // namespace rt
