#include "backends/traced_text.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <set>
#include <utility>

namespace rt {

namespace {

using Token = KernelToken;
using Type = KernelType::Kind;

// Functions that stay as they are: each device has its own, or there is nothing in them to note.
const std::set<std::string>& untouched_functions()
{
	static const std::set<std::string> names = {"rt_root", "rt_rcp", "rt_seed_rsqrt", "rt_seed_rcp", "v3", "v3_splat"};
	return names;
}

// What rt_compat.h gives every target, by the type of its value.
const std::map<std::string, KernelType>& compat_calls()
{
	static const KernelType real{Type::Real, "rt_float", false}, integer{Type::Int, "rt_i32", false},
	    natural{Type::Uint, "rt_u32", false};
	static const std::map<std::string, KernelType> calls = {
	    {"rt_splat", real},      {"rt_from_bits", real}, {"rt_splat_i", integer},
	    {"rt_any", integer},     {"rt_not", integer},    {"RT_HAS", integer},
	    {"rt_splat_u", natural}, {"rt_bits", natural},   {"rt_lane_ids", natural}};
	return calls;
}

struct Operator {
	int rank = 0; // binds the tighter the larger
	TraceKind kind = TraceKind::Value;
};

Operator binary_operator(const Token& token)
{
	static const std::map<std::string, Operator> operators = {
	    {"||", {1, {}}},
	    {"&&", {2, {}}},
	    {"|", {3, TraceKind::Or}},
	    {"^", {4, TraceKind::Xor}},
	    {"&", {5, TraceKind::And}},
	    {"==", {6, TraceKind::Equal}},
	    {"!=", {6, TraceKind::NotEqual}},
	    {"<", {7, TraceKind::Less}},
	    {"<=", {7, TraceKind::LessEqual}},
	    {">", {7, TraceKind::Greater}},
	    {">=", {7, TraceKind::GreaterEqual}},
	    {"<<", {8, TraceKind::ShiftLeft}},
	    {">>", {8, TraceKind::ShiftRight}},
	    {"+", {9, TraceKind::Add}},
	    {"-", {9, TraceKind::Subtract}},
	    {"*", {10, TraceKind::Multiply}},
	    {"/", {10, TraceKind::Divide}},
	    {"%", {10, TraceKind::Remainder}},
	};
	const auto found = token.kind == Token::Kind::Mark ? operators.find(token.text) : operators.end();
	return found == operators.end() ? Operator{} : found->second;
}

bool is_comparison(TraceKind kind) { return kind >= TraceKind::Less && kind <= TraceKind::NotEqual; }
bool is_shift(TraceKind kind) { return kind == TraceKind::ShiftLeft || kind == TraceKind::ShiftRight; }
bool is_wide(Type kind) { return kind == Type::Long || kind == Type::Ulong; }

KernelType scalar_type(Type kind)
{
	switch (kind) {
	case Type::Real:
		return {kind, "rt_float", false};
	case Type::Int:
		return {kind, "rt_i32", false};
	case Type::Uint:
		return {kind, "rt_u32", false};
	case Type::Long:
		return {kind, "rt_i64", false};
	case Type::Ulong:
		return {kind, "rt_u64", false};
	default:
		return {};
	}
}

// C's usual arithmetic conversions; Unknown where one side is, unless the other is a float.
KernelType common_type(const KernelType& a, const KernelType& b)
{
	if (a.kind == Type::Real || b.kind == Type::Real)
		return scalar_type(Type::Real);
	if (!a.is_scalar() || !b.is_scalar())
		return {};
	return scalar_type(std::max(a.kind, b.kind)); // Int < Uint < Long < Ulong
}

// A part of an expression after it was taken apart: text without an operation in it.
struct Value {
	std::string text;
	KernelType type;
	bool noted = false; // its last operation has a note, or it is a literal, which needs none
	std::string source;
};

// Text whose lines stay those of the file it is made from.
class LinedText {
public:
	void add(const std::string& text, unsigned line)
	{
		for (; line_ < line; ++line_)
			text_ += '\n';
		text_ += text;
		line_ += static_cast<unsigned>(std::count(text.begin(), text.end(), '\n'));
	}
	std::string take() && { return std::move(text_) + "\n"; }

private:
	std::string text_;
	unsigned line_ = 1;
};

class FileTracer {
public:
	FileTracer(const EmbeddedText& file, std::uint32_t number, const KernelDeclarations& declarations,
	           std::vector<TraceSite>& sites)
	    : path_(file.path), text_(file.text, file.bytes), file_number_(number), declarations_(declarations),
	      sites_(sites), tokens_(kernel_tokens(text_))
	{
	}

