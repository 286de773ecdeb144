#include "render/compare.h"

#include "render/flip.h"

#include <half.h>

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <utility>

namespace rt {

namespace {

std::int64_t float_bits(float value)
{
	std::uint32_t bits;
	std::memcpy(&bits, &value, sizeof bits);
	return bits;
}

// The place of a float among all of its type, in the order of their values, -0 before +0. `sign` is the sign's bit.
std::int64_t place(std::int64_t bits, std::int64_t sign) { return (bits & sign) != 0 ? sign - 1 - bits : bits; }

std::uint64_t distance(std::int64_t a, std::int64_t b)
{
	return a > b ? static_cast<std::uint64_t>(a) - static_cast<std::uint64_t>(b)
	             : static_cast<std::uint64_t>(b) - static_cast<std::uint64_t>(a);
}

struct Pair {
	double a, b;                 // in units of white, or radiances
	double difference;           // a - b
	std::int64_t bits_a, bits_b; // equal exactly if the values are
	std::uint64_t steps;
	bool is_finite; // both are
};

// Both images in one form, value by value. What had to be converted lives here.
class Values {
public:
	static Result<Values> of(const LoadedImage& a, const LoadedImage& b)
	{
		Values values(a, b);
		values.channels_ = std::min(a.channels, b.channels);
		if (a.channels != b.channels)
			values.notes.push_back(
			    fmt::format("{} has alpha and the other has not: alpha is not compared", a.channels > 3 ? "A" : "B"));
		for (const LoadedImage* image : {&a, &b})
			if (!image->left_out.empty())
				values.notes.push_back(fmt::format("channels of {} that are not compared: {}", image == &a ? "A" : "B",
				                                   fmt::join(image->left_out, ", ")));
		if (is_encoded(a.type) != is_encoded(b.type))
			RT_TRY(values.encode_one());
		else if (is_encoded(a.type))
			values.align_codes();
		else
			values.align_floats();
		return values;
	}

	std::size_t channels() const { return channels_; }
	Step step() const { return step_; }
	double value_of_code() const { return static_cast<double>(white_); } // 1 for linear values

	Pair at(std::uint64_t pixel, std::size_t channel) const
	{
		if (step_ == Step::FilmUnit)
			return sums_at(pixel, channel);
		const float a = values_a()[static_cast<std::size_t>(pixel) * a_.channels + channel];
		const float b = values_b()[static_cast<std::size_t>(pixel) * b_.channels + channel];
		Pair pair{};
		pair.is_finite = std::isfinite(a) && std::isfinite(b);
		if (step_ == Step::Code) {
			const double code_a = static_cast<double>(a * factor_a_), code_b = static_cast<double>(b * factor_b_);
			const double white = static_cast<double>(white_);
			pair.a = code_a / white;
			pair.b = code_b / white;
			pair.difference = (code_a - code_b) / white;
			pair.bits_a = static_cast<std::int64_t>(code_a);
			pair.bits_b = static_cast<std::int64_t>(code_b);
			pair.steps = distance(pair.bits_a, pair.bits_b);
			return pair;
		}
		pair.a = static_cast<double>(a);
		pair.b = static_cast<double>(b);
		pair.difference = pair.a - pair.b;
		const bool is_half = step_ == Step::HalfUlp;
		pair.bits_a = is_half ? half(a).bits() : float_bits(a);
		pair.bits_b = is_half ? half(b).bits() : float_bits(b);
		const std::int64_t sign = is_half ? 0x8000 : 0x80000000;
		pair.steps = distance(place(pair.bits_a, sign), place(pair.bits_b, sign));
		return pair;
	}

	std::vector<std::string> notes;

private:
	Values(const LoadedImage& a, const LoadedImage& b) : a_(a), b_(b) {}

	const std::vector<float>& values_a() const { return converted_a_.empty() ? a_.values : converted_a_; }
	const std::vector<float>& values_b() const { return converted_b_.empty() ? b_.values : converted_b_; }

	Pair sums_at(std::uint64_t pixel, std::size_t channel) const
	{
		const std::size_t i = 3 * static_cast<std::size_t>(pixel) + channel;
		const std::uint32_t samples = a_.film->samples()[static_cast<std::size_t>(pixel)];
		Pair pair{};
		pair.is_finite = true;
		pair.bits_a = a_.film->sums()[i];
		pair.bits_b = b_.film->sums()[i];
		pair.steps = distance(pair.bits_a, pair.bits_b);
		if (samples == 0)
			return pair;
		const auto radiance = [&](double sum) { return std::ldexp(sum / samples, -a_.film->exponent()); };
		pair.a = radiance(static_cast<double>(pair.bits_a));
		pair.b = radiance(static_cast<double>(pair.bits_b));
		// Of the integers: two large sums that differ in their last bits would be one number as doubles.
		const double magnitude = radiance(static_cast<double>(pair.steps));
		pair.difference = pair.bits_a < pair.bits_b ? -magnitude : magnitude;
		return pair;
	}

