#include "backends/kernel_syntax.h"

#include <algorithm>
#include <cctype>
#include <cstring>

namespace rt {

namespace {

using Kind = KernelToken::Kind;

bool starts_name(char c) { return std::isalpha(static_cast<unsigned char>(c)) || c == '_'; }
bool continues_name(char c) { return std::isalnum(static_cast<unsigned char>(c)) || c == '_'; }

class Lexer {
public:
	explicit Lexer(std::string_view text) : text_(text) {}

	std::vector<KernelToken> run()
	{
		bool line_start = true;
		while (at_ < text_.size()) {
			const char c = text_[at_];
			if (c == '\n') {
				++line_;
				++at_;
				line_start = true;
			} else if (std::isspace(static_cast<unsigned char>(c))) {
				++at_;
			} else if (starts("//")) {
				at_ = std::min(text_.find('\n', at_), text_.size());
			} else if (starts("/*")) {
				skip_comment();
			} else if (c == '#' && line_start) {
				directive();
			} else {
				line_start = false;
				token(c);
			}
		}
		tokens_.push_back({Kind::End, {}, line_, text_.size()});
		return std::move(tokens_);
	}

private:
	bool starts(std::string_view what) const { return text_.substr(at_, what.size()) == what; }

	void skip_comment()
	{
		const std::size_t close = text_.find("*/", at_ + 2);
		const std::size_t end = close == std::string_view::npos ? text_.size() : close + 2;
		line_ += static_cast<unsigned>(std::count(text_.begin() + static_cast<std::ptrdiff_t>(at_),
		                                          text_.begin() + static_cast<std::ptrdiff_t>(end), '\n'));
		at_ = end;
	}

	void add(Kind kind, std::size_t bytes)
	{
		tokens_.push_back({kind, std::string(text_.substr(at_, bytes)), line_, at_});
		at_ += bytes;
	}

	// To the end of its line, where no backslash continues it and no comment hides it.
	void directive()
	{
		const std::size_t begin = at_;
		const unsigned first_line = line_;
		while (at_ < text_.size() && text_[at_] != '\n') {
			if (starts("\\\n")) {
				++line_;
				at_ += 2;
			} else if (starts("/*")) {
				skip_comment();
			} else {
				++at_;
			}
		}
		tokens_.push_back({Kind::Directive, std::string(text_.substr(begin, at_ - begin)), first_line, begin});
	}

	void token(char c)
	{
		std::size_t bytes = 1;
		if (starts_name(c)) {
			while (at_ + bytes < text_.size() && continues_name(text_[at_ + bytes]))
				++bytes;
			return add(Kind::Name, bytes);
		}
		const char next = at_ + 1 < text_.size() ? text_[at_ + 1] : '\0';
		if (std::isdigit(static_cast<unsigned char>(c)) ||
		    (c == '.' && std::isdigit(static_cast<unsigned char>(next)))) {
			// Letters, digits, points, and the sign of an exponent.
			while (at_ + bytes < text_.size()) {
				const char d = text_[at_ + bytes], before = text_[at_ + bytes - 1];
				const bool exponent = starts("0x") ? before == 'p' : before == 'e';
				if (!continues_name(d) && d != '.' && !((d == '+' || d == '-') && exponent))
					break;
				++bytes;
			}
			return add(Kind::Number, bytes);
		}
		if (c == '"' || c == '\'') {
			while (at_ + bytes < text_.size() && text_[at_ + bytes] != c)
				bytes += text_[at_ + bytes] == '\\' ? 2 : 1;
			return add(Kind::Text, std::min(bytes + 1, text_.size() - at_));
		}
		static const char* const marks[] = {"<<=", ">>=", "->", "++", "--", "<<", ">>", "<=", ">=", "==", "!=",
		                                    "&&",  "||",  "+=", "-=", "*=", "/=", "%=", "&=", "|=", "^="};
		for (const char* mark : marks)
			if (starts(mark))
				return add(Kind::Mark, std::strlen(mark));
		add(Kind::Mark, 1);
	}

