// json_reader.h: reading values of known shape out of a JsonDocument.
//
// The first error sticks: every function goes on returning something harmless after it, so that a grammar reads as a
// list of its parts; whoever asked for the whole looks at error() once, at the end.
#pragma once

#include "render/json_document.h"
#include "render/scene_ranges.h"

#include <optional>
#include <string>
#include <vector>

namespace rt {

class JsonReader {
public:
	explicit JsonReader(const JsonDocument& document) : document_(document) {}

	bool failed() const { return error_.has_value(); }
	const Error& error() const { return *error_; }
	std::string where(JsonValue at) const; // file:line, $.path
	void fail(JsonValue at, std::string message, std::string cure);
	void fail(Error error);

	// An object with no keys but these.
	bool object(JsonValue value, const std::vector<std::string>& keys);
	bool object_of_any(JsonValue value); // whatever its keys
	bool array(JsonValue value, const char* of_what);

	// A member that must be there; otherwise the object is at fault.
	std::optional<JsonValue> member(JsonValue object, const char* key);

	double number(JsonValue value, const NumberRange& range);
	double number(JsonValue object, const char* key, const NumberRange& range);
	double number(JsonValue object, const char* key, const NumberRange& range, double fallback);
	std::uint32_t integer(JsonValue object, const char* key, const NumberRange& range, std::uint32_t fallback);
	Vec3d vec3(JsonValue value, const NumberRange& range);
	Vec3d vec3(JsonValue object, const char* key, const NumberRange& range);
	Vec3d vec3(JsonValue object, const char* key, const NumberRange& range, const Vec3d& fallback);
	std::string text(JsonValue value);
	std::string text(JsonValue object, const char* key);

	// The member `key`, which must be one of `choices`: its index there.
	std::size_t choice(JsonValue object, const char* key, const std::vector<std::string>& choices);

private:
	bool expect(JsonValue value, JsonValue::Kind kind, const char* wanted);

	const JsonDocument& document_;
	std::optional<Error> error_;
};

} // namespace rt
