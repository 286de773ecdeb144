// odd_environment.h: what of the process's surroundings may change devices, arithmetic or code, and what of it is odd:
// a reason to look twice at a verdict, or to explain one. The self-test judges; this only tells.
#pragma once

#include "backends/backend.h"

#include <cstddef>
#include <string>
#include <utility>
#include <vector>

namespace rt {

// Set variables that choose or hide devices, change a driver's code, or move rt's own files; sorted by name.
std::vector<std::pair<std::string, std::string>> telling_environment();

struct Oddity {
	std::string what;                 // "POCL_EXTRA_BUILD_FLAGS=-cl-fast-relaxed-math"
	std::string meaning;              // what it does, and what to do
	std::vector<std::size_t> devices; // indices into the enumeration; empty: the whole process

	std::string headline() const; // "device 0: POCL_EXTRA_BUILD_FLAGS=-cl-fast-relaxed-math"
};

// Variables that hand compilers flags, drivers registered twice, one device seen through two platforms, a float
// environment that is not IEEE's. To be called after enumeration: loading a driver may change that environment.
std::vector<Oddity> odd_environment(const Enumeration& found);

// Pairs of indices that are one device: the same PCI address or UUID, shown by two backends or two platforms.
std::vector<std::pair<std::size_t, std::size_t>> views_of_one_device(const Enumeration& found);

} // namespace rt
