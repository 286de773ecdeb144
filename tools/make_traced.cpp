// make_traced: writes the text of the traced kernels while rt is built, for the reference backend to compile.
//
//     make_traced OUTPUT.inc
#include "backends/kernel_text.h"
#include "support/files.h"

#include <fmt/format.h>

#include <cstdio>

namespace {

rt::Status write_traced(const char* path)
{
	rt::ProgramSpec spec;
	spec.root = "kernels/trace.cl";
	spec.traced = true;
	RT_TRY_ASSIGN(const std::string text, rt::flatten_program(spec));
	return rt::write_file(path, text);
}

} // namespace

int main(int argc, char** argv)
{
	if (argc != 2) {
		fmt::print(stderr, "usage: make_traced OUTPUT.inc\n");
		return static_cast<int>(rt::ErrorKind::Usage);
	}
	if (const rt::Status written = write_traced(argv[1]); !written) {
		fmt::print(stderr, "rt: {}\n", written.error().message);
		return static_cast<int>(written.error().kind);
	}
	return 0;
}
