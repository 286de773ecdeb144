// passes.h: one film, rendered in passes of whole samples where it must be possible to go on from it.
//
// A render that is stopped leaves a film whose pixels hold unequal numbers of samples, and counts alone do not say
// which samples those are; such a film can be shown but not continued. A resumable render is therefore cut into passes
// of some seconds, each over the whole window. After each pass the film is even, holds the samples [0, n), and going
// on at n gives the bits of a straight run, because sums are integers and random numbers know their sample's number.
// What a stop loses is the pass that it hits. A render with a time limit is cut the same way, and ends after a pass.
// All passes are one session: what the scene takes (tree, program, uploads) is made once.
#pragma once

#include "render/adaptive_render.h"
#include "render/session.h"
#include "support/result.h"

#include <cstdint>
#include <functional>
#include <optional>
#include <vector>

namespace rt {

struct PassOptions {
	SessionOptions session;        // its sample range, progress and snapshot are set here
	std::uint32_t samples = 1;     // wanted in the end, with those of `start`
	std::optional<Film> start;     // an even film to go on from
	bool resumable = false;        // false: all samples in one pass
	std::optional<double> error;   // of tiles, below which they stop (render/adaptive.h); not resumable
	std::optional<double> seconds; // of rendering: stops at the last count of samples that fits
	std::uint32_t checkpoint_seconds = 60;
	std::function<Status(const Film&)> checkpoint;                                // gets even films
	std::function<void(const Progress& progress, std::uint64_t before)> progress; // of the whole film
	std::function<void(const Film&)> snapshot;                                    // gets the whole film so far
};

struct PassResult {
	Film film;                // everything that was taken; uneven only if interrupted
	std::optional<Film> even; // if interrupted and resumable: what can be gone on from, unless that is nothing
	bool interrupted = false;
	bool timed_out = false;
	std::optional<AdaptiveReport> adaptive; // if there was an error to stop at
	double bvh_seconds = 0;                 // building trees
	double seconds = 0;                     // rendering, without checkpoints
	std::uint64_t samples = 0;              // pixel samples taken here, without those of `start`
	std::uint64_t segments = 0;             // path segments, the same
	std::vector<DeviceStats> devices;
};

Result<PassResult> render_in_passes(const PackedScene& packed, const std::vector<DeviceHandle>& devices,
                                    PassOptions options);

} // namespace rt
