#include "render/image_decoders.h"
#include "render/png_input.h"

#include <png.h>

#include <charconv>
#include <csetjmp>
#include <cstring>
#include <string_view>

namespace rt {

namespace {

// Everything up to the picture, which then comes as RGB or RGBA of 8 or 16 bits: palettes, grey levels and transparent
// colours are expanded. Codes stay as they are, whatever gamma or profile the file claims.
bool read_header(png_structp png, png_infop info, PngInput& input)
{
	if (setjmp(png_jmpbuf(png)))
		return false;
	read_png_from(png, input);
	png_read_info(png, info);
	png_set_expand(png);
	png_set_gray_to_rgb(png);
	png_set_interlace_handling(png);
	png_read_update_info(png, info);
	return true;
}

bool read_picture(png_structp png, png_bytepp rows)
{
	if (setjmp(png_jmpbuf(png)))
		return false;
	png_read_image(png, rows);
	png_read_end(png, nullptr);
	return true;
}

// Key and text of a chunk of ours, if it is one: what image_file.cpp writes, so no compressed text.
void take_text(std::string_view type, std::string_view data, Provenance& provenance)
{
	constexpr std::string_view prefix = "rt:";
	const std::size_t end = data.find('\0');
	if (end == data.npos || data.substr(0, prefix.size()) != prefix)
		return;
	const std::string_view key = data.substr(prefix.size(), end - prefix.size());
	data.remove_prefix(end + 1);
	if (type == "iTXt") {
		// Compression flag and method, then language and translated key, each with its zero.
		if (data.size() < 2 || data[0] != 0)
			return;
		data.remove_prefix(2);
		for (int i = 0; i < 2; ++i) {
			const std::size_t zero = data.find('\0');
			if (zero == data.npos)
				return;
			data.remove_prefix(zero + 1);
		}
	}
	provenance.emplace_back(key, data);
}

// The part of the image that the provenance tells, if it is one of this size.
void read_window(LoadedImage& image)
{
	const std::string text = provenance_value(image.provenance, "Window") + "," +
	                         provenance_value(image.provenance, "Width") + "," +
	                         provenance_value(image.provenance, "Height");
	std::uint32_t sides[6]; // x0, x1, y0, y1, width, height
	const char *at = text.data(), *const last = text.data() + text.size();
	for (std::uint32_t& side : sides) {
		const auto [end, error] = std::from_chars(at, last, side);
		if (error != std::errc() || (end != last && *end != ','))
			return;
		at = end == last ? last : end + 1;
	}
	const auto [x0, x1, y0, y1, width, height] = sides;
	if (x0 >= x1 || y0 >= y1 || x1 - x0 != image.window.width || y1 - y0 != image.window.height || x1 > width ||
	    y1 > height)
		return;
	image.window.x = x0;
	image.window.y = y0;
	image.image_width = width;
	image.image_height = height;
	image.knows_window = true;
}

// Provenance and transfer. libpng has read the whole file and found its chunks and checksums right.
void read_chunks(const std::uint8_t* data, std::size_t bytes, LoadedImage& image)
{
	bool says_transfer = false;
	for (std::size_t at = 8; at + 12 <= bytes;) {
		const std::size_t length = png_get_uint_32(data + at);
		if (length > bytes - at - 12)
			break;
		const auto* const first = reinterpret_cast<const char*>(data + at);
		const std::string_view type(first + 4, 4), content(first + 8, length);
		if (type == "tEXt" || type == "iTXt")
			take_text(type, content, image.provenance);
		if (type == "gAMA" && length == 4 && !says_transfer) {
			const std::uint32_t gamma = png_get_uint_32(data + at + 8);
			image.display.transfer = gamma == 100000  ? Transfer::Linear
			                         : gamma == 50000 ? Transfer::Gamma2
			                                          : Transfer::Srgb;
		}
		if (type == "sRGB") {
			image.display.transfer = Transfer::Srgb;
			says_transfer = true;
		}
		at += length + 12;
	}
	read_window(image);
	const std::string stops = provenance_value(image.provenance, "Exposure");
	double exposure = 0;
	const auto [end, error] = std::from_chars(stops.data(), stops.data() + stops.size(), exposure);
	if (error == std::errc() && end == stops.data() + stops.size())
		image.display.exposure_stops = exposure;
}

} // namespace

Result<LoadedImage> decode_image_png(const std::uint8_t* data, std::size_t bytes, const std::string& name)
{
	PngInput input{data, bytes, 0, "unknown error"};
	PngReader reader(input);
	if (!reader.png || !reader.info)
		return Error{ErrorKind::Memory, "libpng could not be started", name, {}, {}};
	std::uint32_t width = 0, height = 0;
	if (!png_size(data, bytes, width, height))
		return broken_image("PNG", "it ends within its header", name);
	RT_TRY(check_image_size(width, height, name));
	// Before libpng takes memory for rows as long as the header says.
	if (!png_is_long_enough(data, bytes, width, height))
		return broken_image("PNG", "it is too short for a picture of its size", name);
	if (!read_header(reader.png, reader.info, input))
		return broken_image("PNG", input.error, name);

	LoadedImage image;
	image.name = name;
	image.format = ImageFormat::Png;
	image.type = png_get_bit_depth(reader.png, reader.info) == 16 ? PixelType::Unsigned16 : PixelType::Unsigned8;
	image.image_width = width;
	image.image_height = height;
	image.window = {0, 0, width, height};
	image.channels = png_get_channels(reader.png, reader.info);
	const std::size_t row_bytes = png_get_rowbytes(reader.png, reader.info);
	std::vector<std::uint8_t> picture(row_bytes * height);
	std::vector<png_bytep> rows(height);
	for (std::size_t y = 0; y < height; ++y)
		rows[y] = picture.data() + y * row_bytes;
	if (!read_picture(reader.png, rows.data()))
		return broken_image("PNG", input.error, name);

	image.values.resize(static_cast<std::size_t>(image.pixels()) * image.channels);
	for (std::size_t i = 0; i < image.values.size(); ++i)
		image.values[i] = image.type == PixelType::Unsigned8
		                      ? static_cast<float>(picture[i])
		                      : static_cast<float>(picture[2 * i] << 8 | picture[2 * i + 1]);
	read_chunks(data, bytes, image);
	return image;
}

} // namespace rt
