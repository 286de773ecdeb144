// Flattening of kernel files, line numbers included, and the kernels' hash.
#include "tests/catch.h"

#include "backends/embedded_text.h"
#include "backends/kernel_text.h"

#include <string>
#include <vector>

namespace {

struct File {
	std::string path, text;
};

// A table of files as the build embeds them.
class Table {
public:
	explicit Table(std::vector<File> files) : files_(std::move(files))
	{
		for (const File& file : files_)
			entries_.push_back({file.path.c_str(), file.text.data(), file.text.size()});
	}
	Table(const Table&) = delete; // the entries point into the files
	Table& operator=(const Table&) = delete;

	rt::Result<std::string> flatten(const rt::ProgramSpec& spec) const
	{
		return rt::flatten_program(spec, entries_.data(), static_cast<unsigned>(entries_.size()));
	}
	std::string hash() const { return rt::kernel_hash(entries_.data(), static_cast<unsigned>(entries_.size())); }

private:
	std::vector<File> files_;
	std::vector<rt::EmbeddedText> entries_;
};

} // namespace

TEST_CASE("includes are replaced once, and lines keep their places")
{
	const Table table({{"k/root.cl", "first\n#include \"k/a.h\"\nthird\n  #  include \"k/b.h\" // again\nfifth\n"},
	                   {"k/a.h", "a1\n#include \"k/b.h\"\na3\n#include <cmath>\n"},
	                   {"k/b.h", "b1\nb2"}}); // no newline at its end
	const auto text = table.flatten({"k/root.cl", {{"RT_LANES", "8"}, {"RT_X", ""}}, {}});
	REQUIRE(text);
	REQUIRE(text.value() == "#define RT_LANES 8\n"
	                        "#define RT_X \n"
	                        "#line 1 \"k/root.cl\"\n"
	                        "first\n"
	                        "#line 1 \"k/a.h\"\n"
	                        "a1\n"
	                        "#line 1 \"k/b.h\"\n"
	                        "b1\n"
	                        "b2\n"
	                        "#line 3 \"k/a.h\"\n"
	                        "a3\n"
	                        "#include <cmath>\n"
	                        "#line 3 \"k/root.cl\"\n"
	                        "third\n"
	                        "\n"
	                        "fifth\n");
}

TEST_CASE("files that include each other end")
{
	const Table table({{"x.h", "#include \"y.h\"\nx\n"}, {"y.h", "#include \"x.h\"\ny\n"}});
	const auto text = table.flatten({"x.h", {}, {}});
	REQUIRE(text);
	REQUIRE(text.value() == "#line 1 \"x.h\"\n#line 1 \"y.h\"\n\ny\n#line 2 \"x.h\"\nx\n");
}

TEST_CASE("an unknown include is a build error that names file and line")
{
	const Table table({{"k/root.cl", "#include \"k/a.h\"\n"}, {"k/a.h", "one\ntwo\n#include \"k/missing.h\"\n"}});
	const auto text = table.flatten({"k/root.cl", {}, {}});
	REQUIRE_FALSE(text);
	REQUIRE(text.error().kind == rt::ErrorKind::Build);
	REQUIRE(text.error().message.find("k/missing.h") != std::string::npos);
	REQUIRE(text.error().where == "k/a.h:3");
	REQUIRE_FALSE(table.flatten({"k/none.cl", {}, {}}));
}

TEST_CASE("text that only looks like an include stays")
{
	const std::string body = "// #include \"k/a.h\"\nint include; \"#include\"\n#included \"k/a.h\"\n";
	const Table table({File{"r", body}});
	const auto text = table.flatten({"r", {}, {}});
	REQUIRE(text);
	REQUIRE(text.value() == "#line 1 \"r\"\n" + body);
}

