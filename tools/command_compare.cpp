#include "tools/command_compare.h"

#include "support/files.h"
#include "tools/film_provenance.h"
#include "tools/report.h"
#include "verify/html_page.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <cmath>
#include <utility>

namespace rt {

namespace {

using Json = nlohmann::ordered_json;
using Rows = std::vector<std::vector<std::string>>;

constexpr const char* channel_names[] = {"R", "G", "B", "A"};

int exit_status(Verdict verdict)
{
	switch (verdict) {
	case Verdict::Identical:
	case Verdict::Match:
		return 0;
	case Verdict::Warning:
		return 1;
	case Verdict::Failure:
		return 2;
	case Verdict::DifferentSize:
		return 3;
	}
	return 2;
}

const char* meaning_of(KeyEffect effect)
{
	switch (effect) {
	case KeyEffect::Image:
		return "makes another image";
	case KeyEffect::Display:
		return "makes other 8-bit pixels";
	case KeyEffect::Device:
		return "must not change a bit";
	case KeyEffect::Trust:
		return "says whether the device is verified";
	case KeyEffect::Result:
		return "follows from the pixels";
	case KeyEffect::Unknown:
		return "not known to this rt";
	}
	return "";
}

std::string format_text(const LoadedImage& image)
{
	std::string text = fmt::format("{} {}, {}x{}", name_of(image.format),
	                               image.film ? fmt::format("2^-{}", image.film->exponent()) : name_of(image.type),
	                               image.window.width, image.window.height);
	if (image.window.width != image.image_width || image.window.height != image.image_height)
		text += fmt::format(" of {}x{}", image.image_width, image.image_height);
	return text;
}

// What a file says, or what its integers say if it has them.
std::string film_hash_of(const LoadedImage& image)
{
	return image.film ? image.film->hash().hex() : provenance_value(image.provenance, "FilmHash");
}

// A film whose provenance claims another hash than its integers have: one of the two was altered.
bool contradicts_itself(const LoadedImage& image)
{
	const std::string said = provenance_value(image.provenance, "FilmHash");
	return image.film && !said.empty() && said != image.film->hash().hex();
}

std::string share(std::uint64_t part, std::uint64_t whole, const char* noun)
{
	return fmt::format("{} of {} {} ({:.3g} %)", part, whole, noun,
	                   whole == 0 ? 0 : 100 * static_cast<double>(part) / static_cast<double>(whole));
}

std::string headline(const Comparison& comparison)
{
	switch (comparison.verdict) {
	case Verdict::Identical:
		return "identical: every value is the same to the last bit";
	case Verdict::DifferentSize:
		return "different size";
	default:
		break;
	}
	if (comparison.differing_pixels == 0)
		return fmt::format("{}: every mean is the same, the films are not", name_of(comparison.verdict));
	return fmt::format("{}: {}", name_of(comparison.verdict),
	                   share(comparison.differing_pixels, comparison.pixels, "pixels differ"));
}

std::string expectation_text(const Comparison& comparison)
{
	const bool differs = comparison.verdict == Verdict::DifferentSize || comparison.differing_values > 0;
	const Expected& expected = comparison.expected;
	switch (expected.expectation) {
	case Expectation::Different:
		return fmt::format("{}: {}",
		                   differs ? "a difference was to be expected" : "a difference would not have surprised",
		                   expected.reason);
	case Expectation::Unknown:
		return "whether a difference is to be expected is not known: " + expected.reason;
	case Expectation::Same:
		break;
	}
	if (!differs)
		return "as it should be: " + expected.reason;
	return fmt::format("NOT expected: {}. A device, a driver or rt is wrong, or a file was altered", expected.reason);
}

std::string hex_text(std::int64_t bits, Step step)
{
	switch (step) {
	case Step::Code:
		return fmt::format("0x{:02x}", bits);
	case Step::HalfUlp:
		return fmt::format("0x{:04x}", bits);
	case Step::FloatUlp:
		return fmt::format("0x{:08x}", bits);
	case Step::FilmUnit:
		return fmt::format("0x{:016x}", static_cast<std::uint64_t>(bits));
	}
	return "";
}

std::string steps_text(std::uint64_t steps, Step step)
{
	return fmt::format("{} {}", steps, name_of(step, steps != 1));
}

// Shortest decimals that are the same float, code or, of a film's mean, double.
std::string decimal_text(double value, Step step)
{
	return step == Step::FilmUnit ? fmt::format("{}", value) : fmt::format("{}", static_cast<float>(value));
}

std::string difference_text(const ValueDifference& difference, Step step)
{
	return fmt::format(
	    "({}, {}) {}: {} and {}, {} and {}, {}", difference.x, difference.y, channel_names[difference.channel],
	    decimal_text(difference.a, step), decimal_text(difference.b, step), hex_text(difference.bits_a, step),
	    hex_text(difference.bits_b, step),
	    std::isfinite(difference.a) && std::isfinite(difference.b) ? steps_text(difference.steps, step) : "not finite");
}

std::string bin_text(const HistogramBin& bin)
{
	return bin.least == bin.most ? fmt::format("{}", bin.least) : fmt::format("{} to {}", bin.least, bin.most);
}

std::string histogram_text(const Comparison& comparison)
{
	Rows rows = {{name_of(comparison.step, true), ">values", ">of all"}};
	for (const HistogramBin& bin : comparison.histogram)
		if (bin.values > 0)
			rows.push_back({bin_text(bin), fmt::format("{}", bin.values),
			                fmt::format("{:.3g} %", 100 * static_cast<double>(bin.values) /
			                                            static_cast<double>(comparison.values))});
	if (comparison.not_finite > 0)
		rows.push_back({"not finite", fmt::format("{}", comparison.not_finite), ""});
	return format_table(rows, "  ");
}

std::string metrics_text(const Comparison& comparison)
{
	Rows rows;
	const auto add = [&rows](const char* name, std::string value) { rows.push_back({name, std::move(value)}); };
	add("max error", fmt::format("{:.9g}", comparison.max_error));
	add("MAE", fmt::format("{:.9g}", comparison.mae));
	add("RMSE", fmt::format("{:.9g}", comparison.rmse));
	add("relMSE", fmt::format("{:.9g}, without the worst 0.1 % of the pixels {:.9g}", comparison.rel_mse,
	                          comparison.rel_mse_trimmed));
	if (comparison.psnr)
		add("PSNR", fmt::format("{:.6f} dB (peak {:.6g})", *comparison.psnr, comparison.peak));
	for (std::size_t c = 0; c < comparison.channels; ++c) {
		const ChannelMeans& means = comparison.means[c];
		add(c == 0 ? "mean A - B" : "", fmt::format("{} {:+.6e} of {:.6g}{}", channel_names[c], means.difference,
		                                            means.b, means.z ? fmt::format(", z {:+.2f}", *means.z) : ""));
	}
	if (comparison.flip)
		add("FLIP", fmt::format("mean {:.6f}, worst pixel {:.6f}", *comparison.flip, *comparison.flip_max));
	if (comparison.hdr_flip)
		add("HDR-FLIP", fmt::format("mean {:.6f}", *comparison.hdr_flip));
	return format_table(rows, "  ");
}

std::string files_text(const LoadedImage& a, const LoadedImage& b)
{
	return format_table({{"", "A", "B"},
	                     {"file", a.name, b.name},
	                     {"format", format_text(a), format_text(b)},
	                     {"pixel hash", a.pixel_hash().hex(), b.pixel_hash().hex()},
	                     {"film hash", film_hash_of(a).empty() ? "not told" : film_hash_of(a),
	                      film_hash_of(b).empty() ? "not told" : film_hash_of(b)}});
}

std::string metadata_text(const LoadedImage& a, const LoadedImage& b, const Comparison& comparison)
{
	// Nothing to hold against each other where one file says nothing.
	if (comparison.metadata.empty() || a.provenance.empty() || b.provenance.empty())
		return "";
	const auto shown = [](const std::string& value) { return value.empty() ? "-" : value; };
	Rows rows;
	std::string long_ones; // a table with a driver's whole description in it would be wider than any terminal
	for (const MetadataDifference& difference : comparison.metadata) {
		constexpr std::size_t widest = 32; // a hash
		const std::string a_value = shown(difference.a), b_value = shown(difference.b);
		if (a_value.size() <= widest && b_value.size() <= widest)
			rows.push_back({difference.key, a_value, b_value, meaning_of(difference.effect)});
		else
			long_ones += fmt::format("  {}, which {}\n    A  {}\n    B  {}\n", difference.key,
			                         meaning_of(difference.effect), a_value, b_value);
	}
	return "\nmetadata that differs\n" + format_table(rows, "  ") + long_ones;
}

Json difference_json(const ValueDifference& difference, Step step)
{
	return {{"x", difference.x},
	        {"y", difference.y},
	        {"channel", channel_names[difference.channel]},
	        {"a", difference.a},
	        {"b", difference.b},
	        {"hex_a", hex_text(difference.bits_a, step)},
	        {"hex_b", hex_text(difference.bits_b, step)},
	        {"steps", difference.steps}};
}

Json image_json(const LoadedImage& image)
{
	Json provenance = Json::object();
	for (const auto& [key, value] : image.provenance)
		provenance[key] = value;
	return {{"file", image.name},
	        {"format", name_of(image.format)},
	        {"type", name_of(image.type)},
	        {"width", image.window.width},
	        {"height", image.window.height},
	        {"pixel_hash", image.pixel_hash().hex()},
	        {"film_hash", film_hash_of(image)},
	        {"film_hash_contradicts", contradicts_itself(image)},
	        {"provenance", provenance}};
}

template <class T>
Json optional_json(const std::optional<T>& value)
{
	return value ? Json(*value) : Json(nullptr);
}

const char* word_for(Expectation expectation)
{
	return expectation == Expectation::Same ? "same" : expectation == Expectation::Different ? "different" : "unknown";
}

Json metrics_json(const Comparison& comparison)
{
	Json means = Json::object();
	for (std::size_t c = 0; c < comparison.channels; ++c)
		means[channel_names[c]] = {{"a", comparison.means[c].a},
		                           {"b", comparison.means[c].b},
		                           {"difference", comparison.means[c].difference},
		                           {"z", optional_json(comparison.means[c].z)}};
	return {{"max_error", comparison.max_error},
	        {"mae", comparison.mae},
	        {"rmse", comparison.rmse},
	        {"rel_mse", comparison.rel_mse},
	        {"rel_mse_trimmed", comparison.rel_mse_trimmed},
	        {"psnr", optional_json(comparison.psnr)},
	        {"peak", comparison.peak},
	        {"means", means},
	        {"flip", optional_json(comparison.flip)},
	        {"flip_max", optional_json(comparison.flip_max)},
	        {"hdr_flip", optional_json(comparison.hdr_flip)}};
}

class CompareCommand {
public:
	explicit CompareCommand(const CompareOptions& options) : options_(options) {}

