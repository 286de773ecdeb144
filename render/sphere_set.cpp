#include "render/sphere_set.h"

#include "render/scene_ranges.h"
#include "support/files.h"

#include <fmt/format.h>

#include <cstring>
#include <new>

namespace rt {

namespace {

constexpr std::uint64_t sphere_bytes = 16;
constexpr std::uint64_t index_bytes = 4;

std::uint32_t read_u32(const std::uint8_t* p)
{
	return static_cast<std::uint32_t>(p[0]) | static_cast<std::uint32_t>(p[1]) << 8 |
	       static_cast<std::uint32_t>(p[2]) << 16 | static_cast<std::uint32_t>(p[3]) << 24;
}

double read_f32(const std::uint8_t* p)
{
	const std::uint32_t bits = read_u32(p);
	float value;
	std::memcpy(&value, &bits, sizeof value);
	return value == 0 ? 0 : static_cast<double>(value); // -0 is read as 0
}

Error bad_record(const std::string& file, std::uint64_t record, std::uint64_t offset, std::string message,
                 std::string cure)
{
	return Error{ErrorKind::InputOutput,
	             std::move(message),
	             fmt::format("{}, record {} at byte {}", file, record, offset),
	             std::move(cure),
	             {}};
}

Status append(const SphereSet& set, const std::vector<std::uint8_t>& data, const std::vector<std::uint8_t>& indices,
              std::vector<Sphere>& spheres)
{
	if (data.size() % sphere_bytes != 0)
		return Error{ErrorKind::InputOutput,
		             fmt::format("{} bytes are not a whole number of spheres", data.size()),
		             set.spheres_file,
		             "a sphere is 4 little-endian floats, 16 bytes: x, y, z, radius",
		             {}};
	const std::uint64_t count = data.size() / sphere_bytes;
	if (count > max_spheres - spheres.size())
		return Error{ErrorKind::InputOutput,
		             fmt::format("{} spheres and {} before them are too many", count, spheres.size()),
		             set.spheres_file,
		             fmt::format("a scene has at most {} spheres", max_spheres),
		             {}};

	const bool indexed = !set.materials_file.empty();
	if (indexed && indices.size() != count * index_bytes)
		return Error{ErrorKind::InputOutput,
		             fmt::format("{} bytes do not match the {} spheres of {}", indices.size(), count, set.spheres_file),
		             set.materials_file,
		             fmt::format("one little-endian u32 a sphere: {} bytes", count * index_bytes),
		             {}};

	spheres.reserve(spheres.size() + count);
	for (std::uint64_t i = 0; i < count; ++i) {
		const std::uint8_t* record = data.data() + i * sphere_bytes;
		Sphere sphere;
		for (std::uint32_t k = 0; k < 4; ++k) {
			const NumberRange& limits = k < 3 ? range::coordinate : range::radius;
			const double value = read_f32(record + 4 * k);
			if (!limits.contains(value))
				return bad_record(
				    set.spheres_file, i, i * sphere_bytes + 4 * k,
				    fmt::format("{} is out of range for {}", value, k < 3 ? "a centre's coordinate" : "a radius"),
				    fmt::format("write {}", limits.describe()));
			(k < 3 ? sphere.center[k] : sphere.radius) = value;
		}
		const std::uint32_t index = indexed ? read_u32(indices.data() + i * index_bytes) : 0;
		if (index >= set.materials.size())
			return bad_record(set.materials_file, i, i * index_bytes, fmt::format("there is no material {}", index),
			                  fmt::format("\"materials\" lists {}, counted from 0", set.materials.size()));
		sphere.material = set.materials[index];
		spheres.push_back(sphere);
	}
	return success();
}

} // namespace

Status append_sphere_set(const SphereSet& set, std::vector<Sphere>& spheres)
{
	RT_TRY_ASSIGN(const std::vector<std::uint8_t> records, read_file(set.spheres_file, max_spheres * sphere_bytes));
	std::vector<std::uint8_t> indices;
	if (!set.materials_file.empty()) {
		RT_TRY_ASSIGN(indices, read_file(set.materials_file, max_spheres * index_bytes));
	}
	return append_sphere_records(set, records, indices, spheres);
}

Status append_sphere_records(const SphereSet& set, const std::vector<std::uint8_t>& records,
                             const std::vector<std::uint8_t>& indices, std::vector<Sphere>& spheres)
{
	try {
		return append(set, records, indices, spheres);
	} catch (const std::bad_alloc&) {
		return Error{ErrorKind::Memory, "no memory for the spheres", set.spheres_file, "use a smaller set", {}};
	}
}

} // namespace rt
