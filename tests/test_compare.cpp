// test_compare.cpp: reading images back, what is counted where two differ, and the metrics against closed forms,
// OpenImageIO's idiff and the authors' FLIP (where those are installed).
#include "render/compare.h"
#include "render/flip.h"
#include "render/image_file.h"
#include "render/image_read.h"
#include "support/files.h"
#include "tests/catch.h"
#include "tests/run_command.h"

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfOutputFile.h>
#include <half.h>
#include <png.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <functional>
#include <limits>
#include <random>
#include <regex>
#include <string>
#include <vector>

#include <sys/wait.h>
#include <unistd.h>

using namespace rt;
using Bytes = std::vector<std::uint8_t>;

namespace {

const Provenance provenance = {{"Software", "rt 0.1"},     {"Contract", "1"},      {"SceneHash", "ab"},
                               {"Samples", "4"},           {"Seed", "0"},          {"Precision", "exact"},
                               {"Device", "Ger\xc3\xa4t"}, {"SelfTest", "passed"}, {"Transfer", "srgb"},
                               {"Exposure", "0"}};

Provenance with(const std::string& key, const std::string& value)
{
	Provenance changed = provenance;
	for (auto& entry : changed)
		if (entry.first == key)
			entry.second = value;
	return changed;
}

Film test_film(unsigned seed = 5, std::uint32_t width = 37, std::uint32_t height = 23)
{
	Film film(width + 20, height + 30, Window{11, 13, width, height}, 30);
	std::mt19937_64 random(seed);
	for (auto& sum : film.sums())
		sum = static_cast<std::int64_t>(random() >> (31 + random() % 10));
	for (auto& count : film.samples())
		count = 7;
	return film;
}

LoadedImage decoded(const Bytes& bytes)
{
	auto image = decode_image(bytes.data(), bytes.size(), "test");
	INFO((image ? "" : image.error().message));
	REQUIRE(image);
	return std::move(*image);
}

Bytes encoded(const Film& film, ImageFormat format, const DisplaySettings& display = {})
{
	auto bytes = encode_image(film, format, display, provenance);
	REQUIRE(bytes);
	return std::move(*bytes);
}

LoadedImage float_image(std::uint32_t width, std::uint32_t height, const std::vector<float>& values)
{
	LoadedImage image;
	image.name = "floats";
	image.format = ImageFormat::Pfm;
	image.type = PixelType::Float;
	image.image_width = width;
	image.image_height = height;
	image.window = {0, 0, width, height};
	image.values = values;
	REQUIRE(values.size() == 3 * std::size_t(width) * height);
	return image;
}

Comparison compared(const LoadedImage& a, const LoadedImage& b, CompareSettings settings = {})
{
	settings.flip = false;
	auto comparison = compare_images(a, b, settings);
	REQUIRE(comparison);
	return std::move(*comparison);
}

std::uint64_t in_bin(const Comparison& comparison, std::uint64_t steps)
{
	for (const HistogramBin& bin : comparison.histogram)
		if (bin.least <= steps && steps <= bin.most)
			return bin.values;
	return 0;
}

// A directory for the programs that the results are held against.
class Scratch {
public:
	Scratch()
	{
		std::string pattern = (std::filesystem::temp_directory_path() / "rt-test-compare-XXXXXX").string();
		REQUIRE(mkdtemp(pattern.data()) != nullptr);
		path_ = pattern;
	}
	~Scratch()
	{
		std::error_code ignored;
		std::filesystem::remove_all(path_, ignored);
	}
	Scratch(const Scratch&) = delete;
	Scratch& operator=(const Scratch&) = delete;
	std::string write(const std::string& name, const void* data, std::size_t bytes) const
	{
		const std::string path = path_ + "/" + name;
		REQUIRE(write_file(path, data, bytes));
		return path;
	}

private:
	std::string path_;
};

Outcome shell(const std::string& command) { return run_command(command + " 2>&1"); }

// A PNG of any kind, by libpng.
Bytes foreign_png(std::uint32_t width, std::uint32_t height, int depth, int type, bool interlaced, const Bytes& pixels)
{
	png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, nullptr, nullptr);
	png_infop info = png_create_info_struct(png);
	Bytes bytes;
	png_set_write_fn(
	    png, &bytes,
	    [](png_structp writer, png_bytep data, png_size_t count) {
		    auto* to = static_cast<Bytes*>(png_get_io_ptr(writer));
		    to->insert(to->end(), data, data + count);
	    },
	    nullptr);
	png_set_IHDR(png, info, width, height, depth, type, interlaced ? PNG_INTERLACE_ADAM7 : PNG_INTERLACE_NONE,
	             PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
	const std::size_t row = pixels.size() / height;
	std::vector<png_bytep> rows;
	for (std::size_t y = 0; y < height; ++y)
		rows.push_back(const_cast<png_bytep>(pixels.data() + y * row));
	png_set_rows(png, info, rows.data());
	png_write_png(png, info, PNG_TRANSFORM_IDENTITY, nullptr);
	png_destroy_write_struct(&png, &info);
	return bytes;
}

struct ExrChannel {
	const char* name;
	Imf::PixelType type;
};
// An EXR of 3x2 pixels whose channels hold 0.5, 1, 1.5, ...
Bytes foreign_exr(const std::vector<ExrChannel>& channels)
{
	Imf::Header header(3, 2);
	std::vector<half> halves;
	std::vector<float> floats;
	std::vector<std::uint32_t> integers;
	for (std::uint32_t i = 1; i <= 6; ++i) {
		halves.emplace_back(0.5f * static_cast<float>(i));
		floats.push_back(0.5f * static_cast<float>(i));
		integers.push_back(i);
	}
	Imf::FrameBuffer frame;
	for (const ExrChannel& channel : channels) {
		header.channels().insert(channel.name, Imf::Channel(channel.type));
		const std::size_t size = channel.type == Imf::HALF ? 2 : 4;
		char* const data = channel.type == Imf::HALF    ? reinterpret_cast<char*>(halves.data())
		                   : channel.type == Imf::FLOAT ? reinterpret_cast<char*>(floats.data())
		                                                : reinterpret_cast<char*>(integers.data());
		frame.insert(channel.name, Imf::Slice(channel.type, data, size, 3 * size));
	}
	std::string path = (std::filesystem::temp_directory_path() / "rt-test-compare-exr-XXXXXX").string();
	const int file = mkstemp(path.data());
	REQUIRE(file >= 0);
	close(file);
	{
		Imf::OutputFile out(path.c_str(), header);
		out.setFrameBuffer(frame);
		out.writePixels(2);
	}
	auto bytes = read_file(path);
	std::filesystem::remove(path);
	REQUIRE(bytes);
	return std::move(*bytes);
}

} // namespace

