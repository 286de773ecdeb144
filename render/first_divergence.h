// first_divergence.h: where two devices first differ: image, pixel, sample, bounce, operation.
//
// The image is rendered on both in passes of 1, 3, 12, 48, ... samples until one differs, so that a fault that shows
// everywhere is found after a few milliseconds. After the first pass, if it is the same, some pixels are compared
// operation by operation, for differences that rounding hides from the film. Each pass is several launches on one film,
// so that faults in the film's own sums show too. Then one differing pixel is taken apart: the launch, the sample, and
// with traced programs (render/trace.h) the operation. Nothing here trusts one device more than the other: of an
// operation that differs, the contract's result is computed from its operands.
#pragma once

#include "render/trace_compare.h"
#include "support/result.h"

#include <atomic>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace rt {

struct TracedDevice {
	DeviceHandle device;
	bool software_roots = false;
};

struct DivergenceOptions {
	std::uint32_t samples = 1;
	bool specialise = true;
	std::uint32_t lanes = 0;                                      // of the ordinary programs; 0: each device's own
	std::optional<std::pair<std::uint32_t, std::uint32_t>> pixel; // look at no other
	std::optional<std::uint32_t> sample;                          // of that pixel
	std::uint64_t most_notes = std::uint64_t(1) << 18;            // compared at a time
	std::uint32_t pixels_to_trace = 16;                           // where the images are the same
	const std::atomic<bool>* stop = nullptr;
	std::function<void(const std::string&)> status;
};

struct DivergenceStep {
	std::string what; // "image", "pixel and sample", "operation"
	double seconds = 0;
};

struct Divergence {
	// Image.
	std::uint32_t samples_compared = 0; // a pixel
	std::uint64_t pixels = 0, different_pixels = 0;
	bool images_differ() const { return different_pixels > 0; }

	// Pixel and sample. first_sample and samples of the launch that differs; more than one only if no sample alone
	// does.
	std::optional<PixelLaunch> launch;
	rt_film_pixel judged{}, against{}; // its film after the launch
	bool alone = true;                 // false: the pixel differs in the image and not when rendered alone

	// Operation.
	std::optional<TraceDifference> operation;
	std::uint64_t notes_compared = 0;
	std::uint32_t traces_compared = 0;
	// Where no operation of the traced programs differs and the ordinary ones do:
	std::optional<std::uint32_t> differing_depth; // the smallest max_depth with which they differ
	std::optional<bool> one_lane_agrees;          // the judged device's ordinary program with 1 lane
	std::string layout_failure; // what the self-test says of struct layouts, after a read that differs

	// A device whose ordinary program was not made from this text: "" for neither, else the device's name.
	std::string stale_device;
	std::uint32_t stale_id = 0, expected_id = 0;

	std::vector<DivergenceStep> steps;
	bool is_identical() const { return !images_differ() && !launch && !operation && stale_device.empty(); }
};

// `packed` must show the whole image. Errors: of building and launching; Interrupted.
Result<Divergence> find_divergence(const PackedScene& packed, const TracedDevice& judged, const TracedDevice& against,
                                   const DivergenceOptions& options);

} // namespace rt
