// kernel_syntax.h: the kernels' language as tokens, declarations and types: as much of C as kernels/ uses.
//
// For rewriting kernels, not for judging them: what is not understood has type Unknown, and whoever rewrites leaves it
// as it stands. tools/lint_kernels.py is the judge.
#pragma once

#include "backends/embedded_text.h"

#include <cstddef>
#include <map>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace rt {

struct KernelToken {
	enum class Kind { Name, Number, Text, Mark, Directive, End };
	Kind kind = Kind::End;
	std::string text; // of a directive: the whole of it, continuation lines and all
	unsigned line = 0;
	std::size_t offset = 0; // in the file
	bool is(const char* mark) const { return kind == Kind::Mark && text == mark; }
};

// Comments are left out; the last token is an End.
std::vector<KernelToken> kernel_tokens(std::string_view text);

struct KernelType {
	enum class Kind { Unknown, Void, Real, Int, Uint, Long, Ulong, Struct, Pointer };
	Kind kind = Kind::Unknown;
	std::string name;       // as it is declared; of a pointer: what it points to
	bool in_memory = false; // a pointer to device memory or a table: reading through it is a load
	bool is_scalar() const { return kind >= Kind::Real && kind <= Kind::Ulong; }
	bool is_integer() const { return kind >= Kind::Int && kind <= Kind::Ulong; }
};

struct KernelMember {
	std::string name;
	KernelType type;
	bool is_array = false;
};

struct KernelFunction {
	KernelType result;
	std::vector<KernelType> parameters;
	std::string file;
	unsigned line = 0;
};

// What a set of files declares.
struct KernelDeclarations {
	std::map<std::string, std::vector<KernelMember>> structs;
	std::map<std::string, KernelFunction> functions; // RT_FN
	std::map<std::string, KernelType> constants;     // object-like macros that are one literal
	std::map<std::string, KernelType> tables;        // RT_TABLE arrays

	KernelType type_named(const std::string& name) const;
	// What a pointer points to, or an array's element.
	KernelType target_of(const KernelType& pointer) const;
	KernelType member_of(const KernelType& type, const std::string& member) const;
	// The scalars that a value is made of: (".x", Real), ... or ("", Real) for a scalar; none for what has no value.
	std::vector<std::pair<std::string, KernelType>> leaves(const KernelType& type) const;
};

KernelDeclarations kernel_declarations(const std::vector<EmbeddedText>& files);

// Reads a type with its qualifiers and stars at tokens[at]; Unknown, and `at` as it was, if there is none.
KernelType read_kernel_type(const KernelDeclarations& declarations, const std::vector<KernelToken>& tokens,
                            std::size_t& at);
// The index behind the bracket that closes the one at `open`; the End token's if there is none.
std::size_t behind_bracket(const std::vector<KernelToken>& tokens, std::size_t open);

} // namespace rt