// ---- reading -----------------------------------------------------------------------------------------------------

TEST_CASE("what rt writes is read back to the bit, with its provenance")
{
	const Film film = test_film();
	for (const ImageFormat format : {ImageFormat::Exr, ImageFormat::Pfm, ImageFormat::RtFilm}) {
		INFO(name_of(format));
		const LoadedImage image = decoded(encoded(film, format));
		CHECK(image.format == format);
		CHECK(image.type == PixelType::Float);
		REQUIRE(image.values == image_of(film, {}, "").values);
		CHECK(image.pixel_hash() == image_of(film, {}, "").pixel_hash());
		if (format != ImageFormat::Pfm) {
			CHECK(image.image_width == 57);
			CHECK(image.window.x == 11);
			CHECK(image.window.y == 13);
			for (const auto& [key, value] : provenance)
				CHECK(provenance_value(image.provenance, key) == value);
			CHECK(image.provenance.size() == provenance.size());
		}
	}
	for (const Transfer transfer : {Transfer::Srgb, Transfer::Gamma2, Transfer::Linear}) {
		const LoadedImage png = decoded(encoded(film, ImageFormat::Png, {transfer, 0}));
		const Bytes codes = to_8bit(film, {transfer, 0});
		CHECK(png.type == PixelType::Unsigned8);
		CHECK(png.display.transfer == transfer);
		CHECK(png.provenance == provenance);
		REQUIRE(png.values == std::vector<float>(codes.begin(), codes.end()));
	}
	const LoadedImage film_back = decoded(encoded(film, ImageFormat::RtFilm));
	REQUIRE(film_back.film);
	CHECK(film_back.film->hash() == film.hash());
}

TEST_CASE("PNGs of other programs: 16 bits, grey, alpha, interlaced")
{
	const LoadedImage wide =
	    decoded(foreign_png(1, 2, 16, PNG_COLOR_TYPE_RGB, false, {1, 2, 3, 4, 5, 6, 255, 255, 0, 0, 0, 1}));
	CHECK(wide.type == PixelType::Unsigned16);
	CHECK(wide.values == std::vector<float>{258, 772, 1286, 65535, 0, 1});
	const LoadedImage grey = decoded(foreign_png(2, 1, 8, PNG_COLOR_TYPE_GRAY, false, {7, 9}));
	CHECK(grey.values == std::vector<float>{7, 7, 7, 9, 9, 9});
	CHECK(grey.channels == 3);
	const LoadedImage alpha = decoded(foreign_png(2, 1, 8, PNG_COLOR_TYPE_RGBA, true, {1, 2, 3, 4, 5, 6, 7, 8}));
	CHECK(alpha.channels == 4);
	CHECK(alpha.values == std::vector<float>{1, 2, 3, 4, 5, 6, 7, 8});
	CHECK(alpha.provenance.empty());

	// The alpha of one is not held against nothing, and that is said.
	const LoadedImage plain = decoded(foreign_png(2, 1, 8, PNG_COLOR_TYPE_RGB, false, {1, 2, 3, 5, 6, 7}));
	const Comparison comparison = compared(plain, alpha);
	CHECK(comparison.verdict == Verdict::Identical);
	CHECK(comparison.channels == 3);
	CHECK(comparison.notes.size() == 1);
	// 8 and 16 bits meet where white is white.
	const LoadedImage same = decoded(foreign_png(2, 1, 16, PNG_COLOR_TYPE_GRAY, false, {7, 7, 9, 10}));
	const Comparison depths = compared(grey, same);
	CHECK(depths.differing_pixels == 1);
	CHECK(depths.most_steps == 1);
}

