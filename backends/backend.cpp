#include "backends/backend.h"

#include <fmt/format.h>

#include <algorithm>

namespace rt {

std::string describe(const DeviceInfo& info) { return fmt::format("{} ({})", info.name, info.backend); }

Status Device::read_pieces(const BufferHandle& buffer, std::size_t offset, std::size_t bytes, const TakePiece& take)
{
	// Small enough to stay in a cache until it is looked at, large enough for threads to share.
	constexpr std::size_t piece_bytes = std::size_t(1) << 22;
	std::vector<std::uint8_t> piece(std::min(bytes, piece_bytes));
	for (std::size_t first = 0; first < bytes; first += piece_bytes) {
		const std::size_t count = std::min(piece_bytes, bytes - first);
		RT_TRY(read(buffer, offset + first, piece.data(), count));
		take(piece.data(), first, count);
	}
	return success();
}

} // namespace rt
