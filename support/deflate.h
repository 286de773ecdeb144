// deflate.h: compression by zlib on all cores.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace rt {

// A zlib stream (RFC 1950) of the data. It is cut into pieces of fixed size that are compressed side by side, each
// knowing the 32 KiB before it, so that the bytes do not depend on the number of threads and are hardly more than one
// thread would make. Throws std::bad_alloc.
std::vector<std::uint8_t> zlib_compress(const std::uint8_t* data, std::size_t bytes);

} // namespace rt
