#include "render/json_reader.h"

#include "render/closest_match.h"

#include <fmt/format.h>

#include <algorithm>

namespace rt {

namespace {

const char* kind_name(JsonValue::Kind kind)
{
	switch (kind) {
	case JsonValue::Kind::Null:
		return "null";
	case JsonValue::Kind::Boolean:
		return "true or false";
	case JsonValue::Kind::Number:
		return "a number";
	case JsonValue::Kind::String:
		return "a string";
	case JsonValue::Kind::Array:
		return "a list";
	case JsonValue::Kind::Object:
		return "an object";
	}
	return "something else";
}

} // namespace

std::string JsonReader::where(JsonValue at) const
{
	return fmt::format("{}:{}, {}", document_.name(), at.line(), at.path());
}

void JsonReader::fail(JsonValue at, std::string message, std::string cure)
{
	if (!failed())
		fail(Error{ErrorKind::InputOutput, std::move(message), where(at), std::move(cure), {}});
}

void JsonReader::fail(Error error)
{
	if (!failed())
		error_ = std::move(error);
}

bool JsonReader::expect(JsonValue value, JsonValue::Kind kind, const char* wanted)
{
	if (value.kind() == kind)
		return !failed();
	fail(value, fmt::format("expected {}, found {}", wanted, kind_name(value.kind())),
	     fmt::format("put {} here", wanted));
	return false;
}

bool JsonReader::object(JsonValue value, const std::vector<std::string>& keys)
{
	if (!object_of_any(value))
		return false;
	for (const JsonValue child : value.children()) {
		if (std::find(keys.begin(), keys.end(), child.key()) != keys.end())
			continue;
		fail(Error{ErrorKind::InputOutput,
		           fmt::format("unknown key {}", in_quotes(child.key())),
		           fmt::format("{}:{}, {}", document_.name(), child.key_line(), value.path()),
		           name_cure(child.key(), "keys allowed here", keys),
		           {}});
		return false;
	}
	return true;
}

bool JsonReader::object_of_any(JsonValue value) { return expect(value, JsonValue::Kind::Object, "an object"); }

bool JsonReader::array(JsonValue value, const char* of_what) { return expect(value, JsonValue::Kind::Array, of_what); }

std::optional<JsonValue> JsonReader::member(JsonValue object, const char* key)
{
	std::optional<JsonValue> value = object.find(key);
	if (!value)
		fail(object, fmt::format("the key \"{}\" is missing", key), fmt::format("add \"{}\" to this object", key));
	return value;
}

double JsonReader::number(JsonValue value, const NumberRange& range)
{
	if (!expect(value, JsonValue::Kind::Number, "a number"))
		return range.least;
	if (range.contains(value.number()))
		return value.number();
	fail(value, fmt::format("{} is out of range", value.number()), fmt::format("write {}", range.describe()));
	return range.least;
}

double JsonReader::number(JsonValue object, const char* key, const NumberRange& range)
{
	const std::optional<JsonValue> value = member(object, key);
	return value ? number(*value, range) : range.least;
}

double JsonReader::number(JsonValue object, const char* key, const NumberRange& range, double fallback)
{
	const std::optional<JsonValue> value = object.find(key);
	return value ? number(*value, range) : fallback;
}

std::uint32_t JsonReader::integer(JsonValue object, const char* key, const NumberRange& range, std::uint32_t fallback)
{
	return static_cast<std::uint32_t>(number(object, key, range, fallback));
}

Vec3d JsonReader::vec3(JsonValue value, const NumberRange& range)
{
	Vec3d result{};
	if (!expect(value, JsonValue::Kind::Array, "a list of 3 numbers"))
		return result;
	const std::vector<JsonValue> parts = value.children();
	if (parts.size() != 3) {
		fail(value, fmt::format("expected a list of 3 numbers, found {}", parts.size()),
		     "write [x, y, z] or [r, g, b]");
		return result;
	}
	for (std::size_t i = 0; i < 3; ++i)
		result[i] = number(parts[i], range);
	return result;
}

Vec3d JsonReader::vec3(JsonValue object, const char* key, const NumberRange& range)
{
	const std::optional<JsonValue> value = member(object, key);
	return value ? vec3(*value, range) : Vec3d{};
}

Vec3d JsonReader::vec3(JsonValue object, const char* key, const NumberRange& range, const Vec3d& fallback)
{
	const std::optional<JsonValue> value = object.find(key);
	return value ? vec3(*value, range) : fallback;
}

std::string JsonReader::text(JsonValue value)
{
	return expect(value, JsonValue::Kind::String, "a string") ? value.text() : std::string();
}

std::string JsonReader::text(JsonValue object, const char* key)
{
	const std::optional<JsonValue> value = member(object, key);
	return value ? text(*value) : std::string();
}

std::size_t JsonReader::choice(JsonValue object, const char* key, const std::vector<std::string>& choices)
{
	const std::optional<JsonValue> value = member(object, key);
	if (!value)
		return 0;
	const std::string chosen = text(*value);
	const auto found = std::find(choices.begin(), choices.end(), chosen);
	if (found != choices.end())
		return static_cast<std::size_t>(found - choices.begin());
	fail(*value, fmt::format("unknown {} {}", key, in_quotes(chosen)), name_cure(chosen, "choices", choices));
	return 0;
}

} // namespace rt