	std::string run()
	{
		while (tokens_[at_].kind != Token::Kind::End) {
			if (is_name("RT_FN") && !untouched_functions().count(function_name()))
				function();
			else if (is_name("RT_KERNEL") && tokens_[at_ + 2].text == "rt_render")
				kernel();
			else
				copy();
		}
		return std::move(out_).take();
	}

private:
	// ---- tokens ----

	const Token& token() const { return tokens_[at_]; }
	bool is(const char* mark) const { return tokens_[at_].is(mark); }
	bool is_name(const char* name) const { return tokens_[at_].kind == Token::Kind::Name && tokens_[at_].text == name; }
	bool take(const char* mark)
	{
		if (!is(mark))
			return false;
		++at_;
		return true;
	}
	void expect(const char* mark) { failed_ = !take(mark) || failed_; }

	// The file's own text of tokens [begin, end), on one line.
	std::string source(std::size_t begin, std::size_t end) const
	{
		const Token& last = tokens_[end - 1];
		std::string result;
		for (const char c : text_.substr(tokens_[begin].offset, last.offset + last.text.size() - tokens_[begin].offset))
			if (!std::isspace(static_cast<unsigned char>(c)))
				result += c;
			else if (!result.empty() && result.back() != ' ' && result.back() != '(')
				result += ' ';
		return result;
	}

	bool takes_log(const std::string& name) const
	{
		const auto function = declarations_.functions.find(name);
		return function != declarations_.functions.end() && function->second.file.rfind("kernels/", 0) == 0 &&
		       function->second.file != "kernels/trace.h" && !untouched_functions().count(name);
	}

	// One token as it stands, but for calls, which hand on the log.
	void copy()
	{
		const Token& here = token();
		if (here.kind == Token::Kind::Directive) {
			out_.add(here.text + "\n", here.line);
			++at_;
			return;
		}
		out_.add(here.text, here.line);
		++at_;
		if (here.kind == Token::Kind::Name && is("(") && takes_log(here.text) && inside_) {
			++at_;
			out_.add(is(")") ? "(rt_log" : "(rt_log, ", here.line);
			return;
		}
		out_.add(" ", here.line);
	}
	void copy_to(std::size_t end)
	{
		while (at_ < end)
			copy();
	}
	void add(const std::string& text) { out_.add(text, token().line); }
	// On the line of what was written last: the next token may be a directive, which wants a line of its own.
	void close() { out_.add("} ", 0); }

	// ---- functions ----

	std::string function_name() const
	{
		std::size_t at = at_ + 1;
		read_kernel_type(declarations_, tokens_, at);
		return tokens_[at].text;
	}

	void function()
	{
		function_ = function_name();
		while (!is("("))
			copy();
		body();
	}

	void kernel()
	{
		function_ = "rt_render";
		copy_to(at_ + 4);
		body();
	}

	// Parameters and block of a function.
	void body()
	{
		symbols_.clear();
		const std::size_t end = behind_bracket(tokens_, at_);
		add("(RT_GLOBAL rt_u64* rt_log");
		const bool none = end == at_ + 2 || (end == at_ + 3 && tokens_[at_ + 1].text == "void");
		at_ += none ? end - at_ - 1 : 1;
		if (!none)
			add(", ");
		for (std::size_t at = at_; at + 1 < end;) {
			const KernelType type = read_kernel_type(declarations_, tokens_, at);
			symbols_[tokens_[at].text] = type;
			while (at + 1 < end && !tokens_[at].is(","))
				++at;
			++at;
		}
		copy_to(end);
		inside_ = true;
		if (function_ == "rt_render" && is("{"))
			add("{ rt_log = rt_own_log(rt_log); ");
		statement();
		if (function_ == "rt_render")
			close();
		inside_ = false;
	}

	// ---- statements ----

	void block()
	{
		copy();
		while (!is("}") && token().kind != Token::Kind::End) {
			if (token().kind == Token::Kind::Directive)
				copy();
			else
				statement();
		}
		if (token().kind != Token::Kind::End)
			copy();
	}

	// A statement that must stay one where it is made of several.
	void child()
	{
		add("{ ");
		while (token().kind == Token::Kind::Directive)
			copy();
		statement();
		close();
	}

