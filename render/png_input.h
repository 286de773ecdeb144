// png_input.h: libpng reading from memory, for the decoders of textures and of images to compare.
//
// libpng reports errors by a jump, which must cross no C++ object: what it calls back takes plain data only, and each
// decoder sets its own jump in functions without destructors.
#pragma once

#include <png.h>

#include <cstddef>
#include <cstdint>

namespace rt {

// What libpng's callbacks share with us.
struct PngInput {
	const std::uint8_t* data;
	std::size_t bytes;
	std::size_t read;
	char error[160]; // what libpng said before it jumped
};

// Owns libpng's structures; a failed read leaves them as they are. Check both before use.
struct PngReader {
	explicit PngReader(PngInput& input);
	~PngReader();
	PngReader(const PngReader&) = delete;
	PngReader& operator=(const PngReader&) = delete;

	png_structp png;
	png_infop info = nullptr;
};

// Reads from `input`, with bounded chunks; profiles, texts and the like are not parsed. The size of the picture is
// checked by the caller, with a better message than libpng's. Jumps.
void read_png_from(png_structp png, PngInput& input);

// The size that the file claims, before libpng sees it; false if this is no PNG or it ends within its header.
bool png_size(const std::uint8_t* data, std::size_t bytes, std::uint32_t& width, std::uint32_t& height);

// Whether a file whose header libpng has read can hold a picture of this size: asked before memory is taken.
bool png_is_long_enough(const std::uint8_t* data, std::size_t bytes, std::uint64_t width, std::uint64_t height);

} // namespace rt
