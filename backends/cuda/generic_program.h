// generic_program.h: programs that serve every scene, compiled when rt is built for machines that have a driver and no
// NVRTC.
//
// A specialised program differs from its generic one in deleted code only and gives the same bits, so defines that
// merely specialise are ignored here; any other define must be one that a generic program was made with.
#pragma once

#include "backends/backend.h"

#include <string>
#include <vector>

namespace rt {

// The lowest compute capability whose PTX is embedded; later GPUs take it too.
constexpr int generic_capability = 75;

// What is compiled at build time (tools/make_ptx.cpp).
std::vector<ProgramSpec> generic_programs();

// Equal for a program and the generic one that can stand in for it.
std::string generic_key(const ProgramSpec& spec);

// One generic program in the binary.
struct EmbeddedPtx {
	const char* key; // generic_key() of what it was made from; nullptr in the table's last row
	const char* ptx; // ends with a zero byte
};

// Written by tools/make_ptx.cpp; only the last row if there was no NVRTC at build time.
extern const EmbeddedPtx embedded_ptx[];
extern const char embedded_ptx_compiler[]; // "NVRTC 13.0"

} // namespace rt
