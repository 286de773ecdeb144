// double_tracer.h: a second path tracer, for tests only.
//
// It is written from the definitions in docs/scenes.md and from textbooks, in double precision, and shares no code and
// no formula's form with kernels/: intersection by the quadratic formula, sampling by rejection, angles by the C
// library, random numbers of std::mt19937_64. Where the two agree, both are right or both definitions are wrong.
#pragma once

#include "render/scene.h"

#include <cstdint>
#include <vector>

namespace rt {

// What one pixel's samples say of its radiance.
struct PixelEstimate {
	Vec3d mean{0, 0, 0};
	Vec3d variance{0, 0, 0}; // of one sample
};

struct TracedImage {
	std::uint32_t width = 0, height = 0, samples = 0;
	std::vector<PixelEstimate> pixels; // rows from the top
};

// Deliberately wrong physics, to show that a comparison would notice.
enum class Reflectance { Fresnel, Schlick };

TracedImage trace_in_double(const Scene& scene, const RenderSettings& settings,
                            Reflectance reflectance = Reflectance::Fresnel);

} // namespace rt
