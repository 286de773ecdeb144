// command_bench.h: `rt bench`, how fast a device renders a scene, part by part, as a table and as JSON.
#pragma once

#include "support/result.h"
#include "tools/options.h"

namespace rt {

Status run_bench(const BenchOptions& options);

} // namespace rt
