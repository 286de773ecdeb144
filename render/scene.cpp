#include "render/scene.h"

#include "render/scene_ranges.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>

namespace rt {

namespace {

double square_length(const Vec3d& v) { return std::fma(v[0], v[0], std::fma(v[1], v[1], v[2] * v[2])); }

Vec3d difference(const Vec3d& a, const Vec3d& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }

Vec3d cross(const Vec3d& a, const Vec3d& b)
{
	return {std::fma(a[1], b[2], -(a[2] * b[1])), std::fma(a[2], b[0], -(a[0] * b[2])),
	        std::fma(a[0], b[1], -(a[1] * b[0]))};
}

// --- interpolation ---

double lerp(double a, double b, double t) { return std::fma(t, b - a, a); }

// A coordinate that passes through zero may come out as a rounding residue, which no length of the contract may be.
double lerp_coordinate(double a, double b, double t)
{
	const double value = lerp(a, b, t);
	return std::abs(value) < RT_MIN_LENGTH ? 0 : value;
}

Vec3d lerp_point(const Vec3d& a, const Vec3d& b, double t)
{
	return {lerp_coordinate(a[0], b[0], t), lerp_coordinate(a[1], b[1], t), lerp_coordinate(a[2], b[2], t)};
}

Camera interpolate(const Camera& a, const Camera& b, double t)
{
	Camera camera;
	camera.from = lerp_point(a.from, b.from, t);
	camera.at = lerp_point(a.at, b.at, t);
	camera.up = lerp_point(a.up, b.up, t);
	camera.vfov = lerp(a.vfov, b.vfov, t);
	camera.aperture = lerp_coordinate(a.aperture, b.aperture, t);
	camera.focus = lerp(a.focus, b.focus, t);
	return camera;
}

Sphere interpolate(const Sphere& a, const Sphere& b, double t)
{
	return {lerp_point(a.center, b.center, t), lerp(a.radius, b.radius, t), a.material};
}

// The value at a frame; at a keyframe it is exactly the keyframe's.
template <class T>
T value_at(const std::vector<Keyframe<T>>& keys, double frame)
{
	const auto after = std::upper_bound(keys.begin(), keys.end(), frame,
	                                    [](double f, const Keyframe<T>& key) { return f < key.frame; });
	if (after == keys.begin())
		return keys.front().value;
	const auto before = after - 1;
	if (after == keys.end() || before->frame == frame)
		return before->value;
	const double t = (frame - before->frame) / (after->frame - before->frame);
	return interpolate(before->value, after->value, t);
}

// --- hashing: a canonical byte form, the same on every machine ---

// Gathers values as little-endian bytes and hashes them in blocks: clouds have tens of millions of values.
class SceneHasher {
public:
	void u32(std::uint32_t value) { bytes<4>(value); }
	void u64(std::uint64_t value) { bytes<8>(value); }
	void number(double value)
	{
		std::uint64_t bits;
		std::memcpy(&bits, &value, sizeof bits);
		u64(bits);
	}
	void vector(const Vec3d& v)
	{
		for (const double x : v)
			number(x);
	}
	Hash128 result()
	{
		flush();
		return hasher_.result();
	}

private:
	// Lowest byte first. In this form compilers see one store.
	template <std::size_t Count>
	void bytes(std::uint64_t value)
	{
		unsigned char* at = block_.data() + used_;
		for (std::size_t i = 0; i < Count; ++i)
			at[i] = static_cast<unsigned char>(value >> (8 * i));
		used_ += Count;
		if (used_ > block_.size() - 8)
			flush();
	}

	void flush()
	{
		hasher_.add(block_.data(), used_);
		used_ = 0;
	}

