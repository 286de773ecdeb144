// The kernels' random numbers and samplers, compiled for the host, against the distributions they should have.
//
// All seeds are fixed. Each TEST_CASE draws a family of p-values and fails if the family's, after Sidak's correction,
// is below 1e-4: that is how often a correct program would fail if its random numbers were drawn anew. Each kind of
// test also has to reject a sampler that is wrong.
#include "render/pack.h"
#include "render/scene_file.h"
#include "tests/catch.h"
#include "tests/statistics.h"

#include "kernels/path.h"

#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <random>
#include <string>
#include <vector>

using namespace rt;

namespace {

constexpr double level = 1e-4;
constexpr double pi = 3.14159265358979323846;
constexpr double ulp = 0x1p-23; // of 1
constexpr std::uint32_t million = 1u << 20;

#define CHECK_FAMILY(family)                                               \
	do {                                                                   \
		INFO("worst of " << (family).tests() << ": " << (family).worst()); \
		CHECK((family).p() > level);                                       \
	} while (false)

// ---- vectors in double ----

double dot(const Vec3d& a, const Vec3d& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
Vec3d cross(const Vec3d& a, const Vec3d& b)
{
	return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
Vec3d in_double(rt_vec3 v) { return {static_cast<double>(v.x), static_cast<double>(v.y), static_cast<double>(v.z)}; }
Vec3d unit(const Vec3d& v)
{
	const double length = std::sqrt(dot(v, v));
	return {v[0] / length, v[1] / length, v[2] / length};
}
rt_vec3 in_float(const Vec3d& v)
{
	return v3(static_cast<float>(v[0]), static_cast<float>(v[1]), static_cast<float>(v[2]));
}
// How far |v|^2 is from 1, in units in the last place of 1.
double ulps_from_unit(rt_vec3 v) { return std::fabs(dot(in_double(v), in_double(v)) - 1) / ulp; }

double turns(double y, double x)
{
	const double angle = std::atan2(y, x) / (2 * pi);
	return angle < 0 ? angle + 1 : angle;
}

// Cylindrical coordinates about an axis: cos(theta) and the angle around, in turns.
struct About {
	explicit About(const Vec3d& axis) : z(unit(axis))
	{
		x = unit(cross(std::fabs(z[0]) < 0.5 ? Vec3d{1, 0, 0} : Vec3d{0, 1, 0}, z));
		y = cross(z, x);
	}
	double cosine(const Vec3d& v) const { return dot(v, z); }
	double around(const Vec3d& v) const { return turns(dot(v, y), dot(v, x)); }
	Vec3d x{}, y{}, z{};
};

// Normals where the frame's construction is ordinary, on its axes, and at its seam.
std::vector<rt_vec3> normals()
{
	std::vector<rt_vec3> list = {v3(0, 0, 1), v3(0, 0, -1), v3(1, 0, 0), v3(-1, 0, 0), v3(0, 1, 0), v3(0, -1, 0)};
	list.push_back(v3(0, 0, std::nextafterf(-1.0f, 0.0f)));
	list.push_back(v3(0x1p-12f, 0, std::nextafterf(-1.0f, 0.0f)));
	list.push_back(v3(0x1p-12f, -0x1p-13f, 1));
	list.push_back(v3(1, 0, 0x1p-30f)); // the two sides of z = 0
	list.push_back(v3(0.6f, -0.8f, -0x1p-30f));
	list.push_back(in_float(unit({1, 2, -3})));
	list.push_back(in_float(unit({-3, 1, 2})));
	return list;
}

std::string name_of(rt_vec3 v)
{
	return "n = (" + std::to_string(v.x) + " " + std::to_string(v.y) + " " + std::to_string(v.z) + ")";
}

std::array<double, 4> numbers(rt_random4 u)
{
	return {static_cast<double>(u.a), static_cast<double>(u.b), static_cast<double>(u.c), static_cast<double>(u.d)};
}

// ---- random numbers ----

double fraction(double x) // of a number in [0, 2^32)
{
	return x - static_cast<double>(static_cast<std::uint32_t>(x));
}

using Stream = std::function<std::array<double, 4>(std::uint32_t)>;

// Every test of one stream of blocks of four.
void examine(TestFamily& family, const std::string& name, const Stream& stream)
{
	std::vector<EvenGrid> single(4, EvenGrid(1024)), low_bits(4, EvenGrid(1024));
	std::vector<EvenGrid> pairs(6, EvenGrid(64, 64)), successive(16, EvenGrid(64, 64));
	std::array<double, 32> products{};
	std::array<std::array<double, 4>, 3> last{};
	for (std::uint32_t i = 0; i < million; ++i) {
		const std::array<double, 4> u = stream(i);
		std::size_t pair = 0;
		for (std::size_t a = 0; a < 4; ++a) {
			single[a].add(u[a]);
			low_bits[a].add(fraction(u[a] * 0x1p14));
			for (std::size_t b = a + 1; b < 4; ++b)
				pairs[pair++].add(u[a], u[b]);
			for (std::size_t b = 0; b < 4; ++b) {
				if (i % 2 == 1) // disjoint pairs, so that they are independent
					successive[4 * a + b].add(last[0][a], u[b]);
				if (i >= 1)
					products[4 * a + b] += (last[0][a] - 0.5) * (u[b] - 0.5);
				if (i >= 3)
					products[16 + 4 * a + b] += (last[2][a] - 0.5) * (u[b] - 0.5);
			}
		}
		last = {u, last[0], last[1]};
	}
	for (const EvenGrid& grid : single)
		family.add(name + ", one number", grid.p());
	for (const EvenGrid& grid : low_bits)
		family.add(name + ", low bits", grid.p());
	for (const EvenGrid& grid : pairs)
		family.add(name + ", pair in a block", grid.p());
	for (const EvenGrid& grid : successive)
		family.add(name + ", pair of neighbours", grid.p());
	for (const double product : products) // each term has mean 0 and variance 1/144
		family.add(name + ", correlation of neighbours", normal_p(product * 12 / std::sqrt(double(million))));
}

} // namespace

TEST_CASE("random numbers are uniform and independent along every axis")
{
	TestFamily family;
	const auto pixel = [](std::uint32_t i) { return numbers(rt_random(0, i, 0, 0)); };
	examine(family, "pixels", pixel);
	examine(family, "pixels, seed 1", [](std::uint32_t i) { return numbers(rt_random(1, i, 7, 3)); });
	examine(family, "rows", [](std::uint32_t i) { return numbers(rt_random(0, i * 640u, 0, 0)); });
	examine(family, "samples", [](std::uint32_t i) { return numbers(rt_random(0, 0, i, 0)); });
	examine(family, "blocks", [](std::uint32_t i) { return numbers(rt_random(0, 0, 0, i)); });
	examine(family, "seeds", [](std::uint32_t i) { return numbers(rt_random(i, 0, 0, 0)); });
	examine(family, "samples of 1024 pixels",
	        [](std::uint32_t i) { return numbers(rt_random(0, i / 1024, i % 1024, 0)); });
	examine(family, "bounces of 2^14 samples",
	        [](std::uint32_t i) { return numbers(rt_random(0, 307200, i / 64, i % 64)); });
	CHECK_FAMILY(family);
}

TEST_CASE("Sobol's numbers are uniform and independent along pixels, blocks and seeds")
{
	// Along samples they are more even than chance; tests/test_sobol.cpp.
	TestFamily family;
	examine(family, "pixels, sample 0", [](std::uint32_t i) { return numbers(rt_sobol(0, i, 0, 0)); });
	examine(family, "pixels, sample 21", [](std::uint32_t i) { return numbers(rt_sobol(1, i, 21, 1)); });
	examine(family, "rows", [](std::uint32_t i) { return numbers(rt_sobol(0, i * 640u, 3, 0)); });
	examine(family, "blocks", [](std::uint32_t i) { return numbers(rt_sobol(0, 0, 1, i)); });
	examine(family, "seeds", [](std::uint32_t i) { return numbers(rt_sobol(i, 0, 2, 0)); });
	examine(family, "a late sample of 2^14 pixels, their bounces",
	        [](std::uint32_t i) { return numbers(rt_sobol(0, i / 64, 100003, i % 64)); });
	CHECK_FAMILY(family);
}

TEST_CASE("wrong random numbers are noticed")
{
	const auto verdict = [](const Stream& stream) {
		TestFamily family;
		examine(family, "wrong", stream);
		return family.p();
	};
	// A density that is 4 % off at the ends.
	CHECK(verdict([](std::uint32_t i) {
		      std::array<double, 4> u = numbers(rt_random(0, i, 0, 0));
		      u[2] += 0.04 * u[2] * (u[2] - 1);
		      return u;
	      }) < level);
	// Two components that share their top two bits in one block of 16.
	CHECK(verdict([](std::uint32_t i) {
		      std::array<double, 4> u = numbers(rt_random(0, i, 0, 0));
		      if (i % 16 == 0)
			      u[3] = (std::floor(u[0] * 4) + fraction(u[3] * 4)) / 4;
		      return u;
	      }) < level);
	// A neighbour's number used again, one time in 64.
	CHECK(verdict([](std::uint32_t i) {
		      std::array<double, 4> u = numbers(rt_random(0, i, 0, 0));
		      if (i % 64 == 9)
			      u[1] = numbers(rt_random(0, i - 1, 0, 0))[1];
		      return u;
	      }) < level);
	// Too even: a lattice.
	CHECK(verdict([](std::uint32_t i) {
		      std::array<double, 4> u = numbers(rt_random(0, i, 0, 0));
		      u[0] = fraction(i * 0.6180339887498949);
		      return u;
	      }) < level);
}

TEST_CASE("different coordinates have different numbers")
{
	// 2^16 blocks of 96 bits: a repeated one would be a defect, not chance.
	std::vector<std::array<double, 4>> blocks;
	for (std::uint32_t pixel = 0; pixel < 16; ++pixel)
		for (std::uint32_t sample = 0; sample < 16; ++sample)
			for (std::uint32_t block = 0; block < 16; ++block)
				for (std::uint32_t seed = 0; seed < 16; ++seed)
					blocks.push_back(numbers(rt_random(seed, pixel, sample, block)));
	std::sort(blocks.begin(), blocks.end());
	CHECK(std::adjacent_find(blocks.begin(), blocks.end()) == blocks.end());
	CHECK(blocks.front()[0] >= 0);
	CHECK(blocks.back()[0] < 1);
}

// ---- directions ----

namespace {

using Sampler = std::function<rt_vec3(rt_random4)>;

// p of a direction sampler for the cosine law about n: sin^2 and the angle around are uniform and independent.
double cosine_law_p(rt_vec3 n, std::uint32_t seed, const Sampler& sampler)
{
	const About frame(in_double(n));
	EvenGrid grid(32, 64);
	for (std::uint32_t i = 0; i < million; ++i) {
		const Vec3d d = in_double(sampler(rt_random(seed, i, 0, 1)));
		const double cosine = frame.cosine(d);
		if (cosine < -1e-6)
			return 0;
		grid.add(1 - cosine * cosine, frame.around(d));
	}
	return grid.p();
}

// p for uniform points of the unit sphere: height and angle are uniform (Archimedes).
double sphere_p(std::uint32_t seed, const Sampler& sampler)
{
	const About frame({0, 0, 1});
	EvenGrid grid(32, 64);
	for (std::uint32_t i = 0; i < million; ++i) {
		const Vec3d d = in_double(sampler(rt_random(seed, i, 0, 1)));
		if (std::fabs(dot(d, d) - 1) > 1e-5)
			return 0;
		grid.add((frame.cosine(d) + 1) / 2, frame.around(d));
	}
	return grid.p();
}

} // namespace

TEST_CASE("lambertian directions follow the cosine law")
{
	TestFamily family;
	std::uint32_t seed = 0;
	for (const rt_vec3 n : normals())
		family.add(name_of(n),
		           cosine_law_p(n, ++seed, [n](rt_random4 u) { return rt_scatter_lambertian(rt_sample_disc(u), n); }));
	CHECK_FAMILY(family);

	// A cosine law that is 2 % too steep, a normal that is 0.3 degrees off, and directions of a uniform hemisphere.
	const rt_vec3 n = in_float(unit({1, 2, -3}));
	CHECK(cosine_law_p(n, 1, [n](rt_random4 u) {
		      u.a = std::pow(u.a, 1.02f);
		      return rt_scatter_lambertian(rt_sample_disc(u), n);
	      }) < level);
	CHECK(cosine_law_p(n, 1, [](rt_random4 u) {
		      return rt_scatter_lambertian(rt_sample_disc(u), in_float(unit({1, 2, -3.02})));
	      }) < level);
	CHECK(cosine_law_p(n, 1, [n](rt_random4 u) {
		      const float z = 1 - u.a;
		      const rt_disc_sample disc = {std::sqrt(1 - z * z), z, 0, 0};
		      rt_disc_sample turned = disc;
		      rt_sincos_turns(u.b, &turned.sine, &turned.cosine);
		      return rt_scatter_lambertian(turned, n);
	      }) < level);
}

TEST_CASE("fuzz is a uniform point of a sphere")
{
	TestFamily family;
	const rt_vec3 zero = v3(0, 0, 0);
	family.add("fuzz 1",
	           sphere_p(1, [zero](rt_random4 u) { return rt_scatter_metal(rt_sample_disc(u), u.a, 1, zero); }));
	const rt_vec3 mirrored = v3(0.6f, 0, -0.8f);
	family.add("fuzz 0.25 about a mirror direction", sphere_p(2, [mirrored](rt_random4 u) {
		           const rt_vec3 d = rt_scatter_metal(rt_sample_disc(u), u.a, 0.25f, mirrored);
		           return v3_scale(4, v3_sub(d, mirrored));
	           }));
	CHECK_FAMILY(family);
	CHECK(sphere_p(1, [zero](rt_random4 u) {
		      u.a = std::pow(u.a, 1.02f);
		      return rt_scatter_metal(rt_sample_disc(u), u.a, 1, zero);
	      }) < level);
}

// ---- camera ----

namespace {

PackedScene packed_camera(double aperture)
{
	Scene scene;
	scene.camera.from = {3, 1, -2};
	scene.camera.at = {0, 0.5, 1};
	scene.camera.vfov = 40;
	scene.camera.aperture = aperture;
	scene.camera.focus = 5;
	scene.render.width = 4;
	scene.render.height = 3;
	const auto packed = pack_scene(scene, scene.render, {0, 0, 4, 3});
	REQUIRE(packed);
	return *packed;
}

rt_vec3 lens_u(const rt_scene& s) { return v3(s.lens_u_x, s.lens_u_y, s.lens_u_z); }
rt_vec3 lens_v(const rt_scene& s) { return v3(s.lens_v_x, s.lens_v_y, s.lens_v_z); }

} // namespace

TEST_CASE("rays start evenly on the lens")
{
	const PackedScene packed = packed_camera(0.5);
	const Vec3d u = in_double(lens_u(packed.scene)), v = in_double(lens_v(packed.scene));
	CHECK(std::sqrt(dot(u, u)) == Approx(0.25));
	CHECK(std::sqrt(dot(v, v)) == Approx(0.25));
	CHECK(std::fabs(dot(u, v)) < 1e-8);
	const auto lens_p = [&](float bias) {
		EvenGrid grid(32, 64);
		for (std::uint32_t i = 0; i < million; ++i) {
			rt_random4 random = rt_random(5, i, 0, 0);
			random.c = std::pow(random.c, bias);
			const rt_ray ray = rt_camera_ray(&packed.scene, 1, 2, random);
			const Vec3d arm = in_double(ray.arm);
			const double x = dot(arm, u) / dot(u, u), y = dot(arm, v) / dot(v, v);
			if (x * x + y * y > 1 + 1e-6)
				return 0.0;
			grid.add(x * x + y * y, turns(y, x));
		}
		return grid.p();
	};
	CHECK(lens_p(1) > level);
	CHECK(lens_p(1.02f) < level);
}

namespace {

// Numbers in [0, 1) that should be uniform and independent, pair by pair.
template <std::size_t n>
class Independence {
public:
	void add(const std::array<double, n>& u)
	{
		std::size_t pair = 0;
		for (std::size_t a = 0; a < n; ++a)
			for (std::size_t b = a + 1; b < n; ++b)
				grids_[pair++].add(u[a], u[b]);
	}
	void tell(TestFamily& family, const std::array<std::string, n>& names) const
	{
		std::size_t pair = 0;
		for (std::size_t a = 0; a < n; ++a)
			for (std::size_t b = a + 1; b < n; ++b)
				family.add(names[a] + " and " + names[b], grids_[pair++].p());
	}

private:
	std::vector<EvenGrid> grids_ = std::vector<EvenGrid>(n * (n - 1) / 2, EvenGrid(32, 32));
};

// Where in its pixel (column, row) a ray meets the plane in focus.
std::array<double, 2> place_in_pixel(const rt_scene& s, const rt_ray& ray, double column, double row)
{
	// From the packed camera; the steps are perpendicular to each other.
	const Vec3d step_x = in_double(v3(s.step_x_x, s.step_x_y, s.step_x_z));
	const Vec3d step_y = in_double(v3(s.step_y_x, s.step_y_y, s.step_y_z));
	const Vec3d corner = in_double(v3(s.corner_x, s.corner_y, s.corner_z));
	const Vec3d normal = cross(step_x, step_y);
	const Vec3d from = in_double(v3_add(ray.base, ray.arm)), d = in_double(ray.dir);
	const double t = (dot(corner, normal) - dot(from, normal)) / dot(d, normal);
	const Vec3d point = {from[0] + t * d[0] - corner[0], from[1] + t * d[1] - corner[1],
	                     from[2] + t * d[2] - corner[2]};
	return {dot(point, step_x) / dot(step_x, step_x) - column, dot(point, step_y) / dot(step_y, step_y) - row};
}

} // namespace

TEST_CASE("rays go evenly through a pixel, wherever on the lens they start")
{
	TestFamily family;
	const PackedScene lens = packed_camera(0.5), pinhole = packed_camera(0);
	const Vec3d u = in_double(lens_u(lens.scene)), v = in_double(lens_v(lens.scene));
	Independence<4> through_lens;
	Independence<2> through_pinhole;
	bool inside = true;
	for (std::uint32_t i = 0; i < million; ++i) {
		const rt_random4 random = rt_random(9, i, 0, 0);
		const rt_ray ray = rt_camera_ray(&lens.scene, 2, 1, random);
		const std::array<double, 2> a = place_in_pixel(lens.scene, ray, 2, 1);
		const std::array<double, 2> b =
		    place_in_pixel(pinhole.scene, rt_camera_ray(&pinhole.scene, 2, 1, random), 2, 1);
		for (const double x : {a[0], a[1], b[0], b[1]})
			inside = inside && x > -1e-5 && x < 1 + 1e-5;
		const double x = dot(in_double(ray.arm), u) / dot(u, u), y = dot(in_double(ray.arm), v) / dot(v, v);
		through_lens.add({a[0], a[1], x * x + y * y, turns(y, x)});
		through_pinhole.add(b);
	}
	CHECK(inside);
	through_lens.tell(family, {"x", "y", "squared distance on the lens", "angle on the lens"});
	through_pinhole.tell(family, {"x", "y"});
	CHECK_FAMILY(family);
}

// ---- dielectrics ----

namespace {

// The share of light that a boundary reflects (n = eta, the index on the ray's side over the other), from the cosines.
double fresnel(double eta, double cosine)
{
	const double sine2 = eta * eta * (1 - cosine * cosine);
	if (sine2 >= 1)
		return 1;
	const double beyond = std::sqrt(1 - sine2);
	const double s = (eta * cosine - beyond) / (eta * cosine + beyond);
	const double p = (eta * beyond - cosine) / (eta * beyond + cosine);
	return (s * s + p * p) / 2;
}

double schlick(double eta, double cosine)
{
	const double sine2 = eta * eta * (1 - cosine * cosine);
	const double r0 = (eta - 1) / (eta + 1) * ((eta - 1) / (eta + 1));
	const double c = eta > 1 ? std::sqrt(std::max(0.0, 1 - sine2)) : cosine;
	return sine2 >= 1 ? 1 : r0 + (1 - r0) * std::pow(1 - c, 5);
}

struct Incidence {
	float eta, cosine;
	rt_vec3 d, n; // d . n = -cosine
};

std::vector<Incidence> incidences()
{
	std::vector<Incidence> list;
	for (const double eta : {1 / 1.5, 1.5, 1 / 0.7, 0.7, 0.9, 1 / 2.4, 2.4, 1.0}) {
		std::vector<double> cosines = {1, 0.999, 0.9, 0.7, 0.5, 0.2, 0.05, 0.001};
		if (eta > 1) {
			const double critical = std::sqrt(1 - 1 / (eta * eta));
			for (const double offset : {-1e-2, -1e-4, -1e-6, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2})
				cosines.push_back(critical + offset);
		}
		for (const double cosine : cosines) {
			const rt_vec3 n = in_float(unit({1, 2, -3}));
			const About frame(in_double(n));
			const double sine = std::sqrt(1 - cosine * cosine);
			Vec3d d{};
			for (std::size_t k = 0; k < 3; ++k)
				d[k] = sine * frame.x[k] - cosine * frame.z[k];
			list.push_back({static_cast<float>(eta), static_cast<float>(cosine), in_float(d), n});
		}
	}
	return list;
}

std::string name_of(const Incidence& in)
{
	return "eta " + std::to_string(in.eta) + ", cosine " + std::to_string(in.cosine);
}

bool refracts(const Incidence& in, float u, rt_vec3* direction = nullptr)
{
	rt_mask refracted = RT_FALSE;
	const rt_vec3 d = rt_scatter_dielectric(u, in.eta, in.d, in.cosine, in.n, &refracted);
	if (direction != nullptr)
		*direction = d;
	return refracted != 0;
}

} // namespace

TEST_CASE("glass reflects what Fresnel says")
{
	TestFamily family, schlick_family;
	for (const Incidence& in : incidences()) {
		const double eta = static_cast<double>(in.eta), cosine = static_cast<double>(in.cosine);
		std::uint32_t reflected = 0;
		for (std::uint32_t i = 0; i < million / 4; ++i)
			reflected += refracts(in, rt_random(11, i, 3, 2).a) ? 0 : 1;
		// Between equal indices nothing is reflected for certain, but for the rounding that is bounded below.
		if (in.eta != 1) {
			family.add(name_of(in), binomial_p(reflected, million / 4.0, fresnel(eta, cosine)));
			schlick_family.add(name_of(in), binomial_p(reflected, million / 4.0, schlick(eta, cosine)));
		}

		// The choice is monotone in u, so a bisection over all 2^24 values of u finds the probability exactly.
		std::uint32_t low = 0, high = 1u << 24; // reflects below low, refracts from high on
		while (low < high) {
			const std::uint32_t middle = (low + high) / 2;
			if (refracts(in, static_cast<float>(middle) * 0x1p-24f))
				high = middle;
			else
				low = middle + 1;
		}
		INFO(name_of(in));
		// Rounding of the refracted cosine's square, about an ulp, matters near the critical angle.
		const double beyond2 = 1 - eta * eta * (1 - cosine * cosine);
		const double blur = beyond2 <= 2 * ulp ? 1.0 : std::fmin(1.0, 4 * ulp / std::sqrt(beyond2));
		CHECK(std::fabs(low * 0x1p-24 - fresnel(eta, cosine)) < 1e-6 + 4 * eta * blur);
	}
	CHECK_FAMILY(family);
	CHECK(schlick_family.p() < level);
}

TEST_CASE("refraction keeps to Snell's law and to the plane of incidence")
{
	for (const Incidence& in : incidences()) {
		INFO(name_of(in));
		rt_vec3 out;
		if (!refracts(in, 0x1.fffffep-1f, &out))
			continue; // total reflection
		const double eta = static_cast<double>(in.eta);
		const Vec3d d = in_double(in.d), n = in_double(in.n), t = in_double(out);
		// eta (n x d) = n x t, and t goes on into the surface
		const Vec3d before = cross(n, d), after = cross(n, t);
		for (std::size_t k = 0; k < 3; ++k)
			CHECK(std::fabs(eta * before[k] - after[k]) < 1e-6);
		CHECK(dot(t, n) < 0);
		CHECK(std::fabs(dot(t, t) - 1) < 4e-6);
	}
}

// ---- scattering as a path does it ----

namespace {

rt_scene_view view_of(const PackedScene& packed)
{
	return {&packed.scene,
	        nullptr,
	        packed.spheres.data(),
	        packed.wide.data(),
	        packed.sphere_ids.data(),
	        packed.sphere_materials.data(),
	        packed.bvh.data(),
	        packed.materials.data(),
	        packed.textures.data(),
	        packed.texels.data(),
	        packed.lights.data()};
}

struct Probe {
	Scene scene;
	PackedScene packed;
	rt_scene_view view{};

	Probe(Material material, double radius)
	{
		scene.materials = {std::move(material)};
		scene.spheres = {{{0, 0, 5}, radius, 0}};
		scene.render.max_depth = 50;
		const auto result = pack_scene(scene, scene.render, {0, 0, 640, 480});
		REQUIRE(result);
		packed = *result;
		view = view_of(packed);
	}

	// A path from the camera that meets the sphere at this cosine of incidence.
	rt_path path_at(double cosine) const
	{
		const double radius = std::fabs(scene.spheres[0].radius);
		const double across = radius * std::sqrt(1 - cosine * cosine) / 5;
		rt_path path = rt_path_start(view, 0, 0, 0);
		path.ray.dir =
		    v3_normalize(in_float({across * 0.6, across * 0.8, std::sqrt(1 - across * across)}), v3(0, 0, 1));
		path.throughput = v3(0.5f, 0.25f, 1);
		return path;
	}
};

Material material_of(Material::Kind kind, double fuzz = 0)
{
	Material material;
	material.kind = kind;
	material.albedo = kind == Material::Kind::Dielectric ? Vec3d{1, 1, 1} : Vec3d{0.75, 0.3, 0.1};
	material.fuzz = fuzz;
	return material;
}

// Scatters `count` samples of a path; calls `seen` with each path and whether it ended.
void scatter_many(const Probe& probe, const rt_path& start, std::uint32_t count,
                  const std::function<void(const rt_path&, bool)>& seen)
{
	const rt_hit hit = rt_closest_hit(probe.view, start.ray, RT_TRUE);
	REQUIRE(hit.index == 0);
	for (std::uint32_t i = 0; i < count; ++i) {
		rt_path path = start;
		const rt_mask ended = rt_path_scatter(probe.view, &path, hit, i, 5, RT_TRUE);
		seen(path, ended != 0);
	}
}

} // namespace

TEST_CASE("rule 12: scattering multiplies the weight by the albedo and leaves a unit direction")
{
	constexpr std::uint32_t count = 1u << 15;
	double worst = 0;
	TestFamily family, wrong;
	for (const double cosine : {1.0, 0.9, 0.5, 0.1, 0.01}) {
		for (const double fuzz : {-2.0, -1.0, 0.0, 0.1, 0.5, 1.0}) {
			const Material material = fuzz == -2   ? material_of(Material::Kind::Lambertian)
			                          : fuzz == -1 ? material_of(Material::Kind::Dielectric)
			                                       : material_of(Material::Kind::Metal, fuzz);
			const Probe probe(material, 1);
			INFO("cosine " << cosine << ", kind or fuzz " << fuzz);
			const rt_path start = probe.path_at(cosine);
			const float red = 0.5f * static_cast<float>(material.albedo[0]);
			const float green = 0.25f * static_cast<float>(material.albedo[1]);
			const float blue = static_cast<float>(material.albedo[2]);
			std::uint32_t absorbed = 0, wrong_weight = 0;
			scatter_many(probe, start, count, [&](const rt_path& path, bool ended) {
				const bool right = path.throughput.x == red && path.throughput.y == green && path.throughput.z == blue;
				wrong_weight += right ? 0 : 1;
				absorbed += ended ? 1 : 0;
				worst = std::max(worst, ulps_from_unit(path.ray.dir));
			});
			CHECK(wrong_weight == 0);
			if (fuzz < 0) {
				CHECK(absorbed == 0); // the mean weight is the albedo exactly
				continue;
			}
			// The height of the mirror direction is c and the fuzz point's is uniform in [-fuzz, fuzz], so the share
			// below the surface is (1 - c / fuzz) / 2.
			const Vec3d d = in_double(start.ray.dir);
			const double along = d[2] * 5;
			const double actual = std::sqrt(1 - (25 - along * along)); // cosine from the rounded direction
			const double lost = actual < fuzz ? (1 - actual / fuzz) / 2 : 0.0;
			family.add("cosine " + std::to_string(cosine) + ", fuzz " + std::to_string(fuzz),
			           binomial_p(absorbed, count, lost));
			// A point in the ball instead of on the sphere loses (2 - 3 k + k^3) / 4 with k = c / fuzz.
			const double k = actual / fuzz;
			wrong.add("ball", binomial_p(absorbed, count, k < 1 ? (2 - 3 * k + k * k * k) / 4 : 0.0));
		}
	}
	CHECK_FAMILY(family);
	CHECK(wrong.p() < level);
	INFO("longest or shortest direction: " << worst << " ulp");
	CHECK(worst < 4);
	CHECK(worst > 0); // it was measured
}

TEST_CASE("rule 12: directions stay unit vectors along whole paths")
{
	double worst = 0, worst_drift = 0;
	std::uint32_t bounces = 0, deep = 0;
	for (const char* name : {"weekend", "three-spheres", "closed", "cornell"}) {
		const auto file = open_scene(name);
		REQUIRE(file);
		const auto packed = pack_scene(file->base, file->base.render, {0, 0, 64, 48});
		REQUIRE(packed);
		const rt_scene_view view = view_of(*packed);
		for (std::uint32_t i = 0; i < 64 * 48; ++i) {
			const std::uint32_t x = i % 64, y = i / 64;
			rt_path path = rt_path_start(view, x, y, 3);
			for (;;) {
				worst = std::max(worst, ulps_from_unit(path.ray.dir));
				const rt_hit hit = rt_closest_hit(view, path.ray, RT_TRUE);
				if (hit.index < 0 || rt_path_scatter(view, &path, hit, y * view.scene->width + x, 3, RT_TRUE))
					break;
				++bounces;
				deep += path.depth == 20 ? 1 : 0;
			}
		}
	}
	INFO(bounces << " bounces; longest or shortest direction: " << worst << " ulp");
	CHECK(worst < 4);
	CHECK(worst > 0);
	CHECK(bounces > 10000);
	CHECK(deep > 100);

	// A mirror's direction that is never normalised drifts away.
	rt_vec3 d = in_float(unit({1, 2, 3}));
	for (const rt_vec3& n : normals())
		for (int k = 0; k < 20; ++k) {
			const Vec3d m = in_double(n);
			const rt_vec3 side = in_float(unit({m[0] + 0.3, m[1] - 0.1 * k, m[2] + 0.2}));
			d = rt_reflect(d, -v3_dot(d, side), side);
			worst_drift = std::max(worst_drift, ulps_from_unit(d));
		}
	CHECK(worst_drift > 4);
}

TEST_CASE("rule 12: the frame about a normal is orthonormal, at its seam too")
{
	double worst = 0;
	for (const rt_vec3& n : normals()) {
		const Vec3d x = in_double(rt_from_frame(v3(1, 0, 0), n)), y = in_double(rt_from_frame(v3(0, 1, 0), n)),
		            z = in_double(rt_from_frame(v3(0, 0, 1), n));
		INFO(name_of(n));
		for (const double product : {dot(x, y), dot(y, z), dot(z, x)})
			worst = std::max(worst, std::fabs(product) / ulp);
		for (const Vec3d& axis : {x, y, z})
			worst = std::max(worst, std::fabs(dot(axis, axis) - 1) / ulp);
		CHECK(dot(z, in_double(n)) > 1 - 8 * ulp); // its z axis is the normal
	}
	INFO("worst product or length: " << worst << " ulp");
	CHECK(worst < 8);

	// Frisvad's frame (2012), whose first axis is (1 - a x^2, -a x y, -x) with a = 1 / (1 + z), beside z = -1.
	const float nx = 0x1p-12f, nz = std::nextafterf(-1.0f, 0.0f);
	const float a = 1 / (1 + nz);
	const Vec3d first = {static_cast<double>(1 - a * nx * nx), 0, static_cast<double>(-nx)};
	CHECK(std::fabs(dot(first, first) - 1) / ulp > 8);
}

TEST_CASE("a path's bounces are independent of each other and of its place in the pixel")
{
	Material white = material_of(Material::Kind::Lambertian);
	const Probe probe(white, 1);
	const rt_path start = probe.path_at(0.8);
	const rt_hit hit = rt_closest_hit(probe.view, start.ray, RT_TRUE);
	REQUIRE(hit.index == 0);
	const rt_surface surface = rt_sphere_surface(probe.view.scene, probe.view.spheres, start.ray, hit.t, hit.index);
	const About frame(in_double(surface.normal));
	Independence<8> independence;
	for (std::uint32_t i = 0; i < million / 4; ++i) {
		const std::uint32_t sample = i % 256, column = (i / 256) % 32, row = i / (256 * 32);
		std::array<double, 8> u{};
		const rt_path primary = rt_path_start(probe.view, column, row, sample);
		const std::array<double, 2> place = place_in_pixel(probe.packed.scene, primary.ray, column, row);
		u[0] = place[0];
		u[1] = place[1];
		for (std::size_t bounce = 0; bounce < 3; ++bounce) {
			// The same surface each time; only the path's depth says that it is another bounce.
			rt_path path = start;
			path.depth = static_cast<rt_i32>(bounce);
			rt_path_scatter(probe.view, &path, hit, row * 640 + column, sample, RT_TRUE);
			const Vec3d d = in_double(path.ray.dir);
			u[2 + 2 * bounce] = 1 - frame.cosine(d) * frame.cosine(d);
			u[3 + 2 * bounce] = frame.around(d);
		}
		independence.add(u);
	}
	TestFamily family;
	independence.tell(family, {"x", "y", "sine 0", "angle 0", "sine 1", "angle 1", "sine 2", "angle 2"});
	CHECK_FAMILY(family);
}

TEST_CASE("rules 11 and 12: normals are unit vectors whatever the sphere's size and distance")
{
	std::mt19937_64 engine(1);
	const auto uniform = [&] { return static_cast<double>(engine() >> 11) * 0x1p-53; };
	const auto direction = [&] {
		const double z = 2 * uniform() - 1, angle = 2 * pi * uniform();
		const double r = std::sqrt(1 - z * z);
		return Vec3d{r * std::cos(angle), r * std::sin(angle), z};
	};
	double worst = 0;
	std::uint32_t hits = 0, far_sides = 0, wide_hits = 0;
	for (int k = 0; k < 3000; ++k) {
		// Two spheres, each at times wide; sizes over six decades, distances up to 2^20 radii.
		Scene scene;
		scene.materials = {material_of(Material::Kind::Lambertian)};
		for (int i = 0; i < 2; ++i) {
			const double radius = std::pow(10.0, 6 * uniform() - 3);
			const double distance = radius * std::exp2(k % 2 ? 3 * uniform() - 2 : 22 * uniform() - 2);
			const Vec3d d = direction();
			scene.spheres.push_back({{distance * d[0], distance * d[1], distance * d[2]}, radius, 0});
		}
		const auto packed = pack_scene(scene, scene.render, {0, 0, 640, 480});
		REQUIRE(packed);
		rt_scene_view view{};
		view.scene = &packed->scene;
		view.spheres = packed->spheres.data();
		view.wide = packed->wide.data();
		view.sphere_ids = packed->sphere_ids.data();
		for (std::uint32_t i = 0; i < 2; ++i) {
			const rt_sphere& sphere = packed->spheres[i];
			for (int ray_number = 0; ray_number < 20; ++ray_number) {
				// From the camera towards a random point of the sphere.
				const Vec3d point = direction();
				const Vec3d at = {static_cast<double>(sphere.cx) + point[0] * static_cast<double>(sphere.radius),
				                  static_cast<double>(sphere.cy) + point[1] * static_cast<double>(sphere.radius),
				                  static_cast<double>(sphere.cz) + point[2] * static_cast<double>(sphere.radius)};
				rt_ray ray;
				ray.base = ray.arm = v3(0, 0, 0);
				ray.reach = 1;
				ray.dir = v3_normalize(in_float(at), v3(0, 0, 1));
				ray.from = -1;
				ray.chord = -1;
				for (int leg = 0; leg < 2; ++leg) {
					const rt_hit hit = rt_closest_hit(view, ray, RT_TRUE);
					if (hit.index < 0)
						break;
					const rt_surface s =
					    rt_sphere_surface(&packed->scene, packed->spheres.data(), ray, hit.t, hit.index);
					worst = std::max(worst, ulps_from_unit(s.normal));
					++hits;
					far_sides += leg == 1 && hit.index == ray.from ? 1 : 0;
					wide_hits += hit.index < static_cast<rt_i32>(packed->wide.size()) ? 1 : 0;
					// On into the sphere.
					const rt_vec3 inward =
					    v3_normalize(v3_sub(in_float(direction()), v3_scale(1.5f, s.normal)), ray.dir);
					ray.base = s.base;
					ray.arm = s.arm;
					ray.reach = s.reach;
					ray.dir = inward;
					ray.from = hit.index;
					ray.chord = s.radius * v3_dot(s.normal, inward) * -2.0f;
				}
			}
		}
	}
	INFO("longest or shortest normal: " << worst << " ulp");
	CHECK(worst < 4);
	CHECK(worst > 0);
	CHECK(hits > 50000);
	CHECK(far_sides > 10000);
	CHECK(wide_hits > 10000);
}
