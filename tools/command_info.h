// command_info.h: `rt info`, what a scene contains, which features of the kernel it needs, and how much memory.
#pragma once

#include "support/result.h"
#include "tools/options.h"

namespace rt {

Status run_info(const InfoOptions& options);

} // namespace rt
