#include "tests/double_tracer.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <random>

namespace rt {
namespace {

constexpr double pi = 3.14159265358979323846;
// A ray does not meet what is nearer than this: keeps it from meeting the surface it leaves.
constexpr double nearest = 1e-6;

// ---- vectors ----

Vec3d operator+(const Vec3d& a, const Vec3d& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
Vec3d operator-(const Vec3d& a, const Vec3d& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
Vec3d operator-(const Vec3d& a) { return {-a[0], -a[1], -a[2]}; }
Vec3d operator*(double s, const Vec3d& a) { return {s * a[0], s * a[1], s * a[2]}; }
Vec3d operator*(const Vec3d& a, const Vec3d& b) { return {a[0] * b[0], a[1] * b[1], a[2] * b[2]}; }
double dot(const Vec3d& a, const Vec3d& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
Vec3d cross(const Vec3d& a, const Vec3d& b)
{
	return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
Vec3d unit(const Vec3d& a) { return (1 / std::sqrt(dot(a, a))) * a; }

// ---- random numbers and points ----

class Random {
public:
	explicit Random(std::uint64_t seed) : engine_(seed) {}
	double number() { return static_cast<double>(engine_() >> 11) * 0x1p-53; } // in [0, 1)
	Vec3d on_unit_sphere()
	{
		for (;;) {
			const Vec3d v{2 * number() - 1, 2 * number() - 1, 2 * number() - 1};
			const double square = dot(v, v);
			if (square > 1e-12 && square <= 1)
				return unit(v);
		}
	}
	void in_unit_disc(double& x, double& y)
	{
		do {
			x = 2 * number() - 1;
			y = 2 * number() - 1;
		} while (x * x + y * y > 1);
	}

private:
	std::mt19937_64 engine_;
};

// ---- rays and spheres ----

struct Ray {
	Vec3d from, direction; // direction is unit
};

// The smallest root beyond `nearest` of |from + t direction - center|^2 = radius^2; infinite if there is none.
double distance_to(const Sphere& sphere, const Ray& ray)
{
	const Vec3d oc = ray.from - sphere.center;
	const double half_b = dot(oc, ray.direction);
	const double discriminant = half_b * half_b - (dot(oc, oc) - sphere.radius * sphere.radius);
	if (discriminant < 0)
		return HUGE_VAL;
	const double root = std::sqrt(discriminant);
	if (-half_b - root > nearest)
		return -half_b - root;
	return -half_b + root > nearest ? -half_b + root : HUGE_VAL;
}

class View {
public:
	View(const Camera& camera, const RenderSettings& settings) : settings_(settings), from_(camera.from)
	{
		const Vec3d forward = unit(camera.at - camera.from);
		right_ = unit(cross(forward, camera.up));
		up_ = cross(right_, forward);
		focus_ = camera.aperture > 0 ? camera.focus : 1;
		lens_radius_ = camera.aperture / 2;
		half_height_ = focus_ * std::tan(camera.vfov * pi / 360);
		forward_ = forward;
	}
	Ray ray(std::uint32_t x, std::uint32_t y, Random& random) const
	{
		const double half_width = half_height_ * settings_.width / settings_.height;
		const double across = (2 * (x + random.number()) / settings_.width - 1) * half_width;
		const double above = (1 - 2 * (y + random.number()) / settings_.height) * half_height_;
		const Vec3d target = from_ + focus_ * forward_ + across * right_ + above * up_;
		Vec3d origin = from_;
		if (lens_radius_ > 0) {
			double a, b;
			random.in_unit_disc(a, b);
			origin = from_ + lens_radius_ * a * right_ + lens_radius_ * b * up_;
		}
		return {origin, unit(target - origin)};
	}

private:
	RenderSettings settings_;
	Vec3d from_, right_{}, up_{}, forward_{};
	double focus_ = 1, lens_radius_ = 0, half_height_ = 1;
};

// ---- surfaces ----

double linear_from_srgb(std::uint32_t byte)
{
	const double c = byte / 255.0;
	return c <= 0.04045 ? c / 12.92 : std::pow((c + 0.055) / 1.055, 2.4);
}

Vec3d texture_color(const Texture& texture, const Vec3d& n)
{
	const double theta = std::acos(-n[1]);
	const double phi = n[0] == 0 && n[2] == 0 ? 0 : std::atan2(-n[2], n[0]) + pi;
	const double u = phi / (2 * pi), v = theta / pi;
	if (texture.kind == Texture::Kind::Checker) {
		const double squares = std::floor(u / texture.size) + std::floor(v / texture.size);
		return std::fmod(squares, 2) != 0 ? texture.odd : texture.even;
	}
	const double column = std::min(std::floor(u * texture.width), texture.width - 1.0);
	const double row = std::min(std::floor((1 - v) * texture.height), texture.height - 1.0);
	const std::uint32_t texel =
	    texture.texels[static_cast<std::size_t>(row) * texture.width + static_cast<std::size_t>(column)];
	return {linear_from_srgb(texel & 255), linear_from_srgb(texel >> 8 & 255), linear_from_srgb(texel >> 16 & 255)};
}

// Light that a boundary reflects, by the amplitudes of the two polarisations (n1 on the ray's side).
double fresnel(double n1, double n2, double cos_i)
{
	const double sin_t = n1 / n2 * std::sqrt(1 - cos_i * cos_i);
	if (sin_t >= 1)
		return 1;
	const double cos_t = std::sqrt(1 - sin_t * sin_t);
	const double s = (n1 * cos_i - n2 * cos_t) / (n1 * cos_i + n2 * cos_t);
	const double p = (n1 * cos_t - n2 * cos_i) / (n1 * cos_t + n2 * cos_i);
	return (s * s + p * p) / 2;
}

// Schlick's approximation, with the cosine on the side of the smaller index.
double schlick(double n1, double n2, double cos_i)
{
	const double sin_t = n1 / n2 * std::sqrt(1 - cos_i * cos_i);
	if (sin_t >= 1)
		return 1;
	const double cosine = n1 > n2 ? std::sqrt(1 - sin_t * sin_t) : cos_i;
	const double r0 = (n1 - n2) / (n1 + n2) * ((n1 - n2) / (n1 + n2));
	return r0 + (1 - r0) * std::pow(1 - cosine, 5);
}

Vec3d sky_radiance(const Sky& sky, const Vec3d& direction)
{
	if (sky.kind == Sky::Kind::None)
		return {0, 0, 0};
	if (sky.kind == Sky::Kind::Constant)
		return sky.bottom;
	const double t = 0.5 * (direction[1] + 1);
	return (1 - t) * sky.bottom + t * sky.top;
}

class Tracer {
public:
	Tracer(const Scene& scene, std::uint32_t max_depth, Reflectance reflectance, Random& random)
	    : scene_(scene), max_depth_(max_depth), reflectance_(reflectance), random_(random)
	{
	}

	Vec3d radiance(Ray ray)
	{
		Vec3d gathered{0, 0, 0}, throughput{1, 1, 1};
		for (std::uint32_t depth = 0; depth < max_depth_; ++depth) {
			const Sphere* met = nullptr;
			double t = HUGE_VAL;
			for (const Sphere& sphere : scene_.spheres)
				if (const double distance = distance_to(sphere, ray); distance < t) {
					t = distance;
					met = &sphere;
				}
			if (met == nullptr)
				return gathered + throughput * sky_radiance(scene_.sky, ray.direction);
			const Material& material = scene_.materials[met->material];
			gathered = gathered + throughput * material.emission;
			ray.from = ray.from + t * ray.direction;
			if (!scatter(material, *met, ray, throughput))
				return gathered;
		}
		return gathered;
	}

private:
	// Gives the ray, which stands on the sphere, its new direction; false if it is absorbed.
	bool scatter(const Material& material, const Sphere& sphere, Ray& ray, Vec3d& throughput)
	{
		// A negative radius turns the normal inward; that is all that the idiom means.
		const Vec3d outward = (1 / sphere.radius) * (ray.from - sphere.center);
		const bool front = dot(ray.direction, outward) < 0;
		const Vec3d n = front ? outward : -outward;
		const double cosine = std::min(1.0, -dot(ray.direction, n));
		const Vec3d mirrored = ray.direction + 2 * cosine * n;
		switch (material.kind) {
		case Material::Kind::Light:
			return false;
		case Material::Kind::Lambertian: {
			const Vec3d geometric = sphere.radius < 0 ? -outward : outward;
			throughput = throughput *
			             (material.texture < 0
			                  ? material.albedo
			                  : texture_color(scene_.textures[static_cast<std::size_t>(material.texture)], geometric));
			const Vec3d sum = n + random_.on_unit_sphere();
			ray.direction = dot(sum, sum) > 1e-24 ? unit(sum) : n;
			return true;
		}
		case Material::Kind::Metal:
			throughput = throughput * material.albedo;
			ray.direction = unit(mirrored + material.fuzz * random_.on_unit_sphere());
			return dot(ray.direction, n) > 0;
		case Material::Kind::Dielectric: {
			const double n1 = front ? 1 : material.ior, n2 = front ? material.ior : 1;
			const double reflected =
			    reflectance_ == Reflectance::Fresnel ? fresnel(n1, n2, cosine) : schlick(n1, n2, cosine);
			if (random_.number() < reflected) {
				ray.direction = unit(mirrored);
				return true;
			}
			// Snell: the part along the surface shrinks by n1 / n2, the rest follows from unit length.
			const Vec3d along = (n1 / n2) * (ray.direction + cosine * n);
			ray.direction = unit(along - std::sqrt(std::fabs(1 - dot(along, along))) * n);
			return true;
		}
		}
		return false;
	}

	const Scene& scene_;
	std::uint32_t max_depth_;
	Reflectance reflectance_;
	Random& random_;
};

} // namespace

TracedImage trace_in_double(const Scene& scene, const RenderSettings& settings, Reflectance reflectance)
{
	TracedImage image{settings.width, settings.height, settings.samples, {}};
	Random random(settings.seed);
	Tracer tracer(scene, settings.max_depth, reflectance, random);
	const View view(scene.camera, settings);
	for (std::uint32_t y = 0; y < settings.height; ++y)
		for (std::uint32_t x = 0; x < settings.width; ++x) {
			PixelEstimate pixel;
			Vec3d squares{0, 0, 0}; // sum of squared differences from the mean so far (Welford 1962)
			for (std::uint32_t k = 1; k <= settings.samples; ++k) {
				const Vec3d value = tracer.radiance(view.ray(x, y, random));
				const Vec3d before = value - pixel.mean;
				pixel.mean = pixel.mean + (1.0 / k) * before;
				squares = squares + before * (value - pixel.mean);
			}
			pixel.variance = (1.0 / (settings.samples - 1)) * squares;
			image.pixels.push_back(pixel);
		}
	return image;
}

} // namespace rt
