// reference_backend.h: the kernels as C++ on the host's cores: with one lane the oracle for the others, with several
// the device of a machine that has no other.
#pragma once

#include "backends/backend.h"

namespace rt {

Backend& reference_backend();

} // namespace rt
