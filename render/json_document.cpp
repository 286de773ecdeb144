#include "render/json_document.h"

#include "render/closest_match.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <cctype>
#include <cstring>
#include <iterator>
#include <unordered_map>

namespace rt {

namespace {

// Reads characters for nlohmann's lexer and tells how far it has read: its SAX events carry no position.
class CountingIterator {
public:
	using iterator_category = std::input_iterator_tag;
	using value_type = char;
	using difference_type = std::ptrdiff_t;
	using pointer = const char*;
	using reference = const char&;

	CountingIterator(const char* at, const char** consumed) : at_(at), consumed_(consumed) {}
	reference operator*() const { return *at_; }
	CountingIterator& operator++()
	{
		*consumed_ = ++at_;
		return *this;
	}
	CountingIterator operator++(int)
	{
		CountingIterator before = *this;
		++*this;
		return before;
	}
	friend bool operator==(const CountingIterator& a, const CountingIterator& b) { return a.at_ == b.at_; }
	friend bool operator!=(const CountingIterator& a, const CountingIterator& b) { return !(a == b); }

private:
	const char* at_;
	const char** consumed_;
};

bool is_space(char c) { return c == ' ' || c == '\t' || c == '\n' || c == '\r'; }

// What nlohmann says, without its error numbers and its own account of the position.
std::string reason_of(const char* what)
{
	std::string reason = what;
	if (const std::size_t column = reason.find(", column "); column != std::string::npos)
		if (const std::size_t colon = reason.find(": ", column); colon != std::string::npos)
			reason.erase(0, colon + 2);
	const std::string_view lead = "syntax error while parsing ";
	if (reason.compare(0, lead.size(), lead) == 0)
		if (const std::size_t dash = reason.find(" - "); dash != std::string::npos)
			reason.erase(0, dash + 3);
	if (const std::size_t last = reason.find("; last read: "); last != std::string::npos)
		reason.erase(last); // the place is named by line and column
	return reason;
}

// The usual slips of people who write JSON by hand; `at` is the offending character.
std::string syntax_cure(std::string_view text, std::size_t at)
{
	const char c = at < text.size() ? text[at] : '\0';
	std::size_t before = at;
	while (before > 0 && is_space(text[before - 1]))
		--before;
	if (c == '\0')
		return "the text ends too early: close every bracket, brace and quote";
	if ((c == '}' || c == ']') && before > 0 && text[before - 1] == ',')
		return "remove the comma before the closing bracket";
	if (c == '/' || c == '#')
		return "JSON has no comments: use the key \"comment\" at the top level";
	if (c == '\'')
		return "JSON has double quotes only";
	if (c == 'N' || c == 'I' || c == 'n' || c == 'i')
		return "JSON has no NaN and no infinity: write a finite number";
	return "correct the text there: a comma, quote or bracket may be missing before it";
}

} // namespace

std::string json_path_step(const std::string& key)
{
	const auto plain = [](unsigned char c) { return std::isalnum(c) || c == '_' || c == '-' || c == '$'; };
	const bool simple = !key.empty() && key.size() <= 64 && std::all_of(key.begin(), key.end(), plain);
	return simple ? "." + key : "[" + in_quotes(key) + "]";
}

// Receives nlohmann's events and grows the document.
class JsonBuilder {
public:
	JsonBuilder(JsonDocument& document, std::string_view text)
	    : document_(document), text_(text), consumed_(text.data()), counted_(text.data())
	{
	}

	const char** consumed() { return &consumed_; }
	const std::optional<Error>& error() const { return error_; }

