// Scenes and numbers at the ends of what rt takes (docs/extremes.md): closed forms, and the double rung as the oracle.
//
// Each TEST_CASE is one row of the table, or a part of one, over every device found. What it measures is recorded
// where RT_EXTREMES_RECORD names a file; tools/extremes makes the page of it. The textbook's form in float
// (tests/textbook_tracer.h) must visibly fail where a row says so: that is what the row is for.
//
// All seeds are fixed. |z| < 4 fails for a correct program once in 16,000 draws.
#include "tests/catch.h"
#include "tests/devices.h"
#include "tests/scene_builders.h"
#include "tests/statistics.h"
#include "tests/textbook_tracer.h"

#include "common/rt_contract.h"
#include "kernels/path.h"
#include "render/display.h"
#include "render/image_file.h"
#include "support/files.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <limits>

using namespace rt;

namespace {

constexpr double pi = 3.14159265358979323846;
const std::string host_kernels = "kernels on the host";
const std::string host_program = "host";
const std::string textbook = "textbook in float";

// ---- what is measured ----

void record(const std::string& row, const std::string& who, bool passed, const std::string& measured)
{
	if (const char* path = std::getenv("RT_EXTREMES_RECORD"))
		std::ofstream(path, std::ios::app)
		    << nlohmann::json{{"row", row}, {"device", who}, {"passed", passed}, {"measured", measured}}.dump() << '\n';
}

void judge(const std::string& row, const std::string& who, bool passed, const std::string& measured)
{
	INFO(row << ", " << who << ": " << measured);
	CHECK(passed);
	record(row, who, passed, measured);
}

// ---- scenes and films ----

Scene scene_named(const std::string& name)
{
	const Result<SceneFile> file = load_scene_file(RT_SOURCE_DIR "/scenes/" + name + ".json");
	if (!file)
		FAIL(file.error().message << " " << file.error().where);
	return file->base;
}

Material lamp(double emission) { return material_of(Material::Kind::Light, 0, emission); }
Material matte(double albedo) { return material_of(Material::Kind::Lambertian, albedo); }
Material glass(double ior)
{
	Material material = material_of(Material::Kind::Dielectric, 1);
	material.ior = ior;
	return material;
}

Camera camera_of(const Vec3d& from, const Vec3d& at, double vfov)
{
	Camera camera;
	camera.from = from;
	camera.at = at;
	camera.vfov = vfov;
	return camera;
}

PackedScene packed_of(const Scene& scene, const RenderSettings& settings, const Window* window = nullptr)
{
	Result<PackedScene> packed =
	    pack_scene(scene, settings, window ? *window : Window{0, 0, settings.width, settings.height});
	if (!packed)
		FAIL(packed.error().message);
	return std::move(packed).value();
}

Film film_of(const Scene& scene, const RenderSettings& settings, const TestDevice& device,
             Precision precision = Precision::Exact)
{
	SessionOptions options;
	options.precision = precision;
	options.specialise = false; // one program for all that a row renders
	Film film = render(packed_of(scene, settings), device, options, settings.samples);
	CHECK(film.rejected == 0);
	return film;
}

Film oracle_of(const Scene& scene, const RenderSettings& settings)
{
	return film_of(scene, settings, reference_device(), Precision::Double);
}

// Where each sample is 0 or `value`: how many are not 0, a pixel. -1 if a sum is no whole number of values.
std::vector<std::int64_t> hits_of(const Film& film, double value = 1)
{
	const auto unit = static_cast<std::int64_t>(std::nearbyint(std::ldexp(value, film.exponent())));
	std::vector<std::int64_t> hits;
	for (std::size_t i = 0; i < film.samples().size(); ++i)
		hits.push_back(film.sums()[3 * i] % unit == 0 ? film.sums()[3 * i] / unit : -1);
	return hits;
}

// Sums that are not 0.
std::int64_t lit_sums(const Film& film)
{
	return std::count_if(film.sums().begin(), film.sums().end(), [](std::int64_t sum) { return sum != 0; });
}

double total_of(const std::vector<std::int64_t>& counts)
{
	double total = 0;
	for (const std::int64_t count : counts)
		total += static_cast<double>(count);
	return total;
}

double samples_of(const RenderSettings& settings)
{
	return static_cast<double>(settings.width) * settings.height * settings.samples;
}

double binomial_z(double hits, double trials, double probability)
{
	return (hits - trials * probability) / std::sqrt(trials * probability * (1 - probability));
}

// Two films of the same expectation, pixel against pixel.
struct Agreement {
	double z = 0, relative = 0, worst = 0; // of the mean; of the mean; of a pixel, in means
	// Paired samples have the same random numbers: what rounding alone moves may be biased, and is nothing.
	bool holds() const { return std::fabs(z) < 4 || std::fabs(relative) < 1e-5; }
	std::string text() const
	{
		const std::string sigma = std::fabs(relative) < 1e-5 ? "" : fmt::format(" (z {:.1f})", z);
		return fmt::format("mean off by {:.1e}{}, worst pixel by {:.1e}", relative, sigma, worst);
	}
};

Agreement compare(const Film& film, const Film& truth)
{
	Agreement agreement;
	double sum = 0, squares = 0, mean = 0, n = 0;
	for (std::uint32_t y = 0; y < film.window().height; ++y)
		for (std::uint32_t x = 0; x < film.window().width; ++x)
			for (int c = 0; c < 3; ++c) {
				const double difference = film.radiance(x, y, c) - truth.radiance(x, y, c);
				sum += difference;
				squares += difference * difference;
				mean += truth.radiance(x, y, c);
				agreement.worst = std::max(agreement.worst, std::fabs(difference));
				n += 1;
			}
	mean = std::max(mean / n, 1e-30);
	const double variance = std::max(0.0, squares / n - sum / n * (sum / n));
	agreement.relative = sum / n / mean;
	agreement.worst /= mean;
	// Channels of a pixel go together: a third as many draws.
	agreement.z = variance > 0 ? sum / n / std::sqrt(variance / (n / 3)) : sum == 0 ? 0 : 1e9;
	return agreement;
}

double mean_of(const TracedImage& image)
{
	double sum = 0;
	for (const PixelEstimate& pixel : image.pixels)
		sum += pixel.mean[1];
	return sum / static_cast<double>(image.pixels.size());
}
double mean_of(const Film& film)
{
	double sum = 0;
	for (std::uint32_t y = 0; y < film.window().height; ++y)
		for (std::uint32_t x = 0; x < film.window().width; ++x)
			sum += film.radiance(x, y, 1);
	return sum / static_cast<double>(film.pixels());
}
// Mean absolute difference of the pixels, in means of the truth.
double distance(const TracedImage& image, const Film& truth)
{
	double sum = 0;
	for (std::uint32_t y = 0; y < image.height; ++y)
		for (std::uint32_t x = 0; x < image.width; ++x)
			sum += std::fabs(image.pixels[std::size_t(y) * image.width + x].mean[1] - truth.radiance(x, y, 1));
	return sum / static_cast<double>(image.pixels.size()) / mean_of(truth);
}

void scale_scene(Scene& scene, double factor)
{
	for (double* length : {&scene.camera.aperture, &scene.camera.focus})
		*length *= factor;
	for (Vec3d* point : {&scene.camera.from, &scene.camera.at})
		for (double& c : *point)
			c *= factor;
	for (Sphere& sphere : scene.spheres) {
		for (double& c : sphere.center)
			c *= factor;
		sphere.radius *= factor;
	}
}

void move_scene(Scene& scene, double offset)
{
	for (Vec3d* point : {&scene.camera.from, &scene.camera.at})
		for (double& c : *point)
			c += offset;
	for (Sphere& sphere : scene.spheres)
		for (double& c : sphere.center)
			c += offset;
}

// The sealed box with a ceiling that shines.
Scene lit_box()
{
	Scene scene = scene_named("extremes/sealed-box");
	scene.materials.push_back(lamp(1));
	scene.spheres[5].material = static_cast<std::uint32_t>(scene.materials.size() - 1);
	return scene;
}

// Glass under a closed wall that is a little larger, seen from inside: black.
Scene glass_in_wall(double gap)
{
	return scene_of(camera_of({0.3, 0, 0}, {0, 0, -1}, 90), 1, {glass(1.5), matte(0.5)},
	                {{{0, 0, 0}, 1, 0}, {{0, 0, 0}, 1 + gap, 1}});
}

double degrees(double half_tangent) { return 2 * std::atan(half_tangent) * 180 / pi; }

} // namespace

