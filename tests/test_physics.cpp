// Are the images right? Closed forms, and an independent path tracer in double (tests/textbook_tracer.h).
//
// All seeds are fixed. A statistical comparison says at its place how often a correct program would fail it if its
// random numbers were drawn anew, and is shown to fail for a scene that is slightly wrong.
#include "backends/registry.h"
#include "common/rt_contract.h"
#include "render/pack.h"
#include "render/scene_file.h"
#include "render/session.h"
#include "tests/catch.h"
#include "tests/scene_builders.h"
#include "tests/statistics.h"
#include "tests/textbook_tracer.h"

#include <array>
#include <cmath>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

using namespace rt;

namespace {

constexpr double pi = 3.14159265358979323846;

// ---- rendering on the reference device ----

DeviceHandle reference_device()
{
	static const DeviceHandle device = [] {
		const auto infos = select_devices({"reference", ""}, enumerate_all());
		REQUIRE(infos);
		REQUIRE(infos->size() == 1);
		const auto opened = open_device((*infos)[0]);
		REQUIRE(opened);
		return *opened;
	}();
	return device;
}

Film render(const Scene& scene, const RenderSettings& settings)
{
	const auto packed = pack_scene(scene, settings, {0, 0, settings.width, settings.height});
	REQUIRE(packed);
	SessionOptions options;
	options.samples = settings.samples;
	auto result = render_scene(*packed, {reference_device()}, options);
	if (!result)
		FAIL(result.error().message << " " << result.error().log);
	CHECK(result->film.rejected == 0);
	return std::move(result->film);
}

Scene shipped(const std::string& name)
{
	const auto file = load_scene_file(RT_SOURCE_DIR "/scenes/" + name + ".json");
	REQUIRE(file);
	return file->base;
}

// In a scene where each sample is 0 or `value` exactly: how many samples of a pixel were not 0. A sum that is no whole
// number of values, or differs between channels, fails.
std::vector<std::int64_t> hits_of(const Film& film, double value)
{
	const std::int64_t unit = static_cast<std::int64_t>(std::ldexp(value, film.exponent()));
	std::vector<std::int64_t> hits;
	bool whole = true;
	for (std::size_t i = 0; i < film.samples().size(); ++i) {
		const std::int64_t* sum = &film.sums()[3 * i];
		const std::int64_t count = sum[0] / unit;
		whole = whole && sum[0] == count * unit && sum[1] == sum[0] && sum[2] == sum[0] && count >= 0 &&
		        count <= static_cast<std::int64_t>(film.samples()[i]);
		hits.push_back(count);
	}
	CHECK(whole);
	return hits;
}

std::int64_t total_of(const std::vector<std::int64_t>& counts)
{
	std::int64_t total = 0;
	for (const std::int64_t count : counts)
		total += count;
	return total;
}

// ---- comparison with the double tracer ----

struct Agreement {
	double mean_z = 0;        // of the whole image, the worst channel
	double chi_squared_p = 0; // of all blocks, the worst channel, by Sidak
	double worst_block_p = 0; // of the worst block and channel, by Sidak
	bool holds() const { return mean_z < 4 && chi_squared_p > 1e-4 && worst_block_p > 1e-4; }
};

// Means over blocks of `side` x `side` pixels, of which the double tracer also tells the variance; blocks have a
// thousand samples or more, so that their means are normal. If both programs are right, holds() is false with a
// probability of 3 * 6.4e-5 + 1e-4 + 1e-4 = 4e-4, or a little more as means of bounded samples are not quite normal.
Agreement compare(const Film& film, const TracedImage& truth, std::uint32_t side)
{
	Agreement agreement;
	TestFamily chi_squared_family, block_family;
	const double of_film = 1.0 / film.max_samples(), of_truth = 1.0 / truth.samples;
	const double both = of_film + of_truth;
	// What happens to one path of a thousand may be missing from all of a block's samples in the truth, which then says
	// that nothing varies: allow for three more samples that are off by the brightest radiance, black or bright.
	const double brightest = std::ldexp(1.0, RT_FILM_BITS - film.exponent());
	const double unseen = 3 * brightest * brightest * (of_film * of_film + of_truth * of_truth);
	for (int channel = 0; channel < 3; ++channel) {
		const std::size_t c = static_cast<std::size_t>(channel);
		double statistic = 0, blocks = 0, total = 0, total_variance = 0;
		for (std::uint32_t top = 0; top < truth.height; top += side)
			for (std::uint32_t left = 0; left < truth.width; left += side) {
				double difference = 0, variance = 0, pixels = 0;
				for (std::uint32_t y = top; y < std::min(top + side, truth.height); ++y)
					for (std::uint32_t x = left; x < std::min(left + side, truth.width); ++x) {
						const PixelEstimate& pixel = truth.pixels[std::size_t(y) * truth.width + x];
						difference += film.radiance(x, y, channel) - pixel.mean[c];
						variance += pixel.variance[c] * both;
						pixels += 1;
					}
				total += difference;
				total_variance += variance;
				variance += unseen + pixels * pixels * 1e-12; // and some 1e-6 a pixel of rounding
				statistic += difference * difference / variance;
				blocks += 1;
				block_family.add("block", normal_p(difference / std::sqrt(variance)));
			}
		chi_squared_family.add("channel", chi_squared_p(statistic, blocks));
		agreement.mean_z = std::max(agreement.mean_z, std::fabs(total) / std::sqrt(total_variance));
	}
	agreement.chi_squared_p = chi_squared_family.p();
	agreement.worst_block_p = block_family.p();
	return agreement;
}

} // namespace