TEST_CASE("EXRs of other programs: half, grey, other channels; integers are refused")
{
	const LoadedImage rgba = decoded(
	    foreign_exr({{"R", Imf::HALF}, {"G", Imf::HALF}, {"B", Imf::HALF}, {"A", Imf::HALF}, {"Z", Imf::FLOAT}}));
	CHECK(rgba.type == PixelType::Half);
	CHECK(rgba.channels == 4);
	CHECK(rgba.left_out == std::vector<std::string>{"Z"});
	CHECK(rgba.values[0] == 0.5f);
	CHECK(rgba.values[23] == 3.0f);
	const LoadedImage grey = decoded(foreign_exr({{"Y", Imf::FLOAT}}));
	CHECK(grey.type == PixelType::Float);
	CHECK(grey.values ==
	      std::vector<float>{0.5f, 0.5f, 0.5f, 1, 1, 1, 1.5f, 1.5f, 1.5f, 2, 2, 2, 2.5f, 2.5f, 2.5f, 3, 3, 3});
	for (const auto& channels : {std::vector<ExrChannel>{{"Z", Imf::FLOAT}},
	                             std::vector<ExrChannel>{{"R", Imf::UINT}, {"G", Imf::UINT}, {"B", Imf::UINT}}}) {
		const Bytes bytes = foreign_exr(channels);
		const auto image = decode_image(bytes.data(), bytes.size(), "name.exr");
		REQUIRE_FALSE(image);
		CHECK(image.error().kind == ErrorKind::InputOutput);
		CHECK(image.error().where == "name.exr");
		CHECK_FALSE(image.error().cure.empty());
	}
}

TEST_CASE("an EXR that claims more than its bytes can hold takes no memory for it")
{
	// The right edge of its data window, after the name, the type, the size and the left and upper edges.
	Bytes bytes = foreign_exr({{"R", Imf::HALF}, {"G", Imf::HALF}, {"B", Imf::HALF}});
	const std::string name("dataWindow\0box2i\0", 17);
	const auto at = std::search(bytes.begin(), bytes.end(), name.begin(), name.end());
	REQUIRE(at != bytes.end());
	const auto edge = at + 17 + 4 + 8;
	for (const std::uint32_t last : {2u, 19999999u}) {
		for (int i = 0; i < 4; ++i)
			edge[i] = static_cast<std::uint8_t>(last >> 8 * i);
		const auto image = decode_image(bytes.data(), bytes.size(), "wide.exr");
		REQUIRE(bool(image) == (last == 2));
		if (!image)
			CHECK(image.error().message.find("cannot hold 20000000 x 2 pixels") != std::string::npos);
	}
}

TEST_CASE("PFMs of other programs: the other byte order, grey")
{
	const std::string header = "PF\n1 1\n1.0\n";
	Bytes bytes(header.begin(), header.end());
	for (const int byte : {0x3f, 0x80, 0, 0, 0x40, 0, 0, 0, 0xc0, 0x40, 0, 0})
		bytes.push_back(static_cast<std::uint8_t>(byte));
	CHECK(decoded(bytes).values == std::vector<float>{1, 2, -3});
	const std::string grey = "Pf 1 2 -1\n";
	bytes.assign(grey.begin(), grey.end());
	for (const int byte : {0, 0, 0x80, 0x3f, 0, 0, 0, 0x40})
		bytes.push_back(static_cast<std::uint8_t>(byte));
	CHECK(decoded(bytes).values == std::vector<float>{2, 2, 2, 1, 1, 1}); // rows come from the bottom
}

TEST_CASE("broken files are refused with their name, whatever is wrong with them")
{
	const Film film = test_film(1, 9, 7);
	for (const ImageFormat format : {ImageFormat::Png, ImageFormat::Exr, ImageFormat::Pfm, ImageFormat::RtFilm}) {
		INFO(name_of(format));
		const Bytes whole = encoded(film, format);
		for (std::size_t length = 0; length < whole.size(); ++length) {
			// A heap block of the very size, so that a read beyond it is seen by the sanitizers.
			const Bytes part(whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(length));
			const auto image = decode_image(part.data(), part.size(), "cut");
			if (image && format == ImageFormat::Png)
				continue; // libpng forgives a missing IEND
			INFO(length << " of " << whole.size());
			REQUIRE_FALSE(image);
			REQUIRE(image.error().kind == ErrorKind::InputOutput);
			REQUIRE(image.error().where == "cut");
			REQUIRE_FALSE(image.error().cure.empty());
		}
		std::mt19937 random(3);
		for (int i = 0; i < 400; ++i) {
			Bytes changed = whole;
			for (int k = 0; k < 3; ++k)
				changed[random() % changed.size()] = static_cast<std::uint8_t>(random());
			(void)decode_image(changed.data(), changed.size(), "changed"); // anything but a crash or a huge allocation
		}
	}
	// Sizes that the file cannot hold.
	for (const char* header : {"PF\n65536 65536\n-1\n", "PF\n4294967295 4294967295\n-1\n", "PF\n16384 16384\n-1\n",
	                           "PF\n0 5\n-1\n", "PF\n-3 5\n-1\n", "PF\n3 5\nnan\n", "PF\n3"}) {
		INFO(header);
		CHECK_FALSE(decode_image(reinterpret_cast<const std::uint8_t*>(header), std::strlen(header), "x"));
	}
	Bytes png = encoded(film, ImageFormat::Png);
	png[16] = 0x3f; // the width's first byte: about 2^30
	const auto huge = decode_image(png.data(), png.size(), "huge.png");
	REQUIRE_FALSE(huge);
	CHECK(huge.error().message.find("pixels") != std::string::npos);
}

