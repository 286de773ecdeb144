#include "tests/textbook_tracer.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <random>

namespace rt {
namespace {

constexpr double pi = 3.14159265358979323846;

// What a textbook's tracer in `Number` is made of. `nearest`: a ray does not meet what is nearer than this, which keeps
// it from meeting the surface that it leaves; as numerics goes, the book's 1e-3 is for float, double can do with less.
template <class Number>
struct Book;
template <>
struct Book<double> {
	static constexpr double nearest = 1e-6;
};
template <>
struct Book<float> {
	static constexpr float nearest = 1e-3f;
};
// ---- vectors ----

template <class Number>
using Vec = std::array<Number, 3>;

template <class Number>
Vec<Number> operator+(const Vec<Number>& a, const Vec<Number>& b)
{
	return {a[0] + b[0], a[1] + b[1], a[2] + b[2]};
}
template <class Number>
Vec<Number> operator-(const Vec<Number>& a, const Vec<Number>& b)
{
	return {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
}
template <class Number>
Vec<Number> operator-(const Vec<Number>& a)
{
	return {-a[0], -a[1], -a[2]};
}
template <class Number>
Vec<Number> operator*(Number s, const Vec<Number>& a)
{
	return {s * a[0], s * a[1], s * a[2]};
}
template <class Number>
Vec<Number> operator*(const Vec<Number>& a, const Vec<Number>& b)
{
	return {a[0] * b[0], a[1] * b[1], a[2] * b[2]};
}
template <class Number>
Number dot(const Vec<Number>& a, const Vec<Number>& b)
{
	return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
template <class Number>
Vec<Number> cross(const Vec<Number>& a, const Vec<Number>& b)
{
	return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
template <class Number>
Vec<Number> unit(const Vec<Number>& a)
{
	return (1 / std::sqrt(dot(a, a))) * a;
}
template <class Number>
Vec<Number> to(const Vec3d& a)
{
	return {static_cast<Number>(a[0]), static_cast<Number>(a[1]), static_cast<Number>(a[2])};
}

// ---- random numbers and points ----

template <class Number>
class Random {
public:
	explicit Random(std::uint64_t seed) : engine_(seed) {}
	// in [0, 1): as many bits as the type has
	Number number()
	{
		constexpr int bits = std::numeric_limits<Number>::digits;
		return std::ldexp(static_cast<Number>(engine_() >> (64 - bits)), -bits);
	}
	Vec<Number> on_unit_sphere()
	{
		for (;;) {
			const Vec<Number> v{2 * number() - 1, 2 * number() - 1, 2 * number() - 1};
			const Number square = dot(v, v);
			if (square > Number(1e-12) && square <= 1)
				return unit(v);
		}
	}
	void in_unit_disc(Number& x, Number& y)
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

template <class Number>
struct Ray {
	Vec<Number> from, direction; // direction is unit
};

// The smallest root beyond the nearest of |from + t direction - center|^2 = radius^2; infinite if there is none.
template <class Number>
Number distance_to(const Sphere& sphere, const Ray<Number>& ray)
{
	constexpr Number nearest = Book<Number>::nearest;
	const auto radius = static_cast<Number>(sphere.radius);
	const Vec<Number> oc = ray.from - to<Number>(sphere.center);
	const Number half_b = dot(oc, ray.direction);
	const Number discriminant = half_b * half_b - (dot(oc, oc) - radius * radius);
	if (discriminant < 0)
		return std::numeric_limits<Number>::infinity();
	const Number root = std::sqrt(discriminant);
	if (-half_b - root > nearest)
		return -half_b - root;
	return -half_b + root > nearest ? -half_b + root : std::numeric_limits<Number>::infinity();
}

template <class Number>
class View {
public:
	View(const Camera& camera, const RenderSettings& settings) : settings_(settings), from_(to<Number>(camera.from))
	{
		const Vec<Number> forward = unit(to<Number>(camera.at) - from_);
		right_ = unit(cross(forward, to<Number>(camera.up)));
		up_ = cross(right_, forward);
		focus_ = camera.aperture > 0 ? static_cast<Number>(camera.focus) : 1;
		lens_radius_ = static_cast<Number>(camera.aperture / 2);
		half_height_ = focus_ * static_cast<Number>(std::tan(camera.vfov * pi / 360));
		forward_ = forward;
	}
	Ray<Number> ray(std::uint32_t x, std::uint32_t y, Random<Number>& random) const
	{
		const auto width = static_cast<Number>(settings_.width), height = static_cast<Number>(settings_.height);
		const Number half_width = half_height_ * width / height;
		const Number across = (2 * (static_cast<Number>(x) + random.number()) / width - 1) * half_width;
		const Number above = (1 - 2 * (static_cast<Number>(y) + random.number()) / height) * half_height_;
		const Vec<Number> target = from_ + focus_ * forward_ + across * right_ + above * up_;
		Vec<Number> origin = from_;
		if (lens_radius_ > 0) {
			Number a = 0, b = 0;
			random.in_unit_disc(a, b);
			origin = from_ + lens_radius_ * a * right_ + lens_radius_ * b * up_;
		}
		return {origin, unit(target - origin)};
	}

private:
	RenderSettings settings_;
	Vec<Number> from_, right_{}, up_{}, forward_{};
	Number focus_ = 1, lens_radius_ = 0, half_height_ = 1;
};

// ---- surfaces ----

template <class Number>
Number linear_from_srgb(std::uint32_t byte)
{
	const double c = byte / 255.0;
	return static_cast<Number>(c <= 0.04045 ? c / 12.92 : std::pow((c + 0.055) / 1.055, 2.4));
}

template <class Number>
Vec<Number> texture_color(const Texture& texture, const Vec<Number>& n)
{
	const Number theta = std::acos(-n[1]);
	const Number phi = n[0] == 0 && n[2] == 0 ? 0 : std::atan2(-n[2], n[0]) + Number(pi);
	const Number u = phi / (2 * Number(pi)), v = theta / Number(pi);
	if (texture.kind == Texture::Kind::Checker) {
		const auto size = static_cast<Number>(texture.size);
		const Number squares = std::floor(u / size) + std::floor(v / size);
		return to<Number>(std::fmod(squares, Number(2)) != 0 ? texture.odd : texture.even);
	}
	const auto width = static_cast<Number>(texture.width), height = static_cast<Number>(texture.height);
	const Number column = std::min(std::floor(u * width), width - 1);
	const Number row = std::min(std::floor((1 - v) * height), height - 1);
	const std::uint32_t texel =
	    texture.texels[static_cast<std::size_t>(row) * texture.width + static_cast<std::size_t>(column)];
	return {linear_from_srgb<Number>(texel & 255), linear_from_srgb<Number>(texel >> 8 & 255),
	        linear_from_srgb<Number>(texel >> 16 & 255)};
}

// Light that a boundary reflects, by the amplitudes of the two polarisations (n1 on the ray's side).
template <class Number>
Number fresnel(Number n1, Number n2, Number cos_i)
{
	const Number sin_t = n1 / n2 * std::sqrt(1 - cos_i * cos_i);
	if (sin_t >= 1)
		return 1;
	const Number cos_t = std::sqrt(1 - sin_t * sin_t);
	const Number s = (n1 * cos_i - n2 * cos_t) / (n1 * cos_i + n2 * cos_t);
	const Number p = (n1 * cos_t - n2 * cos_i) / (n1 * cos_t + n2 * cos_i);
	return (s * s + p * p) / 2;
}

// Schlick's approximation, with the cosine on the side of the smaller index.
template <class Number>
Number schlick(Number n1, Number n2, Number cos_i)
{
	const Number sin_t = n1 / n2 * std::sqrt(1 - cos_i * cos_i);
	if (sin_t >= 1)
		return 1;
	const Number cosine = n1 > n2 ? std::sqrt(1 - sin_t * sin_t) : cos_i;
	const Number r0 = (n1 - n2) / (n1 + n2) * ((n1 - n2) / (n1 + n2));
	return r0 + (1 - r0) * std::pow(1 - cosine, Number(5));
}

template <class Number>
Vec<Number> sky_radiance(const Sky& sky, const Vec<Number>& direction)
{
	if (sky.kind == Sky::Kind::None)
		return {0, 0, 0};
	if (sky.kind == Sky::Kind::Constant)
		return to<Number>(sky.bottom);
	const Number t = Number(0.5) * (direction[1] + 1);
	return (1 - t) * to<Number>(sky.bottom) + t * to<Number>(sky.top);
}

template <class Number>
class Tracer {
public:
	Tracer(const Scene& scene, std::uint32_t max_depth, Reflectance reflectance, Random<Number>& random)
	    : scene_(scene), max_depth_(max_depth), reflectance_(reflectance), random_(random)
	{
	}

	Vec<Number> radiance(Ray<Number> ray)
	{
		Vec<Number> gathered{0, 0, 0}, throughput{1, 1, 1};
		for (std::uint32_t depth = 0; depth < max_depth_; ++depth) {
			const Sphere* met = nullptr;
			Number t = std::numeric_limits<Number>::infinity();
			for (const Sphere& sphere : scene_.spheres)
				if (const Number distance = distance_to(sphere, ray); distance < t) {
					t = distance;
					met = &sphere;
				}
			if (met == nullptr)
				return gathered + throughput * sky_radiance<Number>(scene_.sky, ray.direction);
			const Material& material = scene_.materials[met->material];
			gathered = gathered + throughput * to<Number>(material.emission);
			ray.from = ray.from + t * ray.direction;
			if (!scatter(material, *met, ray, throughput))
				return gathered;
		}
		return gathered;
	}

private:
	// Gives the ray, which stands on the sphere, its new direction; false if it is absorbed.
	bool scatter(const Material& material, const Sphere& sphere, Ray<Number>& ray, Vec<Number>& throughput)
	{
		// A negative radius turns the normal inward; that is all that the idiom means.
		const Vec<Number> outward = (1 / static_cast<Number>(sphere.radius)) * (ray.from - to<Number>(sphere.center));
		const bool front = dot(ray.direction, outward) < 0;
		const Vec<Number> n = front ? outward : -outward;
		const Number cosine = std::min(Number(1), -dot(ray.direction, n));
		const Vec<Number> mirrored = ray.direction + 2 * cosine * n;
		switch (material.kind) {
		case Material::Kind::Light:
			return false;
		case Material::Kind::Lambertian: {
			const Vec<Number> geometric = sphere.radius < 0 ? -outward : outward;
			throughput = throughput *
			             (material.texture < 0
			                  ? to<Number>(material.albedo)
			                  : texture_color(scene_.textures[static_cast<std::size_t>(material.texture)], geometric));
			const Vec<Number> sum = n + random_.on_unit_sphere();
			ray.direction = dot(sum, sum) > Number(1e-24) ? unit(sum) : n;
			return true;
		}
		case Material::Kind::Metal:
			throughput = throughput * to<Number>(material.albedo);
			ray.direction = unit(mirrored + static_cast<Number>(material.fuzz) * random_.on_unit_sphere());
			return dot(ray.direction, n) > 0;
		case Material::Kind::Dielectric: {
			const auto ior = static_cast<Number>(material.ior);
			const Number n1 = front ? 1 : ior, n2 = front ? ior : 1;
			const Number reflected =
			    reflectance_ == Reflectance::Fresnel ? fresnel(n1, n2, cosine) : schlick(n1, n2, cosine);
			if (random_.number() < reflected) {
				ray.direction = unit(mirrored);
				return true;
			}
			// Snell: the part along the surface shrinks by n1 / n2, the rest follows from unit length.
			const Vec<Number> along = (n1 / n2) * (ray.direction + cosine * n);
			ray.direction = unit(along - std::sqrt(std::fabs(1 - dot(along, along))) * n);
			return true;
		}
		}
		return false;
	}

	const Scene& scene_;
	std::uint32_t max_depth_;
	Reflectance reflectance_;
	Random<Number>& random_;
};

template <class Number>
TracedImage trace_by_the_book(const Scene& scene, const RenderSettings& settings, Reflectance reflectance)
{
	TracedImage image{settings.width, settings.height, settings.samples, {}};
	Random<Number> random(settings.seed);
	Tracer<Number> tracer(scene, settings.max_depth, reflectance, random);
	const View<Number> view(scene.camera, settings);
	for (std::uint32_t y = 0; y < settings.height; ++y)
		for (std::uint32_t x = 0; x < settings.width; ++x) {
			PixelEstimate pixel;
			Vec3d squares{0, 0, 0}; // sum of squared differences from the mean so far (Welford 1962)
			for (std::uint32_t k = 1; k <= settings.samples; ++k) {
				const Vec<Number> sample = tracer.radiance(view.ray(x, y, random));
				const Vec3d value{static_cast<double>(sample[0]), static_cast<double>(sample[1]),
				                  static_cast<double>(sample[2])};
				const Vec3d before = value - pixel.mean;
				pixel.mean = pixel.mean + (1.0 / k) * before;
				squares = squares + before * (value - pixel.mean);
			}
			if (settings.samples > 1)
				pixel.variance = (1.0 / (settings.samples - 1)) * squares;
			image.pixels.push_back(pixel);
		}
	return image;
}

} // namespace

TracedImage trace_in_double(const Scene& scene, const RenderSettings& settings, Reflectance reflectance)
{
	return trace_by_the_book<double>(scene, settings, reflectance);
}

TracedImage trace_in_float(const Scene& scene, const RenderSettings& settings)
{
	return trace_by_the_book<float>(scene, settings, Reflectance::Fresnel);
}

} // namespace rt