	void statement()
	{
		if (is("{"))
			return block();
		if (is_name("if"))
			return conditional();
		if (is_name("for") || is_name("while") || is_name("switch")) {
			copy();
			const std::size_t end = behind_bracket(tokens_, at_);
			for (std::size_t at = at_ + 1; at < end; ++at)
				if (std::size_t name = at; read_kernel_type(declarations_, tokens_, name).is_scalar()) {
					std::size_t begin = at;
					symbols_[tokens_[name].text] = read_kernel_type(declarations_, tokens_, begin);
					break;
				}
			copy_to(end);
			return child();
		}
		if (is_name("do")) {
			copy();
			child();
			while (!is(";"))
				copy();
			return copy();
		}
		// A macro that heads a block.
		if (token().kind == Token::Kind::Name && tokens_[at_ + 1].is("("))
			if (const std::size_t end = behind_bracket(tokens_, at_ + 1); tokens_[end].is("{")) {
				copy_to(end);
				return block();
			}
		const std::size_t begin = at_, sites = sites_.size();
		const auto numbers = numbers_;
		pre_.clear();
		failed_ = false;
		simple_statement();
		if (!failed_)
			return;
		// Not understood, or nothing to take apart: as it stands.
		at_ = begin;
		sites_.erase(sites_.begin() + static_cast<std::ptrdiff_t>(sites), sites_.end());
		numbers_ = numbers;
		while (!is(";") && !is("}") && token().kind != Token::Kind::End) {
			const std::size_t end = is("(") || is("[") || is("{") ? behind_bracket(tokens_, at_) : at_ + 1;
			copy_to(end);
			// A macro that is a statement has no semicolon behind it.
			if (tokens_[end - 1].is(")") && token().line > tokens_[end - 1].line && token().kind != Token::Kind::Mark)
				return;
		}
		if (is(";"))
			copy();
	}

	void conditional()
	{
		const unsigned line = token().line;
		const std::size_t begin = at_, sites = sites_.size();
		const auto numbers = numbers_;
		pre_.clear();
		failed_ = false;
		at_ += 2;
		const Value condition = expression();
		expect(")");
		if (failed_) {
			at_ = begin;
			sites_.erase(sites_.begin() + static_cast<std::ptrdiff_t>(sites), sites_.end());
			numbers_ = numbers;
			copy();
			copy_to(behind_bracket(tokens_, at_));
		} else {
			out_.add("{ " + pre_ + "if (" + condition.text + ") ", line);
		}
		const bool braced = !failed_; // statements below use the flag too
		child();
		if (is_name("else")) {
			copy();
			child();
		}
		if (braced)
			close();
	}

	void simple_statement()
	{
		const unsigned line = token().line;
		if (is_name("break") || is_name("continue")) {
			failed_ = true;
			return;
		}
		if (is_name("return")) {
			++at_;
			if (is(";")) {
				failed_ = true;
				return;
			}
			const Value value = expression();
			expect(";");
			if (!failed_)
				out_.add("{ " + pre_ + "return " + value.text + "; } ", line);
			return;
		}
		std::size_t at = at_;
		const KernelType type = read_kernel_type(declarations_, tokens_, at);
		if (type.kind != Type::Unknown)
			return declaration(type, at);
		assignment();
	}

	void declaration(const KernelType& type, std::size_t name)
	{
		const unsigned line = token().line;
		// All names first: also where what follows is not taken apart.
		for (std::size_t at = name; !tokens_[at].is(";") && tokens_[at].kind != Token::Kind::End;) {
			if (tokens_[at].kind == Token::Kind::Name)
				symbols_[tokens_[at].text] =
				    tokens_[at + 1].is("[") ? KernelType{Type::Pointer, type.name, false} : type;
			while (!tokens_[at].is(",") && !tokens_[at].is(";") && tokens_[at].kind != Token::Kind::End)
				at = tokens_[at].is("(") || tokens_[at].is("[") || tokens_[at].is("{") ? behind_bracket(tokens_, at)
				                                                                       : at + 1;
			at += tokens_[at].is(",") ? 1 : 0;
		}
		if (type.kind == Type::Pointer || !tokens_[name + 1].is("=")) {
			failed_ = true;
			return;
		}
		const std::string spelled = source(at_, name);
		at_ = name;
		std::string text;
		do {
			const std::string target = token().text;
			if (token().kind != Token::Kind::Name || !tokens_[at_ + 1].is("=")) {
				failed_ = true;
				return;
			}
			const unsigned place = token().line;
			at_ += 2;
			const Value value = expression();
			text += std::exchange(pre_, {}) + fmt::format("{} {} = {}; ", spelled, target, value.text);
			note_target(target, target, type, value, place);
			text += std::exchange(pre_, {});
		} while (!failed_ && take(","));
		expect(";");
		if (!failed_)
			out_.add(text, line);
	}