// ---- counting ----------------------------------------------------------------------------------------------------

TEST_CASE("ULPs of floats are counted across zero, and one that is not finite is worst of all")
{
	const float next = std::nextafter(1.0f, 2.0f), least = std::numeric_limits<float>::denorm_min();
	const float infinity = std::numeric_limits<float>::infinity();
	std::vector<float> a(24, 0.5f), b = a;
	a[4] = 1, b[4] = next; // pixel 1, G: 1 ULP
	a[9] = 0.0f, b[9] = -0.0f;
	a[12] = least, b[12] = -least; // -least, -0, +0, least
	a[15] = 3, b[15] = 2;
	const Comparison comparison = compared(float_image(4, 2, a), float_image(4, 2, b));
	CHECK(comparison.verdict == Verdict::Failure);
	CHECK(comparison.step == Step::FloatUlp);
	CHECK(comparison.differing_pixels == 4);
	CHECK(comparison.differing_values == 4);
	REQUIRE(comparison.first);
	CHECK(comparison.first->x == 1);
	CHECK(comparison.first->y == 0);
	CHECK(comparison.first->channel == 1);
	CHECK(comparison.first->steps == 1);
	CHECK(comparison.first->bits_a == 0x3f800000);
	CHECK(comparison.first->bits_b == 0x3f800001);
	REQUIRE(comparison.worst);
	CHECK(comparison.worst->x == 1);
	CHECK(comparison.worst->y == 1);
	CHECK(comparison.max_error == 1);
	CHECK(comparison.most_steps == 1 << 22);
	CHECK(in_bin(comparison, 0) == 20);
	CHECK(in_bin(comparison, 1) == 2); // 1 and its neighbour, the two zeros
	CHECK(in_bin(comparison, 3) == 1);
	CHECK(in_bin(comparison, 1 << 22) == 1);

	b[23] = infinity;
	const Comparison infinite = compared(float_image(4, 2, a), float_image(4, 2, b));
	CHECK(infinite.not_finite == 1);
	CHECK(infinite.worst->x == 3);
	CHECK(std::isinf(infinite.max_error));
	CHECK(infinite.mae == comparison.mae);
	a[23] = infinity; // the same on both sides
	CHECK(compared(float_image(4, 2, a), float_image(4, 2, b)).not_finite == 0);
}

TEST_CASE("ULPs of halves are those of halves")
{
	const LoadedImage a = decoded(foreign_exr({{"R", Imf::HALF}, {"G", Imf::HALF}, {"B", Imf::HALF}}));
	LoadedImage b = a;
	b.values[3] = 1.0f + 1.0f / 1024;
	const Comparison comparison = compared(a, b);
	CHECK(comparison.step == Step::HalfUlp);
	CHECK(comparison.most_steps == 1);
	CHECK(comparison.first->bits_a == 0x3c00);
	CHECK(comparison.first->bits_b == 0x3c01);
}

TEST_CASE("films are compared by their sums: one unit is seen where floats cannot show it")
{
	Film film = test_film();
	film.sums()[30] = std::int64_t(1) << 60;
	const LoadedImage a = image_of(film, provenance, "a");
	CHECK(compared(a, a).verdict == Verdict::Identical);
	film.sums()[30] += 1;
	const LoadedImage b = image_of(film, provenance, "b");
	REQUIRE(a.values == b.values);
	REQUIRE(a.pixel_hash() == b.pixel_hash());
	const Comparison comparison = compared(a, b);
	CHECK(comparison.verdict == Verdict::Failure);
	CHECK(comparison.step == Step::FilmUnit);
	CHECK(comparison.differing_values == 1);
	CHECK(comparison.most_steps == 1);
	CHECK(comparison.first->x == 11 + 10);
	CHECK(comparison.first->y == 13);
	CHECK(comparison.max_error == std::ldexp(1.0 / 7, -30));
	CHECK(comparison.expected.expectation == Expectation::Same);

	// Other samples: means are all that can be compared.
	Film twice = film;
	REQUIRE(twice.add(film));
	const Comparison means = compared(image_of(twice, {}, "twice"), b);
	CHECK(means.step == Step::FloatUlp);
	CHECK(means.differing_values == 0);
	CHECK(means.verdict == Verdict::Match); // not identical: the films are not
	CHECK(means.notes.size() == 1);
}

