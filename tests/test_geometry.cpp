// Ray and sphere at the extremes (contract rules 10 and 11), against 113-bit arithmetic, and beside the textbook's
// form, which must fail where ours holds. Errors are those of the exact answer for the very floats that the kernel got.
#include "tests/catch.h"

#include "kernels/path.h"

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

namespace {

__extension__ typedef __float128 Quad;

// Said, where it is meant: -Wdouble-promotion watches the rest.
template <class Number>
Quad quad(Number x)
{
	return static_cast<Quad>(x);
}

Quad square_root(Quad x)
{
	if (!(x > 0))
		return 0;
	Quad y = quad(std::sqrt(static_cast<double>(x)));
	for (int i = 0; i < 3; ++i)
		y = (y + x / y) / 2;
	return y;
}

struct Exact {
	bool hit = false;
	Quad t = 0;
	Quad normal[3] = {0, 0, 0};
};

// First point of a sphere in front of the camera at the origin; the direction need not be of unit length.
Exact intersect(const Quad center[3], Quad radius, rt_vec3 d)
{
	const Quad dir[3] = {quad(d.x), quad(d.y), quad(d.z)};
	Quad a = 0, b = 0, c = -radius * radius;
	for (int k = 0; k < 3; ++k) {
		a += dir[k] * dir[k];
		b += dir[k] * center[k];
		c += center[k] * center[k];
	}
	Exact exact;
	const Quad discriminant = b * b - a * c;
	exact.hit = discriminant >= 0;
	if (!exact.hit)
		return exact;
	const Quad root = square_root(discriminant);
	exact.t = c > 0 ? c / (b + root) : (b + root) / a; // outside: the near root, without cancellation
	for (int k = 0; k < 3; ++k)
		exact.normal[k] = (exact.t * dir[k] - center[k]) / radius;
	return exact;
}

// "Ray Tracing in One Weekend" and the seed: b^2 - 4ac in float, a root above 1e-3, normal (p - c) / r.
bool textbook(const rt_sphere& sphere, rt_vec3 d, float& t, float normal[3])
{
	const float half_b = -(d.x * sphere.cx + d.y * sphere.cy + d.z * sphere.cz);
	const float a = d.x * d.x + d.y * d.y + d.z * d.z;
	const float c =
	    sphere.cx * sphere.cx + sphere.cy * sphere.cy + sphere.cz * sphere.cz - sphere.radius * sphere.radius;
	const float discriminant = half_b * half_b - a * c;
	if (discriminant < 0)
		return false;
	const float root = std::sqrt(discriminant);
	t = (-half_b - root) / a;
	if (t < 1e-3f)
		t = (-half_b + root) / a;
	if (t < 1e-3f)
		return false;
	normal[0] = (t * d.x - sphere.cx) / sphere.radius;
	normal[1] = (t * d.y - sphere.cy) / sphere.radius;
	normal[2] = (t * d.z - sphere.cz) / sphere.radius;
	return true;
}

struct Errors {
	std::vector<double> t, normal; // relative; length of the difference
	int missed = 0, false_hits = 0, rays = 0;

	void add(const Exact& exact, bool hit, float t_found, const float n[3])
	{
		++rays;
		if (exact.hit != hit) {
			++(exact.hit ? missed : false_hits);
			return;
		}
		if (!hit)
			return;
		t.push_back(std::fabs(static_cast<double>((quad(t_found) - exact.t) / exact.t)));
		double square = 0;
		for (int k = 0; k < 3; ++k) {
			const auto difference = static_cast<double>(quad(n[k]) - exact.normal[k]);
			square += difference * difference;
		}
		normal.push_back(std::sqrt(square));
	}
	static double percentile_99(std::vector<double> values)
	{
		if (values.empty())
			return HUGE_VAL;
		std::sort(values.begin(), values.end());
		return values[values.size() * 99 / 100];
	}
};

rt_ray camera_ray(double x, double y, double z)
{
	const double length = std::sqrt(x * x + y * y + z * z);
	rt_ray ray;
	ray.base = ray.arm = v3(0, 0, 0);
	ray.reach = 1;
	ray.dir = v3(static_cast<float>(x / length), static_cast<float>(y / length), static_cast<float>(z / length));
	ray.from = -1;
	ray.chord = -1;
	return ray;
}

// What the kernel does with one sphere: c0 is |c|^2 - r^2 where the sphere is taken as wide.
void trace(const rt_sphere& sphere, const double* c0, const rt_ray& ray, const Exact& exact, Errors& errors)
{
	const rt_vec3 center = v3(sphere.cx, sphere.cy, sphere.cz);
	rt_scene scene{};
	scene.sphere_count = 1;
	scene.wide_count = c0 ? 1 : 0;
	rt_mask met = 0;
	float t = 0;
	if (c0) {
		const auto high = static_cast<float>(*c0);
		const auto low = static_cast<float>(*c0 - static_cast<double>(high));
		t = rt_wide_distance(center, sphere.radius, high, low, ray, v3(0, 0, 0), 0, 0, &met);
	} else
		t = rt_sphere_distance(center, sphere.radius, ray, 0, &met);
	float normal[3] = {0, 0, 0};
	if (met) {
		const rt_surface surface = rt_sphere_surface(&scene, &sphere, ray, t, 0);
		normal[0] = surface.normal.x;
		normal[1] = surface.normal.y;
		normal[2] = surface.normal.z;
	}
	errors.add(exact, met != 0, t, normal);
}

double uniform(std::mt19937_64& random) { return static_cast<double>(random() >> 11) * 0x1p-53; }

} // namespace