// ---- distance and size ----

TEST_CASE("extreme: tiny far sphere", "[extremes]")
{
	struct Case {
		double radius, distance;
	};
	// A disc in a square picture of 2.5 radii.
	const double share = pi / 6.25;
	const RenderSettings settings = settings_of(16, 16, 64, 4);
	const auto disc = [](const Case& c, const Vec3d& towards) {
		const Vec3d from{c.distance * towards[0], c.distance * towards[1], c.distance * towards[2]};
		return scene_of(camera_of(from, {0, 0, 0}, degrees(1.25 * c.radius / c.distance)), 0, {lamp(1)},
		                {{{0, 0, 0}, c.radius, 0}});
	};
	const Vec3d axis{0, 0, 1}, oblique{2 / 7.0, 3 / 7.0, 6 / 7.0};
	Scene shaded = scene_named("extremes/tiny-far");
	const RenderSettings shading = settings_of(20, 15, 32, 4);
	const Film truth = oracle_of(shaded, shading);
	for (const TestDevice& device : test_devices()) {
		std::string text = "disc's area, sigma:";
		bool good = true;
		for (const Case& c : {Case{1, 1e5}, Case{1, 1e6}, Case{1e-4, 1e3}}) {
			const double z =
			    binomial_z(total_of(hits_of(film_of(disc(c, axis), settings, device))), samples_of(settings), share);
			good = good && std::fabs(z) < 4;
			text += fmt::format(" {:+.1f} at {:g} radii;", z, c.distance / c.radius);
		}
		const Agreement agreement = compare(film_of(shaded, shading, device), truth);
		judge("tiny-far", device.name, good && agreement.holds() && agreement.worst < 1e-3,
		      text + " shading at 1e7 radii: " + agreement.text());
		// Off the axes the components of a direction have steps of 2^-24, which the eye sees as steps of the disc.
		text = "oblique view, area by closed form:";
		good = true;
		for (const Case& c : {Case{1, 1e4}, Case{1, 1e5}, Case{1, 1e6}, Case{1e-4, 1e3}}) {
			const double area = total_of(hits_of(film_of(disc(c, oblique), settings, device))) / samples_of(settings);
			good = good && (c.distance / c.radius > 2e5 || std::fabs(area / share - 1) < 0.05);
			text += fmt::format(" {:.3f} at {:g} radii;", area / share, c.distance / c.radius);
		}
		judge("tiny-far-oblique", device.name, good, text);
	}
	const double area = mean_of(trace_in_float(disc({1e-4, 1e3}, axis), settings)) / share;
	const double far = distance(trace_in_float(shaded, shading), truth);
	judge("tiny-far", textbook, std::fabs(area - 1) > 0.1 && far > 0.1,
	      fmt::format("area {:.3f} of the true one; shading off by {:.0f} % a pixel", area, 100 * far));
}

TEST_CASE("extreme: huge ground", "[extremes]")
{
	const RenderSettings settings = settings_of(16, 12, 4, 2), level = settings_of(24, 24, 16, 2);
	double book_lost = 0, book_cases = 0;
	// Something small makes the ground wide (RT_WIDE_RATIO); here it is out of sight. A ground all
	// alone is not: it is seen by r^2 - |l|^2, which near it has lost its digits.
	const Sphere pebble = {{0, 1, 300}, 0.01, 0};
	for (const TestDevice& device : test_devices())
		for (const bool alone : {false, true}) {
			double lost = 0, worst_z = 0;
			for (const double radius : {1e3, 1e4, 1e5, 1e6})
				for (const double height : {1.0, 1e-3}) {
					Scene scene = scene_named("extremes/huge-ground");
					scene.spheres = {{{0, -radius, 0}, radius, 0}};
					if (!alone)
						scene.spheres.push_back(pebble);
					scene.camera = camera_of({0, height, 0}, {0, height - 0.2, -1}, 40);
					// Depth 2: a ray that meets the white ground must be in the sky next, or its sample is 0.
					lost += samples_of(settings) - total_of(hits_of(film_of(scene, settings, device)));
					if (&device == &test_devices().front()) {
						book_lost += 1 - mean_of(trace_in_float(scene, settings));
						book_cases += 1;
					}
					// The horizon dips by acos(r / (r + h)), a cone about the vertical.
					scene.materials = {lamp(1)};
					scene.sky = {};
					scene.camera = camera_of({0, height, 0}, {0, height, -1}, 20);
					const double dip = std::sqrt(height * (2 * radius + height)) / radius;
					const double top = std::tan(10 * pi / 180);
					double covered = 0;
					for (int i = 0; i < 1000; ++i) {
						const double x = ((i + 0.5) / 500 - 1) * top;
						covered += std::max(0.0, top - dip * std::sqrt(1 + x * x)) / (2 * top) / 1000;
					}
					const double z =
					    binomial_z(total_of(hits_of(film_of(scene, level, device))), samples_of(level), covered);
					worst_z = std::max(worst_z, std::fabs(z));
				}
			judge(
			    alone ? "huge-ground-alone" : "huge-ground", device.name, alone || (lost == 0 && worst_z < 4),
			    fmt::format("{}{:.0f} of {:.0f} samples wrong, radii 1e3 to 1e6, eye 1 and 1e-3 above; horizon within "
			                "{:.1f} sigma",
			                alone ? "with no other sphere: " : "", lost, 8 * samples_of(settings), worst_z));
		}
	judge("huge-ground", textbook, book_lost / book_cases > 0.02,
	      fmt::format("{:.0f} % of the light lost to re-hits", 100 * book_lost / book_cases));
}

