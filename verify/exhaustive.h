// exhaustive.h: the contract's operations over all their inputs, on one device (rules 2, 4, 6, 10 to 16, 19).
//
// The device hashes its results block by block (kernels/exhaust.cl) while the host works out the answers: from double
// or integers where they are those of IEEE arithmetic, from the host's compilation of the kernels where they are ours,
// and then with the error against double. Of a block whose hash differs every result is asked for and told.
//
// (float)sqrt((double)x), (float)(1 / (double)x) and the sums and products of floats taken in double are correctly
// rounded: double has 53 >= 2 * 24 + 2 digits, so that rounding twice is harmless (Figueroa 1995, "When is double
// rounding innocuous?"); tests/test_exhaustive.cpp shows it by integers. For fma it would not be: there the sum in
// double is rounded to odd first (Boldo and Melquiond 2008, "Emulation of FMA and correctly rounded sums").
#pragma once

#include "backends/backend.h"
#include "support/result.h"

#include <cstdint>
#include <string>
#include <vector>

namespace rt {

enum class ExhaustiveKind { Device, Rays, Display, Seeds }; // the last two are asked of the host alone

struct ExhaustiveFunction {
	const char* name;
	const char* inputs_text; // "all 2^32 floats"
	ExhaustiveKind kind;
	std::uint32_t operation; // of kernels/exhaust.cl
	std::uint64_t inputs;    // without a stride
	bool samples;            // inputs are drawn, not enumerated: their number can be chosen, a stride leaves some out
	bool uses_roots;         // to be run with the device's own roots and with ours
};

const std::vector<ExhaustiveFunction>& exhaustive_functions();
const ExhaustiveFunction* find_exhaustive(const std::string& name);

// How far a function has been tried and what came of it: all that is needed to go on later.
struct ExhaustiveResult {
	std::string name;
	bool software_roots = false;
	bool required = true;     // false: the device's own roots where rt does not use them
	std::uint64_t stride = 1; // every stride-th input
	std::uint64_t total = 0;  // inputs to try
	std::uint64_t done = 0;   // tried or passed over so far
	std::uint64_t tried = 0;  // of those, in the operation's range
	std::uint64_t failures = 0;
	std::uint64_t outward = 0;  // rehit: rays among them that left a sphere outward
	std::uint64_t controls = 0; // and those that meet it again by the textbook's form with t > 1e-3
	std::uint64_t bits = 0;     // a sum of hashes of their normals and directions
	double max_ulp = -1;        // of ours against double; negative where it is not measured
	double max_error = -1;
	double seconds = 0;
	std::string note;          // "outward 5.0e8, inward 5.0e8, ..."
	std::string first_failure; // operands, result and answer, in hex
	bool finished() const { return done >= total; }
};

class ExhaustiveRun {
public:
	explicit ExhaustiveRun(DeviceHandle device) : device_(std::move(device)) {}

	// `count` inputs instead of the function's own number where they are drawn; 0: its own.
	static ExhaustiveResult begin(const ExhaustiveFunction& function, std::uint64_t stride, std::uint64_t count,
	                              bool software_roots);
	// Tries the next inputs, for something like a second at most; adds to `result`.
	Status advance(const ExhaustiveFunction& function, ExhaustiveResult& result);

private:
	Result<ProgramHandle> program(bool software_roots);
	Status advance_device(const ExhaustiveFunction& function, ExhaustiveResult& result);
	Status advance_rays(ExhaustiveResult& result);
	Status tell_block(const ExhaustiveFunction& function, ExhaustiveResult& result, std::uint32_t first,
	                  std::uint32_t count);

	DeviceHandle device_;
	ProgramHandle programs_[2]; // with native and with software roots
	BufferHandle spheres_, sphere_ids_;
};

// The host's two.
void advance_display(ExhaustiveResult& result);
void advance_seeds(ExhaustiveResult& result);

} // namespace rt
