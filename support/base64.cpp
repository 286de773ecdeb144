#include "support/base64.h"

namespace rt {

std::string to_base64(const std::uint8_t* data, std::size_t bytes)
{
	static constexpr char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
	std::string text;
	text.reserve((bytes + 2) / 3 * 4);
	for (std::size_t i = 0; i < bytes; i += 3) {
		const std::size_t here = bytes - i < 3 ? bytes - i : 3;
		std::uint32_t group = 0;
		for (std::size_t j = 0; j < 3; ++j)
			group = (group << 8) | (j < here ? data[i + j] : 0u);
		for (std::size_t j = 0; j < 4; ++j)
			text += j <= here ? digits[(group >> (18 - 6 * j)) & 63u] : '=';
	}
	return text;
}

} // namespace rt