TEST_CASE("extreme: smallpt box in float", "[extremes]")
{
	const Scene sealed = scene_named("extremes/sealed-box"), cornell = scene_named("cornell");
	const RenderSettings settings = settings_of(32, 24, 4, 50), lit = settings_of(16, 12, 64, 20);
	const Film truth = oracle_of(cornell, lit);
	for (const TestDevice& device : test_devices()) {
		const std::int64_t leaks = lit_sums(film_of(sealed, settings, device));
		const Agreement agreement = compare(film_of(cornell, lit, device), truth);
		judge("smallpt-box", device.name, leaks == 0 && agreement.holds(),
		      fmt::format("{} leaks; lit, against double: {}", leaks, agreement.text()));
	}
	const Film bright = oracle_of(lit_box(), lit);
	const double far = distance(trace_in_float(lit_box(), lit), bright);
	const double mean = mean_of(trace_in_float(lit_box(), lit)) / mean_of(bright);
	judge("smallpt-box", textbook, std::fabs(mean - 1) > 0.05,
	      fmt::format("with a shining ceiling {:.2f} of the light, {:.0f} % off a pixel", mean, 100 * far));
}

TEST_CASE("extreme: world offset", "[extremes]")
{
	const Scene scene = scene_named("three-spheres");
	const RenderSettings settings = settings_of(32, 24, 8, 50);
	const Film truth = oracle_of(scene, settings);
	for (const TestDevice& device : test_devices()) {
		const Film here = film_of(scene, settings, device);
		bool good = film_of(scene_named("extremes/world-offset"), settings, device).hash().hex() == here.hash().hex();
		std::string text =
		    fmt::format("+1e6, no rounding in the file: {} hash; with rounding:", good ? "same" : "OTHER");
		for (const double offset : {1e3 + 0.1, 1e4 + 0.1, 1e6 + 0.1}) {
			Scene moved = scene;
			move_scene(moved, offset);
			const Film there = film_of(moved, settings, device);
			double differing = 0;
			for (std::size_t i = 0; i < here.sums().size(); ++i)
				differing += here.sums()[i] != there.sums()[i];
			const Agreement agreement = compare(there, here);
			good = good && agreement.holds() && agreement.worst < 0.5;
			text += fmt::format(" {:.2f} % of sums differ at {:g};",
			                    100 * differing / static_cast<double>(here.sums().size()), offset);
		}
		judge("world-offset", device.name, good, text);
	}
	std::string text;
	double worst = 0;
	const double noise = distance(trace_in_float(scene, settings), truth);
	for (const double offset : {1e3, 1e4, 1e6}) {
		Scene moved = scene;
		move_scene(moved, offset);
		worst = distance(trace_in_float(moved, settings), truth);
		text += fmt::format("{:.0f} % a pixel at {:g}, ", 100 * worst, offset);
	}
	judge("world-offset", textbook, worst > 2 * noise, text + fmt::format("noise alone {:.0f} %", 100 * noise));
}

TEST_CASE("extreme: power-of-two scale", "[extremes]")
{
	const Scene scene = scene_named("three-spheres");
	const RenderSettings settings = settings_of(24, 16, 4, 50);
	const Film truth = oracle_of(scene, settings);
	for (const TestDevice& device : test_devices()) {
		const std::string hash = film_of(scene, settings, device).hash().hex();
		bool good = true;
		for (const int k : {-20, -7, 9, 20}) {
			Scene scaled = scene;
			scale_scene(scaled, std::ldexp(1.0, k));
			good = good && film_of(scaled, settings, device).hash().hex() == hash;
		}
		judge("scale", device.name, good, good ? "one hash for k = -20, -7, 0, 9, 20" : "hashes differ");
	}
	const double noise = distance(trace_in_float(scene, settings), truth);
	Scene scaled = scene;
	scale_scene(scaled, 0x1p-20);
	const double far = distance(trace_in_float(scaled, settings), truth);
	judge("scale", textbook, far > 2 * noise,
	      fmt::format("at 2^-20 {:.0f} % off a pixel, noise alone {:.0f} %", 100 * far, 100 * noise));
}

TEST_CASE("extreme: small spheres on a large one, far from the camera", "[extremes]")
{
	// Too far to be wide, too near for r^2 - |l|^2 to know the small ones' gap: what is lost must not be seen.
	const Scene scene = scene_named("extremes/small-on-large");
	const RenderSettings settings = settings_of(24, 18, 32, 50);
	const Film truth = oracle_of(scene, settings);
	const PackedScene packed = packed_of(scene, settings);
	CHECK(packed.wide.empty());
	for (const TestDevice& device : test_devices()) {
		const Agreement agreement = compare(film_of(scene, settings, device), truth);
		judge("small-on-large", device.name, agreement.holds(), agreement.text());
	}
	const double far = distance(trace_in_float(scene, settings), truth);
	record("small-on-large", textbook, true, fmt::format("{:.0f} % off a pixel", 100 * far));
}

