#include "render/image_file.h"

#include "support/deflate.h"
#include "support/files.h"

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfIO.h>
#include <ImfOutputFile.h>
#include <ImfStandardAttributes.h>
#include <ImfStringAttribute.h>
#include <fmt/format.h>
#include <zlib.h>

#include <algorithm>
#include <climits>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <new>
#include <string_view>
#include <utility>

namespace {

// In the place of stb_image_write's own compression, which is slow and packs less. Called from C code that frees the
// bytes with free() and takes null for a lack of memory.
unsigned char* compress_for_stb(unsigned char* data, int bytes, int* compressed_bytes, int)
{
	try {
		const std::vector<std::uint8_t> stream = rt::zlib_compress(data, static_cast<std::size_t>(bytes));
		if (stream.size() > INT_MAX)
			return nullptr;
		auto* const copy = static_cast<unsigned char*>(std::malloc(stream.size()));
		if (copy)
			std::memcpy(copy, stream.data(), stream.size());
		*compressed_bytes = static_cast<int>(stream.size());
		return copy;
	} catch (const std::exception&) { // of C code none comes through
		return nullptr;
	}
}

unsigned int crc_for_stb(const unsigned char* data, int bytes)
{
	return static_cast<unsigned int>(::crc32_z(0, data, static_cast<std::size_t>(bytes)));
}

} // namespace

#define STBIW_ZLIB_COMPRESS compress_for_stb
#define STBIW_CRC32 crc_for_stb
#define STB_IMAGE_WRITE_IMPLEMENTATION
#define STB_IMAGE_WRITE_STATIC
#define STBI_WRITE_NO_STDIO
#include <stb_image_write.h>