	// One integer format and one linear image: the linear one is shown with the other's settings.
	Status encode_one()
	{
		const bool encode_a = !is_encoded(a_.type);
		const LoadedImage &linear = encode_a ? a_ : b_, &encoded = encode_a ? b_ : a_;
		if (encoded.type != PixelType::Unsigned8)
			return Error{ErrorKind::Usage, "a 16-bit image and a linear one cannot be compared",
			             fmt::format("{} and {}", a_.name, b_.name), "compare images that are both linear or both PNG",
			             ""};
		std::vector<float>& codes = encode_a ? converted_a_ : converted_b_;
		codes.reserve(linear.values.size());
		if (linear.film) {
			for (const std::uint8_t code : to_8bit(*linear.film, encoded.display))
				codes.push_back(static_cast<float>(code));
		} else {
			for (const float value : linear.values)
				codes.push_back(static_cast<float>(to_8bit(static_cast<double>(value), encoded.display)));
		}
		step_ = Step::Code;
		white_ = largest_code(encoded.type);
		notes.push_back(fmt::format("{} is linear and is compared as 8-bit pixels: transfer {}, exposure {}{}",
		                            encode_a ? "A" : "B", transfer_name(encoded.display.transfer),
		                            encoded.display.exposure_stops,
		                            linear.film ? "" : "; its floats are rounded, so a code may be off by one"));
		return success();
	}

	void align_codes()
	{
		step_ = Step::Code;
		white_ = std::max(largest_code(a_.type), largest_code(b_.type));
		factor_a_ = white_ / largest_code(a_.type); // 257, or 1
		factor_b_ = white_ / largest_code(b_.type);
		if (a_.type != b_.type)
			notes.push_back("8-bit codes are compared with 16-bit ones as code x 257");
	}

	void align_floats()
	{
		const bool is_half = a_.type == PixelType::Half && b_.type == PixelType::Half;
		step_ = is_half ? Step::HalfUlp : Step::FloatUlp;
		if (!a_.film || !b_.film)
			return;
		if (a_.film->exponent() == b_.film->exponent() && a_.film->samples() == b_.film->samples())
			step_ = Step::FilmUnit;
		else
			notes.push_back("the films have other samples or exponents: their mean radiances are compared, not their "
			                "sums");
	}

	const LoadedImage &a_, &b_;
	std::vector<float> converted_a_, converted_b_; // codes of what was linear
	std::size_t channels_ = 3;
	Step step_ = Step::Code;
	float white_ = 1, factor_a_ = 1, factor_b_ = 1;
};

// Counts pixels outside of a tolerance, and says whether they are too many.
class Judge {
public:
	explicit Judge(const Tolerance& tolerance) : tolerance_(tolerance) {}

	bool is_outside(const Pair& pair) const
	{
		if (pair.bits_a == pair.bits_b)
			return false;
		if (!tolerance_.value && !tolerance_.steps)
			return true;
		if (!pair.is_finite)
			return !(std::isnan(pair.a) && std::isnan(pair.b));
		const bool by_value = !tolerance_.value || !(std::fabs(pair.difference) <= *tolerance_.value);
		const bool by_steps = !tolerance_.steps || pair.steps > *tolerance_.steps;
		return by_value && by_steps;
	}
	bool is_outside(float flip) const { return static_cast<double>(flip) > tolerance_.value.value_or(0); }

	void count(bool outside) { pixels_ += outside ? 1 : 0; }
	std::uint64_t pixels() const { return pixels_; }

