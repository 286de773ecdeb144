// fuzz.h: what every fuzz target defines. libFuzzer calls it with bytes of its own making, replay.cpp with those of
// files. It must come back from any input: no crash, no sanitizer's report, no hour, no gigabyte.
#pragma once

#include <cstddef>
#include <cstdint>

// libFuzzer chose the name. NOLINTNEXTLINE(readability-identifier-naming)
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

// A claim about a result; a false one ends the process, which is how a finding is told.
#define FUZZ_CHECK(condition) \
	do {                      \
		if (!(condition))     \
			__builtin_trap(); \
	} while (false)
