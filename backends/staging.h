// staging.h: reading device memory through page-locked memory, into which drivers copy several times as fast as into
// pages that they must lock first. One half is looked at while the driver fills the other.
#pragma once

#include "support/result.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>

namespace rt {

// A half. Below an eighth of it a plain copy is as fast.
constexpr std::size_t staging_bytes = std::size_t(1) << 21;
constexpr std::size_t min_staged_bytes = staging_bytes / 8;

// staging: 2 * staging_bytes. start(target, first, count) -> Status begins to copy bytes [first, first + count) of the
// buffer; wait() -> Status ends all copies begun; take is a TakePiece.
template <class Start, class Wait, class Take>
Status read_through_staging(std::uint8_t* staging, std::size_t bytes, const Start& start, const Wait& wait,
                            const Take& take)
{
	const auto length = [&](std::size_t first) { return std::min(staging_bytes, bytes - first); };
	RT_TRY(start(staging, std::size_t(0), length(0)));
	for (std::size_t first = 0, half = 0; first < bytes; first += staging_bytes, half = 1 - half) {
		RT_TRY(wait());
		if (const std::size_t next = first + staging_bytes; next < bytes)
			RT_TRY(start(staging + (1 - half) * staging_bytes, next, length(next)));
		take(staging + half * staging_bytes, first, length(first));
	}
	return success();
}

// A TakePiece that puts the pieces together again.
inline auto copy_to(void* data)
{
	return [data](const void* piece, std::size_t first, std::size_t bytes) {
		std::memcpy(static_cast<std::uint8_t*>(data) + first, piece, bytes);
	};
}

} // namespace rt
