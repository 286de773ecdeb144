// result.h: how every function below tools/ reports failure.
//
// A function that can fail returns Result<T> (or Status, when success carries nothing). Nothing below
// tools/ prints, exits or throws across a boundary; the command line prints one Error and turns its kind
// into the exit status.
#pragma once

#include <string>
#include <utility>
#include <variant>

namespace rt {

// The kinds are the documented exit statuses of `rt`; tools/ returns them as they stand.
enum class ErrorKind {
	Failure = 1,     // anything without a kind of its own
	Usage = 2,       // the command line or a scene asks for something that cannot be
	NoDevice = 3,    // no usable device or driver, or an ambiguous one
	SelfTest = 4,    // a device does not keep the contract
	Build = 5,       // a kernel did not compile
	Memory = 6,      // host or device memory does not suffice
	InputOutput = 7, // a file could not be read, understood or written
	Interrupted = 130,
};

// An error has three parts for the user: what happened, where, and what to do.
struct Error {
	ErrorKind kind = ErrorKind::Failure;
	std::string message; // what happened, one sentence without a full stop
	std::string where;   // file:line, JSON path, device or operation; may be empty
	std::string cure;    // what to do about it; may be empty
	std::string log;     // a compiler's or driver's own words; may be empty, may have many lines
};

struct Nothing {};

template <class T>
class [[nodiscard]] Result {
public:
	Result(T value) : state_(std::in_place_index<0>, std::move(value)) {}
	Result(Error error) : state_(std::in_place_index<1>, std::move(error)) {}

	explicit operator bool() const { return state_.index() == 0; }
	// Only after checking: value() of a failure and error() of a success are bugs of ours.
	T& value() & { return *std::get_if<0>(&state_); }
	const T& value() const& { return *std::get_if<0>(&state_); }
	T&& value() && { return std::move(*std::get_if<0>(&state_)); }
	const Error& error() const { return *std::get_if<1>(&state_); }
	T* operator->() { return std::get_if<0>(&state_); }
	const T* operator->() const { return std::get_if<0>(&state_); }
	T& operator*() { return value(); }
	const T& operator*() const { return value(); }

private:
	std::variant<T, Error> state_;
};

using Status = Result<Nothing>;
inline Status success() { return Status(Nothing{}); }

} // namespace rt

#define RT_JOIN_NAMES_(a, b) a##b
#define RT_JOIN_NAMES(a, b) RT_JOIN_NAMES_(a, b)

// RT_TRY(expression): returns the error of a Status or Result, otherwise goes on.
#define RT_TRY(expression)                                     \
	do {                                                       \
		if (auto rt_try_result = (expression); !rt_try_result) \
			return rt_try_result.error();                      \
	} while (false)

// RT_TRY_ASSIGN(auto x, expression): returns the error, or moves the value into the declaration.
#define RT_TRY_ASSIGN(declaration, expression) RT_TRY_ASSIGN_(RT_JOIN_NAMES(rt_try_, __LINE__), declaration, expression)
#define RT_TRY_ASSIGN_(temporary, declaration, expression) \
	auto temporary = (expression);                         \
	if (!temporary)                                        \
		return temporary.error();                          \
	declaration = std::move(temporary).value()