TEST_CASE("a film and its PNG are the same picture; another exposure is not")
{
	const Film film = test_film();
	for (const DisplaySettings display : {DisplaySettings{}, DisplaySettings{Transfer::Gamma2, 0}}) {
		LoadedImage png = decoded(encoded(film, ImageFormat::Png, display));
		const LoadedImage a = image_of(film, provenance, "film");
		CHECK(compared(a, png).verdict == Verdict::Identical);
		CHECK(compared(png, a).notes.size() == 1);
		// Floats lose their last bits: a code may be off by one.
		const Comparison floats = compared(decoded(encoded(film, ImageFormat::Exr)), png);
		CHECK(floats.most_steps <= 1);
		CHECK(floats.differing_values <= 2);
		png.values[5] = png.values[5] > 100 ? png.values[5] - 3 : png.values[5] + 3;
		const Comparison changed = compared(a, png);
		CHECK(changed.differing_values == 1);
		CHECK(changed.most_steps == 3);
	}
	auto brighter = encode_image(film, ImageFormat::Png, {Transfer::Srgb, 1.5}, with("Exposure", "1.5"));
	REQUIRE(brighter);
	const LoadedImage png = decoded(*brighter);
	CHECK(png.display.exposure_stops == 1.5);
	CHECK(compared(image_of(film, provenance, "film"), png).verdict == Verdict::Identical);
	const Comparison other = compared(decoded(encoded(film, ImageFormat::Png)), png);
	CHECK(other.verdict == Verdict::Failure);
	CHECK(other.expected.expectation == Expectation::Different);
	CHECK(other.expected.reason == "another Exposure");
}

TEST_CASE("images of different sizes are not compared further")
{
	const Comparison comparison =
	    compared(image_of(test_film(1, 9, 7), {}, "a"), image_of(test_film(1, 7, 9), {}, "b"));
	CHECK(comparison.verdict == Verdict::DifferentSize);
	CHECK_FALSE(difference_picture(image_of(test_film(1, 9, 7), {}, "a"), image_of(test_film(1, 7, 9), {}, "b"), {}));
}

TEST_CASE("tolerances are idiff's: value, percentage, number, hard limit; and steps")
{
	std::vector<float> a(300, 0.5f), b = a;
	b[0] = 0.51f;
	b[30] = 0.6f;
	b[60] = std::nextafter(0.5f, 1.0f);
	const LoadedImage left = float_image(10, 10, a), right = float_image(10, 10, b);
	const auto verdict = [&](const Tolerance& fail, const Tolerance& warn) {
		CompareSettings settings;
		settings.fail = fail;
		settings.warn = warn;
		return compared(left, right, settings);
	};
	const auto tolerance = [](std::optional<double> value, double percent = 0, std::uint64_t pixels = 0,
	                          std::optional<double> hard = {}, std::optional<std::uint64_t> steps = {}) {
		return Tolerance{value, steps, percent, pixels, hard};
	};
	CHECK(verdict({}, {}).failing_pixels == 3);
	CHECK(verdict(tolerance(1e-6), tolerance(1e-6)).failing_pixels == 2);
	CHECK(verdict(tolerance(0.05), tolerance(0.05)).failing_pixels == 1);
	CHECK(verdict(tolerance(0.2), {}).verdict == Verdict::Warning);
	CHECK(verdict(tolerance(0.2), tolerance(0.2)).verdict == Verdict::Match);
	CHECK(verdict(tolerance(0.05, 1), tolerance(1)).verdict == Verdict::Match);
	CHECK(verdict(tolerance(0.05, 0.9), tolerance(1)).verdict == Verdict::Failure);
	CHECK(verdict(tolerance(0.001, 0, 2), tolerance(1)).verdict == Verdict::Match);
	CHECK(verdict(tolerance(0.001, 0, 1), tolerance(1)).verdict == Verdict::Failure);
	CHECK(verdict(tolerance(0.001, 50, 0, 0.099), tolerance(1)).verdict == Verdict::Failure);
	CHECK(verdict(tolerance(0.001, 50, 0, 0.2), tolerance(1)).verdict == Verdict::Match);
	CHECK(verdict(tolerance({}, 0, 0, {}, 1), tolerance(1)).failing_pixels == 2);
	CHECK(verdict(tolerance({}, 0, 0, {}, 1 << 23), tolerance(1)).verdict == Verdict::Match);
	CHECK(verdict(tolerance(1e-9, 0, 0, {}, 1), tolerance(1)).failing_pixels == 2); // beyond both
}

// ---- metrics -----------------------------------------------------------------------------------------------------

