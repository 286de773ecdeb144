// verify_json.h: a verification for programs, as rt verify --json writes it.
#pragma once

#include "verify/verify_report.h"

#include <nlohmann/json_fwd.hpp>

namespace rt {

nlohmann::ordered_json verify_json(const VerifyReport& report);

const char* depth_name(VerifyDepth depth);

} // namespace rt