#define INFO_AGREEMENT(a) \
	INFO("mean z " << (a).mean_z << ", chi-squared p " << (a).chi_squared_p << ", worst block p " << (a).worst_block_p)

// ---- energy ----

TEST_CASE("inside a glowing sphere radiance is exactly 1 - 2^-depth")
{
	const Scene closed = shipped("closed");
	for (const std::uint32_t depth : {1u, 2u, 5u, 10u, 23u}) {
		INFO("depth " << depth);
		const Film film = render(closed, settings_of(32, 24, 8, depth, depth));
		// Every sample alike: the sum is samples times one integer, with nothing rounded.
		const std::int64_t one = std::int64_t(1) << film.exponent();
		const std::int64_t sample = one - (one >> depth);
		bool exact = true;
		for (const std::int64_t sum : film.sums())
			exact = exact && sum == 8 * sample;
		CHECK(exact);
		CHECK(film.segments == 32u * 24u * 8u * depth); // no path gets out
	}
}

TEST_CASE("where nothing absorbs, every sample is exactly 1 or was cut by max_depth")
{
	const Scene furnace = shipped("furnace");
	std::vector<std::int64_t> fewer;
	for (const std::uint32_t depth : {1u, 2u, 3u, 5u, 10u, 50u, 2000u}) {
		INFO("depth " << depth);
		const Film film = render(furnace, settings_of(48, 36, 64, depth));
		const std::vector<std::int64_t> hits = hits_of(film, 1.0);
		// The same paths go on: no pixel may lose by a larger depth.
		bool grows = true;
		for (std::size_t i = 0; i < fewer.size(); ++i)
			grows = grows && hits[i] >= fewer[i];
		CHECK(grows);
		fewer = hits;
		if (depth == 2000) // and in the end all arrive
			CHECK(total_of(hits) == 48 * 36 * 64);
	}
}

TEST_CASE("the energy that max_depth cuts is what an independent tracer loses")
{
	Scene furnace = shipped("furnace");
	for (const std::uint32_t depth : {2u, 4u}) {
		INFO("depth " << depth);
		const TracedImage truth = trace_in_double(furnace, settings_of(48, 36, 128, depth, 77));
		const Agreement agreement = compare(render(furnace, settings_of(48, 36, 128, depth)), truth, 6);
		INFO_AGREEMENT(agreement);
		CHECK(agreement.holds());
		CHECK_FALSE(compare(render(furnace, settings_of(48, 36, 128, depth + 1)), truth, 6).holds());
	}
}

