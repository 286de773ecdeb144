// stress_tile.h: a 32x32 image with every kind of surface and texture, and the hash it must have.
#pragma once

#include "backends/backend.h"
#include "common/rt_features.h"
#include "support/hash.h"
#include "support/result.h"

#include <cstdint>

namespace rt {

// Hash of the tile's sums on every device that keeps the contract of RT_CONTRACT_VERSION.
extern const char* const stress_tile_hash;

// The same in the double rung.
extern const char* const stress_tile_double_hash;

// What its image needs: every surface, and none of the samplers and estimators that users ask for.
constexpr std::uint32_t stress_tile_features =
    RT_FEATURE_ALL & ~(RT_FEATURE_SOBOL | RT_FEATURE_STRATIFIED | RT_FEATURE_LIGHTS | RT_FEATURE_ROULETTE);

// Renders the tile with a program that has the entry rt_render, these features and so many lanes; its spheres are tried
// one after the other or found through a small tree, which must give the same hash.
Result<Hash128> render_stress_tile(Device& device, const ProgramHandle& program, std::uint32_t lanes,
                                   bool through_tree);

} // namespace rt