	std::array<unsigned char, 16384> block_;
	std::size_t used_ = 0;
	Hasher hasher_;
};

} // namespace

bool is_coarse(const Sphere& sphere, int digits)
{
	const Vec3d& c = sphere.center;
	const double largest = std::max({std::fabs(c[0]), std::fabs(c[1]), std::fabs(c[2])});
	return largest > 0 && std::ldexp(1.0, std::ilogb(largest) - digits + 1) > 1e-4 * std::fabs(sphere.radius);
}

double distance(const Vec3d& a, const Vec3d& b) { return std::sqrt(square_length(difference(a, b))); }

bool NumberRange::contains(double value) const
{
	const double limited = magnitude ? std::abs(value) : value;
	if (zero_too && limited == 0)
		return true;
	if (whole && std::floor(limited) != limited)
		return false;
	return open ? limited > least && limited < most : limited >= least && limited <= most;
}

std::string NumberRange::describe() const
{
	std::string text = whole ? "a whole number " : "a number ";
	if (magnitude)
		text += "whose absolute value lies ";
	const auto end = [](double value) {
		return value == std::floor(value) && std::abs(value) < 1e11 ? fmt::format("{:.0f}", value)
		                                                            : fmt::format("{:.4g}", value);
	};
	text += open        ? fmt::format("between {} and {}, the ends excluded", end(least), end(most))
	        : magnitude ? fmt::format("between {} and {}", end(least), end(most))
	                    : fmt::format("from {} to {}", end(least), end(most));
	return zero_too ? text + ", or 0" : text;
}

CameraFault camera_fault(const Camera& camera)
{
	const Vec3d view = difference(camera.at, camera.from);
	const double view_square = square_length(view);
	const double up_square = square_length(camera.up);
	if (!(view_square > 0))
		return CameraFault::SamePoint;
	if (!(up_square > 0))
		return CameraFault::NoUp;
	// The sine of the angle between them, squared; below 2^-20 the frame would be made of rounding errors.
	const double sine_square = square_length(cross(view, camera.up)) / view_square / up_square;
	return sine_square > 0x1p-40 ? CameraFault::None : CameraFault::UpAlongView;
}

Result<Scene> SceneFile::at_frame(double frame) const
{
	if (!std::isfinite(frame) || frame < 0)
		return Error{
		    ErrorKind::Usage, fmt::format("there is no frame {}", frame), base.name, "frames are counted from 0", {}};
	Scene scene = base;
	if (camera_track.empty() && sphere_tracks.empty())
		return scene;
	if (!camera_track.empty())
		scene.camera = value_at(camera_track, frame);
	if (camera_fault(scene.camera) != CameraFault::None)
		return Error{ErrorKind::Usage,
		             fmt::format("the camera has no direction in frame {}", frame),
		             fmt::format("{}, $.camera", base.name),
		             "between keyframes \"from\" passes through \"at\", or the view turns parallel to \"up\": add a "
		             "keyframe there",
		             {}};
	for (const SphereTrack& track : sphere_tracks)
		scene.spheres[track.sphere] = value_at(track.keys, frame);
	update_scene_hash(scene);
	return scene;
}

void update_scene_hash(Scene& scene)
{
	// Names and paths are left out: they cannot reach a pixel, and a path differs from machine to machine.
	SceneHasher hasher;
	hasher.u32(1); // version of this form
	hasher.vector(scene.camera.from);
	hasher.vector(scene.camera.at);
	hasher.vector(scene.camera.up);
	hasher.number(scene.camera.vfov);
	hasher.number(scene.camera.aperture);
	hasher.number(scene.camera.focus);

	hasher.u32(static_cast<std::uint32_t>(scene.sky.kind));
	hasher.vector(scene.sky.bottom);
	hasher.vector(scene.sky.top);

	hasher.u64(scene.textures.size());
	for (const Texture& texture : scene.textures) {
		hasher.u32(static_cast<std::uint32_t>(texture.kind));
		hasher.number(texture.size);
		hasher.vector(texture.even);
		hasher.vector(texture.odd);
		hasher.u32(texture.width);
		hasher.u32(texture.height);
		hasher.u64(texture.texels.size());
		for (const std::uint32_t texel : texture.texels)
			hasher.u32(texel);
	}

	hasher.u64(scene.materials.size());
	for (const Material& material : scene.materials) {
		hasher.u32(static_cast<std::uint32_t>(material.kind));
		hasher.vector(material.albedo);
		hasher.vector(material.emission);
		hasher.number(material.fuzz);
		hasher.number(material.ior);
		hasher.u32(static_cast<std::uint32_t>(material.texture));
	}

	hasher.u64(scene.spheres.size());
	for (const Sphere& sphere : scene.spheres) {
		hasher.vector(sphere.center);
		hasher.number(sphere.radius);
		hasher.u32(sphere.material);
	}
	scene.hash = hasher.result();
}

} // namespace rt
