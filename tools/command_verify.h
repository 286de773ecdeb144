// command_verify.h: rt verify: are these devices right? One screen, made for pasting into a bug report.
#pragma once

#include "support/result.h"
#include "tools/options.h"

namespace rt {

Status run_verify(const VerifyOptions& options);

} // namespace rt