	void assignment()
	{
		const unsigned line = token().line;
		const std::size_t begin = at_, sites = sites_.size();
		const auto numbers = numbers_;
		const Value target = place();
		if (failed_)
			return;
		if (token().kind == Token::Kind::Mark && token().text == "=") {
			++at_;
			const Value value = expression();
			expect(";");
			pre_ += fmt::format("{} = {}; ", target.text, value.text);
			note_target(target.text, target.source, target.type, value, line);
		} else if (token().kind == Token::Kind::Mark && token().text.size() > 1 && token().text.back() == '=' &&
		           target.type.is_scalar()) {
			Token sign = token();
			sign.text.pop_back();
			const Operator operation = binary_operator(sign);
			if (!operation.rank || is_comparison(operation.kind)) {
				failed_ = true;
				return;
			}
			++at_;
			const std::size_t operand = at_;
			Value value = expression();
			value.source = at_ > operand ? source(operand, at_) : "";
			expect(";");
			const Value result = operate(operation.kind, sign, target, value, source(begin, at_ - 1));
			if (result.type.kind == Type::Unknown)
				failed_ = true;
			if (failed_)
				return;
			sites_.back().target = target.source;
			pre_ += fmt::format("{} = {}; ", target.text, result.text);
		} else { // a call for its effect
			at_ = begin;
			pre_.clear();
			sites_.erase(sites_.begin() + static_cast<std::ptrdiff_t>(sites), sites_.end());
			numbers_ = numbers;
			const Value value = expression();
			expect(";");
			if (value.type.kind != Type::Unknown && value.type.kind != Type::Void)
				pre_ += "(void)" + value.text + "; ";
			else if (!value.text.empty())
				pre_ += value.text + "; ";
		}
		if (!failed_)
			out_.add(pre_, line);
	}

	// Behind an assignment: notes of what has none yet, and the name of the target in the note that there is.
	void note_target(const std::string& text, const std::string& name, const KernelType& type, const Value& value,
	                 unsigned line)
	{
		if (failed_)
			return;
		if (value.noted && type.is_scalar()) {
			if (last_noted_ == value.text && !value.text.empty())
				sites_.back().target = name;
			return;
		}
		constexpr std::size_t most_leaves = 24;
		const auto leaves = declarations_.leaves(type);
		if (leaves.size() > most_leaves)
			return;
		for (const auto& [path, leaf] : leaves) {
			note(TraceKind::Value, line, {}, {text + path, leaf, false, {}}, value.source);
			sites_.back().target = name + path;
		}
	}

	// ---- expressions, taken apart from left to right into pre_ ----

	std::string new_name() { return fmt::format("rt_n{}", ++names_); }

	static std::string as_word(const Value& value)
	{
		if (value.type.kind == Type::Real)
			return "(rt_u64)rt_bits(" + value.text + ")";
		return (is_wide(value.type.kind) ? "(rt_u64)(" : "(rt_u64)(rt_u32)(") + value.text + ")";
	}

	void note(TraceKind kind, unsigned line, const std::vector<Value>& operands, const Value& result,
	          const std::string& text)
	{
		TraceSite site;
		site.code.kind = kind;
		// A selection's first operand is its condition, a call's may be of several kinds.
		const Value& typical = kind == TraceKind::Select || operands.empty() ? result : operands[0];
		const bool is_call = kind == TraceKind::Call || kind == TraceKind::MoreArguments;
		const auto is_other = [&typical](const Value& operand) { return operand.type.kind != typical.type.kind; };
		const bool mixed = is_call && (operands.empty() || std::any_of(operands.begin(), operands.end(), is_other));
		site.code.operand = mixed ? Type::Unknown : typical.type.kind;
		for (const Value& operand : operands)
			if (operand.type.kind == Type::Real && !is_call && kind != TraceKind::Load)
				site.code.operand = Type::Real;
		site.code.result = result.type.kind;
		site.code.file = file_number_;
		site.code.line = line;
		site.code.number = numbers_[line]++;
		site.file = path_;
		site.function = function_;
		site.source = text;
		std::string words;
		for (std::size_t i = 0; i < 3; ++i) {
			const bool there = i < operands.size();
			words += there ? as_word(operands[i]) + ", " : "0u, ";
			if (there)
				site.operands[i] = operands[i].source;
		}
		words += result.type.is_scalar() ? as_word(result) : "0u";
		pre_ += fmt::format("rt_note(rt_log, {:#x}u, {:#x}u, {}); ", site.code.what(), site.code.where(), words);
		last_noted_ = result.text;
		sites_.push_back(std::move(site));
	}