TEST_CASE("metrics of a constant difference have closed forms")
{
	std::vector<float> a(3000), b(3000);
	for (std::size_t i = 0; i < a.size(); ++i) {
		b[i] = 2.0f;
		a[i] = i % 3 == 0 ? 2.5f : i % 3 == 1 ? 1.75f : 2.0f;
	}
	const Comparison comparison = compared(float_image(50, 20, a), float_image(50, 20, b));
	CHECK(comparison.max_error == 0.5);
	CHECK(comparison.mae == 0.25);
	CHECK(comparison.rmse == Approx(std::sqrt((0.25 + 0.0625) / 3)).epsilon(1e-14));
	CHECK(comparison.rel_mse == Approx((0.25 + 0.0625) / 3 / 4.01).epsilon(1e-14));
	CHECK(comparison.rel_mse_trimmed == Approx(comparison.rel_mse).epsilon(1e-6));
	CHECK(comparison.peak == 2.5);
	CHECK(*comparison.psnr == Approx(20 * std::log10(2.5 / comparison.rmse)).epsilon(1e-14));
	CHECK(comparison.means[0].difference == 0.5);
	CHECK(comparison.means[1].difference == -0.25);
	CHECK(comparison.means[2].difference == 0);
	CHECK(*comparison.means[0].z == Approx(std::sqrt(1000.0)));
	CHECK_FALSE(comparison.means[2].z);

	// One firefly is the worst 0.1 % of 1000 pixels.
	a[600] = 1e4f;
	const Comparison firefly = compared(float_image(50, 20, a), float_image(50, 20, b));
	CHECK(firefly.rel_mse > 1000);
	CHECK(firefly.rel_mse_trimmed == Approx(comparison.rel_mse).epsilon(1e-3));
	CHECK_FALSE(compared(float_image(50, 20, b), float_image(50, 20, b)).psnr);
}

TEST_CASE("z tells bias from noise")
{
	std::mt19937 random(11);
	std::exponential_distribution<float> noise(2);
	std::vector<float> a(30000), b(30000);
	for (float& value : a)
		value = noise(random);
	for (float& value : b)
		value = noise(random);
	const Comparison same = compared(float_image(100, 100, a), float_image(100, 100, b));
	for (std::size_t c = 0; c < 3; ++c)
		CHECK(std::fabs(*same.means[c].z) < 4.5);
	for (std::size_t i = 0; i < a.size(); i += 3)
		a[i] *= 1.1f; // of a mean of 0.5: 0.05, with a deviation of 0.007
	const Comparison biased = compared(float_image(100, 100, a), float_image(100, 100, b));
	CHECK(*biased.means[0].z > 5);
	CHECK(std::fabs(*biased.means[1].z) < 4.5);
}

TEST_CASE("the difference image: scaled, its largest difference white, or as asked")
{
	const std::vector<float> b(12, 0.25f);
	std::vector<float> a = b;
	a[4] = 0.5f;
	a[6] = 0.125f;
	const auto picture = difference_picture(float_image(2, 2, a), float_image(2, 2, b), {});
	REQUIRE(picture);
	CHECK(picture->scale == 4);
	CHECK(picture->rgb == Bytes{0, 0, 0, 0, 255, 0, 128, 0, 0, 0, 0, 0});
	const auto plain = difference_picture(float_image(2, 2, a), float_image(2, 2, b), 1.0);
	REQUIRE(plain);
	CHECK(plain->rgb[4] == 64);
	a[0] = std::numeric_limits<float>::quiet_NaN();
	const auto broken = difference_picture(float_image(2, 2, a), float_image(2, 2, b), {});
	REQUIRE(broken);
	CHECK(broken->rgb[0] == 255);
	CHECK(broken->scale == 4);
}

TEST_CASE("the metadata say whether a difference was to be expected")
{
	const auto expected = [](const Provenance& a, const Provenance& b, bool encoded = false) {
		return expected_difference(a, b, encoded).expectation;
	};
	CHECK(expected(provenance, provenance) == Expectation::Same);
	CHECK(expected(provenance, with("Device", "another")) == Expectation::Same);
	CHECK(expected(provenance, with("Software", "rt 9")) == Expectation::Same);
	for (const char* key : {"Contract", "SceneHash", "Samples", "Seed", "Precision"})
		CHECK(expected(provenance, with(key, "another")) == Expectation::Different);
	CHECK(expected(provenance, with("Exposure", "1"), false) == Expectation::Same);
	CHECK(expected(provenance, with("Exposure", "1"), true) == Expectation::Different);
	CHECK(expected(with("SelfTest", "failed: sqrt"), with("SelfTest", "failed: sqrt")) == Expectation::Different);
	CHECK(expected({}, provenance) == Expectation::Unknown);
	const Provenance fast = with("Precision", "fast");
	Provenance fast_elsewhere = fast;
	fast_elsewhere[6].second = "another";
	CHECK(expected(fast, fast) == Expectation::Same);
	CHECK(expected(fast, fast_elsewhere) == Expectation::Different);
	Provenance sobol = provenance; // a key that is written only where it is not the default
	sobol.emplace_back("Sampler", "sobol");
	CHECK(expected(provenance, sobol) == Expectation::Different);
	CHECK(metadata_differences(provenance, sobol)[0].effect == KeyEffect::Image);
	Provenance foreign = provenance;
	foreign.emplace_back("Spectrum", "hero wavelengths");
	CHECK(expected(provenance, foreign) == Expectation::Different);
	const auto differences = metadata_differences(provenance, foreign);
	REQUIRE(differences.size() == 1);
	CHECK(differences[0].effect == KeyEffect::Unknown);
}