TEST_CASE("fuzzy metal absorbs what an independent tracer says")
{
	Camera camera;
	camera.from = {0, 0, -4};
	camera.vfov = 32;
	Scene scene = scene_of(camera, 1, {material_of(Material::Kind::Metal, 1)}, {{{0, 0, 0}, 1, 0}});
	scene.materials[0].fuzz = 0.7;
	const TracedImage truth = trace_in_double(scene, settings_of(32, 32, 256, 50, 3));
	const Film film = render(scene, settings_of(32, 32, 256, 50));
	hits_of(film, 1.0); // each sample is 1 or absorbed
	const Agreement agreement = compare(film, truth, 4);
	INFO_AGREEMENT(agreement);
	CHECK(agreement.holds());
	scene.materials[0].fuzz = 0.73;
	CHECK_FALSE(compare(render(scene, settings_of(32, 32, 256, 50)), truth, 4).holds());
}

// ---- whole scenes ----

TEST_CASE("three-spheres agrees with an independent tracer")
{
	const Scene scene = shipped("three-spheres");
	const TracedImage truth = trace_in_double(scene, settings_of(48, 36, 512, 50, 2024));
	const RenderSettings settings = settings_of(48, 36, 512, 50);
	const Agreement agreement = compare(render(scene, settings), truth, 4);
	INFO_AGREEMENT(agreement);
	CHECK(agreement.holds());

	const auto agrees = [&](const Scene& wrong) { return compare(render(wrong, settings), truth, 4).holds(); };
	Scene wrong = scene;
	wrong.materials[0].albedo[0] *= 1.02; // ground 2 % too red
	CHECK_FALSE(agrees(wrong));
	wrong = scene;
	wrong.spheres[2].radius = 0.5; // glass not hollow
	CHECK_FALSE(agrees(wrong));
	wrong = scene;
	wrong.spheres[1].center[0] += 0.02; // the blue sphere a third of a pixel aside
	CHECK_FALSE(agrees(wrong));
	wrong = scene;
	for (Material& material : wrong.materials)
		if (material.kind == Material::Kind::Metal)
			material.fuzz = 0.2;
	CHECK_FALSE(agrees(wrong));
}

TEST_CASE("weekend agrees with an independent tracer")
{
	const Scene scene = shipped("weekend");
	const TracedImage truth = trace_in_double(scene, settings_of(48, 27, 200, 50, 2025));
	const RenderSettings settings = settings_of(48, 27, 200, 50);
	const Agreement agreement = compare(render(scene, settings), truth, 4);
	INFO_AGREEMENT(agreement);
	CHECK(agreement.holds());

	Scene wrong = scene;
	wrong.materials[0].albedo = {0.51, 0.51, 0.51};
	CHECK_FALSE(compare(render(wrong, settings_of(48, 27, 100, 50)), truth, 4).holds());
}

TEST_CASE("floating, with its textures, agrees with an independent tracer")
{
	const Scene scene = shipped("floating");
	const TracedImage truth = trace_in_double(scene, settings_of(48, 36, 256, 50, 2026));
	const RenderSettings settings = settings_of(48, 36, 256, 50);
	const Agreement agreement = compare(render(scene, settings), truth, 4);
	INFO_AGREEMENT(agreement);
	CHECK(agreement.holds());

	Scene wrong = scene;
	for (Texture& texture : wrong.textures)
		if (texture.kind == Texture::Kind::Checker)
			std::swap(texture.even, texture.odd);
	CHECK_FALSE(compare(render(wrong, settings), truth, 4).holds());
	wrong = scene;
	for (Texture& texture : wrong.textures)
		if (texture.kind == Texture::Kind::Image) // upside down
			for (std::uint32_t y = 0; y < texture.height / 2; ++y)
				for (std::uint32_t x = 0; x < texture.width; ++x)
					std::swap(texture.texels[std::size_t(y) * texture.width + x],
					          texture.texels[std::size_t(texture.height - 1 - y) * texture.width + x]);
	CHECK_FALSE(compare(render(wrong, settings), truth, 4).holds());
}

