// make_ptx: compiles the generic programs to PTX while rt is built, and writes them as a C++ file.
//
//     make_ptx OUTPUT.cpp
//
// Without a working NVRTC the table is empty, with a message: the build goes on, and rt then needs NVRTC where it runs.
#include "backends/cuda/generic_program.h"
#include "backends/cuda/nvrtc.h"
#include "backends/kernel_text.h"
#include "support/files.h"

#include <fmt/format.h>

#include <cstdio>
#include <iterator>

namespace {

struct Row {
	std::string key;
	std::vector<std::uint8_t> ptx;
};

rt::Result<std::vector<Row>> compile_all(const rt::Nvrtc& nvrtc)
{
	std::vector<Row> rows;
	for (const rt::ProgramSpec& spec : rt::generic_programs()) {
		RT_TRY_ASSIGN(const std::string text, rt::flatten_program(spec));
		RT_TRY_ASSIGN(rt::NvrtcTarget target, nvrtc.target_for(rt::generic_capability));
		target.binary = false;
		RT_TRY_ASSIGN(rt::NvrtcOutput output, nvrtc.compile(text, spec.root, target, rt::nvrtc_options()));
		rows.push_back({rt::generic_key(spec), std::move(output.image)});
	}
	return rows;
}

std::string table_source(const std::vector<Row>& rows, const std::string& compiler)
{
	std::string source = "// Made by tools/make_ptx.cpp; do not edit.\n"
	                     "#include \"backends/cuda/generic_program.h\"\n\nnamespace rt {\n\n";
	auto out = std::back_inserter(source);
	// Numbers, not string literals: compilers limit a literal's length.
	for (std::size_t row = 0; row < rows.size(); ++row) {
		fmt::format_to(out, "static const char ptx_{}[] = {{", row);
		for (std::size_t i = 0; i < rows[row].ptx.size(); ++i)
			fmt::format_to(out, "{}{},", i % 32 == 0 ? "\n\t" : "", rows[row].ptx[i]);
		source += "\n};\n\n";
	}
	source += "const EmbeddedPtx embedded_ptx[] = {\n";
	for (std::size_t row = 0; row < rows.size(); ++row)
		fmt::format_to(out, "\t{{\"{}\", ptx_{}}},\n", rows[row].key, row);
	fmt::format_to(out,
	               "\t{{nullptr, nullptr}},\n}};\nconst char embedded_ptx_compiler[] = \"{}\";\n\n}} // namespace rt\n",
	               compiler);
	return source;
}

void explain(const rt::Error& error)
{
	fmt::print(stderr, "rt: no generic PTX is embedded: {}\n", error.message);
	if (error.kind == rt::ErrorKind::Build && !error.log.empty())
		fmt::print(stderr, "{}\n", error.log);
}

} // namespace

int main(int argc, char** argv)
{
	if (argc != 2) {
		fmt::print(stderr, "usage: make_ptx OUTPUT.cpp\n");
		return static_cast<int>(rt::ErrorKind::Usage);
	}
	std::vector<Row> rows;
	std::string compiler;
	if (const auto& nvrtc = rt::Nvrtc::load(); !nvrtc) {
		explain(nvrtc.error());
	} else if (auto compiled = compile_all(*nvrtc.value()); !compiled) {
		explain(compiled.error());
	} else {
		rows = std::move(compiled).value();
		compiler = nvrtc.value()->version();
	}
	if (const rt::Status written = rt::write_file(argv[1], table_source(rows, compiler)); !written) {
		fmt::print(stderr, "rt: {}\n", written.error().message);
		return static_cast<int>(written.error().kind);
	}
	return 0;
}
