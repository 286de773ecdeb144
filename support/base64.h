// base64.h: bytes as text (RFC 4648, section 4), for data inside other files.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

namespace rt {

std::string to_base64(const std::uint8_t* data, std::size_t bytes);

} // namespace rt
