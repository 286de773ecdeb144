// cuda_backend.h: NVIDIA GPUs through the driver API and NVRTC, both loaded when rt runs.
#pragma once

#include "backends/backend.h"

namespace rt {

Backend& cuda_backend();

} // namespace rt
