// scene_ranges.h: which numbers a scene may hold, and when a camera is degenerate. The one home of these limits: the
// JSON reader, the binary sphere sets and the interpolation of keyframes ask here.
#pragma once

#include "common/rt_contract.h"
#include "render/scene.h"

#include <string>

namespace rt {

struct NumberRange {
	double least, most;
	bool zero_too = false;  // 0 is allowed besides
	bool open = false;      // the ends themselves are not allowed
	bool magnitude = false; // it is the absolute value that is limited
	bool whole = false;     // integers only

	bool contains(double value) const; // false for NaN
	std::string describe() const;      // "a number from 0 to 1"
};

namespace range {
// A world offset is taken away before the contract's upper limit is asked for (pack.h), so coordinates reach further.
constexpr NumberRange coordinate{RT_MIN_LENGTH, 1e12, true, false, true, false};
constexpr NumberRange radius{RT_MIN_LENGTH, RT_MAX_LENGTH, false, false, true, false};
constexpr NumberRange focus{RT_MIN_LENGTH, RT_MAX_LENGTH, false, false, false, false};
constexpr NumberRange aperture{RT_MIN_LENGTH, RT_MAX_LENGTH, true, false, false, false};
constexpr NumberRange vfov{0, 180, false, true, false, false};
constexpr NumberRange albedo{0, 1, false, false, false, false};
constexpr NumberRange emission{1e-9, 1e9, true, false, false, false};
constexpr NumberRange fuzz{0, 1, false, false, false, false};
constexpr NumberRange ior{1e-3, 1e3, false, false, false, false};
constexpr NumberRange checker_size{0x1p-10, 0x1p+10, false, false, false, false};
constexpr NumberRange image_size{1, 65535, false, false, false, true};
constexpr NumberRange samples{1, RT_MAX_SAMPLES, false, false, false, true};
constexpr NumberRange max_depth{1, 10000, false, false, false, true};
constexpr NumberRange roulette{0, 10000, false, false, false, true};
constexpr NumberRange seed{0, 4294967295.0, false, false, false, true};
constexpr NumberRange frame{0, 1e9, false, false, false, true};
} // namespace range

constexpr std::uint64_t max_spheres = std::uint64_t(1) << 26;

// Whether the sphere's coordinates, as numbers of so many binary digits, come in steps of more than 1e-4 of its radius:
// a world offset has eaten the scene's shape before rt sees it.
bool is_coarse(const Sphere& sphere, int digits);

double distance(const Vec3d& a, const Vec3d& b);

enum class CameraFault { None, SamePoint, NoUp, UpAlongView };

// Whether `from`, `at` and `up` span a frame; scale does not matter.
CameraFault camera_fault(const Camera& camera);

} // namespace rt
