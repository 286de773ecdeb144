// image_read.h: images read back, rt's own and others', for comparing.
//
// PNG (8 or 16 bits), EXR (half or float), PFM and .rtfilm, recognised by their first bytes. Files are not trusted:
// sizes are checked before memory is taken, and an InputOutput error names file and cure. Grey pictures become R = G =
// B. Pixels stay what the file holds: codes of an integer format, linear floats of the others.
#pragma once

#include "render/display.h"
#include "render/film.h"
#include "render/image_file.h"
#include "render/provenance.h"
#include "support/hash.h"
#include "support/result.h"

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace rt {

enum class PixelType { Unsigned8, Unsigned16, Half, Float };

constexpr bool is_encoded(PixelType type) { return type == PixelType::Unsigned8 || type == PixelType::Unsigned16; }
// The code of white.
constexpr float largest_code(PixelType type) { return type == PixelType::Unsigned8 ? 255.0f : 65535.0f; }
const char* name_of(PixelType type);
const char* name_of(ImageFormat format);

struct LoadedImage {
	std::string name; // of the file, for messages
	ImageFormat format = ImageFormat::Png;
	PixelType type = PixelType::Unsigned8;
	std::uint32_t image_width = 0, image_height = 0; // of the whole image, of which the file holds a window
	Window window;
	std::size_t channels = 3;          // R, G, B and perhaps A
	std::vector<float> values;         // rows from the top; a film's are its mean radiances, rounded as in an EXR
	DisplaySettings display;           // by which an integer format's codes were made, as far as the file says
	std::optional<Film> film;          // of an .rtfilm
	std::vector<std::string> left_out; // channels that are not read
	Provenance provenance;             // keys without "rt:"

	std::uint64_t pixels() const { return std::uint64_t(window.width) * window.height; }
	// XXH3-128 of size, channels, type and values (docs/formats.md). The same for an EXR and a PFM of one film, and for
	// the film itself.
	Hash128 pixel_hash() const;
};

constexpr std::uint64_t max_image_pixels = std::uint64_t(1) << 28;

Result<LoadedImage> load_image(const std::string& path);
Result<LoadedImage> decode_image(const std::uint8_t* data, std::size_t bytes, const std::string& name);
// A film as load_image() would give it.
LoadedImage image_of(Film film, Provenance provenance, std::string name);

} // namespace rt
