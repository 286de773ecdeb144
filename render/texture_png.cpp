#include "render/texture_decoders.h"

#include <png.h>

#include <csetjmp>
#include <cstdio>
#include <cstring>

namespace rt {

namespace {

// What libpng's callbacks share with us: plain data, because its errors jump.
struct PngInput {
	const std::uint8_t* data;
	std::size_t bytes;
	std::size_t read;
	char error[160];
};

void fail(png_structp png, png_const_charp message)
{
	auto* input = static_cast<PngInput*>(png_get_error_ptr(png));
	std::snprintf(input->error, sizeof input->error, "%s", message);
	png_longjmp(png, 1);
}

void ignore_warning(png_structp, png_const_charp) {}

void read_bytes(png_structp png, png_bytep to, png_size_t count)
{
	auto* input = static_cast<PngInput*>(png_get_io_ptr(png));
	if (count > input->bytes - input->read)
		png_error(png, "the file ends too early");
	std::memcpy(to, input->data + input->read, count);
	input->read += count;
}

// Owns libpng's structures; a failed read leaves them as they are.
struct PngReader {
	explicit PngReader(PngInput& input)
	    : png(png_create_read_struct(PNG_LIBPNG_VER_STRING, &input, fail, ignore_warning))
	{
		if (png)
			info = png_create_info_struct(png);
	}
	~PngReader() { png_destroy_read_struct(&png, &info, nullptr); }
	PngReader(const PngReader&) = delete;
	PngReader& operator=(const PngReader&) = delete;

	png_structp png;
	png_infop info = nullptr;
};

// Everything up to the picture. Every picture then comes as 8-bit RGBA: palettes, grey levels and transparent colours
// are expanded, 16 bits rounded to 8. Texels are sRGB whatever gamma or colour profile the file claims.
bool read_header(png_structp png, png_infop info, PngInput& input)
{
	if (setjmp(png_jmpbuf(png)))
		return false;
	png_set_read_fn(png, &input, read_bytes);
	png_set_user_limits(png, 0x7fffffff, 0x7fffffff); // the size is checked by us, with a better message
	png_set_chunk_malloc_max(png, 1 << 20);
	png_set_chunk_cache_max(png, 64);
	png_set_keep_unknown_chunks(png, PNG_HANDLE_CHUNK_NEVER, nullptr,
	                            -1); // profiles, texts and the like are not parsed
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

// Deflate packs at most 1032 : 1 (RFC 1951: 258 bytes in 2 bits), so a short file that claims a large picture is
// refused before memory is taken for it.
bool long_enough(std::size_t file_bytes, std::uint64_t width, std::uint64_t height, std::uint64_t bits_per_texel)
{
	const std::uint64_t raw_bytes = (width * bits_per_texel + 7) / 8 * height;
	return raw_bytes / 1032 <= file_bytes;
}

} // namespace

Result<TextureImage> decode_png(const std::uint8_t* data, std::size_t bytes, const std::string& name)
{
	PngInput input{data, bytes, 0, "unknown error"};
	PngReader reader(input);
	if (!reader.png || !reader.info)
		return Error{ErrorKind::Memory, "libpng could not be started", name, {}, {}};

	// The size stands in a fixed place: asked for here, before libpng sees the file.
	if (bytes >= 24 && std::memcmp(data + 12, "IHDR", 4) == 0)
		RT_TRY(check_texture_size(png_get_uint_32(data + 16), png_get_uint_32(data + 20), name));
	if (!read_header(reader.png, reader.info, input))
		return broken_texture("PNG", input.error, name);

	TextureImage image;
	image.width = png_get_image_width(reader.png, reader.info);
	image.height = png_get_image_height(reader.png, reader.info);
	RT_TRY(check_texture_size(image.width, image.height, name));
	// data[24] and data[25] are the header's bit depth and colour type (PNG specification, 11.2.2).
	const std::uint64_t channels = data[25] == 2 ? 3 : data[25] == 4 ? 2 : data[25] == 6 ? 4 : 1;
	if (!long_enough(bytes, image.width, image.height, channels * data[24]))
		return broken_texture("PNG", "the file is too short for a picture of its size", name);

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
