// reference_kernels.h: the kernels compiled as C++, one table for each variant of them.
//
// A host compiler cannot specialise at run time, so ReferenceVariants.cmake compiles reference_kernels.cpp once for
// each number of lanes, feature mask, kind of roots and instruction set that is worth having.
#pragma once

#include <cstdint>

namespace rt {

struct ReferenceKernel {
	const char* entry;
	unsigned argument_count;
	// Runs work-items [begin, end). arguments[i] points to a buffer's memory, or to a rt_u32.
	void (*run)(void* const* arguments, std::uint32_t begin, std::uint32_t end);
};

struct ReferenceVariant {
	const char* name;
	std::uint32_t lanes;    // RT_LANES
	std::uint32_t features; // compiled in
	bool native_roots;
	bool contracted;          // the compiler may fuse products and sums, and finds none: for the tests of rule 3
	bool traced;              // rt_render only, with notes (kernels/trace.h)
	unsigned instruction_set; // it needs x86-64-v3 (AVX2, FMA) or x86-64-v4 (AVX-512): 3 or 4; 0: what rt is built for
	unsigned precision;       // RT_PRECISION
	const ReferenceKernel* kernels;
	unsigned kernel_count;
};

extern const ReferenceVariant* const reference_variants[];
extern const unsigned reference_variant_count;

} // namespace rt
