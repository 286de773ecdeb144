// image_file.h: writing a film as PNG, EXR, PFM or .rtfilm. All go through write_file(): never half-written.
#pragma once

#include "render/display.h"
#include "render/film.h"
#include "render/provenance.h"
#include "support/result.h"

#include <cstdint>
#include <string>
#include <vector>

namespace rt {

enum class ImageFormat { Png, Exr, Pfm, RtFilm };

// By extension, case-insensitive; Usage error that lists the extensions otherwise.
Result<ImageFormat> image_format_of(const std::string& path);

// The file's bytes. PNG: 8-bit RGB by stb_image_write, compressed by zlib, with tEXt chunks added after IHDR. EXR:
// 32-bit float RGB, ZIP compression, display window = the whole image, data window = the film's window, string
// attributes. PFM: little-endian float RGB, rows from the bottom. Floats are the correctly rounded mean radiance.
Result<std::vector<std::uint8_t>> encode_image(const Film& film, ImageFormat format, const DisplaySettings& display,
                                               const Provenance& provenance);

// A PNG of any 8-bit RGB pixels, rows from the top.
Result<std::vector<std::uint8_t>> encode_png(std::uint32_t width, std::uint32_t height,
                                             const std::vector<std::uint8_t>& pixels, Transfer transfer,
                                             const Provenance& provenance);

// encode_image() + write_file().
Status write_image(const Film& film, const std::string& path, ImageFormat format, const DisplaySettings& display,
                   const Provenance& provenance);

// .rtfilm: "RTFILM\r\n", u32 format version, then explicit little-endian fields (docs/formats.md): image size,
// window, exponent, counters, provenance, samples, sums, and an XXH3-128 checksum of all before it.
std::vector<std::uint8_t> encode_rtfilm(const Film& film, const Provenance& provenance);
struct LoadedFilm {
	Film film;
	Provenance provenance;
};
// Not trusted: sizes are checked before allocation; truncated, altered or unknown versions are refused.
Result<LoadedFilm> decode_rtfilm(const std::uint8_t* data, std::size_t bytes, const std::string& name);

} // namespace rt
