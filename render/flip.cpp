#include "render/flip.h"

#include "support/thread_pool.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

namespace rt {

namespace {

using Plane = std::vector<float>;
using Kernel = std::vector<double>;
using Colour = std::array<double, 3>;
using Matrix = std::array<Colour, 3>;

constexpr double pi = 3.14159265358979323846;

// ---- colour spaces -----------------------------------------------------------------------------------------------

double dot(const Colour& a, const Colour& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

Colour cross(const Colour& a, const Colour& b)
{
	return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

Colour product(const Matrix& m, const Colour& v) { return {dot(m[0], v), dot(m[1], v), dot(m[2], v)}; }

Matrix inverse(const Matrix& m)
{
	const Matrix rows = {cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1])};
	const double determinant = dot(m[0], rows[0]);
	Matrix result{};
	for (std::size_t i = 0; i < 3; ++i)
		for (std::size_t j = 0; j < 3; ++j)
			result[i][j] = rows[j][i] / determinant;
	return result;
}

// The colour space of Rec. 709's primaries and of the white D65, from their chromaticities.
struct Rec709 {
	Matrix to_xyz{}, from_xyz{};
	Colour white{};

	Rec709()
	{
		const auto xyz = [](double x, double y) { return Colour{x / y, 1, (1 - x - y) / y}; };
		const std::array<Colour, 3> primaries = {xyz(0.64, 0.33), xyz(0.30, 0.60), xyz(0.15, 0.06)};
		white = xyz(0.31271, 0.32902); // D65 with the five digits that the authors take
		Matrix columns{};
		for (std::size_t i = 0; i < 3; ++i)
			for (std::size_t j = 0; j < 3; ++j)
				columns[i][j] = primaries[j][i];
		const Colour scale = product(inverse(columns), white);
		for (std::size_t i = 0; i < 3; ++i)
			for (std::size_t j = 0; j < 3; ++j)
				to_xyz[i][j] = columns[i][j] * scale[j];
		from_xyz = inverse(to_xyz);
	}
};

const Rec709& rec709()
{
	static const Rec709 space;
	return space;
}

// X, Y and Z, each as a share of white's.
Colour relative_xyz(const Colour& rgb)
{
	const Colour xyz = product(rec709().to_xyz, rgb);
	return {xyz[0] / rec709().white[0], xyz[1] / rec709().white[1], xyz[2] / rec709().white[2]};
}

// YCxCz: CIELAB without its cube roots, in which the eye's contrast sensitivity is known.
Colour opponent_of(const Colour& rgb)
{
	const Colour xyz = relative_xyz(rgb);
	return {116 * xyz[1] - 16, 500 * (xyz[0] - xyz[1]), 200 * (xyz[1] - xyz[2])};
}

Colour rgb_of_opponent(const Colour& opponent)
{
	const double y = (opponent[0] + 16) / 116;
	const Colour& white = rec709().white;
	return product(rec709().from_xyz,
	               {(y + opponent[1] / 500) * white[0], y * white[1], (y - opponent[2] / 200) * white[2]});
}

// CIELAB with Hunt's effect: dark colours are less colourful.
Colour hunt_lab(const Colour& rgb)
{
	constexpr double edge = 6.0 / 29;
	Colour f = relative_xyz(rgb);
	for (double& t : f)
		t = t > edge * edge * edge ? std::cbrt(t) : t / (3 * edge * edge) + 4.0 / 29;
	const double lightness = 116 * f[1] - 16;
	return {lightness, 0.01 * lightness * 500 * (f[0] - f[1]), 0.01 * lightness * 200 * (f[1] - f[2])};
}

// HyAB: lightness by difference, colour by distance.
double hyab(const Colour& a, const Colour& b) { return std::fabs(a[0] - b[0]) + std::hypot(a[1] - b[1], a[2] - b[2]); }

// body(y) for all rows, on all cores.
template <class Body>
void for_each_row(std::size_t height, Body body)
{
	parallel_for(height, 16, [&body](std::uint64_t begin, std::uint64_t end) {
		for (std::uint64_t y = begin; y < end; ++y)
			body(static_cast<std::size_t>(y));
	});
}

// ---- filters -----------------------------------------------------------------------------------------------------

// Filters one row into `out`; pixels beyond the ends are those at the ends.
void filter_row(const float* in, std::size_t width, const Kernel& kernel, std::vector<double>& padded, float* out)
{
	const std::size_t radius = kernel.size() / 2;
	padded.assign(width + 2 * radius, 0);
	for (std::size_t i = 0; i < padded.size(); ++i)
		padded[i] = static_cast<double>(in[std::min(i < radius ? 0 : i - radius, width - 1)]);
	for (std::size_t x = 0; x < width; ++x) {
		double sum = 0;
		for (std::size_t k = 0; k < kernel.size(); ++k)
			sum += kernel[k] * padded[x + k];
		out[x] = static_cast<float>(sum);
	}
}

class Filters {
public:
	Filters(std::size_t width, std::size_t height) : width_(width), height_(height) {}

