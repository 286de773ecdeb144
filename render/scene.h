// scene.h: what a scene is on the host, in double precision, as the file says it.
//
// Lengths are in the user's units, colours are linear RGB, angles are degrees. A SceneFile may be animated; a
// Scene is one frame of it. pack.h turns a Scene into what the kernels read.
#pragma once

#include "render/sampling.h"
#include "support/hash.h"
#include "support/result.h"

#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace rt {

using Vec3d = std::array<double, 3>;

struct Camera {
	Vec3d from{0, 0, 0};
	Vec3d at{0, 0, 1};
	Vec3d up{0, 1, 0};
	double vfov = 30;    // full vertical angle, degrees, in (0, 180)
	double aperture = 0; // lens diameter, 0 = pinhole
	double focus = 0;    // distance of the plane in focus, > 0; the parser fills |at - from| if absent
};

struct Sky {
	enum class Kind { None, Constant, Gradient };
	Kind kind = Kind::None;
	Vec3d bottom{0, 0, 0}; // Constant: the colour; Gradient: at d.y = -1
	Vec3d top{0, 0, 0};    // Gradient: at d.y = +1
};

struct Texture {
	enum class Kind { Checker, Image };
	std::string name;
	Kind kind = Kind::Checker;
	double size = 0.1;                   // checker: width of a square in units of u and v
	Vec3d even{1, 1, 1}, odd{0, 0, 0};   // checker
	std::uint32_t width = 0, height = 0; // image
	std::vector<std::uint32_t> texels;   // image: 0x00BBGGRR, 8-bit sRGB, row 0 is the top (v = 1)
	std::string file;                    // image: resolved path
};

struct Material {
	enum class Kind { Lambertian, Metal, Dielectric, Light };
	std::string name;
	Kind kind = Kind::Lambertian;
	Vec3d albedo{1, 1, 1};   // lambertian, metal: components in [0, 1]
	Vec3d emission{0, 0, 0}; // light; a lambertian may glow too; components >= 0
	double fuzz = 0;         // metal, in [0, 1]
	double ior = 1.5;        // dielectric, > 0
	int texture = -1;        // lambertian: index into textures, or -1
};

// A negative radius is the hollow-sphere idiom: on a dielectric the index is inverted, elsewhere nothing.
struct Sphere {
	Vec3d center{0, 0, 0};
	double radius = 1;
	std::uint32_t material = 0;
};

// What the scene file asks for; the command line may override each.
struct RenderSettings {
	std::uint32_t width = 640, height = 480;
	std::uint32_t samples = 128;
	std::uint32_t max_depth = 50;
	std::uint32_t seed = 0;
	Sampler sampler = Sampler::Independent;
	Estimator estimator = Estimator::Path;
	std::uint32_t roulette = 0; // scatterings after which Russian roulette may end a path; 0: it never does
};

struct Scene {
	std::string name; // file name without directory and extension, or the name of a built-in scene
	Camera camera;
	Sky sky;
	std::vector<Texture> textures;
	std::vector<Material> materials;
	std::vector<Sphere> spheres;
	RenderSettings render;
	Hash128 hash; // of everything above but `name` and `render`
};

template <class T>
struct Keyframe {
	double frame = 0;
	T value;
};

// A scene that may move. `base` holds frame 0's values; the tracks say what changes.
struct SceneFile {
	Scene base;
	std::vector<Keyframe<Camera>> camera_track; // empty: the camera stands still; frames ascend strictly
	struct SphereTrack {
		std::uint32_t sphere; // index into base.spheres
		std::vector<Keyframe<Sphere>> keys;
	};
	std::vector<SphereTrack> sphere_tracks;

	// Spheres whose coordinates the file itself rounds by more than 1e-4 of their radius (is_coarse()).
	std::uint64_t coarse_spheres = 0;

	// The scene at a frame: values interpolated linearly between keyframes, held before the first and after
	// the last. Fails (Usage, naming the frame) if the interpolated camera is degenerate.
	Result<Scene> at_frame(double frame) const;
};

// Fills scene.hash from the rest of the scene.
void update_scene_hash(Scene& scene);

// `cloud-N`: N spheres of radius spread about a mean in a cube, from a counter-based generator (integers only, so
// the same on every machine); nothing is stored. N in [1, 2^26].
Result<Scene> make_cloud(std::uint64_t count);

} // namespace rt
