// replay: a fuzz target without a fuzzer: runs it over the files of folders. So the committed corpus, in which every
// mended finding has its file, is part of the suite under any compiler.
#include "tests/fuzz/fuzz.h"

#include "support/files.h"

#include <cstdio>
#include <filesystem>

int main(int argc, char** argv)
{
	std::size_t inputs = 0;
	for (int i = 1; i < argc; ++i) {
		std::error_code error;
		for (const auto& entry : std::filesystem::directory_iterator(argv[i], error)) {
			const auto bytes = rt::read_file(entry.path().string());
			if (!bytes) {
				std::fprintf(stderr, "%s: %s\n", entry.path().c_str(), bytes.error().message.c_str());
				return 1;
			}
			std::printf("%s\n", entry.path().c_str());
			std::fflush(stdout); // so that the last line names the input that was one too many
			(void)LLVMFuzzerTestOneInput(bytes->data(), bytes->size());
			++inputs;
		}
		if (error) {
			std::fprintf(stderr, "%s: %s\n", argv[i], error.message().c_str());
			return 1;
		}
	}
	std::printf("%zu inputs\n", inputs);
	return inputs == 0;
}
