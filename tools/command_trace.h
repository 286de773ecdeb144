// command_trace.h: `rt trace`: one path with all its numbers, and the first operation in which two devices differ.
#pragma once

#include "support/result.h"
#include "tools/options.h"

namespace rt {

Status run_trace(const TraceOptions& options);

} // namespace rt