	// A name for the value of `text`, and a note of how it came about.
	Value named(TraceKind kind, unsigned line, const std::vector<Value>& operands, const KernelType& type,
	            const std::string& text, const std::string& from)
	{
		Value result{new_name(), type, true, from};
		pre_ += fmt::format("const {} {} = {}; ", type.name, result.text, text);
		note(kind, line, operands, result, from);
		return result;
	}

	Value fail()
	{
		failed_ = true;
		return {};
	}

	Value expression() { return ternary(); }

	Value ternary()
	{
		const std::size_t begin = at_;
		const Value condition = binary(1);
		if (failed_ || !is("?"))
			return condition;
		const unsigned line = token().line;
		++at_;
		return choice(condition, line, begin, ":", nullptr);
	}

	// `condition` is read, `at_` stands before the first choice; `between` and `behind` are the marks to come.
	Value choice(const Value& condition, unsigned line, std::size_t begin, const char* between, const char* behind)
	{
		const std::string before = std::exchange(pre_, {});
		const Value yes = expression();
		const std::string yes_steps = std::exchange(pre_, {});
		expect(between);
		const Value no = expression();
		const std::string no_steps = std::exchange(pre_, before);
		if (behind)
			expect(behind);
		if (failed_)
			return {};
		KernelType type = yes.type.kind == Type::Struct ? yes.type : common_type(yes.type, no.type);
		if (type.kind == Type::Unknown)
			type = yes.type.is_scalar() ? yes.type : no.type;
		if (!type.is_scalar() && type.kind != Type::Struct)
			return fail();
		Value result{new_name(), type, type.is_scalar(), source(begin, at_)};
		pre_ += fmt::format("{} {}; if ({}) {{ {}{} = {}; }} else {{ {}{} = {}; }} ", type.name, result.text,
		                    condition.text, yes_steps, result.text, yes.text, no_steps, result.text, no.text);
		Value mask = condition;
		mask.type = scalar_type(Type::Int);
		if (type.is_scalar())
			note(TraceKind::Select, line, {mask, result}, result, result.source);
		return result;
	}

	Value binary(int least_rank)
	{
		const std::size_t begin = at_;
		Value left = unary();
		for (;;) {
			const Token sign = token();
			const Operator operation = binary_operator(sign);
			if (failed_ || !operation.rank || operation.rank < least_rank)
				return left;
			++at_;
			if (operation.kind == TraceKind{}) {
				left = shortened(left, sign, operation.rank, begin);
				continue;
			}
			const Value right = binary(operation.rank + 1);
			if (failed_)
				return {};
			left = operate(operation.kind, sign, left, right, source(begin, at_));
		}
	}

	// && and ||, whose right side may not be evaluated.
	Value shortened(const Value& left, const Token& sign, int rank, std::size_t begin)
	{
		const std::string before = std::exchange(pre_, {});
		const Value right = binary(rank + 1);
		const std::string steps = std::exchange(pre_, before);
		if (failed_)
			return {};
		Value result{new_name(), scalar_type(Type::Int), false, source(begin, at_)};
		pre_ += fmt::format("rt_i32 {0} = ({1}) != 0; if ({2}{0}) {{ {3}{0} = ({4}) != 0; }} ", result.text, left.text,
		                    sign.text == "&&" ? "" : "!", steps, right.text);
		return result;
	}

	Value operate(TraceKind kind, const Token& sign, const Value& left, const Value& right, const std::string& from)
	{
		const std::string text = fmt::format("{} {} {}", left.text, sign.text, right.text);
		if (left.type.kind == Type::Pointer)
			return {"(" + text + ")", left.type, false, from};
		KernelType operands = is_shift(kind) ? left.type : common_type(left.type, right.type);
		if (operands.kind == Type::Unknown || !operands.is_scalar())
			return {"(" + text + ")", is_comparison(kind) ? scalar_type(Type::Int) : KernelType{}, false, from};
		operands = scalar_type(operands.kind);
		Value a = left, b = right;
		if (!is_shift(kind))
			a.type = b.type = operands; // as the operation sees them
		if (operands.kind == Type::Real && left.type.kind != Type::Real)
			a.text = "(rt_float)(" + a.text + ")";
		if (operands.kind == Type::Real && right.type.kind != Type::Real)
			b.text = "(rt_float)(" + b.text + ")";
		if (is_wide(operands.kind) && !is_wide(left.type.kind))
			a.text = fmt::format("({})({})", operands.name, a.text);
		if (is_wide(operands.kind) && !is_wide(right.type.kind))
			b.text = fmt::format("({})({})", operands.name, b.text);
		return named(kind, sign.line, {a, b}, is_comparison(kind) ? scalar_type(Type::Int) : operands, text, from);
	}