namespace rt {

namespace {

using Bytes = std::vector<std::uint8_t>;

struct Extension {
	const char* name;
	ImageFormat format;
};
const Extension extensions[] = {
    {"png", ImageFormat::Png}, {"exr", ImageFormat::Exr}, {"pfm", ImageFormat::Pfm}, {"rtfilm", ImageFormat::RtFilm}};

void append(Bytes& bytes, std::string_view text) { bytes.insert(bytes.end(), text.begin(), text.end()); }

// ---- provenance as text that every format can hold ----

// A keyword may have 79 printable characters in PNG. Ours are shorter; those of a foreign .rtfilm may not be.
std::string attribute_name(const std::string& key)
{
	std::string name = "rt:" + key.substr(0, 76);
	for (char& c : name)
		if (c <= ' ' || c > '~')
			c = '_';
	return name;
}

bool is_ascii(const std::string& text)
{
	return std::all_of(text.begin(), text.end(), [](char c) { return static_cast<unsigned char>(c) < 128; });
}

// What any viewer of metadata shows of an image that cannot be trusted; empty if it can.
std::string warning_of(const Provenance& provenance)
{
	const std::string self_test = provenance_value(provenance, "SelfTest");
	if (self_test.empty() || self_test == "passed")
		return {};
	return fmt::format("NOT VERIFIED: rendered on a device that fails the self-test of rt. {}: {}",
	                   provenance_value(provenance, "Device"), self_test);
}

// ---- PNG ----

void append_big_endian(Bytes& bytes, std::uint32_t value)
{
	for (int shift = 24; shift >= 0; shift -= 8)
		bytes.push_back(static_cast<std::uint8_t>(value >> shift));
}

// A chunk: length, type, data, CRC over type and data.
void append_chunk(Bytes& png, std::string_view type, std::string_view data)
{
	append_big_endian(png, static_cast<std::uint32_t>(data.size()));
	const std::size_t start = png.size();
	append(png, type);
	append(png, data);
	append_big_endian(png, static_cast<std::uint32_t>(::crc32_z(0, png.data() + start, png.size() - start)));
}

void append_transfer_chunk(Bytes& png, Transfer transfer)
{
	if (transfer == Transfer::Srgb) {
		append_chunk(png, "sRGB", std::string_view("\0", 1)); // rendering intent: perceptual
		return;
	}
	Bytes gamma; // 100000 times the exponent that encoded
	append_big_endian(gamma, transfer == Transfer::Gamma2 ? 50000 : 100000);
	append_chunk(png, "gAMA", std::string_view(reinterpret_cast<const char*>(gamma.data()), gamma.size()));
}

void append_text_chunk(Bytes& png, const std::string& name, const std::string& value)
{
	const std::string text = clean_text(value);
	// tEXt is Latin-1; only ASCII is the same there and in UTF-8. iTXt is UTF-8: not compressed, no language.
	if (is_ascii(text))
		append_chunk(png, "tEXt", name + std::string(1, '\0') + text);
	else
		append_chunk(png, "iTXt", name + std::string(5, '\0') + text);
}

void append_from_stb(void* context, void* data, int size)
{
	auto* const bytes = static_cast<Bytes*>(context);
	const auto* const first = static_cast<const std::uint8_t*>(data);
	bytes->insert(bytes->end(), first, first + size);
}

Status check_png_size(std::uint32_t width, std::uint32_t height)
{
	// stb_image_write counts in int: up to this size nothing of it can overflow.
	constexpr std::uint64_t max_raw_bytes = 900'000'000;
	if ((3 * std::uint64_t(width) + 1) * height > max_raw_bytes)
		return Error{ErrorKind::Usage,
		             fmt::format("{}x{} pixels are too many for a PNG", width, height),
		             {},
		             "write .exr or .rtfilm, or render a part with --crop",
		             {}};
	return success();
}

Result<Bytes> encode_film_png(const Film& film, const DisplaySettings& display, const Provenance& provenance)
{
	RT_TRY(check_png_size(film.window().width, film.window().height));
	return encode_png(film.window().width, film.window().height, to_8bit(film, display), display.transfer, provenance);
}

// ---- float formats ----

// R, G, B a pixel, rows from the top.
std::vector<float> float_pixels(const Film& film)
{
	std::vector<float> values;
	values.reserve(film.sums().size());
	for (std::uint32_t y = 0; y < film.window().height; ++y)
		for (std::uint32_t x = 0; x < film.window().width; ++x)
			for (int channel = 0; channel < 3; ++channel)
				values.push_back(film.radiance_float(x, y, channel));
	return values;
}

class MemoryStream : public Imf::OStream {
public:
	MemoryStream() : Imf::OStream("memory") {}
	void write(const char data[], int count) override
	{
		const std::size_t end = position_ + static_cast<std::size_t>(count);
		if (end > bytes_.size())
			bytes_.resize(end);
		std::memcpy(bytes_.data() + position_, data, static_cast<std::size_t>(count));
		position_ = end;
	}
	std::uint64_t tellp() override { return position_; }
	void seekp(std::uint64_t position) override { position_ = static_cast<std::size_t>(position); }
	Bytes& bytes() { return bytes_; }

private:
	Bytes bytes_;
	std::size_t position_ = 0;
};

Imath::Box2i box(std::uint32_t x, std::uint32_t y, std::uint32_t width, std::uint32_t height)
{
	return {{static_cast<int>(x), static_cast<int>(y)},
	        {static_cast<int>(x + width - 1), static_cast<int>(y + height - 1)}};
}

Result<Bytes> encode_exr(const Film& film, const Provenance& provenance)
{
	const Window& window = film.window();
	if (film.image_width() > INT_MAX / 2 || film.image_height() > INT_MAX / 2)
		return Error{ErrorKind::Usage, "the image is too large for an EXR", {}, "write .rtfilm", {}};
	std::vector<float> values = float_pixels(film);
	MemoryStream stream;
	try {
		// Only what is put here gets into the file: nothing in it depends on the time or the machine.
		const Imath::Box2i data_window = box(window.x, window.y, window.width, window.height);
		Imf::Header header(box(0, 0, film.image_width(), film.image_height()), data_window, 1, Imath::V2f(0, 0), 1,
		                   Imf::INCREASING_Y, Imf::ZIP_COMPRESSION);
		Imf::addChromaticities(header, Imf::Chromaticities()); // of Rec. 709, as sRGB's
		for (const auto& [key, value] : provenance)
			header.insert(attribute_name(key), Imf::StringAttribute(clean_text(value)));
		if (const std::string warning = warning_of(provenance); !warning.empty())
			Imf::addComments(header, clean_text(warning));
		Imf::FrameBuffer frame;
		static const char* const channels[] = {"R", "G", "B"};
		for (std::size_t i = 0; i < 3; ++i) {
			header.channels().insert(channels[i], Imf::Channel(Imf::FLOAT));
			frame.insert(channels[i], Imf::Slice::Make(Imf::FLOAT, values.data() + i, data_window, 3 * sizeof(float),
			                                           3 * sizeof(float) * window.width));
		}
		// No threads: the file is the same with them, but a library should not start any unasked.
		Imf::OutputFile file(stream, header, 0);
		file.setFrameBuffer(frame);
		file.writePixels(static_cast<int>(window.height));
	} catch (const std::bad_alloc&) {
		throw; // encode_image() knows what to say
	} catch (const std::exception& failure) {
		return Error{ErrorKind::Failure, "the EXR could not be encoded", {}, "write .pfm or .rtfilm", failure.what()};
	}
	return std::move(stream.bytes());
}

Bytes encode_pfm(const Film& film)
{
	const std::vector<float> values = float_pixels(film);
	const std::size_t row = 3 * std::size_t(film.window().width);
	Bytes pfm;
	pfm.reserve(64 + 4 * values.size());
	// A negative scale says little-endian.
	append(pfm, fmt::format("PF\n{} {}\n-1.0\n", film.window().width, film.window().height));
	for (std::size_t y = film.window().height; y-- > 0;)
		for (std::size_t i = 0; i < row; ++i) {
			std::uint32_t bits;
			std::memcpy(&bits, &values[y * row + i], sizeof bits);
			for (int shift = 0; shift < 32; shift += 8)
				pfm.push_back(static_cast<std::uint8_t>(bits >> shift));
		}
	return pfm;
}

} // namespace

Result<ImageFormat> image_format_of(const std::string& path)
{
	const std::size_t name = path.rfind('/') + 1; // npos + 1 is 0
	const std::size_t dot = path.rfind('.');
	std::string extension = dot == std::string::npos || dot < name ? std::string() : path.substr(dot + 1);
	std::transform(extension.begin(), extension.end(), extension.begin(),
	               [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; });
	std::string known;
	for (const Extension& candidate : extensions) {
		if (extension == candidate.name)
			return candidate.format;
		known += fmt::format("{}.{}", known.empty() ? "" : ", ", candidate.name);
	}
	return Error{ErrorKind::Usage,
	             "the image's format is not known from its name",
	             path,
	             fmt::format("end the name with one of {}", known),
	             {}};
}

Result<Bytes> encode_image(const Film& film, ImageFormat format, const DisplaySettings& display,
                           const Provenance& provenance)
{
	if (film.pixels() == 0)
		return Error{ErrorKind::Usage, "the film has no pixels", {}, "render at least one", {}};
	try {
		switch (format) {
		case ImageFormat::Png:
			return encode_film_png(film, display, provenance);
		case ImageFormat::Exr:
			return encode_exr(film, provenance);
		case ImageFormat::Pfm:
			return encode_pfm(film);
		case ImageFormat::RtFilm:
			break;
		}
		return encode_rtfilm(film, provenance);
	} catch (const std::bad_alloc&) {
		return Error{
		    ErrorKind::Memory,
		    fmt::format("there is too little memory to encode {}x{} pixels", film.window().width, film.window().height),
		    {},
		    "free some memory, or render a part with --crop",
		    {}};
	}
}

Result<Bytes> encode_png(std::uint32_t width, std::uint32_t height, const Bytes& pixels, Transfer transfer,
                         const Provenance& provenance)
{
	RT_TRY(check_png_size(width, height));
	Bytes plain;
	if (stbi_write_png_to_func(append_from_stb, &plain, static_cast<int>(width), static_cast<int>(height), 3,
	                           pixels.data(), static_cast<int>(3 * width)) == 0)
		return Error{ErrorKind::Memory, "the PNG could not be encoded", {}, "free some memory or write .pfm", {}};

	// Signature (8 bytes) and IHDR (length, type, 13 bytes of data, CRC); our chunks go between it and the pixels.
	constexpr std::ptrdiff_t after_header = 8 + 4 + 4 + 13 + 4;
	Bytes png(plain.begin(), plain.begin() + after_header);
	append_transfer_chunk(png, transfer);
	// "Warning" is one of the keywords that PNG itself defines.
	if (const std::string warning = warning_of(provenance); !warning.empty())
		append_text_chunk(png, "Warning", warning);
	for (const auto& [key, value] : provenance)
		append_text_chunk(png, attribute_name(key), value);
	png.insert(png.end(), plain.begin() + after_header, plain.end());
	return png;
}

Status write_image(const Film& film, const std::string& path, ImageFormat format, const DisplaySettings& display,
                   const Provenance& provenance)
{
	auto bytes = encode_image(film, format, display, provenance);
	if (!bytes) {
		Error error = bytes.error();
		if (error.where.empty())
			error.where = path;
		return error;
	}
	return write_file(path, bytes->data(), bytes->size());
}

} // namespace rt
