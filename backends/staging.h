// staging.h: reading device memory through page-locked memory, into which drivers copy several times as fast as into
// pages that they must lock first. One half is emptied while the driver fills the other.
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
// buffer; wait() -> Status ends all copies begun.
template <class Start, class Wait>
Status read_through_staging(std::uint8_t* staging, void* data, std::size_t bytes, const Start& start, const Wait& wait)
{
	const auto length = [&](std::size_t first) { return std::min(staging_bytes, bytes - first); };
	RT_TRY(start(staging, std::size_t(0), length(0)));
	for (std::size_t first = 0, half = 0; first < bytes; first += staging_bytes, half = 1 - half) {
		RT_TRY(wait());
		if (const std::size_t next = first + staging_bytes; next < bytes)
			RT_TRY(start(staging + (1 - half) * staging_bytes, next, length(next)));
		std::memcpy(static_cast<std::uint8_t*>(data) + first, staging + half * staging_bytes, length(first));
	}
	return success();
}

} // namespace rt