	bool is_broken(std::uint64_t all_pixels, double largest) const
	{
		const double allowed = tolerance_.percent / 100 * static_cast<double>(all_pixels);
		const bool too_many = static_cast<double>(pixels_) > allowed && pixels_ > tolerance_.pixels;
		return too_many || (tolerance_.hard && !(largest <= *tolerance_.hard));
	}

private:
	Tolerance tolerance_;
	std::uint64_t pixels_ = 0;
};

// 0, 1, 2, 3 to 4, 5 to 8, ...
std::size_t bin_of(std::uint64_t steps)
{
	return steps == 0 ? 0 : steps == 1 ? 1 : static_cast<std::size_t>(65 - __builtin_clzll(steps - 1));
}

std::vector<HistogramBin> empty_histogram()
{
	std::vector<HistogramBin> bins(66);
	bins[1] = {1, 1, 0};
	for (std::size_t i = 2; i < bins.size(); ++i)
		bins[i] = {bins[i - 1].most + 1, i == 65 ? UINT64_MAX : std::uint64_t(1) << (i - 1), 0};
	return bins;
}

// Means over pixels without the largest 0.1 % of them.
double trimmed_mean(std::vector<float> values)
{
	const std::size_t kept = values.size() - values.size() / 1000;
	if (kept == 0)
		return 0;
	std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(kept - 1), values.end());
	double sum = 0;
	for (std::size_t i = 0; i < kept; ++i)
		sum += static_cast<double>(values[i]);
	return sum / static_cast<double>(kept);
}

// The image as it is shown, in linear light.
FlipPicture shown(const LoadedImage& image, const DisplaySettings& display)
{
	FlipPicture picture{image.window.width, image.window.height, {}};
	picture.rgb.reserve(static_cast<std::size_t>(3 * image.pixels()));
	const double exposure =
	    std::ldexp(static_cast<double>(exposure_factor(display.exposure_stops)), -exposure_factor_bits);
	const double white = static_cast<double>(largest_code(image.type));
	for (std::size_t i = 0; i < image.values.size(); i += image.channels)
		for (std::size_t c = 0; c < 3; ++c) {
			const double value = static_cast<double>(image.values[i + c]);
			picture.rgb.push_back(static_cast<float>(
			    is_encoded(image.type) ? decode_transfer(value / white, image.display.transfer) : value * exposure));
		}
	return picture;
}

// The settings with which linear images are shown: those that an integer format brings, or the standard ones.
DisplaySettings display_of(const LoadedImage& a, const LoadedImage& b)
{
	return is_encoded(b.type) ? b.display : is_encoded(a.type) ? a.display : DisplaySettings{};
}

bool same_size(const LoadedImage& a, const LoadedImage& b)
{
	return a.window.width == b.window.width && a.window.height == b.window.height;
}

std::vector<float> flip_errors(const LoadedImage& a, const LoadedImage& b)
{
	const DisplaySettings display = display_of(a, b);
	return flip_map(shown(b, display), shown(a, display));
}

class Comparing {
public:
	Comparing(const LoadedImage& a, const LoadedImage& b, const CompareSettings& settings)
	    : a_(a), b_(b), settings_(settings), fail_(settings.fail), warn_(settings.warn)
	{
	}

	Result<Comparison> run()
	{
		result_.metadata = metadata_differences(a_.provenance, b_.provenance);
		result_.expected =
		    expected_difference(a_.provenance, b_.provenance, is_encoded(a_.type) || is_encoded(b_.type));
		if (!same_size(a_, b_)) {
			result_.verdict = Verdict::DifferentSize;
			return std::move(result_);
		}
		RT_TRY_ASSIGN(const Values values, Values::of(a_, b_));
		result_.notes = values.notes;
		if (a_.knows_window && b_.knows_window && (a_.window.x != b_.window.x || a_.window.y != b_.window.y))
			result_.notes.push_back("the files hold different windows of the image; positions are those of A");
		if (a_.film && b_.film && a_.film->exponent() != b_.film->exponent())
			result_.notes.push_back(
			    fmt::format("fixed-point exponents: A {}, B {}", a_.film->exponent(), b_.film->exponent()));
		count(values);
		see();
		judge();
		return std::move(result_);
	}

private:
	void count(const Values& values)
	{
		result_.step = values.step();
		result_.channels = values.channels();
		result_.pixels = a_.pixels();
		result_.values = result_.pixels * result_.channels;
		result_.histogram = empty_histogram();
		std::vector<float> relative;
		relative.reserve(static_cast<std::size_t>(result_.pixels));
		double sum = 0, squares = 0, relative_sum = 0;
		std::array<double, 4> channel_squares{};
		for (std::uint64_t pixel = 0; pixel < result_.pixels; ++pixel) {
			bool differs = false, fails = false, warns = false;
			double pixel_relative = 0;
			for (std::size_t c = 0; c < result_.channels; ++c) {
				const Pair pair = values.at(pixel, c);
				if (pair.bits_a != pair.bits_b) {
					differs = true;
					fails = fails || fail_.is_outside(pair);
					warns = warns || warn_.is_outside(pair);
					see_difference(values, pair, pixel, c);
				} else {
					result_.histogram[0].values++;
				}
				if (!pair.is_finite)
					continue;
				const double size = std::fabs(pair.difference), square = pair.difference * pair.difference;
				result_.peak = std::max({result_.peak, pair.a, pair.b});
				sum += size;
				squares += square;
				pixel_relative += square / (pair.b * pair.b + 0.01);
				result_.means[c].a += pair.a;
				result_.means[c].b += pair.b;
				result_.means[c].difference += pair.difference;
				channel_squares[c] += square;
			}
			result_.differing_pixels += differs ? 1 : 0;
			fail_.count(fails);
			warn_.count(warns);
			relative_sum += pixel_relative;
			relative.push_back(static_cast<float>(pixel_relative / static_cast<double>(result_.channels)));
		}
		while (result_.histogram.size() > 1 && result_.histogram.back().values == 0)
			result_.histogram.pop_back();
		finish_metrics(sum, squares, relative_sum, channel_squares);
		result_.rel_mse_trimmed = trimmed_mean(std::move(relative));
	}

