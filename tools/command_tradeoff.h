// command_tradeoff.h: `rt tradeoff`, speed against accuracy: measured, sorted, and a command line at the end; and
// `rt render --auto-precision`, which takes that command line.
#pragma once

#include "support/result.h"
#include "tools/options.h"

namespace rt {

Status run_tradeoff(const TradeoffOptions& options);

// The options with the precision, sampler, estimator and samples that are quickest for options.target_error on this
// device: from a remembered measurement, or measured now.
Result<RenderOptions> with_auto_precision(const RenderOptions& options);

} // namespace rt
