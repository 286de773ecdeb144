// opencl_backend.h: every OpenCL 1.2 device that the ICD loader shows.
#pragma once

#include "backends/backend.h"

namespace rt {

Backend& opencl_backend();

} // namespace rt
