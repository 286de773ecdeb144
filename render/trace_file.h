// trace_file.h: traces as JSON, so that two people with two machines can compare by mail (docs/formats.md).
#pragma once

#include "render/trace.h"
#include "support/result.h"

#include <cstdint>
#include <string>

namespace rt {

struct SavedTrace {
	std::string kernels; // kernel_hash(): notes are of these kernels' lines
	std::uint32_t contract = 0;
	std::string backend, device, driver;
	std::string scene;  // as it was asked for
	std::string inputs; // hash of what the kernels read: scene, size, seed, depth
	std::uint32_t width = 0, height = 0;
	rt_film_pixel ordinary{}; // what the ordinary program made of the same launch
	Trace trace;
};

// XXH3-128 of everything that the kernels read of a scene but the window.
std::string inputs_hash(const PackedScene& packed);

std::string write_trace(const SavedTrace& saved);
// Errors: InputOutput for what is no trace; Usage for one of other kernels or another contract.
Result<SavedTrace> read_trace(const std::string& text, const std::string& path);

} // namespace rt