	std::string_view text_;
	std::size_t at_ = 0;
	unsigned line_ = 1;
	std::vector<KernelToken> tokens_;
};

KernelType literal_type(const std::string& text)
{
	using Type = KernelType::Kind;
	const bool hex = text.size() > 1 && (text[1] == 'x' || text[1] == 'X');
	const bool real = text.find('.') != std::string::npos || text.find(hex ? 'p' : 'e') != std::string::npos;
	if (real)
		return {Type::Real, "rt_float", false};
	return text.back() == 'u' ? KernelType{Type::Uint, "rt_u32", false} : KernelType{Type::Int, "rt_i32", false};
}

// "#define NAME LITERAL" declares a constant; macros of any other kind are not looked into.
void read_define(const std::string& directive, KernelDeclarations& out)
{
	const std::vector<KernelToken> words = kernel_tokens(" " + directive.substr(1));
	if (words.size() == 4 && words[0].text == "define" && words[2].kind == Kind::Number)
		out.constants[words[1].text] = literal_type(words[2].text);
}

class DeclarationReader {
public:
	DeclarationReader(const std::string& file, const std::vector<KernelToken>& tokens, KernelDeclarations& out)
	    : file_(file), tokens_(tokens), out_(out)
	{
	}

	void run()
	{
		for (at_ = 0; tokens_[at_].kind != Kind::End;) {
			const std::string& word = tokens_[at_].text;
			if (tokens_[at_].kind == Kind::Directive)
				read_define(tokens_[at_++].text, out_);
			else if (word == "typedef" && tokens_[at_ + 1].text == "struct")
				read_struct();
			else if (word == "RT_FN")
				read_function();
			else if (word == "RT_TABLE")
				read_table();
			else
				++at_;
		}
	}

private:
	void read_struct()
	{
		while (!tokens_[at_].is("{") && tokens_[at_].kind != Kind::End)
			++at_;
		const std::size_t end = behind_bracket(tokens_, at_);
		std::vector<KernelMember> members;
		++at_;
		while (at_ + 1 < end) {
			if (tokens_[at_].kind == Kind::Directive) {
				++at_;
				continue;
			}
			const KernelType type = read_kernel_type(out_, tokens_, at_);
			if (type.kind == KernelType::Kind::Unknown) {
				++at_;
				continue;
			}
			while (at_ + 1 < end && !tokens_[at_].is(";")) {
				if (tokens_[at_].kind == Kind::Name)
					members.push_back({tokens_[at_].text, type, tokens_[at_ + 1].is("[")});
				at_ = tokens_[at_].is("[") ? behind_bracket(tokens_, at_) : at_ + 1;
			}
		}
		at_ = end;
		if (tokens_[at_].kind == Kind::Name)
			out_.structs[tokens_[at_].text] = std::move(members);
	}

	void read_function()
	{
		KernelFunction function;
		function.file = file_;
		++at_;
		function.result = read_kernel_type(out_, tokens_, at_);
		const std::string name = tokens_[at_].text;
		function.line = tokens_[at_].line;
		++at_;
		if (!tokens_[at_].is("("))
			return;
		const std::size_t end = behind_bracket(tokens_, at_);
		for (++at_; at_ + 1 < end;) {
			const KernelType type = read_kernel_type(out_, tokens_, at_);
			if (type.kind != KernelType::Kind::Void)
				function.parameters.push_back(type);
			while (at_ + 1 < end && !tokens_[at_].is(","))
				++at_;
			++at_;
		}
		at_ = end;
		out_.functions[name] = std::move(function);
	}

	void read_table()
	{
		++at_;
		const KernelType type = read_kernel_type(out_, tokens_, at_);
		if (type.is_scalar() && tokens_[at_].kind == Kind::Name)
			out_.tables[tokens_[at_].text] = {KernelType::Kind::Pointer, type.name, true};
	}