	void see_difference(const Values& values, const Pair& pair, std::uint64_t pixel, std::size_t channel)
	{
		result_.differing_values++;
		if (pair.is_finite) {
			result_.histogram[bin_of(pair.steps)].values++;
			result_.most_steps = std::max(result_.most_steps, pair.steps);
		} else {
			result_.not_finite++;
		}
		const double size = pair.is_finite ? std::fabs(pair.difference) : std::numeric_limits<double>::infinity();
		if (result_.first && size <= result_.max_error)
			return;
		ValueDifference difference;
		difference.x = a_.window.x + static_cast<std::uint32_t>(pixel % a_.window.width);
		difference.y = a_.window.y + static_cast<std::uint32_t>(pixel / a_.window.width);
		difference.channel = channel;
		difference.a = pair.a * values.value_of_code();
		difference.b = pair.b * values.value_of_code();
		difference.bits_a = pair.bits_a;
		difference.bits_b = pair.bits_b;
		difference.steps = pair.steps;
		if (!result_.first)
			result_.first = difference;
		result_.worst = difference;
		result_.max_error = size;
	}

	void finish_metrics(double sum, double squares, double relative_sum, const std::array<double, 4>& channel_squares)
	{
		const double pixels = static_cast<double>(result_.pixels);
		const double values = static_cast<double>(result_.values);
		result_.mae = sum / values;
		result_.rmse = std::sqrt(squares / values);
		result_.rel_mse = relative_sum / values;
		if (result_.rmse > 0)
			result_.psnr = 20 * std::log10(result_.peak / result_.rmse);
		for (std::size_t c = 0; c < result_.channels; ++c) {
			ChannelMeans& means = result_.means[c];
			if (result_.step != Step::Code && channel_squares[c] > 0)
				means.z = means.difference / std::sqrt(channel_squares[c]);
			means.a /= pixels;
			means.b /= pixels;
			means.difference /= pixels;
		}
	}

	void see()
	{
		if (!settings_.flip && !settings_.by_flip && !settings_.hdr_flip)
			return;
		if (settings_.flip || settings_.by_flip) {
			const std::vector<float> map = flip_errors(a_, b_);
			result_.flip = mean_of(map);
			result_.flip_max = map.empty() ? 0 : static_cast<double>(*std::max_element(map.begin(), map.end()));
			if (settings_.by_flip) {
				fail_ = Judge(settings_.fail);
				warn_ = Judge(settings_.warn);
				for (const float error : map) {
					fail_.count(fail_.is_outside(error));
					warn_.count(warn_.is_outside(error));
				}
			}
		}
		if (settings_.hdr_flip && !is_encoded(a_.type) && !is_encoded(b_.type))
			result_.hdr_flip = mean_of(hdr_flip_map(shown(b_, {}), shown(a_, {})).map);
		else if (settings_.hdr_flip)
			result_.notes.push_back("HDR-FLIP is for linear images only");
	}

