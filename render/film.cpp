#include "render/film.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

namespace rt {

namespace {

__extension__ typedef unsigned __int128 Wide;

// A positive number, mantissa * 2^exponent, of 63 significant bits, rounded to odd: the last bit is 1 where anything
// was lost. Rounding it once more, to 61 bits or fewer, gives what rounding the exact number would have given.
struct OddRounded {
	std::uint64_t mantissa;
	int exponent;
};

int bit_width(std::uint64_t value) { return value == 0 ? 0 : 64 - __builtin_clzll(value); }

OddRounded divide_to_odd(std::uint64_t sum, std::uint32_t samples)
{
	// The dividend gets its top bit at 126, so the quotient has 95 bits or more: enough to cut 63 from the top.
	const int shift = 127 - bit_width(sum);
	const Wide dividend = static_cast<Wide>(sum) << shift;
	const Wide quotient = dividend / samples;
	const int drop = 64 + bit_width(static_cast<std::uint64_t>(quotient >> 64)) - 63;
	const std::uint64_t mantissa = static_cast<std::uint64_t>(quotient >> drop);
	const bool exact = quotient * samples == dividend && static_cast<Wide>(mantissa) << drop == quotient;
	return {mantissa | (exact ? 0u : 1u), drop - shift};
}

// sum / (samples 2^exponent), correctly rounded to float or double; to float also where it is subnormal there, because
// the cut to 53 bits is rounded to odd as well and every step but the last conversion is then exact.
template <class Float>
Float mean_radiance(std::int64_t sum, std::uint32_t samples, std::int32_t exponent)
{
	if (sum == 0 || samples == 0)
		return 0;
	const std::uint64_t magnitude = sum < 0 ? 0 - static_cast<std::uint64_t>(sum) : static_cast<std::uint64_t>(sum);
	OddRounded mean = divide_to_odd(magnitude, samples);
	if constexpr (sizeof(Float) == sizeof(float)) {
		const bool exact = (mean.mantissa & 0x3ff) == 0;
		mean = {mean.mantissa >> 10 | (exact ? 0u : 1u), mean.exponent + 10};
	}
	const double value = std::ldexp(static_cast<double>(mean.mantissa), mean.exponent - exponent);
	return static_cast<Float>(sum < 0 ? -value : value);
}

bool same(const Window& a, const Window& b)
{
	return a.x == b.x && a.y == b.y && a.width == b.width && a.height == b.height;
}

Error cannot_add(std::string reason, std::string cure)
{
	return {ErrorKind::Usage, "the films cannot be added: " + std::move(reason), {}, std::move(cure), {}};
}

} // namespace

Film::Film(std::uint32_t image_width, std::uint32_t image_height, Window window, std::int32_t exponent)
    : image_width_(image_width), image_height_(image_height), window_(window), exponent_(exponent),
      sums_(static_cast<std::size_t>(3 * pixels())), samples_(static_cast<std::size_t>(pixels()))
{
}

bool Film::is_even() const { return min_samples() == max_samples(); }

std::uint32_t Film::min_samples() const
{
	return samples_.empty() ? 0 : *std::min_element(samples_.begin(), samples_.end());
}

std::uint32_t Film::max_samples() const
{
	return samples_.empty() ? 0 : *std::max_element(samples_.begin(), samples_.end());
}

Status Film::add(const Film& other)
{
	if (image_width_ != other.image_width_ || image_height_ != other.image_height_)
		return cannot_add(fmt::format("their images have {}x{} and {}x{} pixels", image_width_, image_height_,
		                              other.image_width_, other.image_height_),
		                  "add films of the same image only");
	if (!same(window_, other.window_))
		return cannot_add("they hold different windows of the image", "add films of the same window only");
	if (exponent_ != other.exponent_)
		return cannot_add(fmt::format("their fixed-point exponents are {} and {}", exponent_, other.exponent_),
		                  "add films of the same scene only");

	// All is checked before anything changes, so that a refused film leaves this one as it was.
	static const char* const too_many = "render fewer samples";
	std::int64_t sum;
	for (std::size_t i = 0; i < sums_.size(); ++i)
		if (__builtin_add_overflow(sums_[i], other.sums_[i], &sum))
			return cannot_add("a pixel's sum would exceed 63 bits", too_many);
	std::uint32_t count;
	for (std::size_t i = 0; i < samples_.size(); ++i)
		if (__builtin_add_overflow(samples_[i], other.samples_[i], &count))
			return cannot_add("a pixel's number of samples would exceed 32 bits", too_many);
	std::uint64_t new_segments, new_rejected;
	if (__builtin_add_overflow(segments, other.segments, &new_segments) ||
	    __builtin_add_overflow(rejected, other.rejected, &new_rejected))
		return cannot_add("a counter would exceed 64 bits", too_many);

	for (std::size_t i = 0; i < sums_.size(); ++i)
		sums_[i] += other.sums_[i];
	for (std::size_t i = 0; i < samples_.size(); ++i)
		samples_[i] += other.samples_[i];
	segments = new_segments;
	rejected = new_rejected;
	return success();
}

Hash128 Film::hash() const
{
	Hasher hasher;
	const bool even = is_even();
	hasher.add_u32(window_.width);
	hasher.add_u32(window_.height);
	hasher.add_u32(even ? min_samples() : 0xffffffffu);
	hasher.add_u32(static_cast<std::uint32_t>(exponent_));
	// In blocks: a call of the hash for each of millions of sums would cost more than the hashing.
	std::array<std::uint8_t, 8192> block;
	std::size_t used = 0;
	for (const std::int64_t sum : sums_) {
		for (int shift = 0; shift < 64; shift += 8)
			block[used++] = static_cast<std::uint8_t>(static_cast<std::uint64_t>(sum) >> shift);
		if (used == block.size()) {
			hasher.add(block.data(), used);
			used = 0;
		}
	}
	hasher.add(block.data(), used);
	if (!even)
		for (const std::uint32_t count : samples_)
			hasher.add_u32(count);
	return hasher.result();
}

double Film::radiance(std::uint32_t x, std::uint32_t y, int channel) const
{
	const std::size_t pixel = pixel_index(x, y);
	return mean_radiance<double>(sums_[3 * pixel + static_cast<std::size_t>(channel)], samples_[pixel], exponent_);
}

float Film::radiance_float(std::uint32_t x, std::uint32_t y, int channel) const
{
	const std::size_t pixel = pixel_index(x, y);
	return mean_radiance<float>(sums_[3 * pixel + static_cast<std::size_t>(channel)], samples_[pixel], exponent_);
}

} // namespace rt
