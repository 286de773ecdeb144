#include "render/texture_file.h"

#include "render/texture_decoders.h"
#include "support/files.h"

#include <fmt/format.h>

#include <algorithm>
#include <new>

namespace rt {

namespace {

// No texture within the texel limit needs more: 8 bytes a texel uncompressed, and some room for headers.
constexpr std::uint64_t max_file_bytes = max_texture_texels * 9;

bool starts_with(const std::uint8_t* data, std::size_t bytes, std::initializer_list<std::uint8_t> magic)
{
	return bytes >= magic.size() && std::equal(magic.begin(), magic.end(), data);
}

} // namespace

Status check_texture_size(std::uint64_t width, std::uint64_t height, const std::string& name)
{
	if (width > 0 && height > 0 && width <= max_texture_texels / height)
		return success();
	return Error{ErrorKind::InputOutput,
	             fmt::format("the texture is {} x {} texels", width, height),
	             name,
	             fmt::format("a texture has 1 to {} texels (such as 16384 x 16384): scale it", max_texture_texels),
	             {}};
}

Error broken_texture(const char* format, const char* reason, const std::string& name)
{
	return Error{ErrorKind::InputOutput,
	             fmt::format("the {} file is broken or cut short: {}", format, reason),
	             name,
	             "fetch or export the texture again",
	             {}};
}

Result<TextureImage> decode_texture(const std::uint8_t* data, std::size_t bytes, const std::string& name)
{
	try {
		if (starts_with(data, bytes, {0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n'}))
			return decode_png(data, bytes, name);
		if (starts_with(data, bytes, {0xff, 0xd8, 0xff}))
			return decode_jpeg(data, bytes, name);
		return Error{ErrorKind::InputOutput,
		             bytes == 0 ? "the texture's file is empty" : "the texture is neither PNG nor JPEG",
		             name,
		             "convert it to PNG or JPEG",
		             {}};
	} catch (const std::bad_alloc&) {
		return Error{ErrorKind::Memory, "no memory for the texture", name, "scale it down", {}};
	}
}

Result<TextureImage> load_texture(const std::string& path)
{
	RT_TRY_ASSIGN(const std::vector<std::uint8_t> data, read_file(path, max_file_bytes));
	return decode_texture(data.data(), data.size(), path);
}

} // namespace rt
