#include "render/image_file.h"
#include "support/deflate.h"
#include "support/files.h"
#include "support/hash.h"
#include "tests/catch.h"

#include <ImfChannelList.h>
#include <ImfChromaticitiesAttribute.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfInputFile.h>
#include <ImfStringAttribute.h>
#include <png.h>
#include <zlib.h>

#include <unistd.h>

#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <map>
#include <random>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

using rt::Film;
using rt::ImageFormat;
using rt::Transfer;
using rt::Window;
using Bytes = std::vector<std::uint8_t>;

namespace {

const rt::Provenance provenance = {{"Software", "rt 0.1"},
                                   {"Device", "Ger\xc3\xa4t \xe2\x84\xa2"},
                                   {"Driver", "broken \xff\x80 with\x01 control"},
                                   {"BuildOptions", "-a\n-b"},
                                   {"Compiler", ""}};

Film test_film(std::uint32_t width = 37, std::uint32_t height = 23)
{
	Film film(width + 20, height + 30, Window{11, 13, width, height}, 30);
	std::mt19937_64 random(5);
	for (auto& sum : film.sums())
		sum = static_cast<std::int64_t>(random() >> (24 + random() % 10));
	for (auto& count : film.samples())
		count = static_cast<std::uint32_t>(random() % 900 + 300);
	film.samples()[3] = 0;
	film.segments = 0x0123456789abcdef;
	film.rejected = 2;
	return film;
}

Bytes encoded(const Film& film, ImageFormat format, Transfer transfer = Transfer::Srgb)
{
	auto bytes = rt::encode_image(film, format, {transfer, 0}, provenance);
	REQUIRE(bytes);
	return std::move(*bytes);
}

struct Chunk {
	std::string type, data;
};

// The PNG's chunks, with libpng not asked.
std::vector<Chunk> chunks_of(const Bytes& png)
{
	const auto big_endian = [&](std::size_t at) {
		return std::size_t(png[at]) << 24 | std::size_t(png[at + 1]) << 16 | std::size_t(png[at + 2]) << 8 |
		       png[at + 3];
	};
	std::vector<Chunk> chunks;
	std::size_t at = 8;
	while (at < png.size()) {
		REQUIRE(at + 12 <= png.size());
		const std::size_t length = big_endian(at);
		REQUIRE(at + 12 + length <= png.size());
		const auto begin = png.begin() + static_cast<std::ptrdiff_t>(at);
		const auto span = static_cast<std::ptrdiff_t>(length);
		chunks.push_back({std::string(begin + 4, begin + 8), std::string(begin + 8, begin + 8 + span)});
		at += 12 + length;
	}
	return chunks;
}

struct DecodedPng {
	std::uint32_t width = 0, height = 0;
	Bytes pixels;
	std::map<std::string, std::string> texts;
	bool has_srgb = false;
	double gamma = 0;
};

// libpng's errors and warnings (a wrong CRC is one) fail the test.
[[noreturn]] void png_complains(png_structp, png_const_charp message) { throw std::runtime_error(message); }

DecodedPng decode_png(const Bytes& bytes)
{
	struct Source {
		const Bytes* bytes;
		std::size_t position;
	} source{&bytes, 0};
	png_structp png = png_create_read_struct(PNG_LIBPNG_VER_STRING, nullptr, png_complains, png_complains);
	png_infop info = png_create_info_struct(png);
	png_set_crc_action(png, PNG_CRC_ERROR_QUIT, PNG_CRC_ERROR_QUIT);
	png_set_read_fn(png, &source, [](png_structp reader, png_bytep out, png_size_t count) {
		auto* from = static_cast<Source*>(png_get_io_ptr(reader));
		if (from->bytes->size() - from->position < count)
			throw std::runtime_error("PNG ends too early");
		std::memcpy(out, from->bytes->data() + from->position, count);
		from->position += count;
	});
	png_read_png(png, info, PNG_TRANSFORM_IDENTITY, nullptr);
	DecodedPng decoded;
	decoded.width = png_get_image_width(png, info);
	decoded.height = png_get_image_height(png, info);
	REQUIRE(png_get_bit_depth(png, info) == 8);
	REQUIRE(png_get_color_type(png, info) == PNG_COLOR_TYPE_RGB);
	png_bytepp rows = png_get_rows(png, info);
	for (std::uint32_t y = 0; y < decoded.height; ++y)
		decoded.pixels.insert(decoded.pixels.end(), rows[y], rows[y] + 3 * std::size_t(decoded.width));
	png_textp texts = nullptr;
	const int count = png_get_text(png, info, &texts, nullptr);
	for (int i = 0; i < count; ++i)
		decoded.texts[texts[i].key] = texts[i].text;
	int intent = -1;
	decoded.has_srgb = png_get_sRGB(png, info, &intent) != 0;
	if (png_get_gAMA(png, info, &decoded.gamma) == 0)
		decoded.gamma = 0;
	png_destroy_read_struct(&png, &info, nullptr);
	REQUIRE(source.position == bytes.size());
	return decoded;
}

// A scratch file: OpenEXR reads from a file here, as any program would.
class ScratchFile {
public:
	ScratchFile() : path_((std::filesystem::temp_directory_path() / ("rt-test-" + std::to_string(::getpid()))).string())
	{
	}
	~ScratchFile() { std::remove(path_.c_str()); }
	const std::string& path() const { return path_; }

private:
	std::string path_;
};

rt::Error refusal(const Bytes& bytes)
{
	// A copy of exactly this size lets the address sanitizer see a read beyond it.
	const std::vector<std::uint8_t> exact(bytes.begin(), bytes.end());
	const auto loaded = rt::decode_rtfilm(exact.data(), exact.size(), "test.rtfilm");
	if (loaded)
		return {rt::ErrorKind::Failure, "accepted", {}, {}, {}};
	CHECK(loaded.error().kind == rt::ErrorKind::InputOutput);
	CHECK(loaded.error().where == "test.rtfilm");
	CHECK_FALSE(loaded.error().cure.empty());
	return loaded.error();
}

void set_u32(Bytes& film, std::size_t at, std::uint32_t value)
{
	for (std::size_t i = 0; i < 4; ++i)
		film[at + i] = static_cast<std::uint8_t>(value >> (8 * i));
}

// Makes the checksum right again, as a malicious writer would.
Bytes sealed(Bytes film)
{
	const std::string hex = rt::hash_bytes(film.data(), film.size() - 16).hex();
	for (std::size_t i = 0; i < 16; ++i)
		film[film.size() - 16 + i] = static_cast<std::uint8_t>(std::stoi(hex.substr(2 * i, 2), nullptr, 16));
	return film;
}

} // namespace

