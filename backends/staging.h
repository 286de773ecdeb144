// staging.h: reading and writing device memory through page-locked memory, with which drivers copy several times as
// fast as with pages that they must lock first. The host has one half while the driver has the other.
#pragma once

#include "support/result.h"
#include "support/thread_pool.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>

namespace rt {

// A half: with smaller ones the waiting between them counts (docs/performance.md, Steps).
constexpr std::size_t staging_bytes = std::size_t(1) << 22;
// Below it a plain copy is as fast.
constexpr std::size_t min_staged_bytes = std::size_t(1) << 18;

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

// As above, the other way: start(source, first, count) begins to copy into the buffer.
template <class Start, class Wait>
Status write_through_staging(std::uint8_t* staging, const void* data, std::size_t bytes, const Start& start,
                             const Wait& wait)
{
	constexpr std::uint64_t copied_at_once = std::uint64_t(1) << 19;
	for (std::size_t first = 0, half = 0; first < bytes; first += staging_bytes, half = 1 - half) {
		const std::size_t count = std::min(staging_bytes, bytes - first);
		std::uint8_t* const target = staging + half * staging_bytes;
		// By several threads: one alone fills memory more slowly than the driver empties it.
		parallel_for(count, copied_at_once, [&](std::uint64_t begin, std::uint64_t end) {
			std::memcpy(target + begin, static_cast<const std::uint8_t*>(data) + first + begin, end - begin);
		});
		RT_TRY(wait()); // for the other half
		RT_TRY(start(target, first, count));
	}
	return wait();
}

// A TakePiece that puts the pieces together again.
inline auto copy_to(void* data)
{
	return [data](const void* piece, std::size_t first, std::size_t bytes) {
		std::memcpy(static_cast<std::uint8_t*>(data) + first, piece, bytes);
	};
}

} // namespace rt