	Value unary()
	{
		const std::size_t begin = at_;
		if (is("-") || is("!") || is("~")) {
			const std::string sign = token().text;
			++at_;
			Value value = unary();
			if (failed_)
				return {};
			value.text = "(" + sign + value.text + ")";
			value.source = source(begin, at_);
			if (sign == "!")
				value.type = scalar_type(Type::Int);
			return value;
		}
		if (is("&")) {
			++at_;
			Value value = place();
			value.text = "&" + value.text;
			value.type = {Type::Pointer, value.type.name, false};
			return value;
		}
		if (is("("))
			if (std::size_t at = at_ + 1;
			    read_kernel_type(declarations_, tokens_, at).kind != Type::Unknown && tokens_[at].is(")"))
				return cast();
		if (is("*") || (token().kind != Token::Kind::Name && token().kind != Token::Kind::Number && !is("(")))
			return read(place());
		return read(postfix());
	}

	Value cast()
	{
		const std::size_t begin = at_;
		const unsigned line = token().line;
		++at_;
		const KernelType type = read_kernel_type(declarations_, tokens_, at_);
		++at_;
		Value value = unary();
		if (failed_ || !type.is_scalar())
			return fail();
		const std::string text = fmt::format("({})({})", type.name, value.text);
		const bool same_size = value.type.is_integer() && is_wide(value.type.kind) == is_wide(type.kind);
		if (!value.type.is_scalar() || same_size || value.type.kind == type.kind)
			return {"(" + text + ")", type, value.noted, source(begin, at_)};
		return named(TraceKind::Convert, line, {value}, type, text, source(begin, at_));
	}

	// A chain of members and indices, not yet read.
	struct Chain {
		Value value;
		bool load = false;
		std::vector<Value> index;
		unsigned line = 0;
		std::size_t begin = 0;
	};

	// Reading device memory is an operation.
	Value read(const Chain& chain)
	{
		if (failed_ || !chain.load || !chain.value.type.is_scalar())
			return chain.value;
		return named(TraceKind::Load, chain.line, chain.index, scalar_type(chain.value.type.kind), chain.value.text,
		             source(chain.begin, at_));
	}
	static Value read(const Value& value) { return value; }

	// What can be assigned to.
	Value place()
	{
		const std::size_t begin = at_;
		if (take("*")) {
			Value value = postfix().value;
			value.type = declarations_.target_of(value.type);
			value.text = "(*" + value.text + ")";
			value.source = at_ > begin ? source(begin, at_) : "";
			return value;
		}
		if (token().kind != Token::Kind::Name)
			return fail();
		Value value = postfix().value;
		value.source = at_ > begin ? source(begin, at_) : "";
		return value;
	}

	Chain postfix()
	{
		Chain chain;
		chain.begin = at_;
		chain.line = token().line;
		chain.value = primary();
		while (!failed_) {
			if (is(".") || is("->")) {
				const bool through_pointer = is("->");
				KernelType type = chain.value.type;
				if (through_pointer) {
					chain.load = chain.load || type.in_memory;
					type = declarations_.target_of(type);
				}
				chain.value.text += token().text + tokens_[at_ + 1].text;
				chain.value.type = declarations_.member_of(type, tokens_[at_ + 1].text);
				chain.value.noted = false;
				at_ += 2;
			} else if (is("[")) {
				++at_;
				const Value index = expression();
				expect("]");
				chain.load = chain.load || chain.value.type.in_memory;
				chain.value.text += "[" + index.text + "]";
				chain.value.type = declarations_.target_of(chain.value.type);
				chain.value.noted = false;
				if (index.type.is_scalar())
					chain.index = {index};
			} else if (is("++") || is("--")) {
				failed_ = true;
			} else {
				break;
			}
		}
		chain.value.source = at_ > chain.begin ? source(chain.begin, at_) : "";
		return chain;
	}

	Value primary()
	{
		const Token here = token();
		if (take("(")) {
			const Value value = expression();
			expect(")");
			return value;
		}
		if (here.kind == Token::Kind::Number) {
			++at_;
			return {here.text, literal_type(here.text), true, here.text};
		}
		if (here.kind != Token::Kind::Name || here.text == "sizeof")
			return fail();
		if (tokens_[at_ + 1].is("("))
			return call();
		++at_;
		Value value;
		value.text = value.source = here.text;
		if (const auto symbol = symbols_.find(here.text); symbol != symbols_.end()) {
			value.type = symbol->second;
		} else if (const auto constant = declarations_.constants.find(here.text);
		           constant != declarations_.constants.end()) {
			value.type = constant->second;
			value.noted = true;
		} else if (const auto table = declarations_.tables.find(here.text); table != declarations_.tables.end()) {
			value.type = table->second;
		} else if (here.text == "RT_TRUE" || here.text == "RT_FALSE") {
			value.type = scalar_type(Type::Int);
			value.noted = true;
		} else if (here.text == "RT_GLOBAL_ID") {
			value.type = scalar_type(Type::Uint);
			value.noted = true;
		}
		return value;
	}

