// texture_file.h: reading PNG and JPEG files as 8-bit sRGB texels, with libpng and libjpeg-turbo.
//
// Files are not trusted: the header's width and height are checked against `max_texels` before anything is
// allocated, every size is computed in 64 bits, and any decoder error is one InputOutput error naming the file.
#pragma once

#include "support/result.h"

#include <cstdint>
#include <string>
#include <vector>

namespace rt {

struct TextureImage {
	std::uint32_t width = 0, height = 0;
	std::vector<std::uint32_t> texels; // 0x00BBGGRR, row 0 at the top
};

constexpr std::uint64_t max_texture_texels = std::uint64_t(1) << 28;

Result<TextureImage> load_texture(const std::string& path);
Result<TextureImage> decode_texture(const std::uint8_t* data, std::size_t bytes, const std::string& name);

} // namespace rt
