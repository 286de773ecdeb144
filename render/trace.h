// trace.h: one pixel's samples as a device computes them, operation by operation.
//
// A Tracer has a scene and two programs on one device: the ordinary one that renders, and the traced one
// (backends/traced_text.h), which is generic and of one lane. Both take the same launches on a film of one pixel, so
// that what they add up can be compared.
#pragma once

#include "backends/backend.h"
#include "backends/render_launch.h"
#include "backends/traced_text.h"
#include "common/rt_structs.h"
#include "render/pack.h"
#include "render/session.h"
#include "support/result.h"

#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace rt {

struct TraceNote {
	TraceCode code;
	std::array<std::uint64_t, 3> operands{};
	std::uint64_t result = 0;
};

// A launch that takes samples of one pixel.
struct PixelLaunch {
	std::uint32_t x = 0, y = 0; // in the whole image
	std::uint32_t first_sample = 0, samples = 1;
	rt_film_pixel before{}; // what the film holds already
};

struct Trace {
	PixelLaunch launch;
	std::uint64_t first_note = 0; // of all, which `notes` begins with
	std::uint64_t note_count = 0; // of all
	std::vector<TraceNote> notes;
	rt_film_pixel after{};
};

bool same_sums(const rt_film_pixel& a, const rt_film_pixel& b);

// What a note of the kernels in this binary means; nullptr for a place where none has a note.
const TraceSite* trace_site(const TraceCode& code);

class Tracer {
public:
	// `options`: specialise, software_roots and lanes of the ordinary program.
	static Result<Tracer> make(DeviceHandle device, const PackedScene& packed, const SessionOptions& options);

	const DeviceInfo& info() const { return device_->info(); }
	// The ordinary program: the pixel after the launch. max_depth 0: the scene's.
	Result<rt_film_pixel> render(const PixelLaunch& launch, std::uint32_t max_depth = 0);
	// The traced program: `most_notes` notes from `first_note` on.
	Result<Trace> trace(const PixelLaunch& launch, std::uint64_t first_note, std::uint64_t most_notes);
	// What the ordinary program says it was made from, and what it should say; 0 where the backend does not tell.
	Result<std::uint32_t> program_id();
	std::uint32_t expected_program_id() const { return expected_id_; }

private:
	// The scene in device memory, its spheres stored as a program of so many lanes wants them.
	struct Resident {
		rt_scene scene{};
		rt_few_spheres few{};
		SceneBuffers lists;
	};

	Tracer() = default;
	Result<Resident> upload(const PackedScene& packed) const;
	// Arguments of rt_render, with the film set to what it holds before the launch.
	Result<std::vector<Argument>> arguments(const Resident& scene, const PixelLaunch& launch, std::uint32_t max_depth);
	Result<rt_film_pixel> film();

	DeviceHandle device_;
	ProgramHandle ordinary_, traced_;
	ProgramSpec traced_spec_;
	Resident ordinary_scene_, traced_scene_;
	BufferHandle film_, log_;
	std::uint32_t lanes_ = 1, expected_id_ = 0;
};

} // namespace rt