TEST_CASE("rule 11: normals to 5e-7 and no false miss for |m| / r up to 1e7", "[geometry]")
{
	std::mt19937_64 random(1);
	for (const double ratio : {1.5, 10.0, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7}) {
		Errors narrow, wide, plain;
		for (int i = 0; i < 20000; ++i) {
			// A sphere of radius e^-5 to e^5 in a random direction, and a ray at a random point of its disc.
			const double radius = std::exp((uniform(random) - 0.5) * 10);
			const double z = 2 * uniform(random) - 1, turn = 6.283185307179586 * uniform(random);
			const double ring = std::sqrt(1 - z * z), distance = ratio * radius;
			const double toward[3] = {ring * std::cos(turn), ring * std::sin(turn), z};
			const rt_sphere sphere = {static_cast<float>(distance * toward[0]),
			                          static_cast<float>(distance * toward[1]),
			                          static_cast<float>(distance * toward[2]), static_cast<float>(radius)};
			const double across[3] = {toward[2] != 0 || toward[0] != 0 ? -toward[2] : 1, 0, toward[0]};
			const double across_length = std::hypot(across[0], across[2]);
			const double off = 0.999 * std::sqrt(uniform(random)) * static_cast<double>(sphere.radius) *
			                   std::sqrt(1 - 1 / (ratio * ratio)) / across_length;
			const double center_d[3] = {static_cast<double>(sphere.cx), static_cast<double>(sphere.cy),
			                            static_cast<double>(sphere.cz)};
			const rt_ray ray = camera_ray(center_d[0] + off * across[0], center_d[1], center_d[2] + off * across[2]);
			const Quad center[3] = {quad(sphere.cx), quad(sphere.cy), quad(sphere.cz)};
			const Exact exact = intersect(center, quad(sphere.radius), ray.dir);

			trace(sphere, nullptr, ray, exact, narrow);
			const double r = static_cast<double>(sphere.radius);
			const double c0 = center_d[0] * center_d[0] + center_d[1] * center_d[1] + center_d[2] * center_d[2] - r * r;
			trace(sphere, &c0, ray, exact, wide);
			float t = 0, normal[3] = {0, 0, 0};
			const bool hit = textbook(sphere, ray.dir, t, normal);
			plain.add(exact, hit, t, normal);
		}
		INFO("|m| / r = " << ratio << ": normal " << Errors::percentile_99(narrow.normal) << ", wide "
		                  << Errors::percentile_99(wide.normal) << ", textbook " << Errors::percentile_99(plain.normal)
		                  << ", which misses " << plain.missed << " of " << plain.rays);
		for (const Errors* errors : {&narrow, &wide}) {
			CHECK(Errors::percentile_99(errors->normal) <= 5e-7);
			CHECK(Errors::percentile_99(errors->t) <= 5e-7);
			CHECK(errors->missed == 0);
			CHECK(errors->false_hits == 0);
		}
		// The control: the same rays by the book.
		if (ratio >= 1e3)
			CHECK(Errors::percentile_99(plain.normal) > 1e-2);
		if (ratio >= 1e5)
			CHECK(plain.missed > plain.rays / 20);
	}
}

