// ptxas_use.h: what a program takes of an NVIDIA GPU, told by NVRTC's assembler; needs no GPU.
#pragma once

#include "backends/backend.h"
#include "backends/cuda/nvrtc.h"
#include "support/result.h"

#include <cstddef>
#include <optional>

namespace rt {

struct PtxasUse {
	std::optional<unsigned> registers;                  // of rt_render; empty if the assembler's log has none
	std::optional<unsigned> stack_bytes, spilled_bytes; // the same
	std::size_t code_bytes = 0;                         // of the whole program's binary
	double seconds = 0;                                 // of compiling
};

// What programs are made for where no GPU is there to ask.
DeviceInfo imagined_gpu();

// `capability`: 90 for 9.0.
Result<PtxasUse> ptxas_use(const Nvrtc& nvrtc, const ProgramSpec& spec, int capability);

} // namespace rt
