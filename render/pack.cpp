#include "render/pack.h"

#include "common/rt_contract.h"
#include "common/rt_features.h"
#include "render/lights.h"
#include "support/float_environment.h"
#include "support/pages.h"

#include <algorithm>
#include <cmath>
#include <fmt/format.h>

namespace rt {
namespace {

// ---- double vectors; every product that feeds a sum is an explicit fma, as in the kernels (contract rule 3) ----

double dot(const Vec3d& a, const Vec3d& b) { return std::fma(a[0], b[0], std::fma(a[1], b[1], a[2] * b[2])); }

Vec3d cross(const Vec3d& a, const Vec3d& b)
{
	return {std::fma(a[1], b[2], -(a[2] * b[1])), std::fma(a[2], b[0], -(a[0] * b[2])),
	        std::fma(a[0], b[1], -(a[1] * b[0]))};
}

Vec3d subtract(const Vec3d& a, const Vec3d& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }

Vec3d scale(double s, const Vec3d& a) { return {s * a[0], s * a[1], s * a[2]}; }

// s a + b
Vec3d scale_add(double s, const Vec3d& a, const Vec3d& b)
{
	return {std::fma(s, a[0], b[0]), std::fma(s, a[1], b[1]), std::fma(s, a[2], b[2])};
}

Vec3d normalized(const Vec3d& a)
{
	const double length = std::sqrt(dot(a, a));
	return {a[0] / length, a[1] / length, a[2] / length};
}

// tan of half an angle in degrees, 0 < degrees < 180, from + * / and fma only: the C library's tan may differ in the
// last bit between machines. Taylor series of sine and cosine on [0, pi/4], where 12 terms are beyond double.
double tan_half_degrees(double degrees)
{
	const double pi_over_360 = 0x1.1df46a2529d39p-7;
	const bool steep = degrees > 90;
	const double x = (steep ? 180 - degrees : degrees) * pi_over_360;
	const double x2 = x * x;
	double sine = 1, cosine = 1;
	for (int k = 12; k >= 1; --k) {
		const double even = 2.0 * k;
		cosine = std::fma(-x2 / (even * (even - 1)), cosine, 1.0);
		sine = std::fma(-x2 / (even * (even + 1)), sine, 1.0);
	}
	sine *= x;
	return steep ? cosine / sine : sine / cosine;
}

// The smallest e with value <= 2^e; value > 0.
int ceil_log2(double value)
{
	int exponent = 0;
	const double mantissa = std::frexp(value, &exponent);
	return mantissa == 0.5 ? exponent - 1 : exponent;
}

double largest(const Vec3d& v) { return std::max({v[0], v[1], v[2]}); }

Error out_of_range(std::string what, double value, std::string cure)
{
	return Error{ErrorKind::Usage,
	             fmt::format("{} is {:g}, outside the range in which rt keeps its promise", what, value),
	             {},
	             std::move(cure),
	             {}};
}

// ---- camera ----

Status pack_camera(const Camera& camera, const RenderSettings& settings, rt_scene& out)
{
	const Vec3d back = normalized(subtract(camera.from, camera.at));
	const Vec3d right = normalized(cross(camera.up, back));
	const Vec3d up = cross(back, right);
	const bool lens = camera.aperture > 0;
	// A pinhole's image plane may be anywhere: at distance 1 nothing depends on the scene's units.
	const double distance = lens ? camera.focus : 1.0;
	const double height = 2 * distance * tan_half_degrees(camera.vfov);
	const double width = height * settings.width / settings.height;
	if (lens && !(distance >= RT_MIN_LENGTH && distance <= RT_MAX_LENGTH))
		return out_of_range("the camera's focus distance", distance, "choose units in which it lies in [2^-30, 2^30]");
	if (lens && !(camera.aperture >= RT_MIN_LENGTH && camera.aperture <= RT_MAX_LENGTH))
		return out_of_range("the camera's aperture", camera.aperture, "use 0 for a pinhole");
	if (!(height >= RT_MIN_LENGTH && width <= RT_MAX_LENGTH))
		return out_of_range("the camera's field of view", camera.vfov, "choose vfov further from 0 and 180 degrees");

	const Vec3d corner = scale_add(-distance, back, scale_add(-width / 2, right, scale(height / 2, up)));
	const Vec3d step_x = scale(width / settings.width, right);
	const Vec3d step_y = scale(-height / settings.height, up);
	const Vec3d lens_u = scale(camera.aperture / 2, right);
	const Vec3d lens_v = scale(camera.aperture / 2, up);
	const auto store = [](const Vec3d& v, float& x, float& y, float& z) {
		x = static_cast<float>(v[0]);
		y = static_cast<float>(v[1]);
		z = static_cast<float>(v[2]);
	};
	store(corner, out.corner_x, out.corner_y, out.corner_z);
	store(step_x, out.step_x_x, out.step_x_y, out.step_x_z);
	store(step_y, out.step_y_x, out.step_y_y, out.step_y_z);
	store(lens_u, out.lens_u_x, out.lens_u_y, out.lens_u_z);
	store(lens_v, out.lens_v_x, out.lens_v_y, out.lens_v_z);
	return success();
}

// ---- sky ----

void pack_sky(const Sky& sky, rt_scene& out)
{
	if (sky.kind == Sky::Kind::None)
		return;
	const Vec3d delta = sky.kind == Sky::Kind::Gradient ? subtract(sky.top, sky.bottom) : Vec3d{0, 0, 0};
	out.sky_bottom_r = static_cast<float>(sky.bottom[0]);
	out.sky_bottom_g = static_cast<float>(sky.bottom[1]);
	out.sky_bottom_b = static_cast<float>(sky.bottom[2]);
	out.sky_delta_r = static_cast<float>(delta[0]);
	out.sky_delta_g = static_cast<float>(delta[1]);
	out.sky_delta_b = static_cast<float>(delta[2]);
}

// ---- materials and textures ----

rt_material pack_material(const Material& material, bool hollow)
{
	rt_material out{};
	out.albedo_r = static_cast<float>(material.albedo[0]);
	out.albedo_g = static_cast<float>(material.albedo[1]);
	out.albedo_b = static_cast<float>(material.albedo[2]);
	out.emission_r = static_cast<float>(material.emission[0]);
	out.emission_g = static_cast<float>(material.emission[1]);
	out.emission_b = static_cast<float>(material.emission[2]);
	out.ior = out.ior_inverse = 1.0f;
	out.texture = RT_NO_TEXTURE;
	switch (material.kind) {
	case Material::Kind::Lambertian:
		out.kind = RT_MATERIAL_LAMBERTIAN;
		if (material.texture >= 0)
			out.texture = static_cast<std::uint32_t>(material.texture);
		break;
	case Material::Kind::Metal:
		out.kind = RT_MATERIAL_METAL;
		out.fuzz = static_cast<float>(material.fuzz);
		break;
	case Material::Kind::Dielectric:
		out.kind = RT_MATERIAL_DIELECTRIC;
		out.albedo_r = out.albedo_g = out.albedo_b = 1.0f;
		out.ior = static_cast<float>(hollow ? 1 / material.ior : material.ior);
		out.ior_inverse = static_cast<float>(hollow ? material.ior : 1 / material.ior);
		break;
	case Material::Kind::Light:
		out.kind = RT_MATERIAL_LIGHT;
		break;
	}
	return out;
}

void pack_textures(const Scene& scene, PackedScene& out)
{
	for (const Texture& texture : scene.textures) {
		rt_texture packed{};
		if (texture.kind == Texture::Kind::Checker) {
			packed.kind = RT_TEXTURE_CHECKER;
			packed.squares = static_cast<float>(1 / texture.size);
			packed.even_r = static_cast<float>(texture.even[0]);
			packed.even_g = static_cast<float>(texture.even[1]);
			packed.even_b = static_cast<float>(texture.even[2]);
			packed.odd_r = static_cast<float>(texture.odd[0]);
			packed.odd_g = static_cast<float>(texture.odd[1]);
			packed.odd_b = static_cast<float>(texture.odd[2]);
		} else {
			packed.kind = RT_TEXTURE_IMAGE;
			packed.first_texel = static_cast<std::uint32_t>(out.texels.size());
			packed.width = texture.width;
			packed.height = texture.height;
			out.texels.insert(out.texels.end(), texture.texels.begin(), texture.texels.end());
		}
		out.textures.push_back(packed);
	}
}

// ---- spheres ----

// A difference of doubles may leave a remnant where the exact difference is 0; squared as a float it would be
// subnormal. Relative to the sphere's own distance it is nothing.
double without_remnant(double value, double size) { return std::fabs(value) < size * 0x1p-45 ? 0.0 : value; }

Status check_sphere(std::size_t index, const Vec3d& center, double radius)
{
	const double distance = std::sqrt(dot(center, center));
	if (!(radius >= RT_MIN_LENGTH && radius <= RT_MAX_LENGTH))
		return out_of_range(fmt::format("sphere {}'s radius", index), radius,
		                    "choose units in which radii lie in [2^-30, 2^30] (1e-9 to 1e9)");
	if (!(distance <= RT_MAX_LENGTH))
		return out_of_range(fmt::format("sphere {}'s distance from the camera", index), distance,
		                    "keep it below 2^30 (1e9)");
	if (!(distance <= RT_MAX_DISTANCE_IN_RADII * radius))
		return out_of_range(fmt::format("sphere {}'s distance from the camera in its radii", index), distance / radius,
		                    "a sphere must be nearer than 2^24 (1.6e7) of its radii");
	return success();
}

// Fills spheres, wide, ids and materials; returns the used materials by file index and hollowness in materials.
Status pack_spheres(const Scene& scene, PackedScene& out)
{
	double smallest = HUGE_VAL;
	for (const Sphere& sphere : scene.spheres)
		smallest = std::min(smallest, std::fabs(sphere.radius));

	// Each (material, hollow) pair that a sphere uses becomes a packed material, in order of first use.
	std::vector<std::int64_t> packed_material(scene.materials.size() * 2, -1);
	out.reserve_spheres(scene.spheres.size());
	for (const bool wide_pass : {true, false}) {
		for (std::size_t i = 0; i < scene.spheres.size(); ++i) {
			const Sphere& sphere = scene.spheres[i];
			const double radius = std::fabs(sphere.radius);
			Vec3d center = subtract(sphere.center, scene.camera.from);
			const double reach = RT_WIDE_REACH * radius;
			const bool is_wide = radius >= RT_WIDE_RATIO * smallest && dot(center, center) <= reach * reach;
			if (is_wide != wide_pass)
				continue;
			RT_TRY(check_sphere(i, center, radius));
			const double size = std::max({std::fabs(center[0]), std::fabs(center[1]), std::fabs(center[2]), radius});
			for (double& c : center)
				c = without_remnant(c, size);

			out.spheres.push_back({static_cast<float>(center[0]), static_cast<float>(center[1]),
			                       static_cast<float>(center[2]), static_cast<float>(radius)});
			if (wide_pass) {
				// From the unrounded centre and radius: the surface near the camera is where the file says.
				const double c0 = std::fma(-radius, radius, dot(center, center));
				rt_wide wide{};
				wide.c0_high = static_cast<float>(c0);
				wide.c0_low = static_cast<float>(c0 - static_cast<double>(wide.c0_high));
				out.wide.push_back(wide);
			}
			const Material& material = scene.materials[sphere.material];
			const bool hollow = sphere.radius < 0 && material.kind == Material::Kind::Dielectric;
			std::int64_t& slot = packed_material[sphere.material * 2 + (hollow ? 1 : 0)];
			if (slot < 0) {
				slot = static_cast<std::int64_t>(out.materials.size());
				out.materials.push_back(pack_material(material, hollow));
			}
			out.sphere_ids.push_back(static_cast<std::uint32_t>(out.sphere_ids.size()));
			out.sphere_materials.push_back(static_cast<std::uint32_t>(slot));
		}
	}
	return success();
}

// ---- what the scene needs, and how bright it gets ----

std::uint32_t features_of(const Scene& scene, const PackedScene& packed)
{
	std::uint32_t features = 0;
	const auto emits = [](const rt_material& m) { return m.emission_r > 0 || m.emission_g > 0 || m.emission_b > 0; };
	for (const rt_material& material : packed.materials) {
		if (emits(material) || material.kind == RT_MATERIAL_LIGHT)
			features |= RT_FEATURE_EMISSION;
		if (material.kind == RT_MATERIAL_LAMBERTIAN)
			features |= RT_FEATURE_LAMBERTIAN;
		if (material.kind == RT_MATERIAL_METAL)
			features |= RT_FEATURE_METAL | (material.fuzz > 0 ? RT_FEATURE_FUZZ : 0u);
		if (material.kind == RT_MATERIAL_DIELECTRIC)
			features |= RT_FEATURE_DIELECTRIC;
		if (material.texture != RT_NO_TEXTURE)
			features |=
			    packed.textures[material.texture].kind == RT_TEXTURE_IMAGE ? RT_FEATURE_IMAGE : RT_FEATURE_CHECKER;
	}
	if (scene.camera.aperture > 0)
		features |= RT_FEATURE_DEFOCUS;
	const rt_scene& s = packed.scene;
	const bool changes = s.sky_delta_r != 0 || s.sky_delta_g != 0 || s.sky_delta_b != 0;
	if (changes)
		features |= RT_FEATURE_GRADIENT;
	if (changes || s.sky_bottom_r > 0 || s.sky_bottom_g > 0 || s.sky_bottom_b > 0)
		features |= RT_FEATURE_SKY;
	if (!packed.wide.empty())
		features |= RT_FEATURE_WIDE;
	return features;
}

// What is asked for beside the scene.
std::uint32_t features_of(const RenderSettings& settings)
{
	std::uint32_t features = 0;
	if (settings.sampler == Sampler::Sobol)
		features |= RT_FEATURE_SOBOL;
	if (settings.sampler == Sampler::Stratified)
		features |= RT_FEATURE_STRATIFIED;
	if (settings.roulette > 0)
		features |= RT_FEATURE_ROULETTE;
	return features;
}

// 1 + a + a^2 + ..., so many terms; at least the true sum but for roundings.
double geometric_series(double a, std::uint32_t terms)
{
	if (a >= 1)
		return terms;
	double sum = 0;
	for (std::uint32_t k = 0; k < terms; ++k) {
		const double next = std::fma(sum, a, 1.0);
		if (next == sum)
			break;
		sum = next;
	}
	return sum;
}

// What the rays that a path aims at lamps can add. The k-th diffuse surface on the way, k = 1, 2, ..., aims with a
// throughput of at most A^k, A being the largest albedo of such surfaces, and the last of max_depth surfaces aims no
// more. The weight W = 2 (1 - cos_max) cos / p of an aimed ray (kernels/light.h) is at most 2 / p, since both factors
// are at most 1. With multiple importance sampling it is W / (1 + W^2), at most 1/2 for any p.
double largest_aimed(const Scene& scene, const RenderSettings& settings, const PackedScene& packed)
{
	if (packed.lights.empty())
		return 0;
	double emission = 0, albedo = 0;
	for (const Material& material : scene.materials) {
		emission = std::max(emission, largest(material.emission));
		if (material.kind == Material::Kind::Lambertian)
			albedo = std::max(albedo, material.texture < 0 ? largest(material.albedo) : 1.0);
	}
	if (settings.roulette > 0)
		albedo = 1; // it gives back what albedos took
	const double once = packed.scene.estimator == RT_ESTIMATOR_MIS ? emission / 2 : 2 * brightest_choice(packed);
	return once * albedo * geometric_series(albedo, settings.max_depth - 1);
}

// The largest radiance that a sample can gather where lamps are met by chance. A surface that both emits and scatters
// adds up along a path: at most the geometric series of the largest albedo.
double largest_radiance(const Scene& scene, const RenderSettings& settings)
{
	double sky = 0;
	if (scene.sky.kind != Sky::Kind::None)
		sky = std::max(largest(scene.sky.bottom), scene.sky.kind == Sky::Kind::Gradient ? largest(scene.sky.top) : 0.0);
	double emission = 0, albedo = 0;
	bool glows = false;
	for (const Material& material : scene.materials) {
		emission = std::max(emission, largest(material.emission));
		if (material.kind == Material::Kind::Light)
			continue;
		glows = glows || largest(material.emission) > 0;
		const bool own_albedo = material.kind != Material::Kind::Dielectric && material.texture < 0;
		albedo = std::max(albedo, own_albedo ? largest(material.albedo) : 1.0);
		if (settings.roulette > 0)
			albedo = 1; // it gives back what albedos took (kernels/roulette.h)
	}
	if (!glows)
		return std::max(sky, emission);
	return std::fma(emission, geometric_series(albedo, settings.max_depth), sky);
}

} // namespace

std::uint64_t PackedScene::bytes() const
{
	return sizeof(rt_scene) + spheres.size() * sizeof(rt_sphere) + wide.size() * sizeof(rt_wide) +
	       (sphere_ids.size() + sphere_materials.size() + texels.size()) * sizeof(std::uint32_t) +
	       lights.size() * sizeof(rt_light) + bvh.size() * sizeof(rt_row4) + materials.size() * sizeof(rt_material) +
	       textures.size() * sizeof(rt_texture);
}

void PackedScene::reserve_spheres(std::size_t count)
{
	reserve_pages(spheres, count);
	reserve_pages(sphere_ids, count);
	reserve_pages(sphere_materials, count);
}

void PackedScene::free_lists()
{
	PackedScene rest;
	rest.scene = scene;
	rest.features = features;
	rest.film_exponent = film_exponent;
	*this = std::move(rest);
}

Result<PackedScene> pack_scene(const Scene& scene, const RenderSettings& settings, const Window& window)
{
	if (window.width == 0 || window.height == 0 || std::uint64_t(window.x) + window.width > settings.width ||
	    std::uint64_t(window.y) + window.height > settings.height)
		return Error{ErrorKind::Usage,
		             fmt::format("the part to render, {}x{} at ({}, {}), does not lie in the image of {}x{} pixels",
		                         window.width, window.height, window.x, window.y, settings.width, settings.height),
		             {},
		             "choose a part within the image",
		             {}};
	if (settings.samples > RT_MAX_SAMPLES)
		return Error{ErrorKind::Usage,
		             fmt::format("{} samples a pixel could overflow the film's sums", settings.samples),
		             {},
		             fmt::format("use at most {}", RT_MAX_SAMPLES),
		             {}};

	const ContractFloatEnvironment environment;
	PackedScene packed;
	packed.scene.width = settings.width;
	packed.scene.height = settings.height;
	packed.scene.window_x = window.x;
	packed.scene.window_y = window.y;
	packed.scene.window_width = window.width;
	packed.scene.window_height = window.height;
	packed.scene.seed = settings.seed;
	packed.scene.max_depth = settings.max_depth;
	packed.scene.sampler = static_cast<std::uint32_t>(settings.sampler);
	packed.scene.estimator = static_cast<std::uint32_t>(settings.estimator);
	packed.scene.roulette = settings.roulette;
	RT_TRY(pack_camera(scene.camera, settings, packed.scene));
	pack_sky(scene.sky, packed.scene);
	pack_textures(scene, packed);
	RT_TRY(pack_spheres(scene, packed));
	packed.scene.sphere_count = static_cast<std::uint32_t>(packed.spheres.size());
	packed.scene.wide_count = static_cast<std::uint32_t>(packed.wide.size());
	packed.scene.bvh_root = RT_BVH_NONE;
	packed.features = features_of(scene, packed) | features_of(settings);
	RT_TRY(pack_lights(packed));

	const double brightest = largest_radiance(scene, settings) + largest_aimed(scene, settings, packed);
	const int ceiling = brightest > 0 ? ceil_log2(brightest) : 0;
	packed.film_exponent = RT_FILM_BITS - ceiling;
	packed.scene.film_scale = std::ldexp(1.0f, packed.film_exponent);
	packed.scene.film_scale_high = std::ldexp(1.0f, packed.film_exponent - 20);
	// One binade of room, so that rounding on the way cannot push a bright sample over the edge.
	packed.scene.radiance_limit = std::ldexp(1.0f, ceiling + 1);
	return packed;
}

PackedScene permute_spheres(const PackedScene& packed, const std::vector<std::uint32_t>& order)
{
	PackedScene out = packed;
	for (std::size_t stored = 0; stored < order.size(); ++stored) {
		const std::uint32_t source = order[stored];
		out.spheres[stored] = packed.spheres[source];
		out.sphere_ids[stored] = packed.sphere_ids[source];
		out.sphere_materials[stored] = packed.sphere_materials[source];
		if (stored < packed.wide.size())
			out.wide[stored] = packed.wide[source];
	}
	follow_spheres(packed, out);
	out.features |= RT_FEATURE_PERMUTED;
	return out;
}

std::vector<std::string> feature_names(std::uint32_t features)
{
	std::vector<std::string> names;
#define RT_FEATURE_NAME(bit, name, what) \
	if ((features & (bit)) != 0)         \
		names.emplace_back(name);
	RT_FEATURE_LIST(RT_FEATURE_NAME)
#undef RT_FEATURE_NAME
	return names;
}

} // namespace rt
