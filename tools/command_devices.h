// command_devices.h: `rt devices`, what rt can run on, what is missing, and how to get it.
#pragma once

#include "support/result.h"
#include "tools/options.h"

namespace rt {

Status run_devices(const DevicesOptions& options);

} // namespace rt