TEST_CASE("extreme: grazing", "[extremes]")
{
	// The limb goes through the middle of the picture, which spans r (1 +- 2^-k). A float cannot tell rays apart that
	// pass within an ulp of r, 2^-23: beyond that no ray is misjudged.
	const RenderSettings settings = settings_of(32, 32, 2, 2);
	const auto limb = [](int k) {
		Scene scene = scene_named("extremes/grazing");
		scene.camera.vfov = degrees(std::ldexp(1.0, -k));
		return scene;
	};
	std::vector<double> truth;
	for (int k = 1; k <= 30; ++k)
		truth.push_back(total_of(hits_of(oracle_of(limb(k), settings))));
	for (const TestDevice& device : test_devices()) {
		bool monotone = true, right = true;
		int blurred = 0;
		for (int k = 1; k <= 30; ++k) {
			const std::vector<std::int64_t> hits = hits_of(film_of(limb(k), settings, device));
			// Rows are curved against the limb by 2^-2k alone.
			for (std::size_t i = 0; i < hits.size(); ++i)
				monotone = monotone && (i % 32 == 0 || hits[i] >= hits[i - 1]);
			const double off = std::fabs(total_of(hits) - truth[static_cast<std::size_t>(k - 1)]);
			right = right && off <= samples_of(settings) * std::min(1.0, std::ldexp(1.0, k - 22)) + 1;
			if (off > 0.25 * samples_of(settings) && blurred == 0)
				blurred = k;
		}
		judge("grazing", device.name, monotone && right,
		      fmt::format("k = 1 to 30: {}, misjudged only within an ulp of r{}",
		                  monotone ? "monotone" : "NOT MONOTONE",
		                  blurred ? fmt::format(" (from k = {} on rays count as touching)", blurred) : ""));
	}
	std::string text;
	double wrong = 0;
	for (const int k : {8, 12, 16, 20}) {
		Scene scene = limb(k);
		// The same picture from 1000 radii away.
		scene.spheres[0].center = {1, 0, -1000};
		scene.camera.vfov = degrees(std::ldexp(1e-3, -k));
		const double truth_mean = mean_of(oracle_of(scene, settings));
		const double off = std::fabs(mean_of(trace_in_float(scene, settings)) - truth_mean);
		wrong = std::max(wrong, off);
		text += fmt::format("{:.0f} % at k = {}, ", 100 * off, k);
	}
	judge("grazing", textbook, wrong > 0.05, "rays misjudged from 1000 radii away: " + text.substr(0, text.size() - 2));
}

TEST_CASE("extreme: ray origin on the surface, at the centre, inside", "[extremes]")
{
	const RenderSettings settings = settings_of(12, 12, 4, 2);
	for (const TestDevice& device : test_devices()) {
		bool good = true;
		std::string outward = "; on the surface outward, share that meets it all the same:";
		for (const double radius : {1.0, 100.0}) { // 100: wide beside the little one
			for (const double inside : {0.0, 0.5, 0.999999, 1.0}) {
				// Looking inward or from within: the lamp fills the picture. On the surface the near root is 0.
				const Scene in = scene_of(camera_of({0, 0, inside * radius}, {0, 0, -2 * radius}, 40), 0, {lamp(1)},
				                          {{{0, 0, 0}, radius, 0}, {{0, 0, 1e3}, 0.5, 0}});
				good = good && total_of(hits_of(film_of(in, settings, device))) == samples_of(settings);
			}
			const Scene out = scene_of(camera_of({0, 0, radius}, {0, 0, 2 * radius}, 40), 1, {lamp(0)},
			                           {{{0, 0, 0}, radius, 0}, {{0, 0, -1e3}, 0.5, 0}});
			outward +=
			    fmt::format(" {:.3f} at r = {:g},",
			                1 - total_of(hits_of(film_of(out, settings, device))) / samples_of(settings), radius);
		}
		outward.pop_back();
		judge("eye-on-sphere", device.name, good,
		      (good ? "inside, and on the surface inward: every sample right" : "SAMPLES DIFFER") + outward);
	}
}

// ---- spheres that meet ----

TEST_CASE("extreme: touching, overlapping, nested", "[extremes]")
{
	const Scene shells = scene_named("extremes/shells");
	const RenderSettings settings = settings_of(16, 12, 4, 50);
	for (const TestDevice& device : test_devices()) {
		const std::int64_t leaks = lit_sums(film_of(shells, settings, device));
		// Two spheres with a gap of 0, one ulp, 1e-7 r, and overlaps: their order in the file is not seen.
		bool order = true;
		for (const double gap : {0.0, 0x1p-23, -0x1p-23, 1e-7, -1e-7, -0.5}) {
			Scene pair = scene_of(camera_of({0, 0.3, 6}, {0, 0, 0}, 40), 0, {matte(0.8), matte(0.3)},
			                      {{{-1 - gap, 0, 0}, 1, 0}, {{1, 0, 0}, 1, 1}});
			pair.sky = scene_named("extremes/tiny-far").sky;
			const std::string hash = film_of(pair, settings, device).hash().hex();
			std::swap(pair.spheres[0], pair.spheres[1]);
			order = order && film_of(pair, settings, device).hash().hex() == hash;
		}
		judge("touching", device.name, leaks == 0 && order,
		      fmt::format("{} leaks through 50 shells; swapped pairs, gaps 0, 1 ulp, 1e-7, overlap: {}", leaks,
		                  order ? "same hash" : "OTHER HASH"));
		// Glass right under a closed wall: what refracts out must meet the wall, however thin the gap.
		std::string text = "share of light through a closed wall around glass:";
		bool tight = true;
		for (const double gap : {1e-2, 1e-4, 1e-6, 0x1p-22, 0x1p-23}) {
			const double leak = mean_of(film_of(glass_in_wall(gap), settings_of(16, 12, 32, 50), device));
			tight = tight && (gap < 0x1p-20 || leak == 0);
			text += fmt::format(" {:.4f} at {:.1e} r,", leak, gap);
		}
		text.pop_back();
		judge("thin-gap", device.name, tight, text);
	}
	const double through = mean_of(trace_in_float(glass_in_wall(1e-4), settings_of(16, 12, 32, 50)));
	judge("thin-gap", textbook, through > 0.01, fmt::format("{:.3f} of the light at 1e-4 r", through));
}

TEST_CASE("extreme: duplicate spheres", "[extremes]")
{
	const RenderSettings settings = settings_of(12, 12, 4, 2);
	for (const TestDevice& device : test_devices()) {
		Scene scene = scene_of(camera_of({0, 0, 5}, {0, 0, 0}, 10), 0, {lamp(1), lamp(0.5)},
		                       {{{0, 0, 0}, 1, 0}, {{0, 0, 0}, 1, 1}});
		const bool first = total_of(hits_of(film_of(scene, settings, device))) == samples_of(settings);
		std::swap(scene.spheres[0].material, scene.spheres[1].material);
		const bool other = total_of(hits_of(film_of(scene, settings, device), 0.5)) == samples_of(settings);
		judge("duplicates", device.name, first && other, first && other ? "the first one shows, always" : "mixed");
	}
}