TEST_CASE("the format follows from the name")
{
	CHECK(*rt::image_format_of("a.png") == ImageFormat::Png);
	CHECK(*rt::image_format_of("dir.x/a.b.EXR") == ImageFormat::Exr);
	CHECK(*rt::image_format_of(".pfm") == ImageFormat::Pfm);
	CHECK(*rt::image_format_of("/a.RtFilm") == ImageFormat::RtFilm);
	for (const char* path : {"a", "a.jpg", "dir.png/a", "", "png", "a.png/", "a.pngx"}) {
		const auto format = rt::image_format_of(path);
		REQUIRE_FALSE(format);
		CHECK(format.error().kind == rt::ErrorKind::Usage);
		CHECK(format.error().cure.find(".png, .exr, .pfm, .rtfilm") != std::string::npos);
	}
}

TEST_CASE("PNG holds the pixels, the transfer and the provenance")
{
	const Film film = test_film();
	for (const Transfer transfer : {Transfer::Srgb, Transfer::Gamma2, Transfer::Linear}) {
		const DecodedPng png = decode_png(encoded(film, ImageFormat::Png, transfer));
		CHECK(png.width == 37);
		CHECK(png.height == 23);
		CHECK(png.pixels == rt::to_8bit(film, {transfer, 0}));
		CHECK(png.has_srgb == (transfer == Transfer::Srgb));
		if (transfer != Transfer::Srgb)
			CHECK(std::fabs(png.gamma - (transfer == Transfer::Gamma2 ? 0.5 : 1.0)) < 1e-5);
		CHECK(png.texts == std::map<std::string, std::string>{{"rt:Software", "rt 0.1"},
		                                                      {"rt:Device", "Ger\xc3\xa4t \xe2\x84\xa2"},
		                                                      {"rt:Driver", "broken ?? with  control"},
		                                                      {"rt:BuildOptions", "-a\n-b"},
		                                                      {"rt:Compiler", ""}});
	}
	const std::vector<Chunk> chunks = chunks_of(encoded(film, ImageFormat::Png));
	REQUIRE(chunks.size() == 9);
	const char* const types[] = {"IHDR", "sRGB", "tEXt", "iTXt", "tEXt", "tEXt", "tEXt", "IDAT", "IEND"};
	for (std::size_t i = 0; i < 9; ++i)
		CHECK(chunks[i].type == types[i]);
	CHECK(chunks[2].data == std::string("rt:Software\0rt 0.1", 18));
}

