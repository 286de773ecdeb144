// reference_backend.h: the kernels as C++ on the host's cores: the oracle for the others and the last resort.
#pragma once

#include "backends/backend.h"

namespace rt {

Backend& reference_backend();

} // namespace rt
