// traced_text.h: kernels that write down what they compute.
//
// A traced program is made from the kernels' own text: every function gets the log as one more parameter, every
// expression is taken apart into its operations, and behind each stands a note of its operands and its result
// (kernels/trace.h). So the kernels need no word about tracing, every operation is seen, and a program that a fault was
// planted in (ProgramSpec::edits) is traced with its fault.
//
// Left whole: the square root, the reciprocal and their seeds, which devices compute each in its own way; constructors
// of vectors; conditions of loops.
//
// A note says where it stands by file, line and its number among the notes of that line, and what it notes, so that two
// logs can be compared even if their programs differ.
#pragma once

#include "backends/embedded_text.h"
#include "backends/kernel_syntax.h"

#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace rt {

enum class TraceKind : std::uint8_t {
	Value = 1, // a variable or a member gets this value, which no operation noted before
	Load,      // read from the scene or a table; first operand: index
	Call,      // of a function; operands: its first arguments
	MoreArguments,
	Add,
	Subtract,
	Multiply,
	Divide,
	Remainder,
	ShiftLeft,
	ShiftRight,
	And,
	Or,
	Xor,
	Less,
	LessEqual,
	Greater,
	GreaterEqual,
	Equal,
	NotEqual,
	Fma,
	Root,
	Reciprocal,
	Select,  // operands: condition, chosen value
	Convert, // between int and float, or 32 and 64 bits
};

// "fma", "comparison <", ...
const char* name_of(TraceKind kind);

// A note's first two words as rt_note() gets them.
struct TraceCode {
	TraceKind kind = TraceKind::Value;
	KernelType::Kind operand = KernelType::Kind::Unknown, result = KernelType::Kind::Unknown;
	std::uint32_t file = 0, line = 0, number = 0;

	std::uint32_t what() const;
	std::uint32_t where() const;
	static TraceCode from(std::uint32_t what, std::uint32_t where);
};

struct TraceSite {
	TraceCode code;
	std::string file, function;
	std::string source;                  // "rt_fma(f.b, f.b, -c)"
	std::array<std::string, 3> operands; // their sources
	std::string target;                  // the variable that gets the result; empty inside of an expression
};

struct TracedText {
	std::vector<std::string> files; // in the order of the files given
	std::vector<TraceSite> sites;
};

// Rewrites what lies in kernels/; other files stay as they are.
TracedText trace_kernels(const std::vector<EmbeddedText>& files);

} // namespace rt