// ---- glass ----

TEST_CASE("extreme: air bubble in glass", "[extremes]")
{
	const Scene scene = scene_named("extremes/bubble");
	const RenderSettings settings = settings_of(20, 15, 16, 2000);
	for (const TestDevice& device : test_devices()) {
		const double dark = samples_of(settings) - total_of(hits_of(film_of(scene, settings, device)));
		judge("bubble", device.name, dark == 0,
		      fmt::format("{:.0f} of {:.0f} samples are not exactly 1", dark, samples_of(settings)));
	}
	const double mean = mean_of(trace_in_float(scene, settings));
	record("bubble", textbook, true, fmt::format("mean {:.4f}", mean));
}

TEST_CASE("extreme: index 1", "[extremes]")
{
	const RenderSettings settings = settings_of(20, 15, 32, 50), other = settings_of(20, 15, 32, 50, 9);
	Scene alone = scene_of(camera_of({0, 0, 3}, {0, 0, 0}, 60), 0, {glass(1)}, {{{0, 0, 0}, 1, 0}});
	alone.sky = scene_named("extremes/tiny-far").sky;
	Scene nothing = alone;
	nothing.spheres.clear();
	const Scene with = scene_named("extremes/index-one"), without = scene_named("three-spheres");
	for (const TestDevice& device : test_devices()) {
		const double worst = compare(film_of(alone, settings, device), film_of(nothing, settings, device)).worst;
		const Agreement agreement = compare(film_of(with, settings, device), film_of(without, other, device));
		judge(
		    "index-one", device.name, worst < 1e-6 && agreement.holds(),
		    fmt::format("before a sky: worst pixel off by {:.1e}; before three-spheres: z {:.1f}", worst, agreement.z));
	}
}

TEST_CASE("extreme: light trap", "[extremes]")
{
	const Scene trap = scene_named("extremes/light-trap");
	// At the centre rays meet the surface head on: of each (3/5)^2 stays in.
	const Scene centre = scene_of(camera_of({0, 0, 0}, {0, 0, -1}, 40), 1, {glass(4)}, {{{0, 0, 0}, 1, 0}});
	for (const TestDevice& device : test_devices()) {
		bool dark = true, monotone = true;
		for (const std::uint32_t depth : {1u, 10u, 100u, 1000u, 10000u}) {
			const RenderSettings settings = settings_of(8, 8, 1, depth);
			const Film film = film_of(trap, settings, device);
			dark = dark && mean_of(film) == 0 && static_cast<double>(film.segments) == samples_of(settings) * depth;
		}
		double worst = 0;
		std::vector<std::int64_t> fewer(256, 0);
		for (const std::uint32_t depth : {1u, 2u, 3u, 4u, 6u, 10u, 100u, 10000u}) {
			const RenderSettings settings = settings_of(16, 16, 64, depth);
			const std::vector<std::int64_t> hits = hits_of(film_of(centre, settings, device));
			for (std::size_t i = 0; i < hits.size(); ++i)
				monotone = monotone && hits[i] >= fewer[i];
			fewer = hits;
			const double out = 1 - std::pow(0.36, depth - 1.0);
			if (out > 0 && out < 0.999)
				worst = std::max(worst, std::fabs(binomial_z(total_of(hits), samples_of(settings), out)));
			else if (depth > 10)
				monotone = monotone && total_of(hits) == samples_of(settings);
		}
		judge("light-trap", device.name, dark && monotone && worst < 4,
		      fmt::format("depth 1 to 1e4: {}, each sample {} with depth, geometric series within {:.1f} sigma",
		                  dark ? "no ray gets out, all end" : "RAYS GET OUT", monotone ? "grows" : "DOES NOT GROW",
		                  worst));
	}
}

TEST_CASE("extreme: critical angle", "[extremes]")
{
	const Scene scene = scene_named("extremes/critical-angle");
	const RenderSettings settings = settings_of(24, 18, 64, 2);
	const Film truth = oracle_of(scene, settings);
	for (const TestDevice& device : test_devices()) {
		const Film film = film_of(scene, settings, device);
		const Agreement agreement = compare(film, truth);
		double edge = 0, middle = 0; // rows of light, and of total reflection
		for (std::uint32_t x = 0; x < 24; ++x) {
			edge += film.radiance(x, 0, 0);
			middle += film.radiance(x, 9, 0);
		}
		judge("critical-angle", device.name, agreement.holds() && edge > 0 && middle == 0,
		      fmt::format("against double: {}; top row {:.3f}, middle row {:.3f}", agreement.text(), edge / 24,
		                  middle / 24));
	}
}

namespace {

// What rt_scatter_dielectric() reflects: the least u = k 2^-24 that refracts.
double reflectance_of(float eta, float c)
{
	const rt_vec3 n = v3(0, 0, 1);
	const float s = std::sqrt(std::fmax(0.0f, std::fma(-c, c, 1.0f)));
	std::uint32_t low = 0, high = 1u << 24; // refracts at high, if at all
	while (low < high) {
		const std::uint32_t middle = (low + high) / 2;
		rt_mask refracted = 0;
		rt_scatter_dielectric(static_cast<float>(middle) * 0x1p-24f, eta, v3(s, 0, -c), c, n, &refracted);
		if (refracted)
			high = middle;
		else
			low = middle + 1;
	}
	return low * 0x1p-24;
}

// Fresnel's equations for unpolarised light in long double.
double fresnel(float eta_float, float c_float)
{
	const auto eta = static_cast<long double>(eta_float), c = static_cast<long double>(c_float),
	           square = 1 - eta * eta * (1 - c * c);
	if (square <= 0)
		return 1;
	const long double beyond = std::sqrt(square);
	const long double s = (eta * c - beyond) / (eta * c + beyond), p = (eta * beyond - c) / (eta * beyond + c);
	return static_cast<double>((s * s + p * p) / 2);
}

} // namespace