TEST_CASE("foreign provenance keys become valid ones")
{
	auto png = rt::encode_image(test_film(), ImageFormat::Png, {}, {{" a\n\xff" + std::string(100, 'k'), "v"}});
	REQUIRE(png);
	CHECK(decode_png(*png).texts.count("rt:_a__" + std::string(72, 'k')) == 1);
}

TEST_CASE("images without pixels are refused")
{
	const auto empty = rt::encode_image(Film(), ImageFormat::Png, {}, {});
	REQUIRE_FALSE(empty);
	CHECK(empty.error().kind == rt::ErrorKind::Usage);
}

TEST_CASE("EXR holds correctly placed floats and attributes")
{
	const Film film = test_film();
	const ScratchFile scratch;
	REQUIRE(rt::write_image(film, scratch.path(), ImageFormat::Exr, {}, provenance));
	Imf::InputFile file(scratch.path().c_str(), 0);
	const Imf::Header& header = file.header();
	CHECK(header.displayWindow() == Imath::Box2i({0, 0}, {56, 52}));
	CHECK(header.dataWindow() == Imath::Box2i({11, 13}, {47, 35}));
	CHECK(header.compression() == Imf::ZIP_COMPRESSION);
	std::string channels;
	for (auto channel = header.channels().begin(); channel != header.channels().end(); ++channel) {
		channels += channel.name();
		CHECK(channel.channel().type == Imf::FLOAT);
	}
	CHECK(channels == "BGR");
	CHECK(header.typedAttribute<Imf::StringAttribute>("rt:Software").value() == "rt 0.1");
	CHECK(header.typedAttribute<Imf::StringAttribute>("rt:Device").value() == "Ger\xc3\xa4t \xe2\x84\xa2");
	CHECK(header.findTypedAttribute<Imf::StringAttribute>("rt:Compiler") != nullptr);

	std::vector<float> pixels(3 * film.pixels());
	Imf::FrameBuffer frame;
	const char* const names[] = {"R", "G", "B"};
	for (std::size_t i = 0; i < 3; ++i)
		frame.insert(names[i], Imf::Slice::Make(Imf::FLOAT, pixels.data() + i, header.dataWindow(), 12, 12 * 37));
	file.setFrameBuffer(frame);
	file.readPixels(13, 35);
	std::size_t at = 0, wrong = 0;
	for (std::uint32_t y = 0; y < 23; ++y)
		for (std::uint32_t x = 0; x < 37; ++x)
			for (int channel = 0; channel < 3; ++channel)
				wrong += pixels[at++] != film.radiance_float(x, y, channel);
	CHECK(wrong == 0);
	CHECK(pixels[9] == 0); // the pixel without samples
	CHECK(pixels[0] > 0);
}

TEST_CASE("PFM holds the floats from the bottom row up")
{
	const Film film = test_film();
	const Bytes pfm = encoded(film, ImageFormat::Pfm);
	const std::string header = "PF\n37 23\n-1.0\n";
	REQUIRE(pfm.size() == header.size() + 12 * film.pixels());
	REQUIRE(std::string(pfm.begin(), pfm.begin() + static_cast<std::ptrdiff_t>(header.size())) == header);
	std::size_t at = header.size(), wrong = 0;
	for (std::uint32_t y = 23; y-- > 0;)
		for (std::uint32_t x = 0; x < 37; ++x)
			for (int channel = 0; channel < 3; ++channel, at += 4) {
				const std::uint32_t bits = std::uint32_t(pfm[at]) | std::uint32_t(pfm[at + 1]) << 8 |
				                           std::uint32_t(pfm[at + 2]) << 16 | std::uint32_t(pfm[at + 3]) << 24;
				float value;
				std::memcpy(&value, &bits, 4);
				wrong += value != film.radiance_float(x, y, channel);
			}
	CHECK(wrong == 0);
}