	const std::string& file_;
	const std::vector<KernelToken>& tokens_;
	KernelDeclarations& out_;
	std::size_t at_ = 0;
};

} // namespace

std::vector<KernelToken> kernel_tokens(std::string_view text) { return Lexer(text).run(); }

KernelType KernelDeclarations::type_named(const std::string& name) const
{
	using Type = KernelType::Kind;
	static const std::map<std::string, Type> scalars = {
	    {"rt_float", Type::Real}, {"float", Type::Real},   {"rt_int", Type::Int},   {"rt_i32", Type::Int},
	    {"rt_mask", Type::Int},   {"int", Type::Int},      {"rt_uint", Type::Uint}, {"rt_u32", Type::Uint},
	    {"rt_i64", Type::Long},   {"rt_u64", Type::Ulong}, {"void", Type::Void}};
	if (const auto found = scalars.find(name); found != scalars.end())
		return {found->second, name, false};
	if (structs.count(name))
		return {Type::Struct, name, false};
	return {};
}

KernelType KernelDeclarations::target_of(const KernelType& pointer) const
{
	return pointer.kind == KernelType::Kind::Pointer ? type_named(pointer.name) : KernelType{};
}

KernelType KernelDeclarations::member_of(const KernelType& type, const std::string& member) const
{
	if (const auto found = structs.find(type.name); found != structs.end())
		for (const KernelMember& candidate : found->second)
			if (candidate.name == member)
				return candidate.is_array ? KernelType{KernelType::Kind::Pointer, candidate.type.name, false}
				                          : candidate.type;
	return {};
}

std::vector<std::pair<std::string, KernelType>> KernelDeclarations::leaves(const KernelType& type) const
{
	if (type.is_scalar())
		return {{"", type}};
	std::vector<std::pair<std::string, KernelType>> result;
	if (type.kind == KernelType::Kind::Struct)
		for (const KernelMember& member : structs.at(type.name))
			if (!member.is_array)
				for (const auto& [path, leaf] : leaves(member.type))
					result.emplace_back("." + member.name + path, leaf);
	return result;
}

KernelDeclarations kernel_declarations(const std::vector<EmbeddedText>& files)
{
	KernelDeclarations result;
	// Twice, so that a file may use what a later one declares.
	for (int pass = 0; pass < 2; ++pass)
		for (const EmbeddedText& file : files) {
			const std::vector<KernelToken> tokens = kernel_tokens({file.text, file.bytes});
			DeclarationReader(file.path, tokens, result).run();
		}
	return result;
}

KernelType read_kernel_type(const KernelDeclarations& declarations, const std::vector<KernelToken>& tokens,
                            std::size_t& at)
{
	static const std::set<std::string> qualifiers = {"const",       "RT_GLOBAL", "RT_UNIFORM", "RT_PRIVATE",
	                                                 "RT_RESTRICT", "RT_TABLE",  "struct",     "static"};
	const std::size_t start = at;
	KernelType type;
	bool in_memory = false;
	for (; tokens[at].kind == Kind::Name; ++at) {
		if (qualifiers.count(tokens[at].text)) {
			in_memory = in_memory || tokens[at].text == "RT_GLOBAL" || tokens[at].text == "RT_UNIFORM" ||
			            tokens[at].text == "RT_TABLE";
			continue;
		}
		if (type.kind != KernelType::Kind::Unknown)
			break;
		type = declarations.type_named(tokens[at].text);
		if (type.kind == KernelType::Kind::Unknown)
			break;
	}
	if (type.kind == KernelType::Kind::Unknown) {
		at = start;
		return type;
	}
	for (; tokens[at].is("*") || qualifiers.count(tokens[at].text); ++at)
		if (tokens[at].is("*"))
			type = {KernelType::Kind::Pointer, type.name, in_memory};
	return type;
}

std::size_t behind_bracket(const std::vector<KernelToken>& tokens, std::size_t open)
{
	int depth = 0;
	for (std::size_t at = open; tokens[at].kind != Kind::End; ++at) {
		if (tokens[at].is("(") || tokens[at].is("[") || tokens[at].is("{"))
			++depth;
		if (tokens[at].is(")") || tokens[at].is("]") || tokens[at].is("}"))
			if (--depth == 0)
				return at + 1;
	}
	return tokens.size() - 1;
}

} // namespace rt
