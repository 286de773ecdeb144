#include "render/image_decoders.h"

#include <charconv>
#include <cmath>
#include <cstring>
#include <optional>
#include <string_view>

namespace rt {

namespace {

bool is_space(char c) { return c == ' ' || c == '\t' || c == '\r' || c == '\n'; }

// The next word of the header; empty if the text ends first.
std::string_view next_word(std::string_view& text)
{
	while (!text.empty() && is_space(text.front()))
		text.remove_prefix(1);
	std::size_t end = 0;
	while (end < text.size() && !is_space(text[end]))
		++end;
	const std::string_view word = text.substr(0, end);
	text.remove_prefix(end);
	return word;
}

template <class T>
std::optional<T> number_in(std::string_view word)
{
	T value{};
	const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
	if (error != std::errc() || end != word.data() + word.size())
		return std::nullopt;
	return value;
}

} // namespace

Result<LoadedImage> decode_image_pfm(const std::uint8_t* data, std::size_t bytes, const std::string& name)
{
	std::string_view text(reinterpret_cast<const char*>(data), bytes);
	const std::string_view magic = next_word(text);
	const auto width = number_in<std::uint32_t>(next_word(text));
	const auto height = number_in<std::uint32_t>(next_word(text));
	// The sign says the byte order; the scale itself is a unit that nobody uses.
	const auto scale = number_in<double>(next_word(text));
	if ((magic != "PF" && magic != "Pf") || !width || !height || !scale || *scale == 0 || !std::isfinite(*scale) ||
	    text.empty())
		return broken_image("PFM", "its header is not 'PF', width, height and scale", name);
	text.remove_prefix(1); // one white space
	RT_TRY(check_image_size(*width, *height, name));
	const std::size_t channels = magic == "PF" ? 3 : 1;
	const std::size_t row = std::size_t(*width) * channels;
	if (text.size() / (4 * row) < *height)
		return broken_image("PFM", "it is too short for a picture of its size", name);

	LoadedImage image;
	image.name = name;
	image.format = ImageFormat::Pfm;
	image.type = PixelType::Float;
	image.image_width = *width;
	image.image_height = *height;
	image.window = {0, 0, *width, *height};
	image.values.reserve(static_cast<std::size_t>(image.pixels()) * 3);
	for (std::size_t y = *height; y-- > 0;)
		for (std::size_t i = 0; i < row; ++i) {
			const char* const at = text.data() + 4 * (y * row + i);
			std::uint32_t bits = 0;
			for (std::uint32_t k = 0; k < 4; ++k)
				bits |= std::uint32_t(static_cast<std::uint8_t>(at[k])) << (*scale < 0 ? 8 * k : 24 - 8 * k);
			float value;
			std::memcpy(&value, &bits, sizeof value);
			for (std::size_t copies = channels == 3 ? 1 : 3; copies > 0; --copies)
				image.values.push_back(value);
		}
	return image;
}

} // namespace rt
