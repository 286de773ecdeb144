// naive_backend.h: a candidate backend that is wrong on purpose: the patient of docs/porting.md.
//
// It runs on every OpenCL device, through the OpenCL backend's eight calls, and exchanges the kernels' text for that of
// a textbook path tracer (naive_kernels.h). A port of another program is a backend with kernels of its own in the same
// way: what is above backends/ sees no difference.
//
// RT_NAIVE=dot,quadratic,... leaves it only these habits, RT_NAIVE=none no habit, so that they can be cured one by one.
#pragma once

#include "backends/backend.h"

namespace rt {

Backend& naive_backend();

} // namespace rt