	Result<int> run()
	{
		RT_TRY_ASSIGN(const LoadedImage a, load_image(options_.a));
		RT_TRY_ASSIGN(const LoadedImage b, load_image(options_.b));
		RT_TRY_ASSIGN(const Comparison comparison, compare_images(a, b, options_.settings));
		std::string picture_note;
		Json picture_json = nullptr;
		if (!options_.output.empty() && comparison.verdict != Verdict::DifferentSize &&
		    (!options_.output_if_different || comparison.differing_pixels > 0))
			RT_TRY(write_picture(a, b, picture_note, picture_json));
		if (!options_.html.empty())
			RT_TRY(write_file(options_.html, page(a, b, comparison)));
		if (options_.json) {
			Json json = comparison_json(a, b, comparison);
			json["difference_image"] = picture_json;
			print_result(to_text(json));
		} else if (options_.quiet) {
			print_result(headline(comparison) + "\n");
		} else {
			print_result(comparison_text(a, b, comparison) + picture_note);
		}
		return exit_status(comparison.verdict);
	}

private:
	// The text for the terminal with the pictures beside it.
	std::string page(const LoadedImage& a, const LoadedImage& b, const Comparison& comparison) const
	{
		const bool good = exit_status(comparison.verdict) <= 1;
		std::string html =
		    html_head("rt compare: " + std::string(name_of(comparison.verdict))) + "<h1>rt compare</h1>\n";
		html +=
		    fmt::format("<p class=\"verdict {}\">{}</p>\n", good ? "good" : "bad", html_escape(headline(comparison)));
		for (const auto& [letter, image] : {std::pair("A", &a), std::pair("B", &b)})
			html += html_picture(
			    fmt::format("{}: {}", letter, image->name),
			    encode_png(image->window.width, image->window.height, shown_rgb(*image), Transfer::Srgb, {}));
		if (comparison.verdict != Verdict::DifferentSize) {
			html += difference(difference_picture(a, b, options_.scale), "|A - B|");
			if (options_.settings.flip)
				html += difference(flip_picture(a, b, {}), "FLIP, white: 1");
		}
		html += fmt::format("<pre>{}</pre>\n", html_escape(comparison_text(a, b, comparison)));
		return html + html_end;
	}

