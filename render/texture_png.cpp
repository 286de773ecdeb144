#include "render/png_input.h"
#include "render/texture_decoders.h"

#include <png.h>

#include <csetjmp>
#include <cstring>

namespace rt {

namespace {

// Everything up to the picture. Every picture then comes as 8-bit RGBA: palettes, grey levels and transparent colours
// are expanded, 16 bits rounded to 8. Texels are sRGB whatever gamma or colour profile the file claims.
bool read_header(png_structp png, png_infop info, PngInput& input)
{
	if (setjmp(png_jmpbuf(png)))
		return false;
	read_png_from(png, input);
	png_read_info(png, info);
	png_set_expand(png);
	png_set_scale_16(png);
	png_set_gray_to_rgb(png);
	png_set_add_alpha(png, 0xff, PNG_FILLER_AFTER);
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

} // namespace

Result<TextureImage> decode_png(const std::uint8_t* data, std::size_t bytes, const std::string& name)
{
	// All this is asked before libpng sees the file: it takes and clears memory for rows as long as the header says.
	std::uint32_t width = 0, height = 0;
	if (!png_size(data, bytes, width, height))
		return broken_texture("PNG", "it ends within its header", name);
	RT_TRY(check_texture_size(width, height, name));
	if (!png_is_long_enough(data, bytes, width, height))
		return broken_texture("PNG", "the file is too short for a picture of its size", name);

	PngInput input{data, bytes, 0, "unknown error"};
	PngReader reader(input);
	if (!reader.png || !reader.info)
		return Error{ErrorKind::Memory, "libpng could not be started", name, {}, {}};
	if (!read_header(reader.png, reader.info, input))
		return broken_texture("PNG", input.error, name);
	if (png_get_image_width(reader.png, reader.info) != width ||
	    png_get_image_height(reader.png, reader.info) != height)
		return broken_texture("PNG", "it has two headers", name);

	TextureImage image;
	image.width = width;
	image.height = height;
	image.texels.resize(std::size_t(image.width) * image.height);
	std::vector<png_bytep> rows(image.height);
	for (std::size_t y = 0; y < image.height; ++y)
		rows[y] = reinterpret_cast<png_bytep>(image.texels.data() + y * image.width);
	if (!read_picture(reader.png, rows.data()))
		return broken_texture("PNG", input.error, name);
	for (std::uint32_t& texel : image.texels) {
		std::uint8_t rgba[4];
		std::memcpy(rgba, &texel, sizeof rgba);
		texel = static_cast<std::uint32_t>(rgba[0] | rgba[1] << 8 | rgba[2] << 16); // alpha is dropped
	}
	return image;
}

} // namespace rt
