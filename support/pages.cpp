#include "support/pages.h"

#include "support/thread_pool.h"

#include <cstdint>

#ifdef __linux__
#include <sys/mman.h>
#endif

namespace rt {

void prefer_large_pages(void* memory, std::size_t bytes)
{
#if defined(__linux__) && defined(MADV_HUGEPAGE)
	// What begins or ends within a large page shares it with other memory, which must not be grown by it.
	constexpr std::uintptr_t large_page = std::uintptr_t(1) << 21;
	const auto first = reinterpret_cast<std::uintptr_t>(memory);
	const std::uintptr_t begin = (first + large_page - 1) & ~(large_page - 1),
	                     end = (first + bytes) & ~(large_page - 1);
	if (begin < end)
		madvise(reinterpret_cast<void*>(begin), end - begin, MADV_HUGEPAGE); // refused: small pages serve as well
#else
	(void)memory;
	(void)bytes;
#endif
}

void populate_pages(void* memory, std::size_t bytes)
{
#if defined(__linux__) && defined(MADV_POPULATE_WRITE)
	constexpr std::uintptr_t page = 4096, taken_at_once = std::uintptr_t(1) << 21; // a large page
	const auto first = reinterpret_cast<std::uintptr_t>(memory);
	const std::uintptr_t begin = (first + page - 1) & ~(page - 1), end = (first + bytes) & ~(page - 1);
	if (begin >= end)
		return;
	// In pieces that end where large pages do.
	const std::uintptr_t base = begin & ~(taken_at_once - 1);
	parallel_for((end - base + taken_at_once - 1) / taken_at_once, 1, [&](std::uint64_t from, std::uint64_t to) {
		const std::uintptr_t piece = std::max(begin, base + from * taken_at_once);
		// Refused by kernels before 5.14: then pages come when they are touched.
		madvise(reinterpret_cast<void*>(piece), std::min(end, base + to * taken_at_once) - piece, MADV_POPULATE_WRITE);
	});
#else
	(void)memory;
	(void)bytes;
#endif
}

} // namespace rt