TEST_CASE("the same film gives the same bytes at any time")
{
	const Film film = test_film();
	std::vector<Bytes> first;
	for (const ImageFormat format : {ImageFormat::Png, ImageFormat::Exr, ImageFormat::Pfm, ImageFormat::RtFilm})
		first.push_back(encoded(film, format));
	std::this_thread::sleep_for(std::chrono::milliseconds(1100)); // a time stamp in seconds would show
	std::size_t i = 0;
	for (const ImageFormat format : {ImageFormat::Png, ImageFormat::Exr, ImageFormat::Pfm, ImageFormat::RtFilm})
		CHECK(encoded(film, format) == first[i++]);
}

TEST_CASE(".rtfilm round trip")
{
	const Film film = test_film();
	const Bytes bytes = encoded(film, ImageFormat::RtFilm);
	const auto loaded = rt::decode_rtfilm(bytes.data(), bytes.size(), "test.rtfilm");
	REQUIRE(loaded);
	CHECK(loaded->provenance == provenance);
	CHECK(loaded->film.image_width() == 57);
	CHECK(loaded->film.image_height() == 53);
	CHECK(loaded->film.window().x == 11);
	CHECK(loaded->film.window().y == 13);
	CHECK(loaded->film.window().width == 37);
	CHECK(loaded->film.window().height == 23);
	CHECK(loaded->film.exponent() == 30);
	CHECK(loaded->film.segments == film.segments);
	CHECK(loaded->film.rejected == 2);
	CHECK(loaded->film.samples() == film.samples());
	CHECK(loaded->film.sums() == film.sums());
	CHECK(loaded->film.hash() == film.hash());
	CHECK(encoded(loaded->film, ImageFormat::RtFilm) == bytes);

	Film negative(1, 1, Window{0, 0, 1, 1}, -7);
	negative.sums() = {-1, INT64_MIN, INT64_MAX};
	const Bytes small = encoded(negative, ImageFormat::RtFilm);
	const auto again = rt::decode_rtfilm(small.data(), small.size(), "test.rtfilm");
	REQUIRE(again);
	CHECK(again->film.exponent() == -7);
	CHECK(again->film.sums() == negative.sums());
}

TEST_CASE(".rtfilm bytes of the documented example")
{
	Film film(2, 1, Window{0, 0, 2, 1}, 30);
	film.sums() = {1073741824, 536870912, 0, 4294967296, 1, 4611686018427387904};
	film.samples() = {4, 4};
	film.segments = 12;
	const Bytes bytes = rt::encode_rtfilm(film, {{"Seed", "7"}});
	std::string hex;
	for (const std::uint8_t byte : bytes) {
		char digits[3];
		std::snprintf(digits, sizeof digits, "%02x", static_cast<unsigned>(byte));
		hex += digits;
	}
	CHECK(hex == "525446494c4d0d0a"                 // magic
	             "01000000"                         // version
	             "0200000001000000"                 // image
	             "00000000000000000200000001000000" // window
	             "1e000000"                         // exponent
	             "0c000000000000000000000000000000" // segments, rejected
	             "010000000d000000"                 // provenance: entries, bytes
	             "04000000536565640100000037"       // Seed = 7
	             "0400000004000000"                 // samples
	             "000000400000000000000020000000000000000000000000"
	             "000000000100000001000000000000000000000000000040"
	             "1d3eee3ddb92ee0e85da2dfbc0028ae1");
}

TEST_CASE(".rtfilm: every truncation and every flipped bit is refused")
{
	const Bytes good = encoded(test_film(3, 2), ImageFormat::RtFilm);
	for (std::size_t length = 0; length < good.size(); ++length)
		REQUIRE(refusal(Bytes(good.begin(), good.begin() + static_cast<std::ptrdiff_t>(length))).message != "accepted");
	for (std::size_t bit = 0; bit < 8 * good.size(); ++bit) {
		Bytes bad = good;
		bad[bit / 8] = static_cast<std::uint8_t>(bad[bit / 8] ^ 1u << bit % 8);
		REQUIRE(refusal(bad).message != "accepted");
	}
	Bytes longer = good;
	longer.push_back(0);
	CHECK(refusal(longer).message.find("length") != std::string::npos);
	Bytes last = good;
	last.back() ^= 1;
	CHECK(refusal(last).message.find("checksum") != std::string::npos);
}

