// memory.h: how much of the machine's memory is free.
#pragma once

#include <cstdint>

namespace rt {

// Bytes that can be taken without swapping, as the system reckons; 0 if it does not tell.
std::uint64_t available_host_bytes();

} // namespace rt
