// html_page.h: what rt's HTML pages have in common: one file each, style and pictures inside, no script, nothing
// fetched.
#pragma once

#include "support/result.h"

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace rt {

// Text as HTML shows it, in an attribute too.
std::string html_escape(std::string_view text);

// From the doctype to the open body. Classes: good, bad, odd (colours), verdict (a framed line), number, hash, scroll.
std::string html_head(std::string_view title);
inline constexpr const char* html_end = "</body></html>\n";

// A figure with its caption, which is plain text; in place of a PNG that could not be made, why.
std::string html_picture(const std::string& caption, const Result<std::vector<std::uint8_t>>& png);

} // namespace rt
