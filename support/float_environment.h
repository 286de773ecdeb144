// float_environment.h: contract rule 18: round to nearest even, subnormals neither flushed nor read as zero.
#pragma once

namespace rt {

// The calling thread's float environment, as far as the contract cares.
struct FloatEnvironment {
	bool rounds_to_nearest = true;
	bool flushes_subnormals = false; // results, operands or both
	bool is_ieee() const { return rounds_to_nearest && !flushes_subnormals; }
};
FloatEnvironment current_float_environment();
// That of the first thread before main(), as preloaded libraries left it.
FloatEnvironment inherited_float_environment();

// Sets the calling thread's environment to the contract's for the object's lifetime.
class ContractFloatEnvironment {
public:
	ContractFloatEnvironment();
	~ContractFloatEnvironment();
	ContractFloatEnvironment(const ContractFloatEnvironment&) = delete;
	ContractFloatEnvironment& operator=(const ContractFloatEnvironment&) = delete;

private:
	unsigned saved_control_ = 0;
	int saved_rounding_ = 0;
};

// Lets the calling thread flush subnormals for the object's lifetime, where the processor can: the fast rung's.
class FlushingFloatEnvironment {
public:
	FlushingFloatEnvironment();
	~FlushingFloatEnvironment();
	FlushingFloatEnvironment(const FlushingFloatEnvironment&) = delete;
	FlushingFloatEnvironment& operator=(const FlushingFloatEnvironment&) = delete;

private:
	unsigned saved_control_ = 0;
};

} // namespace rt
