// sphere_set.h: reading spheres from a binary file, for sets too large for JSON.
//
// Format f32le-xyzr: four little-endian floats a sphere: centre x, y, z and radius. Materials come from a parallel file
// of little-endian u32 indices, or one material serves all.
#pragma once

#include "render/scene.h"
#include "support/result.h"

#include <cstdint>
#include <string>
#include <vector>

namespace rt {

struct SphereSet {
	std::string spheres_file;
	std::string materials_file;           // empty: every sphere has materials[0]
	std::vector<std::uint32_t> materials; // what the file's indices mean, as indices into the scene's materials
};

// Appends the set. Errors (InputOutput): unreadable files, sizes that do not fit, more than max_spheres in all, and
// values out of range, with the record's number and its byte offset. (Memory): no room.
Status append_sphere_set(const SphereSet& set, std::vector<Sphere>& spheres);

// The same from the bytes of the two files, whose names are only used in messages. `indices` is read only if the set
// has a materials_file.
Status append_sphere_records(const SphereSet& set, const std::vector<std::uint8_t>& records,
                             const std::vector<std::uint8_t>& indices, std::vector<Sphere>& spheres);

} // namespace rt