TEST_CASE("places in a compiler's log become places in the files")
{
	const Table table({{"k/root.cl", "first\n#include \"k/a.h\"\nthird\n"}, {"k/a.h", "a1\na2\n"}});
	const auto text = table.flatten({"k/root.cl", {{"A", "1"}}, {}});
	REQUIRE(text);
	// Lines of the text: 1 define, 2 #line, 3 first, 4 #line, 5 a1, 6 a2, 7 #line, 8 third.
	const auto placed = [&text](const char* log) { return rt::place_in_files(log, "<kernel>", text.value()); };
	REQUIRE(placed("<kernel>:6:9: error: x\n<kernel>:8:1: note") == "k/a.h:2:9: error: x\nk/root.cl:3:1: note");
	REQUIRE(placed("in <kernel>:3") == "in k/root.cl:1");
	REQUIRE(placed("<kernel>:1:9: macro") == "<kernel>:1:9: macro");               // the defines have no file
	REQUIRE(placed("<kernel>:99:1: x <kernel>:") == "<kernel>:99:1: x <kernel>:"); // no such line
	REQUIRE(placed("k/a.h:2:9: error") == "k/a.h:2:9: error");
}

TEST_CASE("edits are made once and in their own file, or are an error")
{
	const Table table({{"k/root.cl", "one\n#include \"k/a.h\"\nthree three\n"}, {"k/a.h", "one\n"}, {"k/b.h", "b\n"}});
	const auto edited = [&table](std::vector<rt::TextEdit> edits) {
		rt::ProgramSpec spec;
		spec.root = "k/root.cl";
		spec.edits = std::move(edits);
		return table.flatten(spec);
	};
	const std::string before = "#line 1 \"k/root.cl\"\none\n#line 1 \"k/a.h\"\n";
	const std::string after = "\n#line 3 \"k/root.cl\"\nthree three\n";
	REQUIRE(edited({}).value() == before + "one" + after);
	REQUIRE(edited({{"k/a.h", "one", "two"}}).value() == before + "two" + after);
	REQUIRE(edited({{"k/a.h", "one", "two"}, {"k/a.h", "two", "five"}}).value() == before + "five" + after);
	for (const rt::TextEdit& wrong :
	     {rt::TextEdit{"k/a.h", "two", "one"}, rt::TextEdit{"k/root.cl", "three", "one"},
	      rt::TextEdit{"k/b.h", "b", "c"}, rt::TextEdit{"k/c.h", "b", "c"}, rt::TextEdit{"k/a.h", "", "c"}}) {
		const auto refused = edited({wrong});
		REQUIRE_FALSE(refused);
		REQUIRE(refused.error().kind == rt::ErrorKind::Build);
		REQUIRE(refused.error().message.find(wrong.file) != std::string::npos);
	}
}

TEST_CASE("the kernels' hash changes with every name, byte and border")
{
	const std::string hash = Table({{"a", "xy"}, {"b", "z"}}).hash();
	REQUIRE(hash.size() == 32);
	REQUIRE(hash == Table({{"a", "xy"}, {"b", "z"}}).hash());
	REQUIRE(hash != Table({{"a", "xy"}, {"b", "Z"}}).hash());
	REQUIRE(hash != Table({{"a", "xy"}, {"c", "z"}}).hash());
	REQUIRE(hash != Table({{"a", "x"}, {"yb", "z"}}).hash());
	REQUIRE(hash != Table({{"ax", "y"}, {"b", "z"}}).hash());
	REQUIRE(hash != Table({{"b", "z"}, {"a", "xy"}}).hash());
	REQUIRE(hash != Table({File{"a", "xy"}}).hash());
}

TEST_CASE("the embedded kernels flatten without a project include left")
{
	for (const char* root : {"kernels/render.cl", "kernels/probe.cl"}) {
		const auto text = rt::flatten_program({root, {}, {}});
		REQUIRE(text);
		REQUIRE(text.value().find("#include \"") == std::string::npos);
		REQUIRE(text.value().find("#line 1 \"common/rt_compat.h\"") != std::string::npos);
	}
}