	static KernelType literal_type(const std::string& text)
	{
		const bool hex = text.size() > 1 && text[1] == 'x';
		const bool real = text.find('.') != std::string::npos || text.find(hex ? 'p' : 'e') != std::string::npos;
		return scalar_type(real ? Type::Real : text.back() == 'u' ? Type::Uint : Type::Int);
	}

	Value call()
	{
		const std::size_t begin = at_;
		const Token name = token();
		const std::size_t end = behind_bracket(tokens_, at_ + 1);
		if (name.text == "RT_GATHER_F" || name.text == "RT_GATHER_U")
			return gather(end);
		const auto function = declarations_.functions.find(name.text);
		const auto compat = compat_calls().find(name.text);
		const bool known = function != declarations_.functions.end() || compat != compat_calls().end() ||
		                   name.text == "rt_sel" || name.text == "rt_fma" || name.text == "rt_to_float" ||
		                   name.text == "rt_to_int" || name.text == "rt_to_uint";
		if (!known) { // a macro, whose arguments need not be expressions
			at_ = end;
			return {source(begin, end), {}, false, source(begin, end)};
		}
		at_ += 2;
		if (name.text == "rt_sel") {
			const Value condition = expression();
			expect(",");
			return choice(condition, name.line, begin, ",", ")");
		}
		std::vector<Value> arguments;
		while (!failed_ && at_ + 1 < end) {
			arguments.push_back(expression());
			if (at_ + 1 < end)
				expect(",");
		}
		expect(")");
		if (failed_ || at_ != end)
			return fail();
		return called(name, arguments, source(begin, end));
	}

	Value called(const Token& name, const std::vector<Value>& arguments, const std::string& from)
	{
		std::string list;
		bool all_noted = true;
		for (const Value& argument : arguments) {
			list += (list.empty() ? "" : ", ") + argument.text;
			all_noted = all_noted && argument.noted;
		}
		const std::string text = name.text + "(" + list + ")";
		if (name.text == "rt_fma")
			return named(TraceKind::Fma, name.line, as_reals(arguments), scalar_type(Type::Real), text, from);
		if (name.text == "rt_root" || name.text == "rt_rcp")
			return named(name.text == "rt_root" ? TraceKind::Root : TraceKind::Reciprocal, name.line,
			             as_reals(arguments), scalar_type(Type::Real), text, from);
		if (name.text == "rt_to_float" ||
		    ((name.text == "rt_to_int" || name.text == "rt_to_uint") && arguments[0].type.kind == Type::Real))
			return named(TraceKind::Convert, name.line, arguments,
			             scalar_type(name.text == "rt_to_float" ? Type::Real
			                         : name.text == "rt_to_int" ? Type::Int
			                                                    : Type::Uint),
			             text, from);
		if (name.text == "rt_to_int" || name.text == "rt_to_uint")
			// Between integers no bit changes, but the name that it is assigned to wants its note.
			return {text, scalar_type(name.text == "rt_to_int" ? Type::Int : Type::Uint), false, from};
		if (const auto compat = compat_calls().find(name.text); compat != compat_calls().end())
			return {text, compat->second, all_noted, from};

		const KernelFunction& function = declarations_.functions.at(name.text);
		if (!takes_log(name.text)) {
			if (function.result.kind != Type::Struct)
				return {text, function.result, all_noted && function.result.is_scalar(), from};
			Value made{new_name(), function.result, false, from};
			pre_ += fmt::format("const {} {} = {}; ", function.result.name, made.text, text);
			return made;
		}
		note_arguments(name, arguments, from);
		const std::string with_log = name.text + "(rt_log" + (list.empty() ? "" : ", ") + list + ")";
		if (function.result.kind == Type::Void) {
			pre_ += with_log + "; ";
			return {{}, function.result, true, from};
		}
		if (!function.result.is_scalar() && function.result.kind != Type::Struct)
			return {with_log, function.result, false, from};
		Value result{new_name(), function.result, false, from};
		pre_ += fmt::format("const {} {} = {}; ", function.result.name, result.text, with_log);
		return result;
	}