	static std::string difference(const Result<DifferencePicture>& picture, const std::string& what)
	{
		if (!picture)
			return html_picture(what, picture.error());
		return html_picture(picture->scale == 1 ? what : fmt::format("{} x {:.6g}", what, picture->scale),
		                    encode_png(picture->width, picture->height, picture->rgb, Transfer::Linear, {}));
	}

	Status write_picture(const LoadedImage& a, const LoadedImage& b, std::string& note, Json& json) const
	{
		const bool flip = options_.settings.by_flip;
		RT_TRY_ASSIGN(const DifferencePicture picture,
		              flip ? flip_picture(a, b, options_.scale) : difference_picture(a, b, options_.scale));
		const Provenance origin = {{"Software", software_text()},
		                           {"Difference", fmt::format("{} x {:.9g}", flip ? "FLIP" : "|A - B|", picture.scale)},
		                           {"A", a.name + " " + a.pixel_hash().hex()},
		                           {"B", b.name + " " + b.pixel_hash().hex()}};
		RT_TRY_ASSIGN(const std::vector<std::uint8_t> png,
		              encode_png(picture.width, picture.height, picture.rgb, Transfer::Linear, origin));
		RT_TRY(write_file(options_.output, png.data(), png.size()));
		note = fmt::format("\n{}: {} x {:.6g}\n", options_.output, flip ? "FLIP" : "|A - B|", picture.scale);
		json = {{"file", options_.output}, {"scale", picture.scale}};
		return success();
	}