TEST_CASE("extreme: Fresnel at the critical angle, head on and grazing", "[extremes]")
{
	double worst = 0, longest = 0;
	bool range = true;
	for (const float ior : {1.1f, 1.33f, 1.5f, 2.42f, 4.0f}) {
		float c = std::sqrt(1 - 1 / (ior * ior));
		for (int k = 0; k < 64; ++k)
			c = std::nextafter(c, 0.0f);
		for (int k = 0; k < 128; ++k, c = std::nextafter(c, 2.0f)) {
			const double f = reflectance_of(ior, c);
			range = range && f >= 0 && f <= 1 + 0x1p-24;
			worst = std::max(worst, std::fabs(f - fresnel(ior, c)));
			rt_mask refracted = 0;
			const float s = std::sqrt(std::fma(-c, c, 1.0f));
			const rt_vec3 d = rt_scatter_dielectric(1.0f, ior, v3(s, 0, -c), c, v3(0, 0, 1), &refracted);
			longest = std::max(longest, std::fabs(static_cast<double>(v3_dot(d, d)) - 1));
		}
	}
	judge("critical-angle", host_kernels, range && worst < 5e-3 && longest < 1e-3,
	      fmt::format("64 ulp to both sides, 5 indices: F in [0, 1], off by {:.1e}; |d|^2 before renormalising off by "
	                  "{:.1e}",
	                  worst, longest));
	double head_on = 0, grazing = 0;
	for (const float eta : {1.1f, 1.5f, 2.42f, 4.0f, 1 / 1.5f, 1 / 4.0f}) {
		head_on = std::max(head_on, std::fabs(reflectance_of(eta, 1.0f) - fresnel(eta, 1.0f)));
		grazing = std::max(grazing, std::fabs(reflectance_of(eta, 0x1p-24f) - fresnel(eta, 0x1p-24f)));
	}
	judge("normal-incidence", host_kernels, head_on < 2e-7 && grazing < 1e-6,
	      fmt::format("F off by {:.1e} at c = 1, by {:.1e} at c = 2^-24", head_on, grazing));
	const Scene centre = scene_of(camera_of({0, 0, 0}, {0, 0, -1}, 40), 1, {glass(1.5)}, {{{0, 0, 0}, 1, 0}});
	const RenderSettings settings = settings_of(16, 16, 256, 2);
	for (const TestDevice& device : test_devices()) {
		const double out = total_of(hits_of(film_of(centre, settings, device)));
		const double z = binomial_z(out, samples_of(settings), 0.96);
		judge("normal-incidence", device.name, std::fabs(z) < 4,
		      fmt::format("reflected {:.5f}, R0 = 0.04 (z {:.1f})", 1 - out / samples_of(settings), z));
	}
}

// ---- energy ----

TEST_CASE("extreme: white furnace and closed emissive sphere", "[extremes]")
{
	const Scene furnace = scene_named("furnace"), closed = scene_named("closed");
	const RenderSettings settings = settings_of(20, 15, 16, 2000);
	for (const TestDevice& device : test_devices()) {
		const double dark = samples_of(settings) - total_of(hits_of(film_of(furnace, settings, device)));
		judge("furnace", device.name, dark == 0,
		      fmt::format("{:.0f} of {:.0f} samples are not exactly 1 (depth 2000)", dark, samples_of(settings)));
		bool exact = true;
		for (const std::uint32_t depth : {1u, 5u, 23u}) {
			const Film film = film_of(closed, settings_of(16, 12, 4, depth), device);
			const std::int64_t one = std::int64_t(1) << film.exponent();
			for (const std::int64_t sum : film.sums())
				exact = exact && sum == 4 * (one - (one >> depth));
		}
		judge("closed-sphere", device.name, exact, exact ? "every sum is 1 - 2^-n exactly" : "sums differ");
	}
}

TEST_CASE("extreme: lamps from 1e-4 to 1e4, as bright as 1e-6 to 1e9", "[extremes]")
{
	const std::uint32_t samples = 1u << 14;
	const RenderSettings settings = settings_of(1, 1, samples, 4);
	for (const TestDevice& device : test_devices()) {
		TestFamily family;
		bool inside = true;
		for (int k = -4; k <= 4; ++k) {
			// Overhead at 2.5 radii: a scattered ray meets it with probability (r / d)^2.
			const double r = std::pow(10.0, k), brightness = std::pow(10.0, 1.875 * k + 1.5);
			const Scene scene = scene_of(camera_of({0, r, -5 * r}, {0, 0, 0}, 0.01), 0, {matte(0.5), lamp(brightness)},
			                             {{{0, -100 * r, 0}, 100 * r, 0}, {{0, 2.5 * r, 0}, r, 1}});
			const Film film = film_of(scene, settings, device);
			const double hits = film.radiance(0, 0, 0) * samples / (0.5 * brightness);
			family.add("lamp", std::fabs(hits - std::nearbyint(hits)) < 1e-3 * (1 + hits / 1e3)
			                       ? binomial_p(hits, samples, 0.16)
			                       : 0);
			const Scene within =
			    scene_of(camera_of({0, 0, 0}, {0, 0, 1}, 40), 0, {lamp(brightness)}, {{{0, 0, 0}, r, 0}});
			const double seen = mean_of(film_of(within, settings_of(4, 4, 2, 2), device));
			inside = inside && std::fabs(seen / brightness - 1) < 1e-6;
		}
		judge("lamps", device.name, inside && family.p() > 1e-4,
		      fmt::format("irradiance over 8 decades of radius, 15 of radiance: p {:.3f}; from inside {}", family.p(),
		                  inside ? "L" : "NOT L"));
	}
}

// ---- ends of samplers ----

TEST_CASE("extreme: degenerate normals and the ends of random numbers", "[extremes]")
{
	double worst = 0;
	const float below_one = std::nextafter(1.0f, 0.0f);
	const float sliver = std::sqrt(std::fma(-below_one, below_one, 1.0f));
	const rt_vec3 normals[] = {
	    v3(0, 0, 1), v3(0, 0, -1),    v3(0, 0, -0.0f),   v3(sliver, 0, -below_one), v3(0, -sliver, -below_one),
	    v3(1, 0, 0), v3(0, 1, -0.0f), v3(1, 0, 0x1p-60f)};
	for (const rt_vec3& n : normals) {
		if (v3_dot(n, n) == 0)
			continue;
		const rt_vec3 axes[] = {rt_from_frame(v3(1, 0, 0), n), rt_from_frame(v3(0, 1, 0), n),
		                        rt_from_frame(v3(0, 0, 1), n)};
		for (int i = 0; i < 3; ++i)
			for (int j = 0; j < 3; ++j)
				worst = std::max(worst, std::fabs(static_cast<double>(v3_dot(axes[i], axes[j])) - (i == j)));
		worst = std::max(worst, std::fabs(static_cast<double>(v3_dot(axes[2], n)) - 1));
	}
	judge("degenerate-normals", host_kernels, worst < 1e-6, fmt::format("frame orthonormal to {:.1e}", worst));

	double length = 0, least = 1;
	for (const float a : {0.0f, below_one})
		for (const float b : {0.0f, below_one})
			for (const rt_vec3& n : normals) {
				if (v3_dot(n, n) == 0)
					continue;
				rt_random4 u;
				u.a = a;
				u.b = b;
				u.c = u.d = a;
				const rt_disc_sample p = rt_sample_disc(u);
				const rt_vec3 diffuse = rt_scatter_lambertian(p, n);
				const rt_vec3 fuzzy = rt_scatter_metal(p, u.a, 1.0f, v3(0, 0, 0));
				for (const rt_vec3& d : {diffuse, fuzzy})
					length = std::max(length, std::fabs(static_cast<double>(v3_dot(d, d)) - 1));
				least = std::min(least, static_cast<double>(v3_dot(diffuse, n)));
			}
	// NaN would leave no trace in a maximum: the least cosine is above 0 only if all are numbers.
	judge("rng-ends", host_kernels, length < 1e-6 && least > 0,
	      fmt::format("|d|^2 within {:.1e} of 1, least cosine {:.1e}", length, least));
}

