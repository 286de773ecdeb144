// ledger.h: docs/ledger.json, the rows that verifications leave behind: which device gave which film.
//
// One row for the self-test and one for each film. A row replaces the older one with the same device, driver,
// compiler, system, contract, kernels, rung, scene, settings and variant; all others stay, the failing ones too.
#pragma once

#include "support/result.h"
#include "verify/verify_report.h"

#include <string>

namespace rt {

// Reads the file if it is there, adds the rows, writes it. InputOutput error if it is not a ledger.
Status add_to_ledger(const std::string& path, const VerifyReport& report);

} // namespace rt
