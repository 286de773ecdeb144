// json_document.h: a JSON text as a tree that remembers where everything stood.
//
// nlohmann-json reads the text; this keeps what its own tree forgets and an error message needs: the line of every
// value and key, the path from the root, and which keys came twice. Numbers are doubles (nearest, ties to even; -0 is
// read as 0). The limits below bound memory and stack whatever the text holds.
#pragma once

#include "support/result.h"

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace rt {

constexpr std::uint64_t max_json_bytes = std::uint64_t(256) << 20;
constexpr std::uint32_t max_json_values = std::uint32_t(1) << 24;
constexpr std::uint32_t max_json_depth = 64;

class JsonDocument;

// A value of a document: a handle, valid as long as the document.
class JsonValue {
public:
	enum class Kind : std::uint8_t { Null, Boolean, Number, String, Array, Object };

	Kind kind() const;
	bool is_array() const { return kind() == Kind::Array; }
	bool is_object() const { return kind() == Kind::Object; }
	double number() const;           // of a Number
	const std::string& text() const; // of a String
	std::uint32_t line() const;      // of its last character if it is a scalar, of its opening bracket if not
	const std::string& key() const;  // its name, if it is a member of an object
	std::uint32_t key_line() const;
	std::string path() const; // $.materials.steel.albedo[1]

	std::size_t size() const; // of an Array or Object
	std::vector<JsonValue> children() const;
	std::optional<JsonValue> find(std::string_view key) const; // a member of an Object

private:
	friend class JsonDocument;
	JsonValue(const JsonDocument* document, std::uint32_t index) : document_(document), index_(index) {}
	const JsonDocument* document_;
	std::uint32_t index_;
};

class JsonDocument {
public:
	// `name` is the file's name in messages. Errors (InputOutput): text that is not JSON, duplicate keys, numbers that
	// no double can hold, a limit above.
	static Result<JsonDocument> parse(std::string_view text, const std::string& name);

	JsonValue root() const { return JsonValue(this, 0); }
	const std::string& name() const { return name_; }

private:
	friend class JsonValue;
	friend class JsonBuilder;

	static constexpr std::uint32_t none = UINT32_MAX;
	struct Node {
		JsonValue::Kind kind = JsonValue::Kind::Null;
		std::uint32_t line = 0;
		std::uint32_t key = none; // index into strings_
		std::uint32_t key_line = 0;
		std::uint32_t parent = none;
		std::uint32_t first_child = none;
		std::uint32_t next = none;
		std::uint32_t count = 0; // children; or a String's index into strings_
		double number = 0;
	};

	std::string path(std::uint32_t index) const;

	std::string name_;
	std::vector<Node> nodes_;
	std::vector<std::string> strings_; // each text once
};

// A path's last step: `.key`, `["odd key"]`.
std::string json_path_step(const std::string& key);

} // namespace rt