TEST_CASE("extreme: poles and seam of a texture", "[extremes]")
{
	Texture texel;
	texel.kind = Texture::Kind::Image;
	texel.width = texel.height = 1;
	texel.texels = {0x00ffffff}; // white: weight 1
	Material painted = matte(1);
	painted.texture = 0;
	const RenderSettings settings = settings_of(16, 16, 8, 2);
	for (const TestDevice& device : test_devices()) {
		bool white = true;
		std::string text;
		for (const Vec3d& from : {Vec3d{0, 3, 0}, Vec3d{0, -3, 0}, Vec3d{-3, 0, 0}, Vec3d{3, 0, 0}}) {
			Scene scene = scene_of(camera_of(from, {0, 0, 0}, 0.001), 1, {painted}, {{{0, 0, 0}, 1, 0}});
			scene.camera.up = {0, 0, 1};
			scene.textures = {texel};
			white = white && total_of(hits_of(film_of(scene, settings, device))) == samples_of(settings);
			// Two columns and two rows: the seam runs through the picture, against double.
			scene.textures[0].width = scene.textures[0].height = 2;
			scene.textures[0].texels = {0x00ffffff, 0, 0, 0x00ffffff};
			const double share = mean_of(film_of(scene, settings, device));
			const double truth = mean_of(oracle_of(scene, settings));
			white = white && std::fabs(share - truth) < 0.02;
			text += fmt::format(" {:.3f} ({:.3f})", share, truth);
		}
		judge("uv-poles", device.name, white,
		      "one texel: exactly its colour at poles and seam; 2x2, light share there and in double:" + text);
	}
}

// ---- input ----

namespace {

// A small scene, one value of which is replaced; line 4 or 6 holds it.
std::string scene_text(const std::string& what, const std::string& value)
{
	const auto pick = [&](const char* name, const char* usual) { return what == name ? value : std::string(usual); };
	return "{\n\"rt\": 1,\n\"camera\": {\n\"from\": " + pick("from", "[0, 0, 5]") +
	       ", \"at\": [0, 0, 0], \"up\": " + pick("up", "[0, 1, 0]") + ", \"vfov\": " + pick("vfov", "30") +
	       "},\n\"sky\": {\"kind\": \"none\"}, \"materials\": {\"m\": {\"kind\": \"light\", \"emission\":\n[" +
	       pick("emission", "1") + ", 1, 1]}},\n\"spheres\": [{\"center\": [" + pick("center", "0") +
	       ", 0, 0], \"radius\": " + pick("radius", "1") + ", \"material\": \"m\"}],\n\"render\": {" +
	       pick("render", "\"width\": 8") + "}\n}\n";
}

struct BadValue {
	const char* what;
	const char* value;
};

// How many are refused with a line and a cure.
std::string refused(const std::vector<BadValue>& values, bool& all)
{
	int count = 0;
	for (const BadValue& bad : values) {
		const Result<SceneFile> file = parse_scene(scene_text(bad.what, bad.value), "scene.json");
		INFO(bad.what << " = " << bad.value);
		const bool told = !file && file.error().kind == ErrorKind::InputOutput &&
		                  file.error().where.find("scene.json:") == 0 && !file.error().cure.empty();
		CHECK(told);
		count += told;
	}
	all = count == static_cast<int>(values.size());
	return fmt::format("{} of {} refused with line and cure", count, values.size());
}

} // namespace

TEST_CASE("extreme: bright outliers, subnormal and senseless input", "[extremes]")
{
	bool all = false;
	CHECK(parse_scene(scene_text("", ""), "scene.json")); // the control
	std::string text =
	    refused({{"emission", "1e30"}, {"emission", "1e400"}, {"emission", "Infinity"}, {"emission", "NaN"}}, all);
	judge("outlier", host_program, all, text);
	text = refused({{"radius", "1e-42"}, {"emission", "1e-40"}, {"center", "1e-42"}, {"radius", "4.9e-324"}}, all);
	judge("subnormal", host_program, all, text);
	text = refused({{"radius", "0"},
	                {"radius", "NaN"},
	                {"radius", "1e39"},
	                {"center", "1e39"},
	                {"vfov", "0"},
	                {"vfov", "180"},
	                {"from", "[0, 0, 0]"},
	                {"up", "[0, 0, 1]"},
	                {"up", "[0, 0, 0]"},
	                {"render", "\"width\": 0"},
	                {"render", "\"samples\": 0"},
	                {"render", "\"samples\": 16777216"},
	                {"render", "\"max_depth\": 0"}},
	               all);
	const Result<SceneFile> empty = parse_scene("", "scene.json");
	judge("out-of-contract", host_program, all && !empty, text + "; an empty file too");
}

// ---- sizes ----