TEST_CASE("cornell agrees with an independent tracer")
{
	const Scene scene = shipped("cornell");
	const TracedImage truth = trace_in_double(scene, settings_of(24, 18, 256, 50, 2027));
	const Agreement agreement = compare(render(scene, settings_of(24, 18, 256, 50)), truth, 6);
	INFO_AGREEMENT(agreement);
	CHECK(agreement.holds());
	Scene wrong = scene;
	for (Material& material : wrong.materials)
		if (material.kind == Material::Kind::Light)
			for (double& e : material.emission)
				e *= 1.1;
	CHECK_FALSE(compare(render(wrong, settings_of(24, 18, 256, 50)), truth, 6).holds());
}

TEST_CASE("glass reflects by Fresnel's equations, not Schlick's, and by its own index")
{
	// A glass ball under a sky that is bright above and dark below; what it reflects and refracts is told apart.
	Camera camera;
	camera.from = {0, 0, -4};
	camera.at = {0, 0, 0};
	camera.vfov = 30;
	Material glass = material_of(Material::Kind::Dielectric, 1);
	Scene scene = scene_of(camera, 0, {glass}, {{{0, 0, 0}, 1, 0}});
	scene.sky.kind = Sky::Kind::Gradient;
	scene.sky.bottom = {0, 0, 1};
	scene.sky.top = {1, 0, 0};
	const RenderSettings settings = settings_of(32, 32, 1024, 50);
	for (const double ior : {1.5, 0.75}) {
		INFO("index " << ior);
		scene.materials[0].ior = ior;
		const TracedImage truth = trace_in_double(scene, settings_of(32, 32, 1024, 50, 5));
		const Film film = render(scene, settings);
		const Agreement agreement = compare(film, truth, 4);
		INFO_AGREEMENT(agreement);
		CHECK(agreement.holds());
		if (ior == 1.5) { // at 0.75 the approximation is too good to be told apart
			const TracedImage approximate =
			    trace_in_double(scene, settings_of(32, 32, 1024, 50, 5), Reflectance::Schlick);
			CHECK_FALSE(compare(film, approximate, 4).holds());
		}
		scene.materials[0].ior = ior + 0.02;
		CHECK_FALSE(compare(render(scene, settings), truth, 4).holds());
	}
}

// ---- light, perspective and lens in closed form ----
//
// Every sample is 0 or one known value, so counts are binomial. Each p-value enters a family that fails with
// probability 1e-4.

namespace {

Camera camera_from(const Vec3d& from, const Vec3d& at, double vfov)
{
	Camera camera;
	camera.from = from;
	camera.at = at;
	camera.vfov = vfov;
	return camera;
}

} // namespace

TEST_CASE("a spherical lamp lights a matte point as the solid angle says")
{
	// A lamp of radius r at distance d, seen at the angle a from the normal and wholly above the horizon, gives the
	// irradiance pi L (r / d)^2 cos a; a matte point turns it into radiance by albedo / pi. A scattered ray meets the
	// lamp with probability (r / d)^2 cos a.
	TestFamily family, wrong;
	for (const double ground : {1.0, 1000.0}) // the second is a wide sphere
		for (const double ratio : {0.4, 0.1})
			for (const double angle : {0.0, 30.0, 60.0}) {
				INFO("ground " << ground << ", r/d " << ratio << ", angle " << angle);
				const double a = angle * pi / 180;
				Camera camera = camera_from({0, 1, -5}, {0, 0, 0}, 0.01); // one point of the ground
				const Scene scene = scene_of(
				    camera, 0, {material_of(Material::Kind::Lambertian, 0.5), material_of(Material::Kind::Light, 0, 4)},
				    {{{0, -ground, 0}, ground, 0}, {{3 * std::sin(a), 3 * std::cos(a), 0}, 3 * ratio, 1}});
				const std::uint32_t samples = 1u << 18;
				const std::int64_t hits = total_of(hits_of(render(scene, settings_of(1, 1, samples, 10)), 2.0));
				const double probability = ratio * ratio * std::cos(a);
				family.add("lamp", binomial_p(static_cast<double>(hits), samples, probability));
				wrong.add("lamp", binomial_p(static_cast<double>(hits), samples, probability * 1.02));
			}
	CHECK(family.p() > 1e-4);
	CHECK(wrong.p() < 1e-4);
}

