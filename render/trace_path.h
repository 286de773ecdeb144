// trace_path.h: a path as people read it, picked from the notes of a trace.
#pragma once

#include "render/trace.h"

#include <cstdint>
#include <string>
#include <vector>

namespace rt {

struct PathValue {
	std::string name; // "ray direction"
	KernelType::Kind type = KernelType::Kind::Real;
	std::vector<std::uint64_t> bits;
};

struct PathStep {
	std::string title; // "camera", "segment 1", "scattering 1", "film"
	std::vector<PathValue> values;
};

// Of a trace from its first note on. What a kernel does not compute (no texture, no sky) is not there.
std::vector<PathStep> path_of(const Trace& trace);

} // namespace rt
