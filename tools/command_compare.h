// command_compare.h: `rt compare`, whether two images are the same, where they differ, by how much, and whether that
// was to be expected.
#pragma once

#include "render/compare.h"
#include "support/result.h"
#include "tools/options.h"

#include <nlohmann/json_fwd.hpp>

#include <string>

namespace rt {

// The exit status, which is that of OpenImageIO's idiff: 0 match, 1 warning, 2 failure, 3 different size, 4 a file
// could not be read or written. The error behind 4 has been printed.
Result<int> run_compare(const CompareOptions& options);

// The same for images that are at hand: verdict first, then hashes, metadata, pixels, histogram, metrics.
std::string comparison_text(const LoadedImage& a, const LoadedImage& b, const Comparison& comparison);
nlohmann::ordered_json comparison_json(const LoadedImage& a, const LoadedImage& b, const Comparison& comparison);

} // namespace rt
