// reference_kernels.h: the kernels compiled as C++, one table for each variant of them.
//
// A host compiler cannot specialise at run time, so ReferenceVariants.cmake compiles reference_kernels.cpp once for
// each feature mask, kind of roots and instruction set that is worth having.
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
	std::uint32_t features; // compiled in
	bool native_roots;
	bool contracted;      // the compiler may fuse products and sums, and finds none: for the tests of rule 3
	bool traced;          // rt_render only, with notes (kernels/trace.h)
	bool needs_x86_64_v3; // compiled for AVX2 and FMA
	const ReferenceKernel* kernels;
	unsigned kernel_count;
};

extern const ReferenceVariant* const reference_variants[];
extern const unsigned reference_variant_count;

} // namespace rt