	// --- events: the names and signatures are nlohmann's ---
	bool null() { return add(JsonValue::Kind::Null); }
	bool boolean(bool value) { return add(JsonValue::Kind::Boolean, value ? 1 : 0); }
	bool number_integer(std::int64_t value) { return add(JsonValue::Kind::Number, static_cast<double>(value)); }
	bool number_unsigned(std::uint64_t value) { return add(JsonValue::Kind::Number, static_cast<double>(value)); }
	bool number_float(double value, const std::string&) { return add(JsonValue::Kind::Number, value == 0 ? 0 : value); }
	bool string(std::string& value)
	{
		const std::uint32_t index = intern(value);
		if (!add(JsonValue::Kind::String))
			return false;
		document_.nodes_.back().count = index;
		return true;
	}
	template <class Binary>
	bool binary(Binary&)
	{
		return false; // not in text
	}
	bool start_object(std::size_t) { return open(JsonValue::Kind::Object); }
	bool start_array(std::size_t) { return open(JsonValue::Kind::Array); }
	bool key(std::string& name)
	{
		key_ = intern(name);
		key_line_ = line();
		return true;
	}
	bool end_array()
	{
		open_.pop_back();
		return true;
	}
	bool end_object()
	{
		const bool unique = check_unique(open_.back().node);
		open_.pop_back();
		return unique;
	}
	template <class Exception>
	bool parse_error(std::size_t, const std::string& token, const Exception& exception)
	{
		if (error_)
			return false;
		// A number that no double can hold is the one error that is not of syntax.
		if (exception.id == 406)
			return fail(fmt::format("the number {} is too large", token), place(), "write a number below 1.79e308");
		// The last character read and not blank is where the text goes wrong, or ends.
		const std::size_t read = static_cast<std::size_t>(consumed_ - text_.data());
		std::size_t at = read;
		while (at > 0 && is_space(text_[at - 1]))
			--at;
		const std::string reason = reason_of(exception.what());
		const bool ended = read == text_.size() && reason.find("unexpected end of input") != std::string::npos;
		if (!ended && at > 0)
			--at;
		const auto line_number = 1 + std::count(text_.begin(), text_.begin() + static_cast<std::ptrdiff_t>(at), '\n');
		const std::size_t newline = at == 0 ? std::string_view::npos : text_.rfind('\n', at - 1);
		const std::size_t column = at - (newline == std::string_view::npos ? 0 : newline + 1) + 1;
		return fail(fmt::format("not valid JSON: {}", reason),
		            fmt::format("{}:{}:{}", document_.name_, line_number, column),
		            syntax_cure(text_, ended ? text_.size() : at));
	}

private:
	struct Open {
		std::uint32_t node;
		std::uint32_t last_child;
	};

	bool fail(std::string message, std::string where, std::string cure)
	{
		error_ = Error{ErrorKind::InputOutput, std::move(message), std::move(where), std::move(cure), {}};
		return false;
	}

	// The line of the token just read. Tokens do not span lines; after a number the lexer has read one character more.
	std::uint32_t line()
	{
		const char* end = consumed_;
		if (end > text_.data() && is_space(end[-1]))
			--end;
		line_ += static_cast<std::uint32_t>(std::count(counted_, std::max(counted_, end), '\n'));
		counted_ = std::max(counted_, end);
		return line_;
	}

	std::uint32_t intern(const std::string& text)
	{
		const auto [entry, fresh] =
		    string_index_.try_emplace(text, static_cast<std::uint32_t>(document_.strings_.size()));
		if (fresh)
			document_.strings_.push_back(text);
		return entry->second;
	}

	// file:line and path of the value that is being read.
	std::string place()
	{
		std::string path = open_.empty() ? "$" : document_.path(open_.back().node);
		if (!open_.empty()) {
			const JsonDocument::Node& parent = document_.nodes_[open_.back().node];
			path += parent.kind == JsonValue::Kind::Object ? json_path_step(document_.strings_[key_])
			                                               : fmt::format("[{}]", parent.count);
		}
		return fmt::format("{}:{}, {}", document_.name_, line(), path);
	}

	bool add(JsonValue::Kind kind, double number = 0)
	{
		std::vector<JsonDocument::Node>& nodes = document_.nodes_;
		if (nodes.size() >= max_json_values)
			return fail(fmt::format("more than {} values", max_json_values), place(),
			            "put large sets of spheres into a binary file and name it in \"sphere_sets\"");
		JsonDocument::Node node;
		node.kind = kind;
		node.line = line();
		node.number = number;
		const auto index = static_cast<std::uint32_t>(nodes.size());
		if (!open_.empty()) {
			Open& open = open_.back();
			JsonDocument::Node& parent = nodes[open.node];
			if (parent.kind == JsonValue::Kind::Object) {
				node.key = key_;
				node.key_line = key_line_;
			}
			node.parent = open.node;
			(open.last_child == JsonDocument::none ? parent.first_child : nodes[open.last_child].next) = index;
			open.last_child = index;
			++parent.count;
		}
		nodes.push_back(node);
		return true;
	}

