// bench_run.h: one scene rendered again and again on one device, with the time of each part.
//
// Nothing is written to a disk: encoding ends in memory. The first render is told apart from the others: it may
// compile, and caches are cold.
#pragma once

#include "backends/backend.h"
#include "render/peak.h"
#include "render/scene.h"
#include "render/session.h"
#include "support/hash.h"
#include "support/result.h"
#include "tools/options.h"

#include <array>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

namespace rt {

struct Spread {
	double min = 0, median = 0, max = 0;
};
// Of one value at least.
Spread spread_of(std::vector<double> values);

// The parts of a render, in their order. Rest: what the session does beside them (its threads, its film). Total: from
// the packed scene to the PNG's bytes.
enum class BenchPhase { Bvh, Build, Upload, Launches, ReadBack, Rest, Encode, Total };
constexpr std::array<const char*, 8> bench_phase_names = {"bvh",       "build", "upload", "launches",
                                                          "read_back", "rest",  "encode", "total"};

struct BenchRun {
	std::string scene;
	Hash128 scene_hash;
	std::string film_hash; // 32 hex digits
	RenderSettings settings;
	std::uint32_t features = 0;
	std::uint64_t spheres = 0;
	double load_seconds = 0, pack_seconds = 0; // once: from the file to a Scene, from that to what kernels read
	std::array<double, bench_phase_names.size()> first{};
	std::array<Spread, bench_phase_names.size()> phases{}; // of the repeats
	Spread render_seconds;                                 // what rates are of: launches and reading back
	std::uint64_t samples = 0, segments = 0;               // of one render
	DeviceStats stats;                                     // of the last one
	BuildReport first_build;

	const Spread& phase(BenchPhase which) const { return phases[static_cast<std::size_t>(which)]; }
};

// A device that was opened and has passed its self-test.
struct BenchDevice {
	DeviceHandle handle;
	bool software_roots = false;
	double enumerate_seconds = 0, open_seconds = 0, self_test_seconds = 0;
};
// Usage error for more than one device, SelfTest error for one that fails (unless --force-unverified).
Result<BenchDevice> open_bench_device(const RenderOptions& options,
                                      const std::function<void(const std::string&)>& status);

// Failure if two renders differ by a bit.
Result<BenchRun> bench_scene(const std::string& scene, const RenderOptions& options, const BenchDevice& device,
                             std::uint32_t repeats, const std::function<void(const std::string&)>& status);

} // namespace rt
