// image_decoders.h: the formats behind image_read.h, each in a file of its own.
#pragma once

#include "render/image_read.h"

namespace rt {

Result<LoadedImage> decode_image_png(const std::uint8_t* data, std::size_t bytes, const std::string& name);
Result<LoadedImage> decode_image_exr(const std::uint8_t* data, std::size_t bytes, const std::string& name);
Result<LoadedImage> decode_image_pfm(const std::uint8_t* data, std::size_t bytes, const std::string& name);

// Refuses images without pixels and with more than max_image_pixels: asked before anything is allocated.
Status check_image_size(std::uint64_t width, std::uint64_t height, const std::string& name);

Error broken_image(const char* format, const std::string& reason, const std::string& name);

} // namespace rt
