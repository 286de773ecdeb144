#include "tools/report.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstdlib>
#include <cstring>

#include <unistd.h>

namespace rt {

namespace {

// Every line of `text` behind `first` on the first line and as many spaces on the others.
std::string hang(std::string_view first, std::string_view text)
{
	std::string out;
	std::string lead(first);
	while (!text.empty() && text.back() == '\n')
		text.remove_suffix(1);
	for (;;) {
		const std::size_t end = text.find('\n');
		out += lead;
		out += text.substr(0, end);
		out += '\n';
		if (end == std::string_view::npos)
			return out;
		text.remove_prefix(end + 1);
		lead.assign(first.size(), ' ');
	}
}

std::string label(const char* word, const char* colour)
{
	return has_colour(stderr) ? fmt::format("\033[1;{}m{}\033[0m", colour, word) : word;
}

// Code points, which is what a column of a terminal holds for all text that rt prints.
std::size_t columns_of(std::string_view text)
{
	return static_cast<std::size_t>(std::count_if(
	    text.begin(), text.end(), [](char c) { return (static_cast<unsigned char>(c) & 0xc0u) != 0x80u; }));
}

} // namespace

int end_program(const Result<int>& status)
{
	if (!status)
		return report_error(status.error());
	if (const Status flushed = flush_results(); !flushed)
		return report_error(flushed.error());
	return *status;
}

bool has_terminal(std::FILE* stream)
{
	const char* term = std::getenv("TERM");
	return isatty(fileno(stream)) == 1 && (term == nullptr || std::strcmp(term, "dumb") != 0);
}

bool has_colour(std::FILE* stream)
{
	const char* no_colour = std::getenv("NO_COLOR"); // no-color.org: any value but the empty one
	return has_terminal(stream) && (no_colour == nullptr || *no_colour == '\0');
}

int report_error(const Error& error)
{
	const bool interrupted = error.kind == ErrorKind::Interrupted;
	std::string text = fmt::format("rt: {} {}\n", interrupted ? label("interrupted:", "33") : label("error:", "31"),
	                               error.message.empty() ? "unknown failure" : error.message);
	if (!error.where.empty())
		text += hang("    where: ", error.where);
	if (!error.cure.empty())
		text += hang("    cure:  ", error.cure);
	if (!error.log.empty()) {
		text += "    log:\n";
		std::string_view log = error.log;
		while (!log.empty()) {
			const std::size_t end = std::min(log.find('\n'), log.size());
			text += fmt::format("    | {}\n", log.substr(0, end));
			log.remove_prefix(std::min(end + 1, log.size()));
		}
	}
	// Results that are still buffered come first, so that a terminal shows things in their order.
	(void)std::fflush(stdout);
	print_message(text);
	return static_cast<int>(error.kind);
}

void report_warning(std::string_view message, std::string_view cure)
{
	std::string text = fmt::format("rt: {} {}\n", label("warning:", "33"), message);
	if (!cure.empty())
		text += hang("    cure:  ", cure);
	print_message(text);
}

void report_note(std::string_view message) { print_message(hang("rt: ", message)); }

void print_message(std::string_view text)
{
	// Nothing can be done about a failure here.
	(void)std::fwrite(text.data(), 1, text.size(), stderr);
}

void print_result(std::string_view text) { (void)std::fwrite(text.data(), 1, text.size(), stdout); }

Status flush_results()
{
	errno = 0;
	if (std::fflush(stdout) != 0 || std::ferror(stdout) != 0) {
		const std::string reason = errno != 0 ? std::strerror(errno) : "write error";
		return Error{ErrorKind::InputOutput, "standard output could not be written: " + reason, "standard output",
		             "look at where standard output goes: a full disk, or a closed file", ""};
	}
	return success();
}

std::string format_bytes(std::uint64_t bytes)
{
	static constexpr std::array<const char*, 6> units = {"KiB", "MiB", "GiB", "TiB", "PiB", "EiB"};
	if (bytes < 1024)
		return fmt::format("{} B", bytes);
	double value = static_cast<double>(bytes) / 1024;
	std::size_t unit = 0;
	while (value >= 1023.95 && unit + 1 < units.size()) {
		value /= 1024;
		unit++;
	}
	return fmt::format("{:.1f} {}", value, units[unit]);
}

std::string format_quantity(double value)
{
	static constexpr std::array<const char*, 5> prefixes = {"", "k", "M", "G", "T"};
	if (!std::isfinite(value) || value < 0)
		return "?";
	std::size_t prefix = 0;
	while (value >= 999.5 && prefix + 1 < prefixes.size()) {
		value /= 1000;
		prefix++;
	}
	const int decimals = value >= 99.95 || (prefix == 0 && value == std::floor(value)) ? 0 : value >= 9.995 ? 1 : 2;
	return fmt::format("{:.{}f} {}", value, decimals, prefixes[prefix]);
}

std::string format_seconds(double seconds)
{
	if (!std::isfinite(seconds) || seconds < 0)
		return "?";
	if (seconds < 0.0995)
		return fmt::format("{:.{}f} ms", seconds * 1e3, seconds < 0.00995 ? 2 : 1);
	if (seconds < 59.95)
		return fmt::format("{:.{}f} s", seconds, seconds < 9.995 ? 2 : 1);
	const auto whole = static_cast<std::uint64_t>(std::min(seconds + 0.5, 1e15));
	if (whole < 3600)
		return fmt::format("{}:{:02} min", whole / 60, whole % 60);
	return fmt::format("{}:{:02}:{:02} h", whole / 3600, whole / 60 % 60, whole % 60);
}

std::string plural(std::uint64_t count, const char* noun)
{
	return fmt::format("{} {}{}", count, noun, count == 1 ? "" : "s");
}

std::string format_table(const std::vector<std::vector<std::string>>& rows, const std::string& indent)
{
	if (rows.empty())
		return {};
	std::vector<std::vector<std::string>> cells = rows;
	std::vector<bool> flush_right(cells[0].size());
	for (std::size_t column = 0; column < cells[0].size(); column++)
		if (!cells[0][column].empty() && cells[0][column][0] == '>') {
			flush_right[column] = true;
			cells[0][column].erase(0, 1);
		}
	std::vector<std::size_t> width(cells[0].size(), 0);
	for (const auto& row : cells)
		for (std::size_t column = 0; column < row.size(); column++)
			width[column] = std::max(width[column], columns_of(row[column]));
	std::string out;
	for (const auto& row : cells) {
		std::string line = indent;
		for (std::size_t column = 0; column < row.size(); column++) {
			const std::string pad(width[column] - columns_of(row[column]), ' ');
			line += flush_right[column] ? pad + row[column] : row[column] + pad;
			line += "  ";
		}
		line.erase(line.find_last_not_of(' ') + 1);
		out += line + '\n';
	}
	return out;
}

std::string to_text(const nlohmann::ordered_json& json)
{
	return json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + '\n';
}

} // namespace rt
