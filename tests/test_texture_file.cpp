// Reading textures: every PNG layout, JPEG, and files that lie.
#include "render/texture_file.h"
#include "support/files.h"
#include "tests/catch.h"

#include <algorithm>
#include <cstring>
#include <functional>

#include <sys/resource.h>

using namespace rt;

namespace {

bool contains(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

using Bytes = std::vector<std::uint8_t>;

void add_u32_be(Bytes& bytes, std::uint32_t value)
{
	for (int shift = 24; shift >= 0; shift -= 8)
		bytes.push_back(static_cast<std::uint8_t>(value >> shift));
}

std::uint32_t crc32(const std::uint8_t* data, std::size_t size)
{
	std::uint32_t crc = ~0u;
	for (std::size_t i = 0; i < size; ++i) {
		crc ^= data[i];
		for (int k = 0; k < 8; ++k)
			crc = crc >> 1 ^ (crc & 1 ? 0xedb88320u : 0);
	}
	return ~crc;
}

void add_chunk(Bytes& png, const char* kind, const Bytes& data)
{
	add_u32_be(png, static_cast<std::uint32_t>(data.size()));
	const std::size_t start = png.size();
	png.insert(png.end(), kind, kind + 4);
	png.insert(png.end(), data.begin(), data.end());
	add_u32_be(png, crc32(png.data() + start, png.size() - start));
}

// zlib's format with stored blocks.
Bytes stored(const Bytes& raw)
{
	Bytes out = {0x78, 0x01};
	std::uint32_t a = 1, b = 0;
	for (std::size_t at = 0; at < raw.size() || at == 0; at += 65535) {
		const auto length = static_cast<std::uint16_t>(std::min<std::size_t>(65535, raw.size() - at));
		out.push_back(at + length >= raw.size());
		for (const int value : {length & 255, length >> 8, ~length & 255, ~length >> 8 & 255})
			out.push_back(static_cast<std::uint8_t>(value));
		out.insert(out.end(), raw.begin() + static_cast<std::ptrdiff_t>(at),
		           raw.begin() + static_cast<std::ptrdiff_t>(at + length));
	}
	for (const std::uint8_t byte : raw) {
		a = (a + byte) % 65521;
		b = (b + a) % 65521;
	}
	add_u32_be(out, b << 16 | a);
	return out;
}

// A picture to write: sample(x, y, channel) of `depth` bits.
struct Picture {
	std::uint32_t width, height;
	int depth, colour_type;
	std::function<std::uint32_t(std::uint32_t, std::uint32_t, int)> sample;
	bool interlaced = false;
	std::vector<std::pair<const char*, Bytes>> before_data; // further chunks

	int channels() const { return colour_type == 2 ? 3 : colour_type == 4 ? 2 : colour_type == 6 ? 4 : 1; }

	void add_pass(Bytes& raw, std::uint32_t x0, std::uint32_t dx, std::uint32_t y0, std::uint32_t dy) const
	{
		if (x0 >= width)
			return;
		for (std::uint32_t y = y0; y < height; y += dy) {
			raw.push_back(0); // no filter
			std::uint32_t bits = 0;
			int held = 0;
			for (std::uint32_t x = x0; x < width; x += dx)
				for (int c = 0; c < channels(); ++c) {
					bits = bits << depth | sample(x, y, c);
					for (held += depth; held >= 8; held -= 8)
						raw.push_back(static_cast<std::uint8_t>(bits >> (held - 8)));
				}
			if (held)
				raw.push_back(static_cast<std::uint8_t>(bits << (8 - held)));
		}
	}

	Bytes png() const
	{
		Bytes file = {0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n'};
		Bytes header;
		add_u32_be(header, width);
		add_u32_be(header, height);
		for (const int value : {depth, colour_type, 0, 0, interlaced ? 1 : 0})
			header.push_back(static_cast<std::uint8_t>(value));
		add_chunk(file, "IHDR", header);
		for (const auto& [kind, data] : before_data)
			add_chunk(file, kind, data);
		Bytes raw;
		if (interlaced) {
			const std::uint32_t passes[7][4] = {{0, 8, 0, 8}, {4, 8, 0, 8}, {0, 4, 4, 8}, {2, 4, 0, 4},
			                                    {0, 2, 2, 4}, {1, 2, 0, 2}, {0, 1, 1, 2}};
			for (const auto& p : passes)
				add_pass(raw, p[0], p[1], p[2], p[3]);
		} else {
			add_pass(raw, 0, 1, 0, 1);
		}
		add_chunk(file, "IDAT", stored(raw));
		add_chunk(file, "IEND", {});
		return file;
	}
};

Result<TextureImage> decoded(const Bytes& file) { return decode_texture(file.data(), file.size(), "map.png"); }

std::uint32_t rgb(std::uint32_t r, std::uint32_t g, std::uint32_t b) { return r | g << 8 | b << 16; }

std::uint32_t mixed(std::uint32_t x, std::uint32_t y, int c)
{
	return (x * 37 + y * 101 + static_cast<std::uint32_t>(c) * 59) & 255;
}

void check_is_error(const Result<TextureImage>& image, const std::string& part)
{
	REQUIRE_FALSE(image);
	INFO(image.error().message << " | " << image.error().cure);
	CHECK(image.error().kind == ErrorKind::InputOutput);
	CHECK(image.error().where == "map.png");
	CHECK_FALSE(image.error().cure.empty());
	CHECK(contains(image.error().message, part));
}

Bytes file_bytes(const char* name)
{
	Result<Bytes> bytes = read_file(std::string(RT_TEST_DATA "/textures/") + name);
	REQUIRE(bytes);
	return std::move(*bytes);
}

} // namespace

TEST_CASE("PNG of every colour type, depth and layout gives the same 8-bit RGB")
{
	for (const bool interlaced : {false, true}) {
		INFO((interlaced ? "interlaced" : "plain"));
		for (const int type : {2, 6}) {
			Picture picture{13, 11, 8, type, mixed, interlaced, {}};
			const Result<TextureImage> image = decoded(picture.png());
			REQUIRE(image);
			REQUIRE(image->width == 13);
			REQUIRE(image->height == 11);
			for (std::uint32_t y = 0; y < 11; ++y)
				for (std::uint32_t x = 0; x < 13; ++x) // alpha is dropped
					REQUIRE(image->texels[y * 13 + x] == rgb(mixed(x, y, 0), mixed(x, y, 1), mixed(x, y, 2)));
		}
		for (const int type : {0, 4})
			for (const int depth : {1, 2, 4, 8, 16}) {
				if (type == 4 && depth < 8)
					continue;
				const std::uint32_t most = (1u << depth) - 1;
				const auto grey = [&](std::uint32_t x, std::uint32_t y, int c) { return mixed(x, y, c) * 257 & most; };
				const Result<TextureImage> image = decoded(Picture{9, 5, depth, type, grey, interlaced, {}}.png());
				REQUIRE(image);
				for (std::uint32_t y = 0; y < 5; ++y)
					for (std::uint32_t x = 0; x < 9; ++x) {
						const std::uint32_t v = (grey(x, y, 0) * 255 + most / 2) / most;
						REQUIRE(image->texels[y * 9 + x] == rgb(v, v, v));
					}
			}
		const Bytes palette = {10, 20, 30, 200, 100, 50, 1, 2, 3, 255, 255, 255};
		for (const int depth : {2, 4, 8}) {
			Picture picture{7,
			                7,
			                depth,
			                3,
			                [](std::uint32_t x, std::uint32_t y, int) { return (x + y) & 3; },
			                interlaced,
			                {{"PLTE", palette}, {"tRNS", {0, 128}}}};
			const Result<TextureImage> image = decoded(picture.png());
			REQUIRE(image);
			for (std::uint32_t y = 0; y < 7; ++y)
				for (std::uint32_t x = 0; x < 7; ++x) {
					const std::uint8_t* p = &palette[3 * ((x + y) & 3)];
					REQUIRE(image->texels[y * 7 + x] == rgb(p[0], p[1], p[2]));
				}
		}
	}
}

TEST_CASE("16 bits are rounded to the nearest of 8")
{
	const auto ramp = [](std::uint32_t x, std::uint32_t y, int) { return y * 256 + x; };
	const Result<TextureImage> image = decoded(Picture{256, 256, 16, 0, ramp, false, {}}.png());
	REQUIRE(image);
	for (std::uint32_t v = 0; v < 65536; ++v)
		REQUIRE((image->texels[v] & 255) == (v * 255 + 32767) / 65535);
}

TEST_CASE("gamma and colour profiles change no texel")
{
	Picture picture{4, 4, 8, 2, mixed, false, {}};
	const Bytes plain = picture.png();
	Bytes gamma;
	add_u32_be(gamma, 100000);
	picture.before_data = {{"gAMA", gamma}, {"iCCP", {'x', 0, 0, 1, 2, 3}}, {"tEXt", {'a', 0, 'b'}}};
	const Result<TextureImage> image = decoded(picture.png());
	REQUIRE(image);
	CHECK(image->texels == decoded(plain)->texels);
}

TEST_CASE("PNG files that lie about their size take no memory")
{
	Picture picture{4, 4, 8, 2, mixed, false, {}};
	const auto with_size = [&](std::uint32_t width, std::uint32_t height) {
		Bytes file = picture.png();
		Bytes size;
		add_u32_be(size, width);
		add_u32_be(size, height);
		std::copy(size.begin(), size.end(), file.begin() + 16);
		const std::uint32_t crc = crc32(file.data() + 12, 17);
		Bytes check;
		add_u32_be(check, crc);
		std::copy(check.begin(), check.end(), file.begin() + 29);
		return file;
	};
	REQUIRE(decoded(with_size(4, 4)));
	const Result<TextureImage> huge = decoded(with_size(100000, 100000));
	check_is_error(huge, "100000 x 100000");
	CHECK(contains(huge.error().cure, "268435456"));
	check_is_error(decoded(with_size(0x7fffffff, 0x7fffffff)), "2147483647 x 2147483647");
	check_is_error(decoded(with_size(0x80000000u, 0x80000000u)), "2147483648 x 2147483648");
	check_is_error(decoded(with_size(0, 4)), "0 x 4");
	check_is_error(decoded(with_size(16384, 16384)), "too short");
	check_is_error(decoded(with_size(4, 5)), "broken or cut short");

	// libpng takes memory for a row when it has read the header, so one long row must be refused before.
	const auto peak_mebibytes = [] {
		rusage usage{};
		REQUIRE(getrusage(RUSAGE_SELF, &usage) == 0);
		return usage.ru_maxrss / 1024;
	};
	const long before = peak_mebibytes();
	check_is_error(decoded(with_size(0x08000003u, 1)), "too short");
	CHECK(peak_mebibytes() < before + 64);
	const std::vector<std::uint8_t> control(std::size_t(128 + 64) << 20, 1); // such memory would have been seen
	CHECK(control.back() == 1);
	CHECK(peak_mebibytes() >= before + 64);
}

TEST_CASE("cut, changed and foreign files are errors")
{
	const Bytes good = Picture{16, 16, 8, 2, mixed, false, {}}.png();
	REQUIRE(decoded(good));
	for (std::size_t length = 0; length < good.size(); ++length) {
		Bytes cut(good.begin(), good.begin() + static_cast<std::ptrdiff_t>(length));
		REQUIRE_FALSE(decoded(cut));
	}
	// Every byte of this file is covered by a checksum.
	for (std::size_t at = 8; at < good.size(); ++at) {
		Bytes changed = good;
		changed[at] ^= 0x40;
		REQUIRE_FALSE(decoded(changed));
	}
	check_is_error(decoded({}), "is empty");
	check_is_error(decoded({'G', 'I', 'F', '8', '9', 'a'}), "neither PNG nor JPEG");
	const Result<TextureImage> missing = load_texture(RT_TEST_DATA "/textures/no_such.png");
	REQUIRE_FALSE(missing);
	CHECK(missing.error().kind == ErrorKind::InputOutput);
}

TEST_CASE("JPEG, baseline and progressive, colour and grey")
{
	// Left half (200, 60, 40), right half (30, 90, 180), 32 x 24, quality 95.
	for (const char* name : {"halves.jpg", "halves_progressive.jpg"}) {
		INFO(name);
		const Bytes file = file_bytes(name);
		const Result<TextureImage> image = decode_texture(file.data(), file.size(), name);
		REQUIRE(image);
		REQUIRE(image->width == 32);
		REQUIRE(image->height == 24);
		for (const auto& [x, colour] : {std::pair<int, std::array<int, 3>>{3, {200, 60, 40}}, {28, {30, 90, 180}}})
			for (int c = 0; c < 3; ++c) {
				const auto texel = 12 * 32 + static_cast<std::size_t>(x);
				const auto value = static_cast<int>(image->texels[texel] >> 8 * c & 255);
				CHECK(std::abs(value - colour[static_cast<std::size_t>(c)]) <= 3);
			}
	}
	const Bytes grey = file_bytes("grey.jpg");
	const Result<TextureImage> image = decode_texture(grey.data(), grey.size(), "grey.jpg");
	REQUIRE(image);
	for (const std::uint32_t texel : image->texels)
		CHECK(((texel & 255) == (texel >> 8 & 255) && (texel & 255) == (texel >> 16)));
}

TEST_CASE("JPEG files that lie about their size take no memory")
{
	for (const std::string name : {"halves", "halves_progressive"}) {
		const auto file = read_file(RT_TEST_DATA "/textures/" + name + ".jpg");
		REQUIRE(file);
		// Start of frame: marker, length 17, precision, height, width.
		Bytes lying = *file;
		const Bytes marker = {0xff, static_cast<std::uint8_t>(name == "halves" ? 0xc0 : 0xc2), 0, 17};
		const auto frame = std::search(lying.begin(), lying.end(), marker.begin(), marker.end());
		REQUIRE(frame != lying.end());
		REQUIRE(decoded(lying));
		const Bytes size = {0x40, 0, 0x40, 0}; // 16384 x 16384
		std::copy(size.begin(), size.end(), frame + 5);
		check_is_error(decoded(lying), "too short");
	}
}

TEST_CASE("broken JPEG")
{
	for (const char* name : {"halves.jpg", "halves_progressive.jpg"}) {
		INFO(name);
		const Bytes good = file_bytes(name);
		for (std::size_t length = 3; length < good.size(); ++length) {
			INFO(length);
			Bytes cut(good.begin(), good.begin() + static_cast<std::ptrdiff_t>(length));
			REQUIRE_FALSE(decoded(cut));
		}
		// The frame header (SOF0 or SOF2) holds height and width.
		Bytes huge = good;
		for (std::size_t i = 2; i + 9 < huge.size(); i += 2 + std::size_t(huge[i + 2]) * 256 + huge[i + 3])
			if (huge[i + 1] == 0xc0 || huge[i + 1] == 0xc2) {
				std::memset(&huge[i + 5], 0xff, 4);
				huge[i + 5] = huge[i + 7] = 0xf0;
				break;
			}
		check_is_error(decoded(huge), "61695 x 61695");
		// No change of a byte may do more than fail or give other colours.
		for (std::size_t at = 3; at < good.size(); ++at)
			for (const int flip : {0x01, 0x80, 0xff}) {
				Bytes changed = good;
				changed[at] = static_cast<std::uint8_t>(changed[at] ^ flip);
				const Result<TextureImage> image = decoded(changed);
				if (image)
					REQUIRE(image->texels.size() == std::uint64_t(image->width) * image->height);
			}
	}
	check_is_error(decoded(file_bytes("cmyk.jpg")), "CMYK");
}