	bool open(JsonValue::Kind kind)
	{
		if (open_.size() >= max_json_depth)
			return fail(fmt::format("brackets nested more than {} deep", max_json_depth), place(),
			            "no scene needs more than 6 levels");
		if (!add(kind))
			return false;
		open_.push_back({static_cast<std::uint32_t>(document_.nodes_.size() - 1), JsonDocument::none});
		return true;
	}

	// Looks for a key that came twice once all are known: sorting keeps hostile objects from taking quadratic time.
	bool check_unique(std::uint32_t object)
	{
		std::vector<std::pair<std::uint32_t, std::uint32_t>> keys; // key, node
		keys.reserve(document_.nodes_[object].count);
		for (std::uint32_t i = document_.nodes_[object].first_child; i != JsonDocument::none;
		     i = document_.nodes_[i].next)
			keys.emplace_back(document_.nodes_[i].key, i);
		std::sort(keys.begin(), keys.end());
		for (std::size_t i = 1; i < keys.size(); ++i) {
			if (keys[i].first != keys[i - 1].first)
				continue;
			const JsonDocument::Node& first = document_.nodes_[keys[i - 1].second];
			const JsonDocument::Node& second = document_.nodes_[keys[i].second];
			return fail(fmt::format("duplicate key {}", in_quotes(document_.strings_[second.key])),
			            fmt::format("{}:{}, {}", document_.name_, second.key_line, document_.path(object)),
			            fmt::format("remove it or rename it: the key stands in line {} already", first.key_line));
		}
		return true;
	}

	JsonDocument& document_;
	std::string_view text_;
	const char* consumed_;
	const char* counted_; // newlines before this are in line_
	std::uint32_t line_ = 1;
	std::uint32_t key_ = 0, key_line_ = 0;
	std::vector<Open> open_;
	std::unordered_map<std::string, std::uint32_t> string_index_;
	std::optional<Error> error_;
};

Result<JsonDocument> JsonDocument::parse(std::string_view text, const std::string& name)
{
	if (text.size() > max_json_bytes)
		return Error{ErrorKind::InputOutput,
		             fmt::format("the file has {} bytes, more than the {} allowed", text.size(), max_json_bytes),
		             name,
		             "put large sets of spheres into a binary file and name it in \"sphere_sets\"",
		             {}};
	JsonDocument document;
	document.name_ = name;
	JsonBuilder builder(document, text);
	const CountingIterator begin(text.data(), builder.consumed());
	const CountingIterator end(text.data() + text.size(), builder.consumed());
	if (!nlohmann::json::sax_parse(begin, end, &builder))
		return *builder.error();
	return document;
}

std::string JsonDocument::path(std::uint32_t index) const
{
	const Node& node = nodes_[index];
	if (node.parent == none)
		return "$";
	if (node.key != none)
		return path(node.parent) + json_path_step(strings_[node.key]);
	std::size_t position = 0;
	for (std::uint32_t i = nodes_[node.parent].first_child; i != index; i = nodes_[i].next)
		++position;
	return path(node.parent) + fmt::format("[{}]", position);
}

JsonValue::Kind JsonValue::kind() const { return document_->nodes_[index_].kind; }

double JsonValue::number() const { return document_->nodes_[index_].number; }

const std::string& JsonValue::text() const { return document_->strings_[document_->nodes_[index_].count]; }

std::uint32_t JsonValue::line() const { return document_->nodes_[index_].line; }

const std::string& JsonValue::key() const { return document_->strings_[document_->nodes_[index_].key]; }

std::uint32_t JsonValue::key_line() const { return document_->nodes_[index_].key_line; }

std::string JsonValue::path() const { return document_->path(index_); }

std::size_t JsonValue::size() const { return document_->nodes_[index_].count; }

std::vector<JsonValue> JsonValue::children() const
{
	std::vector<JsonValue> result;
	result.reserve(size());
	for (std::uint32_t i = document_->nodes_[index_].first_child; i != JsonDocument::none;
	     i = document_->nodes_[i].next)
		result.push_back(JsonValue(document_, i));
	return result;
}

std::optional<JsonValue> JsonValue::find(std::string_view key) const
{
	for (std::uint32_t i = document_->nodes_[index_].first_child; i != JsonDocument::none;
	     i = document_->nodes_[i].next)
		if (document_->strings_[document_->nodes_[i].key] == key)
			return JsonValue(document_, i);
	return std::nullopt;
}

} // namespace rt
