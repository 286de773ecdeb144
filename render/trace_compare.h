// trace_compare.h: the first operation in which two traces differ, and what the contract says of it.
#pragma once

#include "render/trace.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace rt {

// The result that the contract prescribes: computed on the host by correct rounding, from the operands alone. Nothing
// for what is no operation (a read, a call).
std::optional<std::uint64_t> correct_result(const TraceNote& note);

// Where in its path a note stands; follows the notes one by one.
class TracePosition {
public:
	void see(const TraceNote& note);

	std::uint32_t sample() const { return starts_ > 0 ? starts_ - 1 : 0; } // of the launch
	std::uint32_t bounce() const { return bounce_; }                       // 0: the camera's ray and what it meets
	// Innermost first: "rt_root in rt_sqrt, kernels/math.h:87", ...
	std::vector<std::string> stack() const;

private:
	struct Frame {
		std::string function, called_from;
	};
	std::vector<Frame> frames_;
	std::uint32_t starts_ = 0, bounce_ = 0;
};

enum class Difference {
	Result,    // same operation, same operands, another result
	Operands,  // the same operation gets other operands, though all that was computed before agrees
	Operation, // another operation, or one more or less
};

struct TraceDifference {
	Difference kind = Difference::Result;
	std::uint64_t index = 0;              // of the note
	TraceNote expected, got;              // by the trace compared against, and by the one that is judged
	std::optional<std::uint64_t> correct; // of `expected`
	std::uint32_t sample = 0, bounce = 0;
	std::vector<std::string> stack;
	// All notes of the line in both traces: what the compiler or the program made of it.
	std::vector<TraceNote> expected_line, got_line;
};

// Compares traces window by window, in order.
class TraceComparison {
public:
	// Both must begin where the last window ended. True while there is no difference.
	bool compare(const Trace& judged, const Trace& against);
	const std::optional<TraceDifference>& difference() const { return difference_; }
	std::uint64_t compared() const { return compared_; }

private:
	bool excused(const TraceNote& judged, const TraceNote& against);
	void found(const Trace& judged, const Trace& against, std::size_t at);

	TracePosition position_;
	std::optional<TraceDifference> difference_;
	std::uint64_t compared_ = 0;
	// Values that the contract leaves open, and that the kernels must select away: a reciprocal or root out of range.
	std::vector<std::pair<std::uint64_t, std::uint64_t>> open_;
};

} // namespace rt
