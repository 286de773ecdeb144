// files.h: reading whole files, and writing them so that no half-written file is ever seen.
#pragma once

#include "support/result.h"

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace rt {

// The whole file; InputOutput errors name the file and the system's reason. Refuses more than max_bytes.
Result<std::vector<std::uint8_t>> read_file(const std::string& path, std::uint64_t max_bytes = UINT64_MAX);

// Writes a temporary file beside the target, fsyncs it, renames it over the target and fsyncs the directory:
// the target holds either the old bytes or all of the new ones. "-" writes to standard output.
Status write_file(const std::string& path, const void* data, std::size_t bytes);
Status write_file(const std::string& path, std::string_view text);

// InputOutput error if a file could not be created at `path` (missing or unwritable directory): asked before
// a long render, so that it does not fail at its end.
Status check_writable(const std::string& path);

// Directory of the running executable, without a trailing slash; empty if unknown.
std::string executable_directory();

} // namespace rt