TEST_CASE("idiff agrees on mean, RMS, PSNR, maximum and status")
{
	if (shell("idiff --version").status != 0) {
		WARN("OpenImageIO's idiff is not installed (Debian: openimageio-tools): not compared with it");
		return;
	}
	const Scratch scratch;
	for (const ImageFormat format : {ImageFormat::Png, ImageFormat::Exr, ImageFormat::Pfm}) {
		Film film = test_film(5, 61, 43);
		const Bytes first = encoded(film, format);
		std::mt19937_64 random(9);
		for (std::int64_t& sum : film.sums())
			sum += static_cast<std::int64_t>(random() % (std::uint64_t(1) << 29));
		const Bytes second = encoded(film, format);
		const std::string extension = format == ImageFormat::Png   ? ".png"
		                              : format == ImageFormat::Exr ? ".exr"
		                                                           : ".pfm";
		const std::string a = scratch.write("a" + extension, first.data(), first.size());
		const std::string b = scratch.write("b" + extension, second.data(), second.size());
		const Comparison ours = compared(decoded(first), decoded(second));
		const Outcome theirs = shell("idiff " + a + " " + b);
		INFO(theirs.out);
		const auto agrees = [&](const char* name, double value) {
			std::smatch match;
			REQUIRE(std::regex_search(theirs.out, match, std::regex(std::string(name) + " *= *([-+.0-9e]+)")));
			const double printed = std::stod(match[1]);
			// idiff prints six digits: to half of the last one, and 1e-6 for its floats.
			const double last = std::pow(10, std::floor(std::log10(std::fabs(printed))) - 5);
			INFO(name << ": " << value << ", idiff " << printed);
			CHECK(std::fabs(value - printed) <= 0.5 * last + 1e-6 * std::fabs(printed));
		};
		agrees("Mean error", ours.mae);
		agrees("RMS error", ours.rmse);
		agrees("Peak SNR", *ours.psnr);
		agrees("Max error", ours.max_error);
		CHECK(theirs.status == 2);
		// The same pixels fail and warn, and the same status comes of it.
		for (const double limit : {1e-6, 0.01, 0.02, 0.03, 10.0})
			for (const double percent : {0.0, 40.0}) {
				CompareSettings settings;
				settings.fail.value = limit;
				settings.fail.percent = percent;
				settings.warn.value = 0.015;
				const Comparison limited = compared(decoded(first), decoded(second), settings);
				// idiff 2.4 does not look for warnings where no pixel is above the limit of failure; we do.
				const int expected_status = limited.verdict == Verdict::Failure ? 2
				                            : limited.failing_pixels > 0        ? 1
				                                                                : 0;
				CHECK(limited.verdict == (expected_status == 2 ? Verdict::Failure : Verdict::Warning));
				const Outcome judged = shell("idiff -fail " + std::to_string(limit) + " -failpercent " +
				                             std::to_string(percent) + " -warn 0.015 " + a + " " + b);
				INFO(limit << " " << percent << "\n" << judged.out);
				CHECK(judged.status == expected_status);
				if (limited.failing_pixels > 0)
					CHECK(judged.out.find(" " + std::to_string(limited.failing_pixels) + " pixels") !=
					      std::string::npos);
			}
	}
}

// ---- FLIP --------------------------------------------------------------------------------------------------------

