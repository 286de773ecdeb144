// textbook_tracer.h: a second path tracer, for tests only: in double an independent witness, in float the warning.
//
// It is written from the definitions in docs/scenes.md and from textbooks and shares no code and no formula's form with
// kernels/: intersection by the quadratic formula and an epsilon, normals as (p - c) / r, sampling by rejection, angles
// by the C library, random numbers of std::mt19937_64, coordinates of the world. In double, where it agrees with rt,
// both are right or both definitions are wrong. In float, with the epsilon of 1e-3 that "Ray Tracing in One Weekend"
// uses and rt's own first ancestor used, it shows what becomes of the same scenes at the extremes.
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

// The same program with every number a float.
TracedImage trace_in_float(const Scene& scene, const RenderSettings& settings);

} // namespace rt
