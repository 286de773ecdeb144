// bvh.h: builds the tree of boxes through which kernels find the nearest of many spheres (kernels/bvh.h walks it).
//
// The tree is the same for any number of threads: only minima, maxima and counts are merged between them, and nodes
// are numbered by their place in the tree. It can change how long a render takes, never a bit of it.
#pragma once

#include "common/rt_features.h"
#include "common/rt_structs.h"
#include "render/pack.h"
#include "support/result.h"

#include <cstdint>
#include <vector>

namespace rt {

// The tree's shape is chosen by the walking device's lanes: RT_BVH_WIDTH(lanes) children a node, and spheres in blocks
// side by side for several lanes.
struct BvhStats {
	std::uint64_t nodes = 0;
	std::uint32_t stack = 0; // links that a walk keeps at most
	double sphere_tests = 0; // expected for a random ray that meets the root's box: the surface area heuristic
	double node_visits = 0;  // likewise
	std::uint64_t bytes = 0;
	double seconds = 0;
};

// What a scene with a tree asks of the kernels.
constexpr std::uint32_t bvh_features = RT_FEATURE_BVH | RT_FEATURE_PERMUTED;

// Stores the spheres in the order of a tree's leaves and adds the tree: sets PackedScene::bvh, the scene's bvh_ members
// and bvh_features. Wide spheres stay outside the tree, in front. lanes: 1, 4, 8 or 16.
// Errors: Memory.
Result<PackedScene> with_bvh(const PackedScene& packed, std::uint32_t lanes, BvhStats* stats = nullptr);

// Bytes that the tree of so many spheres takes on a device, at most.
std::uint64_t bvh_bytes_needed(std::uint64_t spheres, std::uint32_t lanes);

} // namespace rt
