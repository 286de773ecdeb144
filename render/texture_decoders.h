// texture_decoders.h: the two image formats behind texture_file.h, each in a file of its own because each library
// reports errors by a jump that must cross no C++ object.
#pragma once

#include "render/texture_file.h"

namespace rt {

Result<TextureImage> decode_png(const std::uint8_t* data, std::size_t bytes, const std::string& name);
Result<TextureImage> decode_jpeg(const std::uint8_t* data, std::size_t bytes, const std::string& name);

// Refuses sizes that are zero or above max_texture_texels: asked before anything is allocated.
Status check_texture_size(std::uint64_t width, std::uint64_t height, const std::string& name);

Error broken_texture(const char* format, const char* reason, const std::string& name);

} // namespace rt