TEST_CASE("rule 11: over a huge ground distances are right to 1e-6", "[geometry]")
{
	std::mt19937_64 random(2);
	for (const double radius : {1e3, 1e4, 1e5, 1e6})
		for (const double height : {1.0, 1e-3}) {
			Errors wide, plain;
			const double depth = radius + height;
			const rt_sphere sphere = {0, static_cast<float>(-depth), 0, static_cast<float>(radius)};
			const double c0 = std::fma(-radius, radius, depth * depth);
			// The ground as the scene says it, not as a float can: c0 carries the difference.
			const Quad center[3] = {0, -quad(depth), 0};
			const double horizon = std::sqrt(2 * height / radius);
			for (int i = 0; i < 20000; ++i) {
				const double down = horizon * 1.05 * std::pow(1 / (horizon * 1.05), uniform(random));
				const double turn = 6.283185307179586 * uniform(random), level = std::sqrt(1 - down * down);
				const rt_ray ray = camera_ray(level * std::cos(turn), -down, level * std::sin(turn));
				const Exact exact = intersect(center, quad(radius), ray.dir);
				trace(sphere, &c0, ray, exact, wide);
				float t = 0, normal[3] = {0, 0, 0};
				const bool hit = textbook(sphere, ray.dir, t, normal);
				plain.add(exact, hit, t, normal);
			}
			INFO("radius " << radius << ", eye " << height << " above: t " << Errors::percentile_99(wide.t)
			               << ", textbook " << Errors::percentile_99(plain.t) << ", which misses " << plain.missed);
			CHECK(Errors::percentile_99(wide.t) <= 1e-6);
			CHECK(Errors::percentile_99(wide.normal) <= 5e-7);
			CHECK(wide.missed == 0);
			CHECK(wide.false_hits == 0);
			CHECK((Errors::percentile_99(plain.t) > 1e-5 || plain.missed > 0));
		}
}

TEST_CASE("rule 10: leaving outward a ray never meets its sphere, inward only the far end of its chord", "[geometry]")
{
	std::mt19937_64 random(3);
	double worst_chord = 0;
	for (int decade = -8; decade <= 8; ++decade)
		for (int i = 0; i < 20000; ++i) {
			// Radii over 16 decades, centres up to 1e3 radii away; a random point and direction.
			const auto component = [&] { return static_cast<float>(2 * uniform(random) - 1); };
			const float radius = static_cast<float>(std::pow(10.0, decade) * (1 + uniform(random)));
			const float far = radius * static_cast<float>(std::pow(10.0, 3 * uniform(random)));
			const rt_sphere sphere = {far * component(), far * component(), far * component(), radius};
			const rt_vec3 n = v3_normalize(v3(component(), component(), component()), v3(0, 0, 1));
			const rt_vec3 d = v3_normalize(v3(component(), component(), component()), v3(0, 1, 0));
			const bool inward = v3_dot(n, d) < 0;
			rt_ray ray;
			ray.base = v3(sphere.cx, sphere.cy, sphere.cz);
			ray.arm = n;
			ray.reach = radius;
			ray.dir = d;
			ray.from = 0;
			ray.chord = inward ? (radius + radius) * -v3_dot(n, d) : -1.0f;
			rt_scene scene{};
			scene.sphere_count = 1;
			const std::uint32_t id = 0;
			scene.bvh_root = RT_BVH_NONE;
			rt_scene_view view{};
			view.scene = &scene;
			view.spheres = &sphere;
			view.sphere_ids = &id;
			const rt_hit hit = rt_closest_hit(view, ray, RT_TRUE);
			if ((hit.index == 0) != inward)
				FAIL("radius " << radius << ": " << (inward ? "the far side is missed" : "the sphere is met again"));
			if (!inward)
				continue;
			// The chord by 113-bit arithmetic, and the normal at its end: the mirror image of the first.
			Quad projection = 0;
			for (const auto& [a, b] : {std::pair(n.x, d.x), std::pair(n.y, d.y), std::pair(n.z, d.z)})
				projection += quad(a) * quad(b);
			const Quad chord = -2 * quad(radius) * projection;
			worst_chord = std::max(worst_chord, std::fabs(static_cast<double>((quad(hit.t) - chord) / quad(radius))));
			const rt_surface surface = rt_sphere_surface(&scene, &sphere, ray, hit.t, 0);
			const rt_vec3 mirrored = v3_fma(-2 * v3_dot(n, d), d, n);
			const rt_vec3 difference = v3_sub(surface.normal, mirrored);
			if (v3_dot(difference, difference) > 1e-12f)
				FAIL("radius " << radius << ": the normal at the chord's end is off");
		}
	CHECK(worst_chord <= 3e-7);
	CHECK(worst_chord > 0);
}