	static std::vector<Value> as_reals(std::vector<Value> values)
	{
		for (Value& value : values)
			value.type = scalar_type(Type::Real);
		return values;
	}

	// Scalars and vectors; larger structs were noted where they were made.
	void note_arguments(const Token& name, const std::vector<Value>& arguments, const std::string& from)
	{
		constexpr std::size_t most_leaves = 4;
		std::vector<Value> scalars;
		for (const Value& argument : arguments) {
			const auto leaves = declarations_.leaves(argument.type);
			if (leaves.size() <= most_leaves)
				for (const auto& [path, type] : leaves)
					scalars.push_back({argument.text + path, type, false, argument.source + path});
		}
		std::size_t next = 0;
		do {
			std::vector<Value> some;
			for (; next < scalars.size() && some.size() < 3; ++next)
				some.push_back(scalars[next]);
			note(next <= 3 ? TraceKind::Call : TraceKind::MoreArguments, name.line, some, {}, from);
			sites_.back().target = name.text;
		} while (next < scalars.size());
	}

	// RT_GATHER_F(array, index, .member): the last argument is no expression.
	Value gather(std::size_t end)
	{
		const std::size_t begin = at_;
		const Token name = token();
		at_ += 2;
		const Value array = place();
		expect(",");
		const Value index = expression();
		expect(",");
		if (failed_ || at_ >= end)
			return fail();
		std::string member;
		for (; at_ + 1 < end; ++at_)
			member += token().text;
		++at_;
		const std::string text = fmt::format("{}({}, {}, {})", name.text, array.text, index.text, member);
		return named(TraceKind::Load, name.line, {index},
		             scalar_type(name.text == "RT_GATHER_F" ? Type::Real : Type::Uint), text, source(begin, end));
	}

	std::string path_;
	std::string_view text_;
	std::uint32_t file_number_;
	const KernelDeclarations& declarations_;
	std::vector<TraceSite>& sites_;
	std::vector<Token> tokens_;
	std::size_t at_ = 0;
	LinedText out_;
	std::string function_;
	std::map<std::string, KernelType> symbols_;
	std::map<unsigned, std::uint32_t> numbers_; // notes so far, by line
	std::string pre_, last_noted_;
	unsigned names_ = 0;
	bool inside_ = false, failed_ = false;
};

} // namespace

const char* name_of(TraceKind kind)
{
	static const char* const names[] = {"",
	                                    "value",
	                                    "read",
	                                    "call",
	                                    "call",
	                                    "addition",
	                                    "subtraction",
	                                    "multiplication",
	                                    "division",
	                                    "remainder",
	                                    "shift left",
	                                    "shift right",
	                                    "and",
	                                    "or",
	                                    "exclusive or",
	                                    "comparison <",
	                                    "comparison <=",
	                                    "comparison >",
	                                    "comparison >=",
	                                    "comparison ==",
	                                    "comparison !=",
	                                    "fma",
	                                    "square root",
	                                    "reciprocal",
	                                    "selection",
	                                    "conversion"};
	const auto index = static_cast<std::size_t>(kind);
	return index < sizeof names / sizeof names[0] ? names[index] : "unknown operation";
}

std::uint32_t TraceCode::what() const
{
	return static_cast<std::uint32_t>(kind) | static_cast<std::uint32_t>(operand) << 8 |
	       static_cast<std::uint32_t>(result) << 12 | file << 16;
}

std::uint32_t TraceCode::where() const { return line << 10 | (number & 1023u); }

TraceCode TraceCode::from(std::uint32_t what, std::uint32_t where)
{
	TraceCode code;
	code.kind = static_cast<TraceKind>(what & 255u);
	code.operand = static_cast<KernelType::Kind>(what >> 8 & 15u);
	code.result = static_cast<KernelType::Kind>(what >> 12 & 15u);
	code.file = what >> 16;
	code.line = where >> 10;
	code.number = where & 1023u;
	return code;
}

TracedText trace_kernels(const std::vector<EmbeddedText>& files)
{
	const KernelDeclarations declarations = kernel_declarations(files);
	TracedText result;
	for (std::uint32_t i = 0; i < files.size(); ++i) {
		const std::string path = files[i].path;
		const bool traced = path.rfind("kernels/", 0) == 0 && path != "kernels/trace.h" && path != "kernels/probe.cl";
		result.files.push_back(traced ? FileTracer(files[i], i, declarations, result.sites).run()
		                              : std::string(files[i].text, files[i].bytes));
	}
	return result;
}

} // namespace rt
