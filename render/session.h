// session.h: renders a packed scene on one or more devices into a film, by bounded launches.
//
// A launch covers some rows of the window and a range of samples and aims at 50-200 ms: that gives progress, an
// honest remaining time and a quick stop by one mechanism. How the work is split, and among which devices, cannot
// change a bit: random numbers depend on (seed, pixel, sample, dimension) only and sums are integers.
#pragma once

#include "backends/backend.h"
#include "backends/precision.h"
#include "render/film.h"
#include "render/pack.h"
#include "support/result.h"

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

namespace rt {

struct Progress {
	std::uint64_t samples_done = 0; // pixel samples
	std::uint64_t samples_total = 0;
	double seconds = 0; // since rendering began
};

// Whether spheres are found through a tree (render/bvh.h); it cannot change a bit.
enum class Acceleration { Auto, Never, Always };

struct SessionOptions {
	std::uint32_t first_sample = 0; // samples [first_sample, first_sample + samples) are taken
	std::uint32_t samples = 1;
	Precision precision = Precision::Exact;
	std::uint32_t fast_parts = RT_FAST_ALL; // of the fast rung's approximations, for telling their errors apart
	bool specialise = true;         // compile for the scene's features and sphere count; false: the generic program
	bool software_roots = false;    // our own square root and reciprocal even where the device's are proven
	bool allow_contraction = false; // the compiler may fuse products and sums; it finds none (tests of rule 3)
	Acceleration bvh = Acceleration::Auto; // Auto: where the device gains by it
	std::uint32_t lanes = 0;               // 0: by device and scene (render_lanes)
	std::uint32_t group_size = 0;          // 0: chosen by lanes and backend
	std::uint32_t slices = 0;              // parts that a pixel's samples are taken in, side by side; 0: by the device
	std::uint32_t rows_per_launch = 0;     // 0: chosen by time
	std::uint32_t samples_per_launch = 0;
	const Film* start = nullptr;             // a film to go on from, of this scene and window; open() takes it in
	std::uint64_t host_bytes_beside = 0;     // that the caller takes beside the film: reckoned with, not taken
	const std::atomic<bool>* stop = nullptr; // when true, the launch in flight is finished and the film so far returned
	std::function<void(const Progress&)> progress;  // one call at a time, about ten a second
	std::function<void(const std::string&)> status; // "compiling the kernel for ..."
	std::function<bool()> snapshot_wanted;          // polled between launches
	std::function<void(const Film&)> snapshot;      // gets the film so far
	// Asked once by open(), with all made ready and nothing launched yet: are software roots needed after all? So a
	// device may be tested meanwhile. An error of it is open()'s.
	std::function<Result<bool>()> late_software_roots;
};

struct DeviceStats {
	std::string device;
	BuildReport build;
	std::uint64_t launches = 0;
	std::uint64_t samples = 0;
	std::uint32_t lanes = 1;
	bool native_roots = true;
	bool bvh = false;
	double upload_seconds = 0, launch_seconds = 0, read_seconds = 0;
};

struct SessionResult {
	Film film;
	bool interrupted = false;
	double bvh_seconds = 0; // building trees
	double render_seconds = 0;
	std::vector<DeviceStats> devices;
};

// The program that a session builds for a scene on a device, whether or not the scene has its tree yet: features,
// sphere counts, lanes, roots.
ProgramSpec render_program(const PackedScene& packed, const DeviceInfo& device, const SessionOptions& options);

// Bytes that a render takes on a device, and on the host beside the scene itself.
std::uint64_t device_bytes_needed(const PackedScene& packed);
std::uint64_t host_bytes_needed(const PackedScene& packed);

// Does a device with so many lanes find the spheres of this scene through a tree?
bool wants_bvh(const PackedScene& packed, std::uint32_t lanes, Acceleration bvh);

// Paths that a work-item takes at once: the device's own number, 1 in the double rung, and fewer than 16 where spheres
// are found through a tree.
std::uint32_t render_lanes(const PackedScene& packed, const DeviceInfo& device, const SessionOptions& options);

// A scene made ready on its devices, to be rendered into one film by as many calls as wanted: programs, lists and trees
// stay. Its errors are those of render_scene(), which is the case of one call.
class Session {
public:
	// `packed` must outlive the session; the sample range of `options` is not looked at.
	static Result<Session> open(const PackedScene& packed, const std::vector<DeviceHandle>& devices,
	                            const SessionOptions& options);
	Session(Session&& other) noexcept;
	Session& operator=(Session&& other) noexcept;
	~Session();

	// Adds samples [first_sample, first_sample + samples) of the pixels in `windows`, which do not overlap and are
	// given in the coordinates of the packed scene's window, to the film. False if it was stopped before the end.
	Result<bool> take(std::uint32_t first_sample, std::uint32_t samples, const std::vector<Window>& windows);
	// For progress: pixel samples that all calls will have taken, as far as that is known.
	void expect_samples(std::uint64_t total);
	const Film& film() const;
	SessionResult finish() &&;

private:
	struct State;
	explicit Session(std::unique_ptr<State> state);
	std::unique_ptr<State> state_;
};

// Errors: Build, Memory (estimated before it is taken, with the figures), Failure from a driver.
Result<SessionResult> render_scene(const PackedScene& packed, const std::vector<DeviceHandle>& devices,
                                   const SessionOptions& options);

} // namespace rt
