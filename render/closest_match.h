// closest_match.h: "did you mean ...?" for names that a user mistyped.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace rt {

// The candidate with the smallest edit distance to `word` (letters' case ignored), the first of several; empty if none
// is near enough to be a likely slip of the fingers (more than a third of the letters differ).
std::string closest_match(std::string_view word, const std::vector<std::string>& candidates);

// A cure for an unknown name: `did you mean "x"? ` if something is near, then `lead: a, b, c`, shortened when long.
std::string name_cure(std::string_view word, std::string_view lead, const std::vector<std::string>& candidates);

// Text from a file as it can be shown: in double quotes, control characters escaped, shortened when long.
std::string in_quotes(std::string_view text);

} // namespace rt
