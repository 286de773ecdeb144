// report.h: everything that rt says to people and programs: errors, warnings, tables, numbers with units, JSON.
//
// Results go to standard output, all else to standard error. An error is exactly one message in three parts, and its
// kind is the exit status. Colour only on a terminal, and never where NO_COLOR is set.
#pragma once

#include "support/result.h"

#include <nlohmann/json_fwd.hpp>

#include <cstdint>
#include <cstdio>
#include <string>
#include <string_view>
#include <vector>

namespace rt {

// Prints the error to standard error and returns the exit status that belongs to it.
int report_error(const Error& error);
// "rt: warning: ...", with an optional second line that says what to do.
void report_warning(std::string_view message, std::string_view cure = {});
// "rt: ...": what -v tells.
void report_note(std::string_view message);

// Writes to standard error as it stands.
void print_message(std::string_view text);
// Writes to standard output; a failure (a full disk, say) is told by flush_results() at the end.
void print_result(std::string_view text);
Status flush_results();

// The last line of a main(): tells an error, also one of writing the results; the exit status.
int end_program(const Result<int>& status);

// Whether escape sequences may be written to this stream.
bool has_terminal(std::FILE* stream);
bool has_colour(std::FILE* stream);

std::string format_bytes(std::uint64_t bytes);             // "15.6 GiB"
std::string format_quantity(double value);                 // three digits and a prefix: "39.3 M"
std::string format_seconds(double seconds);                // "4.20 ms", "0.42 s", "3:07 min", "1:02:03 h"
std::string plural(std::uint64_t count, const char* noun); // "1 sample", "3 samples"

// Columns padded to their widest cell; the first row is the heading. Columns whose heading starts with '>' (which is
// not printed) are set flush right.
std::string format_table(const std::vector<std::vector<std::string>>& rows, const std::string& indent = "");

// Indented JSON with a line feed at its end; bytes that are not UTF-8 (a device's name, a path) are replaced.
std::string to_text(const nlohmann::ordered_json& json);

} // namespace rt
