// compare.h: two images held against each other: equal or not, where, by how much, and whether it shows.
//
// Differences are A - B; where a metric has a reference, it is B. Two films of the same exponent and samples are
// compared by their integer sums, floats by value and by ULPs, integer formats by code. An integer format and a float
// one are compared as the integer format shows them. Metrics of integer formats are in units of white (code / 255 or
// / 65535), as OpenImageIO's idiff has them.
#pragma once

#include "render/image_read.h"
#include "render/provenance.h"
#include "support/result.h"

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace rt {

// When a pixel is one that fails or warns: when one of its values differs by more than `value` and by more than
// `steps`, as far as they are given; by a single bit if neither is.
struct Tolerance {
	std::optional<double> value;
	std::optional<std::uint64_t> steps; // ULPs, codes or units of the film's sums
	double percent = 0;                 // of the pixels may do so
	std::uint64_t pixels = 0;           // or this many
	std::optional<double> hard;         // no value may differ by more
};

struct CompareSettings {
	Tolerance fail, warn;
	bool by_flip = false; // `value` and `hard` are about the pixel's FLIP error instead
	bool flip = true;     // the mean FLIP error is wanted
	bool hdr_flip = false;
};

enum class Verdict { Identical, Match, Warning, Failure, DifferentSize };

// In which one step of a value is counted.
enum class Step { Code, HalfUlp, FloatUlp, FilmUnit };

struct ValueDifference {
	std::uint32_t x = 0, y = 0; // in the whole image
	std::size_t channel = 0;
	double a = 0, b = 0;                 // codes, or radiances
	std::int64_t bits_a = 0, bits_b = 0; // code, bits of the float, or film's sum
	std::uint64_t steps = 0;
};

struct HistogramBin {
	std::uint64_t least = 0, most = 0; // steps
	std::uint64_t values = 0;
};

struct ChannelMeans {
	double a = 0, b = 0, difference = 0;
	// Of the mean difference, if the pixels' differences are independent and of mean 0: the sum over the root of the
	// sum of squares. Absent for integer formats (display is not linear) and where nothing differs.
	std::optional<double> z;
};

struct Comparison {
	Verdict verdict = Verdict::Failure;
	Step step = Step::Code;
	std::size_t channels = 3; // that were compared
	std::uint64_t pixels = 0, differing_pixels = 0;
	std::uint64_t values = 0, differing_values = 0;
	std::uint64_t not_finite = 0; // values of which one is NaN or infinite and the other not the same; in no metric
	std::uint64_t failing_pixels = 0, warning_pixels = 0;
	std::optional<ValueDifference> first; // in rows from the top
	std::optional<ValueDifference> worst; // the first with the largest difference; one that is not finite before all
	std::uint64_t most_steps = 0;
	std::vector<HistogramBin> histogram; // 0, 1, 2, 3 to 4, 5 to 8, ...: up to the last that is not empty
	double max_error = 0, mae = 0, rmse = 0;
	double rel_mse = 0;         // mean of (a - b)^2 / (b^2 + 0.01)
	double rel_mse_trimmed = 0; // the same without the worst 0.1 % of the pixels
	std::optional<double> psnr; // dB, of the peak; absent where nothing differs
	double peak = 1;            // 1, or the largest value if that is more
	std::array<ChannelMeans, 4> means;
	std::optional<double> flip, flip_max; // LDR-FLIP of the pictures as shown with the settings of B
	std::optional<double> hdr_flip;
	std::vector<std::string> notes; // what was done to make the two comparable, or could not be compared

	Expected expected;
	std::vector<MetadataDifference> metadata;
};

// Usage error if the two cannot be compared at all. Images of different sizes are compared in their metadata only.
Result<Comparison> compare_images(const LoadedImage& a, const LoadedImage& b, const CompareSettings& settings);

// |A - B| of R, G and B as 8-bit pixels: `scale` times the difference, in units of white; without a scale the largest
// becomes white. Values that are not finite are white. Both images have the same size.
struct DifferencePicture {
	std::uint32_t width = 0, height = 0;
	std::vector<std::uint8_t> rgb;
	double scale = 1;
};
Result<DifferencePicture> difference_picture(const LoadedImage& a, const LoadedImage& b, std::optional<double> scale);

// The FLIP errors of the pixels, white where they are 1 / scale or more.
Result<DifferencePicture> flip_picture(const LoadedImage& a, const LoadedImage& b, std::optional<double> scale);

// An image as a screen shows it: 8-bit codes as they are, others scaled to that, linear values as sRGB; 3 bytes a
// pixel.
std::vector<std::uint8_t> shown_rgb(const LoadedImage& image);

const char* name_of(Verdict verdict);
const char* name_of(Step step, bool plural);

} // namespace rt
