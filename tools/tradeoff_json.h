// tradeoff_json.h: a measured trade between speed and accuracy as JSON (docs/manual.md) and back, and as CSV.
#pragma once

#include "support/result.h"
#include "tools/tradeoff_run.h"

#include <nlohmann/json_fwd.hpp>

#include <string>

namespace rt {

nlohmann::ordered_json tradeoff_json(const Tradeoff& measured);
nlohmann::ordered_json advice_json(const Tradeoff& measured, const TradeoffAdvice& advice);
// Only what a recommendation needs: scene, settings, devices' names, points. The text is one that tradeoff_json() made;
// an InputOutput error otherwise.
Result<Tradeoff> tradeoff_of_json(const std::string& text);

// A row a point, with a heading.
std::string tradeoff_csv(const Tradeoff& measured);

} // namespace rt
