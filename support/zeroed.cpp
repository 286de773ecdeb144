#include "support/zeroed.h"

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

} // namespace rt
