#include "backends/kernel_text.h"

#include "backends/traced_text.h"
#include "support/hash.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <sstream>
#include <string_view>

namespace rt {

namespace {

// Joins files into one text. Each file goes in at its first mention, wherever that stands, so an include must not
// stand under a condition other than its own header's guard.
class Flattener {
public:
	Flattener(const EmbeddedText* files, unsigned count) : files_(files), count_(count), included_(count, false) {}

	// `from` names the file and line that asks for `path`; empty for the root.
	Status add(std::string_view path, const std::string& from)
	{
		unsigned index = 0;
		while (index < count_ && path != files_[index].path)
			++index;
		if (index == count_)
			return Error{ErrorKind::Build,
			             fmt::format("there is no kernel file '{}' in this program", path),
			             from,
			             "list it in RT_KERNEL_FILES (backends/CMakeLists.txt) and build again",
			             {}};
		if (included_[index]) {
			text_ += '\n'; // stands for the #include line, so that the lines below keep their numbers
			return success();
		}
		included_[index] = true;
		mark(1, path);
		std::string_view rest(files_[index].text, files_[index].bytes);
		for (unsigned line = 1; !rest.empty(); ++line) {
			const std::size_t end = rest.find('\n');
			const std::string_view content = rest.substr(0, end);
			rest.remove_prefix(end == std::string_view::npos ? rest.size() : end + 1);
			if (const std::string_view target = include_target(content); target.empty())
				text_.append(content).append("\n");
			else
				RT_TRY(add_include(target, path, line));
		}
		return success();
	}

	bool has_included(unsigned index) const { return included_[index]; }
	std::string text() && { return std::move(text_); }

private:
	Status add_include(std::string_view target, std::string_view path, unsigned line)
	{
		const std::size_t before = text_.size();
		RT_TRY(add(target, fmt::format("{}:{}", path, line)));
		if (text_.size() > before + 1)
			mark(line + 1, path);
		return success();
	}

	void mark(unsigned line, std::string_view path) { text_ += fmt::format("#line {} \"{}\"\n", line, path); }

	// x of `#include "x"`; empty for every other line.
	static std::string_view include_target(std::string_view line)
	{
		const auto skip_blanks = [&line] {
			const std::size_t first = line.find_first_not_of(" \t");
			line.remove_prefix(first == std::string_view::npos ? line.size() : first);
		};
		const auto take = [&line](std::string_view word) {
			if (line.substr(0, word.size()) != word)
				return false;
			line.remove_prefix(word.size());
			return true;
		};
		skip_blanks();
		if (!take("#"))
			return {};
		skip_blanks();
		if (!take("include"))
			return {};
		skip_blanks();
		if (!take("\""))
			return {};
		return line.substr(0, line.find('"'));
	}

	const EmbeddedText* files_;
	unsigned count_;
	std::vector<bool> included_;
	std::string text_;
};

Error cannot_edit(const TextEdit& edit, const char* why)
{
	return Error{ErrorKind::Build,
	             fmt::format("an edit of {} cannot be made: {}", edit.file, why),
	             fmt::format("the text to be replaced: {}", edit.find),
	             "give text that stands exactly once in a file of this program",
	             {}};
}

Status apply(const TextEdit& edit, std::string& text)
{
	const std::size_t found = edit.find.empty() ? std::string::npos : text.find(edit.find);
	if (found == std::string::npos)
		return cannot_edit(edit, "its text is not there");
	if (text.find(edit.find, found + 1) != std::string::npos)
		return cannot_edit(edit, "its text is there more than once");
	text.replace(found, edit.find.size(), edit.replace);
	return success();
}

} // namespace

Result<std::string> flatten_program(const ProgramSpec& spec, const EmbeddedText* files, unsigned file_count)
{
	std::vector<EmbeddedText> texts(files, files + file_count);
	std::vector<std::string> edited(spec.edits.empty() ? 0 : file_count);
	for (const TextEdit& edit : spec.edits) {
		unsigned index = 0;
		while (index < file_count && edit.file != files[index].path)
			++index;
		if (index == file_count)
			return cannot_edit(edit, "there is no such file");
		edited[index].assign(texts[index].text, texts[index].bytes);
		RT_TRY(apply(edit, edited[index]));
		texts[index] = {files[index].path, edited[index].data(), edited[index].size()};
	}
	TracedText traced;
	if (spec.traced) {
		traced = trace_kernels(texts);
		for (unsigned index = 0; index < file_count; ++index)
			texts[index] = {files[index].path, traced.files[index].data(), traced.files[index].size()};
	}
	std::string text;
	for (const auto& [name, value] : spec.defines)
		text += fmt::format("#define {} {}\n", name, value);
	Flattener flattener(texts.data(), file_count);
	RT_TRY(flattener.add(spec.root, "the program's root file"));
	for (const TextEdit& edit : spec.edits)
		for (unsigned index = 0; index < file_count; ++index)
			if (edit.file == files[index].path && !flattener.has_included(index))
				return cannot_edit(edit, "the program does not include the file");
	return text + std::move(flattener).text();
}

std::string place_in_files(const std::string& log, const std::string& name, const std::string& text)
{
	// Where each line of the text comes from: its file's own name and line, by the #line directives above it.
	std::vector<std::string> places;
	std::istringstream lines(text);
	std::string file = name;
	unsigned number = 1;
	for (std::string line; std::getline(lines, line); ++number) {
		places.push_back(fmt::format("{}:{}", file, number));
		char path[256];
		unsigned next = 0;
		if (std::sscanf(line.c_str(), "#line %u \"%255[^\"]\"", &next, path) == 2) {
			file = path;
			number = next - 1;
		}
	}
	std::string result;
	const std::string mark = name + ":";
	for (std::size_t at = 0;;) {
		const std::size_t found = log.find(mark, at);
		result.append(log, at, found == std::string::npos ? found : found - at);
		if (found == std::string::npos)
			return result;
		const std::size_t digits = found + mark.size();
		at = std::min(log.find_first_not_of("0123456789", digits), log.size());
		const unsigned long line = std::strtoul(log.c_str() + digits, nullptr, 10);
		if (line >= 1 && line <= places.size())
			result += places[line - 1];
		else
			result.append(log, found, at - found);
	}
}

std::string kernel_hash(const EmbeddedText* files, unsigned file_count)
{
	Hasher hasher;
	for (unsigned i = 0; i < file_count; ++i) {
		// Lengths go in too, so that no shift of bytes between a name and its text leaves the hash alone.
		const std::size_t name_bytes = std::strlen(files[i].path);
		hasher.add_u64(name_bytes);
		hasher.add(files[i].path, name_bytes);
		hasher.add_u64(files[i].bytes);
		hasher.add(files[i].text, files[i].bytes);
	}
	return hasher.result().hex();
}

} // namespace rt