namespace {

constexpr std::uint32_t flip_width = 72, flip_height = 48;

using Formula = std::function<float(std::uint32_t x, std::uint32_t y, std::uint32_t channel)>;

FlipPicture picture_of(const Formula& formula)
{
	FlipPicture picture{flip_width, flip_height, {}};
	for (std::uint32_t y = 0; y < flip_height; ++y)
		for (std::uint32_t x = 0; x < flip_width; ++x)
			for (std::uint32_t c = 0; c < 3; ++c)
				picture.rgb.push_back(formula(x, y, c));
	return picture;
}

float code(std::uint32_t value) { return static_cast<float>(value % 256) / 255.0f; }

struct FlipCase {
	const char* name;
	Formula reference, test;
	bool hdr;
	double mean;      // by flip-evaluator 1.7, the mean of its map in double
	double tolerance; // it computes in float, of which its square root of small features makes 1e-5 where all is smooth
};

// Integer formulas, so that all machines have the same inputs.
const std::vector<FlipCase>& flip_cases()
{
	const Formula ramp = [](auto x, auto y, auto c) { return code(3 * x + 2 * y + 40 * c); };
	const Formula shifted = [](auto x, auto y, auto c) { return code(3 * (x + 1) + 2 * y + 40 * c); };
	const Formula noise = [](auto x, auto y, auto c) {
		std::uint32_t h = x * 0x9e3779b1u + y * 0x85ebca77u + c * 0xc2b2ae3du;
		h = (h ^ h >> 15) * 0x2c1b3c6du;
		return code((h ^ h >> 12) >> 3);
	};
	const Formula half_noise = [=](auto x, auto y, auto c) { return (noise(x, y, c) + ramp(x, y, c)) * 0.5f; };
	const Formula edge = [](auto x, auto, auto) { return x < 36 ? 0.0f : 1.0f; };
	const Formula moved_edge = [](auto x, auto, auto) { return x < 38 ? 0.0f : 1.0f; };
	const Formula green = [](auto, auto, auto c) { return c == 1 ? 1.0f : 0.0f; };
	const Formula blue = [](auto, auto, auto c) { return c == 2 ? 1.0f : 0.0f; };
	const Formula bright = [=](auto x, auto y, auto c) {
		return (ramp(x, y, c) + 0.125f) * static_cast<float>(1u << (x / 6 + y / 8)) * 0.0625f;
	};
	const Formula bright_noise = [=](auto x, auto y, auto c) {
		return bright(x, y, c) * (0.875f + 0.25f * noise(x, y, c));
	};
	static const std::vector<FlipCase> cases = {
	    {"ramp", ramp, shifted, false, 0.166859170, 1e-5},
	    {"noise", ramp, half_noise, false, 0.506013749, 1e-6},
	    {"edge", edge, moved_edge, false, 0.074132061, 1e-5},
	    {"green, blue", green, blue, false, 1.000000000, 1e-6},
	    {"HDR noise", bright, bright_noise, true, 0.049969457, 1e-6},
	};
	return cases;
}

std::vector<float> map_of(const FlipCase& flip_case)
{
	const FlipPicture reference = picture_of(flip_case.reference), test = picture_of(flip_case.test);
	return flip_case.hdr ? hdr_flip_map(reference, test).map : flip_map(reference, test);
}

} // namespace

TEST_CASE("mean FLIP is that of the authors' program")
{
	for (const FlipCase& flip_case : flip_cases()) {
		INFO(flip_case.name);
		CHECK(std::fabs(mean_of(map_of(flip_case)) - flip_case.mean) < flip_case.tolerance);
	}
	const FlipPicture ramp = picture_of(flip_cases()[0].reference);
	CHECK(mean_of(flip_map(ramp, ramp)) == 0);
}

TEST_CASE("FLIP maps are those of flip-evaluator, pixel by pixel")
{
	const char* const chosen = std::getenv("RT_FLIP_PYTHON");
	const std::string python = chosen ? chosen : "python3";
	if (shell(python + " -c 'import flip_evaluator, numpy'").status != 0) {
		WARN("the Python package flip-evaluator is not installed: its stored results were used");
		return;
	}
	const Scratch scratch;
	const std::string script = "import sys, numpy as np\n"
	                           "from flip_evaluator import evaluate\n"
	                           "w, h = int(sys.argv[3]), int(sys.argv[4])\n"
	                           "a, b = (np.fromfile(f, '<f4').reshape(h, w, 3) for f in sys.argv[1:3])\n"
	                           "m = evaluate(a, b, sys.argv[5], inputsRGB=False, applyMagma=False)[0]\n"
	                           "m[..., 0].astype('<f4').tofile(sys.argv[6])\n"
	                           "print('%.9f' % m[..., 0].mean(dtype='f8'))\n";
	const std::string program = scratch.write("flip.py", script.data(), script.size());
	for (const FlipCase& flip_case : flip_cases()) {
		const FlipPicture reference = picture_of(flip_case.reference), test = picture_of(flip_case.test);
		const std::string a = scratch.write("a", reference.rgb.data(), 4 * reference.rgb.size());
		const std::string b = scratch.write("b", test.rgb.data(), 4 * test.rgb.size());
		const std::string out = a + ".map";
		const Outcome output = shell(python + " " + program + " " + a + " " + b + " " + std::to_string(flip_width) +
		                             " " + std::to_string(flip_height) + (flip_case.hdr ? " HDR " : " LDR ") + out);
		INFO(flip_case.name << ": " << output.out);
		REQUIRE(output.status == 0);
		const auto bytes = read_file(out);
		REQUIRE(bytes);
		std::vector<float> theirs(bytes->size() / 4);
		std::memcpy(theirs.data(), bytes->data(), bytes->size());
		const std::vector<float> ours = map_of(flip_case);
		REQUIRE(theirs.size() == ours.size());
		float worst = 0;
		for (std::size_t i = 0; i < ours.size(); ++i)
			worst = std::max(worst, std::fabs(ours[i] - theirs[i]));
		CHECK(worst < 2e-3f);
		CHECK(std::fabs(mean_of(ours) - mean_of(theirs)) < flip_case.tolerance);
		CHECK(std::fabs(mean_of(theirs) - flip_case.mean) < 1e-6); // the stored value is theirs
	}
}
