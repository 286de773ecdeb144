// precision.h: the rungs: the kinds of arithmetic that the one kernel source is compiled for.
//
//   exact   float32 by the contract (docs/contract.md): the same bits on every device
//   fast    float32 with what the device offers: approximate roots, sines, flushed subnormals; no identity
//   double  float64 by the same rules as exact: the oracle; needs a device with fp64
#pragma once

#include "backends/backend.h"
#include "common/rt_compat.h"
#include "support/result.h"

namespace rt {

enum class Precision { Exact = RT_PRECISION_EXACT, Fast = RT_PRECISION_FAST, Double = RT_PRECISION_DOUBLE };

// "exact", "fast" or "double": as --precision takes it and files record it.
const char* precision_name(Precision precision);

// RT_LANES of a program of this rung: the device's own, or one in the double rung.
std::uint32_t lanes_for(const DeviceInfo& device, Precision precision);

// Makes a spec's program one of this rung. Of the fast rung's approximations (RT_FAST_* of common/rt_compat.h) only
// `fast_parts` are taken.
void set_precision(ProgramSpec& spec, Precision precision, std::uint32_t fast_parts = RT_FAST_ALL);

// May the compiler fuse products and sums of the program? In the fast rung, and where tests ask for it (rule 3).
bool lets_compiler_fuse(const ProgramSpec& spec);

// Does the program flush subnormals? Only the fast rung's may: contract rule 18.
bool flushes_subnormals(const ProgramSpec& spec);

// NoDevice error if the device cannot compute in this rung.
Status check_precision(const DeviceInfo& device, Precision precision);

} // namespace rt
