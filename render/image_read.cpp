#include "render/image_read.h"

#include "render/image_decoders.h"
#include "support/files.h"

#include <fmt/format.h>

#include <cstring>
#include <new>
#include <string_view>
#include <utility>

namespace rt {

namespace {

bool starts_with(const std::uint8_t* data, std::size_t bytes, std::string_view magic)
{
	return bytes >= magic.size() && std::memcmp(data, magic.data(), magic.size()) == 0;
}

Result<LoadedImage> decode_any(const std::uint8_t* data, std::size_t bytes, const std::string& name)
{
	if (starts_with(data, bytes, "\x89PNG\r\n\x1a\n"))
		return decode_image_png(data, bytes, name);
	if (starts_with(data, bytes, "\x76\x2f\x31\x01"))
		return decode_image_exr(data, bytes, name);
	if (starts_with(data, bytes, "PF") || starts_with(data, bytes, "Pf"))
		return decode_image_pfm(data, bytes, name);
	if (starts_with(data, bytes, "RTFILM\r\n")) {
		RT_TRY_ASSIGN(LoadedFilm loaded, decode_rtfilm(data, bytes, name));
		RT_TRY(check_image_size(loaded.film.window().width, loaded.film.window().height, name));
		return image_of(std::move(loaded.film), std::move(loaded.provenance), name);
	}
	return Error{ErrorKind::InputOutput,
	             bytes == 0 ? "the file is empty" : "the file is no PNG, EXR, PFM or .rtfilm",
	             name,
	             bytes == 0 ? "copy the file again or render it again" : "convert it to one of them",
	             {}};
}

} // namespace

const char* name_of(PixelType type)
{
	switch (type) {
	case PixelType::Unsigned8:
		return "8-bit";
	case PixelType::Unsigned16:
		return "16-bit";
	case PixelType::Half:
		return "half";
	case PixelType::Float:
		return "float";
	}
	return "";
}

const char* name_of(ImageFormat format)
{
	switch (format) {
	case ImageFormat::Png:
		return "PNG";
	case ImageFormat::Exr:
		return "EXR";
	case ImageFormat::Pfm:
		return "PFM";
	case ImageFormat::RtFilm:
		return ".rtfilm";
	}
	return "";
}

Status check_image_size(std::uint64_t width, std::uint64_t height, const std::string& name)
{
	if (width > 0 && height > 0 && width <= max_image_pixels / height)
		return success();
	return Error{ErrorKind::InputOutput,
	             fmt::format("the image has {}x{} pixels", width, height),
	             name,
	             fmt::format("images of 1 to {} pixels (such as 16384x16384) can be compared: take a part of it",
	                         max_image_pixels),
	             {}};
}

Error broken_image(const char* format, const std::string& reason, const std::string& name)
{
	return Error{ErrorKind::InputOutput,
	             fmt::format("the {} is broken, cut short or of a kind that rt does not read: {}", format, reason),
	             name,
	             "copy the file again, or convert it",
	             {}};
}

Hash128 LoadedImage::pixel_hash() const
{
	Hasher hasher;
	hasher.add_u32(window.width);
	hasher.add_u32(window.height);
	hasher.add_u32(static_cast<std::uint32_t>(channels));
	hasher.add_u32(type == PixelType::Unsigned8 ? 8 : type == PixelType::Unsigned16 ? 16 : 32);
	// In blocks: a call of the hash for each of millions of values would cost more than the hashing.
	std::uint8_t block[8192];
	std::size_t used = 0;
	for (const float value : values) {
		std::uint32_t bits;
		if (is_encoded(type))
			bits = static_cast<std::uint32_t>(value);
		else
			std::memcpy(&bits, &value, sizeof bits);
		const int width = type == PixelType::Unsigned8 ? 8 : type == PixelType::Unsigned16 ? 16 : 32;
		for (int shift = 0; shift < width; shift += 8)
			block[used++] = static_cast<std::uint8_t>(bits >> shift);
		if (used > sizeof block - 4) {
			hasher.add(block, used);
			used = 0;
		}
	}
	hasher.add(block, used);
	return hasher.result();
}

LoadedImage image_of(Film film, Provenance provenance, std::string name)
{
	LoadedImage image;
	image.name = std::move(name);
	image.format = ImageFormat::RtFilm;
	image.type = PixelType::Float;
	image.image_width = film.image_width();
	image.image_height = film.image_height();
	image.window = film.window();
	image.values.reserve(film.sums().size());
	for (std::uint32_t y = 0; y < film.window().height; ++y)
		for (std::uint32_t x = 0; x < film.window().width; ++x)
			for (int channel = 0; channel < 3; ++channel)
				image.values.push_back(film.radiance_float(x, y, channel));
	image.film = std::move(film);
	image.provenance = std::move(provenance);
	return image;
}

Result<LoadedImage> decode_image(const std::uint8_t* data, std::size_t bytes, const std::string& name)
{
	try {
		return decode_any(data, bytes, name);
	} catch (const std::bad_alloc&) {
		return Error{ErrorKind::Memory, "there is too little memory for the image", name, "compare a part of it", {}};
	}
}

Result<LoadedImage> load_image(const std::string& path)
{
	// The largest .rtfilm of max_image_pixels, and some room for what stands beside the pixels.
	constexpr std::uint64_t max_file_bytes = 28 * max_image_pixels + (std::uint64_t(1) << 20);
	RT_TRY_ASSIGN(const std::vector<std::uint8_t> data, read_file(path, max_file_bytes));
	return decode_image(data.data(), data.size(), path);
}

} // namespace rt
