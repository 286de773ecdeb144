// float_environment.h: contract rule 18: round to nearest even, subnormals neither flushed nor read as zero.
#pragma once

#include "support/result.h"

namespace rt {

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