	const CompareOptions& options_;
};

} // namespace

std::string comparison_text(const LoadedImage& a, const LoadedImage& b, const Comparison& comparison)
{
	std::string text = headline(comparison) + "\n" + expectation_text(comparison) + "\n";
	const std::string film_a = film_hash_of(a), film_b = film_hash_of(b);
	if (comparison.verdict == Verdict::Identical && !film_a.empty() && !film_b.empty() && film_a != film_b)
		text += "the films behind them are not the same: ask for .rtfilm files to see where\n";
	for (const LoadedImage* image : {&a, &b})
		if (contradicts_itself(*image))
			text += fmt::format("{}: the film's hash is not the one that its provenance tells ({})\n", image->name,
			                    provenance_value(image->provenance, "FilmHash"));
	text += "\n" + files_text(a, b) + metadata_text(a, b, comparison);
	for (const std::string& note : comparison.notes)
		text += "\nnote: " + note;
	if (!comparison.notes.empty())
		text += "\n";
	if (comparison.verdict == Verdict::DifferentSize || comparison.differing_values == 0)
		return text;
	text +=
	    fmt::format("\npixels\n  {}\n  {}\n", share(comparison.differing_pixels, comparison.pixels, "pixels differ"),
	                share(comparison.differing_values, comparison.values, "values differ"));
	if (comparison.failing_pixels != comparison.differing_pixels ||
	    comparison.warning_pixels != comparison.differing_pixels)
		text += fmt::format("  beyond the limit of failure {}, of warning {}\n",
		                    plural(comparison.failing_pixels, "pixel"), plural(comparison.warning_pixels, "pixel"));
	if (comparison.first)
		text += format_table({{"first", difference_text(*comparison.first, comparison.step)},
		                      {"worst", difference_text(*comparison.worst, comparison.step)},
		                      {"most", steps_text(comparison.most_steps, comparison.step)}},
		                     "  ");
	text += "\nhistogram\n" + histogram_text(comparison);
	text += "\nmetrics\n" + metrics_text(comparison);
	return text;
}

Json comparison_json(const LoadedImage& a, const LoadedImage& b, const Comparison& comparison)
{
	Json metadata = Json::array();
	for (const MetadataDifference& difference : comparison.metadata)
		metadata.push_back({{"key", difference.key},
		                    {"a", difference.a},
		                    {"b", difference.b},
		                    {"effect", meaning_of(difference.effect)}});
	Json json = {{"verdict", name_of(comparison.verdict)},
	             {"exit_status", exit_status(comparison.verdict)},
	             {"expected",
	              {{"difference", word_for(comparison.expected.expectation)}, {"reason", comparison.expected.reason}}},
	             {"a", image_json(a)},
	             {"b", image_json(b)},
	             {"metadata", metadata},
	             {"notes", comparison.notes}};
	if (comparison.verdict == Verdict::DifferentSize)
		return json;
	Json histogram = Json::array();
	for (const HistogramBin& bin : comparison.histogram)
		histogram.push_back({{"least", bin.least}, {"most", bin.most}, {"values", bin.values}});
	json["step"] = name_of(comparison.step, false);
	json["pixels"] = comparison.pixels;
	json["differing_pixels"] = comparison.differing_pixels;
	json["values"] = comparison.values;
	json["differing_values"] = comparison.differing_values;
	json["not_finite"] = comparison.not_finite;
	json["failing_pixels"] = comparison.failing_pixels;
	json["warning_pixels"] = comparison.warning_pixels;
	json["first"] = comparison.first ? difference_json(*comparison.first, comparison.step) : Json(nullptr);
	json["worst"] = comparison.worst ? difference_json(*comparison.worst, comparison.step) : Json(nullptr);
	json["most_steps"] = comparison.most_steps;
	json["histogram"] = histogram;
	json["metrics"] = metrics_json(comparison);
	return json;
}

Result<int> run_compare(const CompareOptions& options)
{
	const Result<int> status = CompareCommand(options).run();
	if (status || status.error().kind != ErrorKind::InputOutput)
		return status;
	constexpr int file_error = 4;
	report_error(status.error());
	return file_error;
}

} // namespace rt
