// adaptive_render.h: a render that leaves each tile alone when its estimated error is small enough.
//
// The samples of a pixel are always [0, n), and what n is follows from the films at fixed counts and from nothing else
// (adaptive.h). A time limit ends it at one of these counts; the same run with that count as its limit gives the same
// film.
#pragma once

#include "render/adaptive.h"
#include "render/session.h"

#include <cstdint>
#include <limits>
#include <optional>
#include <vector>

namespace rt {

struct AdaptiveOptions {
	SessionOptions session;                      // its sample range is not looked at
	double error = 0.05;                         // below which a tile's bound must be
	std::uint32_t limit = adaptive_sample_limit; // samples a pixel at most
	std::optional<double> seconds;               // of rendering, at most
};

struct TileResult {
	std::uint32_t samples = 0; // a pixel
	// Of the relative error at the last decision; infinite if there was none.
	double bound = std::numeric_limits<double>::infinity();
};

struct AdaptiveReport {
	std::uint32_t limit = 0; // that of the options, or what the time limit made of it
	bool timed_out = false;
	std::uint32_t tiles_across = 0;
	std::vector<TileResult> tiles; // rows from the top
	std::size_t unfinished = 0;    // tiles that the limit stopped above the error
};

struct AdaptiveResult {
	SessionResult session;
	AdaptiveReport report;
};

// The packed scene's window must be the whole image: where tiles lie, and so how many samples they get, would follow
// from the window otherwise. A Usage error if it is not; others as render_scene().
Result<AdaptiveResult> render_adaptive(const PackedScene& packed, const std::vector<DeviceHandle>& devices,
                                       const AdaptiveOptions& options);

} // namespace rt