TEST_CASE(".rtfilm: headers that lie are refused before anything is allocated")
{
	const Bytes good = encoded(test_film(3, 2), ImageFormat::RtFilm);
	REQUIRE(sealed(good) == good);
	const auto altered = [&](std::size_t at, std::uint32_t value) {
		Bytes bad = good;
		set_u32(bad, at, value);
		return refusal(sealed(bad)).message;
	};
	CHECK(altered(0, 0x4d544652).find("not an .rtfilm") != std::string::npos);
	CHECK(altered(8, 2).find("version 2") != std::string::npos);
	CHECK(altered(8, 0).find("does not exist") != std::string::npos);
	CHECK(altered(12, 13).find("window") != std::string::npos);         // image narrower than the window's end
	CHECK(altered(20, 0xffffffff).find("window") != std::string::npos); // x + width wraps in 32 bits
	CHECK(altered(24, 0xfffffffe).find("window") != std::string::npos);
	CHECK(altered(28, 4).find("length") != std::string::npos);
	CHECK(altered(28, 0).find("length") != std::string::npos);
	CHECK(altered(36, 257).find("exponent") != std::string::npos);
	CHECK(altered(36, 0x80000000).find("exponent") != std::string::npos);
	CHECK(altered(56, 4).find("provenance") != std::string::npos); // entries
	CHECK(altered(56, 0xffffffff).find("provenance") != std::string::npos);
	CHECK(altered(60, 0).find("length") != std::string::npos);
	CHECK(altered(64, 0xffffffff).find("provenance") != std::string::npos); // the first key's length

	// 28 bytes a pixel times (2^32 - 1)^2 pixels: wraps in 64 bits unless it is looked at before.
	Bytes absurd = good;
	set_u32(absurd, 28, 0xffffffff);
	set_u32(absurd, 32, 0xffffffff);
	CHECK(refusal(sealed(absurd)).message.find("length") != std::string::npos);
	// 2^62 pixels: 28 times that is 0 modulo 2^64.
	set_u32(absurd, 28, 0x80000000);
	set_u32(absurd, 32, 0x80000000);
	set_u32(absurd, 60, static_cast<std::uint32_t>(absurd.size() - 80));
	CHECK(refusal(sealed(absurd)).message.find("length") != std::string::npos);

	// No pixels, with sizes that agree.
	Bytes empty(good.begin(), good.begin() + 64);
	empty.resize(80);
	set_u32(empty, 28, 0);
	set_u32(empty, 56, 0);
	set_u32(empty, 60, 0);
	CHECK(refusal(sealed(empty)).message.find("window") != std::string::npos);
}

TEST_CASE("write_image names the file in its errors")
{
	const ScratchFile scratch;
	REQUIRE(rt::write_file(scratch.path(), "a file, not a directory"));
	const std::string path = scratch.path() + "/image.pfm";
	const auto status = rt::write_image(test_film(), path, ImageFormat::Pfm, {}, {});
	REQUIRE_FALSE(status);
	CHECK(status.error().kind == rt::ErrorKind::InputOutput);
	CHECK(status.error().where == path);
	const auto empty = rt::write_image(Film(), scratch.path(), ImageFormat::Pfm, {}, {});
	REQUIRE_FALSE(empty);
	CHECK(empty.error().kind == rt::ErrorKind::Usage);
	CHECK(empty.error().where == scratch.path());
}

TEST_CASE("zlib_compress makes streams that zlib reads, whatever their length")
{
	std::mt19937_64 random(11);
	// About the pieces' ends, and several of them; noise, runs, and repeats from before a piece's beginning.
	for (const std::size_t size : {0u, 1u, 131071u, 131072u, 131073u, 262144u, 1000003u}) {
		Bytes data(size);
		for (std::size_t i = 0; i < size; ++i)
			data[i] = i % 3000 < 1000   ? static_cast<std::uint8_t>(random())
			          : i % 3000 < 2000 ? static_cast<std::uint8_t>(7)
			                            : data[i - 1000];
		const Bytes stream = rt::zlib_compress(data.data(), data.size());
		Bytes back(size + 1);
		uLongf length = back.size();
		REQUIRE(uncompress(back.data(), &length, stream.data(), stream.size()) == Z_OK);
		back.resize(length);
		CHECK(back == data);
		CHECK(stream == rt::zlib_compress(data.data(), data.size()));
		// Hardly more than from one thread.
		Bytes whole(compressBound(size));
		uLongf best = whole.size();
		REQUIRE(compress2(whole.data(), &best, data.data(), size, Z_BEST_SPEED) == Z_OK);
		CHECK(stream.size() < best + best / 100 + 16);
	}
}
