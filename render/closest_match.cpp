#include "render/closest_match.h"

#include <fmt/format.h>

#include <algorithm>

namespace rt {

namespace {

// Longer words are never slips of anything: bounds the table below whatever a file holds.
constexpr std::size_t longest_word = 64;
constexpr std::size_t most_names_shown = 16;
constexpr std::size_t longest_quote = 80;

char lower(char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; }

// Edit distance with insertion, deletion, substitution and exchange of neighbours (Damerau 1964, Levenshtein 1966, in
// the restricted form), by three rows of the table.
std::size_t edit_distance(std::string_view a, std::string_view b)
{
	std::vector<std::size_t> before(b.size() + 1), above(b.size() + 1), row(b.size() + 1);
	for (std::size_t j = 0; j <= b.size(); ++j)
		row[j] = j;
	for (std::size_t i = 1; i <= a.size(); ++i) {
		before.swap(above);
		above.swap(row);
		row[0] = i;
		for (std::size_t j = 1; j <= b.size(); ++j) {
			const char from = lower(a[i - 1]), to = lower(b[j - 1]);
			row[j] = std::min({above[j - 1] + (from == to ? 0 : 1), row[j - 1] + 1, above[j] + 1});
			if (i > 1 && j > 1 && from == lower(b[j - 2]) && lower(a[i - 2]) == to)
				row[j] = std::min(row[j], before[j - 2] + 1);
		}
	}
	return row[b.size()];
}

} // namespace

std::string closest_match(std::string_view word, const std::vector<std::string>& candidates)
{
	std::string best;
	if (word.size() > longest_word)
		return best;
	std::size_t best_distance = std::max<std::size_t>(1, word.size() / 3) + 1;
	for (const std::string& candidate : candidates) {
		if (candidate.size() > longest_word)
			continue;
		const std::size_t distance = edit_distance(word, candidate);
		if (distance < best_distance && distance < candidate.size()) {
			best_distance = distance;
			best = candidate;
		}
	}
	return best;
}

std::string name_cure(std::string_view word, std::string_view lead, const std::vector<std::string>& candidates)
{
	std::string cure;
	if (const std::string near = closest_match(word, candidates); !near.empty())
		cure = fmt::format("did you mean {}? ", in_quotes(near));
	const std::size_t shown = std::min(candidates.size(), most_names_shown);
	cure += fmt::format("{}: ", lead);
	for (std::size_t i = 0; i < shown; ++i)
		cure += (i ? ", " : "") + candidates[i];
	if (shown < candidates.size())
		cure += fmt::format(", and {} more", candidates.size() - shown);
	return cure;
}

std::string in_quotes(std::string_view text)
{
	const bool shortened = text.size() > longest_quote;
	if (shortened) {
		std::size_t end = longest_quote;
		while (end > 0 && (static_cast<unsigned char>(text[end]) & 0xc0) == 0x80)
			--end; // not in the middle of a UTF-8 sequence
		text = text.substr(0, end);
	}
	std::string result = "\"";
	for (const char c : text) {
		const auto byte = static_cast<unsigned char>(c);
		if (c == '"' || c == '\\')
			result += fmt::format("\\{}", c);
		else if (byte < 0x20 || byte == 0x7f)
			result += fmt::format("\\u{:04x}", byte);
		else
			result += c;
	}
	return result + (shortened ? "...\"" : "\"");
}

} // namespace rt
