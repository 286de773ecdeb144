// render_stats.h: what a render took and where, for --stats and for the summary.
#pragma once

#include "render/pack.h"
#include "tools/film_provenance.h"
#include "tools/passes.h"

#include <nlohmann/json_fwd.hpp>

#include <chrono>
#include <string>
#include <utility>
#include <vector>

namespace rt {

// Seconds by phase, in the order in which the phases first come.
class PhaseTimes {
public:
	// Ends the phase under way, if any, and begins another.
	void begin(const char* phase);
	void end();
	const std::vector<std::pair<std::string, double>>& phases() const { return phases_; }
	// From the making of this object until now.
	double total() const;

private:
	using Clock = std::chrono::steady_clock;
	std::vector<std::pair<std::string, double>> phases_;
	std::string current_;
	Clock::time_point start_ = Clock::now(), phase_start_ = start_;
};

// Facts of the whole run: versions, devices, self-test, times.
nlohmann::ordered_json run_json(const FilmOrigin& origin, const PhaseTimes& times);
// Facts of one frame, whose file holds the film `kept`.
nlohmann::ordered_json frame_json(const FilmOrigin& origin, const PackedScene& packed, const PassResult& result,
                                  const Film& kept, const std::string& file);
nlohmann::ordered_json device_json(const DeviceInfo& info);

const char* kind_name(DeviceKind kind);

} // namespace rt
