// golden_scenes.h: small renders of the shipped scenes, and the film hash that every one must have on every device.
//
// The table is render/golden.json, the only home of these hashes. It is embedded when rt is built, so that an installed
// rt can judge devices, and read by the tests. Hashes are those of RT_CONTRACT_VERSION.
#pragma once

#include "render/pack.h"
#include "support/result.h"

#include <cstdint>
#include <string>
#include <vector>

namespace rt {

struct GoldenScene {
	std::string name; // shipped name or cloud-N
	std::uint32_t width = 0, height = 0, samples = 0, seed = 0;
	std::string film = {}; // 32 hex digits; empty for a scene that the table has no film of
	Sampler sampler = Sampler::Independent;
	Estimator estimator = Estimator::Path;
	std::uint32_t roulette = 0;
};

// In the table's order. Of another contract's table only the scenes, without films. Failure if it cannot be read: a
// mistake of the build.
Result<std::vector<GoldenScene>> golden_scenes();

// The golden scenes, and after them every other shipped scene (its first frame) at a size like theirs, with no hash.
Result<std::vector<GoldenScene>> golden_and_shipped_scenes();

// "51x34, 5 samples, seed 1", and what else is not the default: "..., sobol, roulette 3"
std::string settings_text(const GoldenScene& scene);

Result<PackedScene> pack_golden_scene(const GoldenScene& scene);

// The table's text with these films (tests, after a change of the contract).
std::string golden_table(const std::vector<GoldenScene>& scenes);

} // namespace rt