TEST_CASE("a lamp is as bright as it says, from outside and from inside")
{
	for (const double distance : {0.0, 0.5, 3.0}) {
		const Scene scene = scene_of(camera_from({0, 0, -distance}, {0, 0, 1}, 20), 0,
		                             {material_of(Material::Kind::Light, 0, 0.75)}, {{{0, 0, 0}, 1, 0}});
		const Film film = render(scene, settings_of(16, 16, 16, 3));
		CHECK(total_of(hits_of(film, 0.75)) == 16 * 16 * 16);
		CHECK(film.segments == 16 * 16 * 16);
	}
}

TEST_CASE("a sphere's picture has the size and place that perspective gives it")
{
	// A cone of half angle alpha about an axis at the angle psi from the view meets the image plane at distance 1 in an
	// ellipse of area pi cos(alpha) sin^2(alpha) / A^(3/2), A = cos^2(psi) - sin^2(alpha), whose centre lies
	// sin(psi) cos(psi) / A from the middle.
	TestFamily family, wrong;
	const double half = std::tan(25 * pi / 180);
	const double distance = 10, radius = 2;
	const double sine = radius / distance, cosine = std::sqrt(1 - sine * sine);
	struct Place {
		double psi, turn; // turn: angle in the image, from right towards up
	};
	for (const Place place :
	     {Place{0, 0}, Place{10, 0}, Place{10, 90}, Place{10, 180}, Place{10, 270}, Place{12, 40}}) {
		const double psi = place.psi * pi / 180, turn = place.turn * pi / 180;
		// Looking along +z with y up, the right-hand side of the image is -x.
		const Vec3d center = {-distance * std::sin(psi) * std::cos(turn), distance * std::sin(psi) * std::sin(turn),
		                      distance * std::cos(psi)};
		const Scene scene = scene_of(camera_from({0, 0, 0}, {0, 0, 1}, 50), 0,
		                             {material_of(Material::Kind::Light, 0, 1)}, {{center, radius, 0}});
		const std::uint32_t samples = 1u << 18;
		const double a = std::cos(psi) * std::cos(psi) - sine * sine;
		const double area = pi * cosine * sine * sine / std::pow(a, 1.5);
		const double hits = static_cast<double>(total_of(hits_of(render(scene, settings_of(1, 1, samples, 3)), 1.0)));
		family.add("area", binomial_p(hits, samples, area / (4 * half * half)));
		wrong.add("area", binomial_p(hits, samples, 1.03 * area / (4 * half * half)));

		// The centroid, in an image of 48 x 48; pixels make its variance smaller than that of single points.
		const std::vector<std::int64_t> image = hits_of(render(scene, settings_of(48, 48, 64, 3)), 1.0);
		double x = 0, y = 0;
		for (std::size_t i = 0; i < image.size(); ++i) {
			const std::size_t column = i % 48, row = i / 48;
			x += static_cast<double>(image[i]) * ((static_cast<double>(column) + 0.5) / 24 - 1) * half;
			y += static_cast<double>(image[i]) * (1 - (static_cast<double>(row) + 0.5) / 24) * half;
		}
		const double count = static_cast<double>(total_of(image));
		const double away = std::sin(psi) * std::cos(psi) / a;
		const double deviation = cosine * sine / a / 2 / std::sqrt(count); // of a disc with the ellipse's larger axis
		family.add("centre, x", normal_p((x / count - away * std::cos(turn)) / deviation));
		family.add("centre, y", normal_p((y / count - away * std::sin(turn)) / deviation));
	}
	CHECK(family.p() > 1e-4);
	CHECK(wrong.p() < 1e-4);
}

