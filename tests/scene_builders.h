// scene_builders.h: scenes and settings in a line, for tests.
#pragma once

#include "render/scene.h"

#include <cstdint>
#include <utility>
#include <vector>

inline rt::RenderSettings settings_of(std::uint32_t width, std::uint32_t height, std::uint32_t samples,
                                      std::uint32_t max_depth, std::uint32_t seed = 0)
{
	rt::RenderSettings settings;
	settings.width = width;
	settings.height = height;
	settings.samples = samples;
	settings.max_depth = max_depth;
	settings.seed = seed;
	return settings;
}

// Of grey albedo and emission.
inline rt::Material material_of(rt::Material::Kind kind, double albedo, double emission = 0)
{
	rt::Material material;
	material.kind = kind;
	material.albedo = {albedo, albedo, albedo};
	material.emission = {emission, emission, emission};
	return material;
}

// Under an even grey sky, or with none at 0.
inline rt::Scene scene_of(const rt::Camera& camera, double sky, std::vector<rt::Material> materials,
                          std::vector<rt::Sphere> spheres)
{
	rt::Scene scene;
	scene.camera = camera;
	scene.sky.kind = sky > 0 ? rt::Sky::Kind::Constant : rt::Sky::Kind::None;
	scene.sky.bottom = {sky, sky, sky};
	scene.materials = std::move(materials);
	scene.spheres = std::move(spheres);
	return scene;
}