	Plane across(const Plane& in, const Kernel& kernel) const
	{
		Plane out(in.size());
		for_each_row(height_, [&](std::size_t y) {
			std::vector<double> padded;
			filter_row(in.data() + y * width_, width_, kernel, padded, out.data() + y * width_);
		});
		return out;
	}

	Plane down(const Plane& in, const Kernel& kernel) const
	{
		const std::size_t radius = kernel.size() / 2;
		Plane out(in.size());
		for_each_row(height_, [&](std::size_t y) {
			std::vector<double> sums(width_, 0);
			for (std::size_t k = 0; k < kernel.size(); ++k) {
				const std::size_t row = std::min(y + k < radius ? 0 : y + k - radius, height_ - 1);
				for (std::size_t x = 0; x < width_; ++x)
					sums[x] += kernel[k] * static_cast<double>(in[row * width_ + x]);
			}
			for (std::size_t x = 0; x < width_; ++x)
				out[y * width_ + x] = static_cast<float>(sums[x]);
		});
		return out;
	}

private:
	std::size_t width_, height_;
};

// value(-radius .. radius)
template <class F>
Kernel sampled(int radius, F value)
{
	Kernel kernel;
	for (int x = -radius; x <= radius; ++x)
		kernel.push_back(value(static_cast<double>(x)));
	return kernel;
}

// Positive weights sum to 1, negative ones to -1.
Kernel normalised(Kernel kernel)
{
	double positive = 0, negative = 0;
	for (const double weight : kernel)
		(weight > 0 ? positive : negative) += weight;
	for (double& weight : kernel)
		weight /= weight > 0 ? positive : negative < 0 ? -negative : 1;
	return kernel;
}

// The eye's contrast sensitivity to a channel: a sum of two Gaussians, a sqrt(pi / b) exp(-pi^2 x^2 / b) with x in
// degrees (table 1 of the paper).
struct Sensitivity {
	double a1, b1, a2, b2;
};
constexpr Sensitivity sensitivities[3] = {{1, 0.0047, 0, 1e-5}, {1, 0.0053, 0, 1e-5}, {34.1, 0.04, 13.5, 0.025}};

Plane blurred(const Filters& filters, const Plane& plane, const Sensitivity& channel, double pixels_per_degree)
{
	constexpr double widest = 0.04;
	const int radius = static_cast<int>(std::ceil(3 * std::sqrt(widest / (2 * pi * pi)) * pixels_per_degree));
	// Each Gaussian is separable, their sum is not: they are blurred one by one and weighed by their sums over the
	// square of pixels.
	Plane result(plane.size(), 0);
	std::array<Kernel, 2> kernels;
	std::array<double, 2> weights{};
	const std::array<std::pair<double, double>, 2> gaussians = {{{channel.a1, channel.b1}, {channel.a2, channel.b2}}};
	for (std::size_t i = 0; i < 2; ++i) {
		const auto [a, b] = gaussians[i];
		const double steepness = pi * pi / (b * pixels_per_degree * pixels_per_degree);
		kernels[i] = sampled(radius, [steepness](double x) { return std::exp(-steepness * x * x); });
		double sum = 0;
		for (const double weight : kernels[i])
			sum += weight;
		weights[i] = a * std::sqrt(pi / b) * sum * sum;
	}
	const double total = weights[0] + weights[1];
	for (std::size_t i = 0; i < 2; ++i) {
		if (weights[i] == 0)
			continue;
		const Kernel kernel = normalised(kernels[i]);
		const Plane one = filters.down(filters.across(plane, kernel), kernel);
		const double share = weights[i] / total;
		for (std::size_t p = 0; p < one.size(); ++p)
			result[p] = static_cast<float>(static_cast<double>(result[p]) + share * static_cast<double>(one[p]));
	}
	return result;
}

// ---- the two pipelines -------------------------------------------------------------------------------------------

struct Features {
	Plane edges, points;
};

Plane length(const Plane& x, const Plane& y)
{
	Plane result(x.size());
	for (std::size_t i = 0; i < x.size(); ++i)
		result[i] = std::sqrt(x[i] * x[i] + y[i] * y[i]);
	return result;
}

// Edges and points in the luminance: derivatives of a Gaussian whose width, 0.082 degrees, is that of the eye's
// feature detectors.
Features features_of(const Filters& filters, const Plane& luminance, double pixels_per_degree)
{
	const double deviation = 0.5 * 0.082 * pixels_per_degree;
	const int radius = static_cast<int>(std::ceil(3 * deviation));
	const double variance = deviation * deviation;
	const auto gauss = [variance](double x) { return std::exp(-x * x / (2 * variance)); };
	const Kernel smooth = normalised(sampled(radius, gauss));
	const Kernel first = normalised(sampled(radius, [&](double x) { return -x * gauss(x); }));
	const Kernel second = normalised(sampled(radius, [&](double x) { return (x * x / variance - 1) * gauss(x); }));
	const Plane across = filters.across(luminance, smooth);
	return {
	    length(filters.down(filters.across(luminance, first), smooth), filters.down(across, first)),
	    length(filters.down(filters.across(luminance, second), smooth), filters.down(across, second)),
	};
}

// What the eye makes of one picture.
struct Seen {
	std::vector<Colour> colours;
	Features features;
};

double within_display(float value)
{
	return std::isfinite(value) ? std::clamp(static_cast<double>(value), 0.0, 1.0) : 0;
}

Seen see(const FlipPicture& picture, double pixels_per_degree)
{
	const std::size_t pixels = std::size_t(picture.width) * picture.height;
	const Filters filters(picture.width, picture.height);
	std::array<Plane, 3> planes;
	for (Plane& plane : planes)
		plane.resize(pixels);
	Plane luminance(pixels);
	for (std::size_t i = 0; i < pixels; ++i) {
		const float* rgb = picture.rgb.data() + 3 * i;
		const Colour opponent = opponent_of({within_display(rgb[0]), within_display(rgb[1]), within_display(rgb[2])});
		for (std::size_t c = 0; c < 3; ++c)
			planes[c][i] = static_cast<float>(opponent[c]);
		luminance[i] = static_cast<float>((opponent[0] + 16) / 116);
	}
	Seen seen;
	seen.features = features_of(filters, luminance, pixels_per_degree);
	for (std::size_t c = 0; c < 3; ++c)
		planes[c] = blurred(filters, planes[c], sensitivities[c], pixels_per_degree);
	seen.colours.resize(pixels);
	for_each_row(picture.height, [&](std::size_t y) {
		for (std::size_t i = y * picture.width; i < (y + 1) * picture.width; ++i) {
			Colour rgb = rgb_of_opponent({static_cast<double>(planes[0][i]), static_cast<double>(planes[1][i]),
			                              static_cast<double>(planes[2][i])});
			for (double& value : rgb)
				value = std::clamp(value, 0.0, 1.0);
			seen.colours[i] = hunt_lab(rgb);
		}
	});
	return seen;
}

// Colour differences, compressed and stretched so that most of [0, 1] is for the small ones.
class ColourError {
public:
	ColourError() : largest_(std::pow(hyab(hunt_lab({0, 1, 0}), hunt_lab({0, 0, 1})), exponent)) {}
	double operator()(const Colour& a, const Colour& b) const
	{
		constexpr double knee = 0.4, share_below = 0.95;
		const double error = std::pow(hyab(a, b), exponent), edge = knee * largest_;
		if (error < edge)
			return share_below / edge * error;
		return share_below + (error - edge) / (largest_ - edge) * (1 - share_below);
	}

private:
	static constexpr double exponent = 0.7;
	double largest_;
};

double feature_error(const Features& a, const Features& b, std::size_t pixel)
{
	const double edges = std::fabs(static_cast<double>(a.edges[pixel]) - static_cast<double>(b.edges[pixel]));
	const double points = std::fabs(static_cast<double>(a.points[pixel]) - static_cast<double>(b.points[pixel]));
	return std::sqrt(std::max(edges, points) / std::sqrt(2.0));
}

// ---- exposures of HDR-FLIP ---------------------------------------------------------------------------------------

// The ACES film curve as a quotient of two quadratics (Narkowicz's fit, its input scaled by 0.6).
constexpr double aces[6] = {0.6 * 0.6 * 2.51, 0.6 * 0.03, 0, 0.6 * 0.6 * 2.43, 0.6 * 0.59, 0.14};

double aces_curve(double x)
{
	return (aces[0] * x * x + aces[1] * x + aces[2]) / (aces[3] * x * x + aces[4] * x + aces[5]);
}

// Where the curve reaches 0.85: the luminance that should come out bright.
double aces_bright()
{
	constexpr double bright = 0.85;
	const double a = aces[0] - bright * aces[3], b = aces[1] - bright * aces[4], c = aces[2] - bright * aces[5];
	const double root = std::sqrt(b * b - 4 * a * c);
	return std::max((-b + root) / (2 * a), (-b - root) / (2 * a));
}

struct Exposures {
	double first, last;
	unsigned count;
};

// From the brightest pixel of the reference at the bright end to its median there.
Exposures exposures_of(const FlipPicture& reference)
{
	std::vector<double> luminances;
	luminances.reserve(reference.rgb.size() / 3);
	for (std::size_t i = 0; i + 2 < reference.rgb.size(); i += 3) {
		Colour rgb{};
		for (std::size_t c = 0; c < 3; ++c)
			rgb[c] = std::isfinite(reference.rgb[i + c]) ? static_cast<double>(reference.rgb[i + c]) : 0;
		luminances.push_back(dot(rec709().to_xyz[1], rgb));
	}
	const auto middle = luminances.begin() + static_cast<std::ptrdiff_t>(luminances.size() / 2);
	std::nth_element(luminances.begin(), middle, luminances.end());
	const double median = *middle; // the upper one where there are two in the middle, as in the authors' program
	const double brightest = *std::max_element(luminances.begin(), luminances.end());
	constexpr double least = 1e-9;
	const double bright = aces_bright();
	const double first = std::log2(bright / std::max(brightest, least));
	const double last = std::log2(bright / std::max(median, least));
	return {first, last, static_cast<unsigned>(std::max(2.0, std::ceil(last - first)))};
}

FlipPicture exposed(const FlipPicture& picture, double stops)
{
	FlipPicture result = picture;
	const double factor = std::exp2(stops);
	for (float& value : result.rgb)
		value = std::isfinite(value)
		            ? static_cast<float>(aces_curve(factor * std::max(static_cast<double>(value), 0.0)))
		            : 0;
	return result;
}

} // namespace

const double flip_pixels_per_degree = 0.7 * (3840 / 0.7) * (pi / 180);

std::vector<float> flip_map(const FlipPicture& reference, const FlipPicture& test, double pixels_per_degree)
{
	std::vector<float> map(std::size_t(reference.width) * reference.height, 0);
	if (reference.rgb == test.rgb || map.empty())
		return map;
	static const ColourError colour_error;
	const Seen a = see(reference, pixels_per_degree), b = see(test, pixels_per_degree);
	for_each_row(reference.height, [&](std::size_t y) {
		for (std::size_t i = y * reference.width; i < (y + 1) * reference.width; ++i)
			map[i] = static_cast<float>(
			    std::pow(colour_error(a.colours[i], b.colours[i]), 1 - feature_error(a.features, b.features, i)));
	});
	return map;
}

HdrFlip hdr_flip_map(const FlipPicture& reference, const FlipPicture& test, double pixels_per_degree)
{
	HdrFlip result;
	result.map.assign(std::size_t(reference.width) * reference.height, 0);
	if (result.map.empty())
		return result;
	const Exposures exposures = exposures_of(reference);
	result.first_exposure = exposures.first;
	result.last_exposure = exposures.last;
	result.exposures = exposures.count;
	if (reference.rgb == test.rgb)
		return result;
	for (unsigned i = 0; i < exposures.count; ++i) {
		const double stops = exposures.first + (exposures.last - exposures.first) * i / (exposures.count - 1);
		const std::vector<float> map = flip_map(exposed(reference, stops), exposed(test, stops), pixels_per_degree);
		for (std::size_t p = 0; p < map.size(); ++p)
			result.map[p] = std::max(result.map[p], map[p]);
	}
	return result;
}

double mean_of(const std::vector<float>& map)
{
	double sum = 0;
	for (const float value : map)
		sum += static_cast<double>(value);
	return map.empty() ? 0 : sum / static_cast<double>(map.size());
}

} // namespace rt
