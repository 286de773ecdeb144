#include "render/png_input.h"

#include <csetjmp>
#include <cstdio>
#include <cstring>

namespace rt {

namespace {

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

} // namespace

PngReader::PngReader(PngInput& input) : png(png_create_read_struct(PNG_LIBPNG_VER_STRING, &input, fail, ignore_warning))
{
	if (png)
		info = png_create_info_struct(png);
}

PngReader::~PngReader() { png_destroy_read_struct(&png, &info, nullptr); }

void read_png_from(png_structp png, PngInput& input)
{
	png_set_read_fn(png, &input, read_bytes);
	png_set_user_limits(png, 0x7fffffff, 0x7fffffff);
	png_set_chunk_malloc_max(png, 1 << 20);
	png_set_chunk_cache_max(png, 64);
	png_set_keep_unknown_chunks(png, PNG_HANDLE_CHUNK_NEVER, nullptr, -1);
}

bool png_size(const std::uint8_t* data, std::size_t bytes, std::uint32_t& width, std::uint32_t& height)
{
	if (bytes < 26 || std::memcmp(data + 12, "IHDR", 4) != 0)
		return false;
	width = png_get_uint_32(data + 16);
	height = png_get_uint_32(data + 20);
	return true;
}

bool png_is_long_enough(const std::uint8_t* data, std::size_t bytes, std::uint64_t width, std::uint64_t height)
{
	// data[24] and data[25] are the header's bit depth and colour type (PNG specification, 11.2.2). Deflate packs at
	// most 1032 : 1 (RFC 1951: 258 bytes in 2 bits).
	const std::uint64_t channels = data[25] == 2 ? 3 : data[25] == 4 ? 2 : data[25] == 6 ? 4 : 1;
	const std::uint64_t raw_bytes = (width * channels * data[24] + 7) / 8 * height;
	return raw_bytes / 1032 <= bytes;
}

} // namespace rt