TEST_CASE("extreme: sizes of images", "[extremes]")
{
	const Scene scene = scene_named("three-spheres");
	Scene nothing = scene;
	nothing.spheres.clear();
	for (const TestDevice& device : test_devices()) {
		bool good = mean_of(film_of(nothing, settings_of(4, 4, 2, 5), device)) > 0.5;
		good = good && film_of(scene, settings_of(1, 1, 3, 50), device).pixels() == 1;
		// A corner of a huge image alone, and as part of a tile around it.
		std::string text = "no sphere, 1x1; corners equal to those of a tile in";
		for (const auto& [width, height] :
		     {std::pair(1u, 16384u), std::pair(16384u, 16384u), std::pair(65535u, 65535u)}) {
			const RenderSettings settings = settings_of(width, height, 2, 50);
			const std::uint32_t w = std::min(width, 3u), tile = std::min(width, 33u);
			const Window small{width - w, height - 3, w, 3}, large{width - tile, height - 33, tile, 33};
			const Film corner = render(packed_of(scene, settings, &small), device, {}, 2);
			const Film around = render(packed_of(scene, settings, &large), device, {}, 2);
			for (std::uint32_t y = 0; y < 3; ++y)
				for (std::uint32_t x = 0; x < w; ++x)
					for (std::size_t c = 0; c < 3; ++c)
						good = good && corner.sums()[3 * (std::size_t(y) * w + x) + c] ==
						                   around.sums()[3 * (std::size_t(y + 30) * tile + x + tile - w) + c];
			text += fmt::format(" {}x{}", width, height);
		}
		judge("sizes", device.name, good, text);
	}
	RenderSettings settings = settings_of(1, 1, RT_MAX_SAMPLES, 5);
	CHECK(pack_scene(scene, settings, {0, 0, 1, 1}));
	settings.samples = 1u << 24;
	const bool refuses = !pack_scene(scene, settings, {0, 0, 1, 1});
	judge("sizes", host_program, refuses, "2^24 samples a pixel are refused; 2^22 is the most");
}

// Minutes on slow devices: run by tools/extremes.
TEST_CASE("extreme: the most samples, the brightest light, a million spheres", "[.large]")
{
	const Scene bright = scene_of(camera_of({0, 0, 0}, {0, 0, 1}, 40), 0, {lamp(1e9)}, {{{0, 0, 0}, 1, 0}});
	const Result<SceneFile> cloud = open_scene("cloud-1048576");
	REQUIRE(cloud);
	const Film million = film_of(cloud->base, settings_of(16, 12, 1, 20), reference_device());
	for (const TestDevice& device : test_devices()) {
		const Film film = film_of(bright, settings_of(1, 1, RT_MAX_SAMPLES, 2), device);
		// 1e9 as a float, times a power of two, is an integer: so is every sample, and the sum is known.
		const auto sample = static_cast<std::int64_t>(std::ldexp(1e9, film.exponent()));
		const bool exact = film.sums()[0] == sample * std::int64_t(RT_MAX_SAMPLES);
		judge("accumulator", device.name, exact && film.sums()[0] > 0,
		      fmt::format("2^22 samples of 1e9: the sum is {} of 2^63, {}",
		                  fmt::format("{:.3f}", std::ldexp(static_cast<double>(film.sums()[0]), -63)),
		                  exact ? "exact" : "WRONG"));
		const bool same = film_of(cloud->base, settings_of(16, 12, 1, 20), device).hash().hex() == million.hash().hex();
		judge("sizes-spheres", device.name, same, same ? "2^20 spheres: the film of the reference" : "films differ");
	}
}

TEST_CASE("extreme: long run", "[.large]")
{
	// Every pixel expects 0.64; sample ranges that double are independent of each other.
	const Scene centre = scene_of(camera_of({0, 0, 0}, {0, 0, -1}, 40), 1, {glass(4)}, {{{0, 0, 0}, 1, 0}});
	for (const TestDevice& device : test_devices()) {
		const PackedScene packed = packed_of(centre, settings_of(8, 4, 1, 2));
		double sum_x = 0, sum_y = 0, sum_xx = 0, sum_xy = 0, n = 0, last = 0;
		for (int k = 4; k < 20; ++k) {
			const std::uint32_t samples = 1u << k;
			const Film film = render(packed, device, {}, samples, samples);
			double squares = 0;
			for (const std::int64_t hits : hits_of(film)) {
				const double error = static_cast<double>(hits) / samples - 0.64;
				squares += error * error / 32;
			}
			const double x = k * std::log(2.0), y = 0.5 * std::log(squares);
			sum_x += x;
			sum_y += y;
			sum_xx += x * x;
			sum_xy += x * y;
			n += 1;
			last = std::sqrt(squares);
		}
		const double slope = (n * sum_xy - sum_x * sum_y) / (n * sum_xx - sum_x * sum_x);
		judge("long-run", device.name, std::fabs(slope + 0.5) < 0.05,
		      fmt::format("RMSE over 32 pixels, 2^4 to 2^20 samples: slope {:.3f}, at the end {:.1e}", slope, last));
	}
}

// ---- pictures ----

namespace {

// The textbook in float on the left, rt on the right.
void write_pair(const std::string& name, const Scene& scene, RenderSettings settings)
{
	settings.width = 200;
	settings.height = 150;
	const std::uint32_t gap = 4, width = 2 * settings.width + gap;
	std::vector<std::uint8_t> pixels(std::size_t(width) * settings.height * 3, 255);
	const TracedImage book = trace_in_float(scene, settings);
	const std::vector<std::uint8_t> ours = to_8bit(film_of(scene, settings, reference_device()), {});
	for (std::uint32_t y = 0; y < settings.height; ++y)
		for (std::uint32_t x = 0; x < settings.width; ++x)
			for (std::size_t c = 0; c < 3; ++c) {
				const std::size_t from = std::size_t(y) * settings.width + x;
				const double value = book.pixels[from].mean[c];
				pixels[3 * (std::size_t(y) * width + x) + c] = value > 0 ? to_8bit(value, {}) : std::uint8_t(0);
				pixels[3 * (std::size_t(y) * width + x + settings.width + gap) + c] = ours[3 * from + c];
			}
	const auto png = encode_png(width, settings.height, pixels, Transfer::Srgb, {});
	REQUIRE(png);
	REQUIRE(write_file(RT_SOURCE_DIR "/docs/images/extremes/" + name + ".png", png->data(), png->size()));
}

} // namespace

// Run by hand: test_extremes "[.pictures]"
TEST_CASE("draw the pictures of docs/extremes.md", "[.pictures]")
{
	for (const char* name : {"tiny-far", "huge-ground", "world-offset", "small-on-large"}) {
		const Scene scene = scene_named(std::string("extremes/") + name);
		write_pair(name, scene, scene.render);
	}
	write_pair("lit-box", lit_box(), settings_of(200, 150, 64, 50));
	write_pair("thin-gap", glass_in_wall(1e-4), settings_of(200, 150, 4, 50));
	Scene scaled = scene_named("three-spheres");
	scale_scene(scaled, 0x1p-9);
	write_pair("scale", scaled, settings_of(200, 150, 64, 50));
}