namespace {

struct Blur {
	double focus, distance;  // of the lens and of the lamp
	double aperture, radius; // lens diameter, lamp's radius
};

// p that a small lamp is spread by the lens over a disc of the radius (aperture / 2) |1 - focus / distance| on the
// plane in focus, scaled by `claim`.
double blur_p(const Blur& blur, double claim)
{
	constexpr std::uint32_t side = 128, samples = 256;
	const double disc = blur.aperture / 2 * std::fabs(1 - blur.focus / blur.distance);
	const double lamp = blur.radius * blur.focus / blur.distance; // its own picture on that plane
	const double half = 1.3 * (disc + lamp);
	Camera camera = camera_from({1, 2, 3}, {1, 2, 4}, 2 * std::atan(half / blur.focus) * 180 / pi);
	camera.aperture = blur.aperture;
	camera.focus = blur.focus;
	const Scene scene =
	    scene_of(camera, 0, {material_of(Material::Kind::Light, 0, 1)}, {{{1, 2, 3 + blur.distance}, blur.radius, 0}});
	const std::vector<std::int64_t> image = hits_of(render(scene, settings_of(side, side, samples, 3)), 1.0);

	TestFamily family;
	const double pixel = 2 * half / side;
	const double claimed = disc * claim;
	double count = 0, squares = 0;
	std::array<double, 32> hits{}, pixels{}; // by distance and quadrant, well inside the disc
	const double inner = claimed - lamp - 2 * pixel;
	bool outside = false;
	for (std::uint32_t y = 0; y < side; ++y)
		for (std::uint32_t x = 0; x < side; ++x) {
			const double n = static_cast<double>(image[std::size_t(y) * side + x]);
			const double px = (x + 0.5) * pixel - half, py = half - (y + 0.5) * pixel;
			const double square = px * px + py * py;
			count += n;
			squares += n * (square + pixel * pixel / 6); // a point's square on average over its pixel
			outside = outside || (n > 0 && std::sqrt(square) > claimed + 1.01 * lamp + pixel);
			if (inner > 0 && square < inner * inner) {
				const std::size_t ring = static_cast<std::size_t>(8 * square / (inner * inner));
				const std::size_t bin = 4 * ring + (px > 0 ? 1 : 0) + (py > 0 ? 2 : 0);
				hits[bin] += n;
				pixels[bin] += 1;
			}
		}
	family.add("nothing outside", outside ? 0 : 1);
	// How many: the lamp's picture in proportion to the image, whatever the blur.
	family.add("energy", binomial_p(count, double(side) * side * samples, pi * lamp * lamp / (4 * half * half)));
	// How far: the squared distance of a uniform disc has mean r^2 / 2 and variance r^4 / 12.
	const double mean = (claimed * claimed + lamp * lamp) / 2;
	const double variance = (std::pow(claimed, 4) + std::pow(lamp, 4)) / 12 + claimed * claimed * lamp * lamp / 2;
	family.add("size", normal_p((squares / count - mean) / std::sqrt(variance / count)));
	// How evenly.
	if (inner > 0) {
		double all_hits = 0, all_pixels = 0, statistic = 0, bins = 0;
		for (std::size_t i = 0; i < hits.size(); ++i) {
			all_hits += hits[i];
			all_pixels += pixels[i];
		}
		for (std::size_t i = 0; i < hits.size(); ++i)
			if (pixels[i] > 0) {
				const double expected = all_hits * pixels[i] / all_pixels;
				statistic += (hits[i] - expected) * (hits[i] - expected) / expected;
				bins += 1;
			}
		family.add("evenness", chi_squared_p(statistic, bins - 1));
	}
	return family.p();
}

} // namespace

TEST_CASE("a lens spreads a lamp out of focus over the disc of geometrical optics")
{
	// Lamp beyond the plane in focus, before it, and in it.
	for (const Blur blur : {Blur{4, 8, 0.25, 0.0125}, Blur{8, 4, 0.25, 0.0125}, Blur{4, 4, 0.25, 0.0125}}) {
		INFO("focus " << blur.focus << ", lamp at " << blur.distance);
		CHECK(blur_p(blur, 1) > 1e-4);
		if (blur.focus != blur.distance) {
			CHECK(blur_p(blur, 1.05) < 1e-4);
			CHECK(blur_p(blur, 0.95) < 1e-4);
		}
	}
}