	void judge()
	{
		result_.failing_pixels = fail_.pixels();
		result_.warning_pixels = warn_.pixels();
		const double largest = settings_.by_flip ? *result_.flip_max : result_.max_error;
		// Equal means of unequal films are a match, not the same film.
		const bool other_film = a_.film && b_.film && result_.step != Step::FilmUnit;
		result_.verdict = result_.differing_values == 0              ? other_film ? Verdict::Match : Verdict::Identical
		                  : fail_.is_broken(result_.pixels, largest) ? Verdict::Failure
		                  : warn_.is_broken(result_.pixels, largest) ? Verdict::Warning
		                                                             : Verdict::Match;
	}

	const LoadedImage &a_, &b_;
	const CompareSettings& settings_;
	Judge fail_, warn_;
	Comparison result_;
};

Error cannot_subtract(const LoadedImage& a, const LoadedImage& b)
{
	return Error{ErrorKind::Usage,
	             fmt::format("the images have {}x{} and {}x{} pixels", a.window.width, a.window.height, b.window.width,
	                         b.window.height),
	             fmt::format("{} and {}", a.name, b.name), "a difference image needs two of one size", ""};
}

std::uint8_t quantised(double value)
{
	return !(value < 1) ? 255 : static_cast<std::uint8_t>(std::lround(255 * std::max(value, 0.0)));
}

} // namespace

Result<Comparison> compare_images(const LoadedImage& a, const LoadedImage& b, const CompareSettings& settings)
{
	return Comparing(a, b, settings).run();
}

Result<DifferencePicture> difference_picture(const LoadedImage& a, const LoadedImage& b, std::optional<double> scale)
{
	if (!same_size(a, b))
		return cannot_subtract(a, b);
	RT_TRY_ASSIGN(const Values values, Values::of(a, b));
	DifferencePicture picture{a.window.width, a.window.height, {}, 1};
	const auto difference = [&values](std::uint64_t pixel, std::size_t channel) {
		const Pair pair = values.at(pixel, channel);
		return pair.bits_a == pair.bits_b ? 0
		       : pair.is_finite           ? std::fabs(pair.difference)
		                                  : std::numeric_limits<double>::infinity();
	};
	double largest = 0;
	if (!scale)
		for (std::uint64_t pixel = 0; pixel < a.pixels(); ++pixel)
			for (std::size_t c = 0; c < 3; ++c)
				if (const double size = difference(pixel, c); std::isfinite(size))
					largest = std::max(largest, size);
	picture.scale = scale ? *scale : largest > 0 ? 1 / largest : 1;
	picture.rgb.reserve(static_cast<std::size_t>(3 * a.pixels()));
	for (std::uint64_t pixel = 0; pixel < a.pixels(); ++pixel)
		for (std::size_t c = 0; c < 3; ++c)
			picture.rgb.push_back(quantised(difference(pixel, c) * picture.scale));
	return picture;
}

Result<DifferencePicture> flip_picture(const LoadedImage& a, const LoadedImage& b, std::optional<double> scale)
{
	if (!same_size(a, b))
		return cannot_subtract(a, b);
	DifferencePicture picture{a.window.width, a.window.height, {}, scale.value_or(1)};
	for (const float error : flip_errors(a, b))
		picture.rgb.insert(picture.rgb.end(), 3, quantised(static_cast<double>(error) * picture.scale));
	return picture;
}

std::vector<std::uint8_t> shown_rgb(const LoadedImage& image)
{
	std::vector<std::uint8_t> rgb;
	rgb.reserve(static_cast<std::size_t>(3 * image.pixels()));
	for (std::uint64_t pixel = 0; pixel < image.pixels(); ++pixel)
		for (std::size_t c = 0; c < 3; ++c) {
			const auto value = static_cast<double>(image.values[pixel * image.channels + c]);
			rgb.push_back(is_encoded(image.type) ? quantised(value / static_cast<double>(largest_code(image.type)))
			                                     : to_8bit(value, DisplaySettings{}));
		}
	return rgb;
}

const char* name_of(Verdict verdict)
{
	switch (verdict) {
	case Verdict::Identical:
		return "identical";
	case Verdict::Match:
		return "match";
	case Verdict::Warning:
		return "warning";
	case Verdict::Failure:
		return "failure";
	case Verdict::DifferentSize:
		return "different size";
	}
	return "";
}

const char* name_of(Step step, bool plural)
{
	switch (step) {
	case Step::Code:
		return plural ? "codes" : "code";
	case Step::HalfUlp:
		return plural ? "ULPs of half" : "ULP of half";
	case Step::FloatUlp:
		return plural ? "ULPs" : "ULP";
	case Step::FilmUnit:
		return plural ? "units of the film" : "unit of the film";
	}
	return "";
}

} // namespace rt
