// Contract rule 20: a render that stops at an error decides at fixed numbers of samples from integers, so its film is
// one film; and the error that it tells is honest.
#include "tests/catch.h"
#include "tests/devices.h"

#include "render/adaptive.h"
#include "render/adaptive_render.h"

#include <algorithm>
#include <cmath>
#include <iostream>
#include <limits>
#include <map>
#include <numeric>
#include <random>
#include <set>

using namespace rt;

namespace {

PackedScene pack(const std::string& name, std::uint32_t width, std::uint32_t height, std::uint32_t seed = 0,
                 Estimator estimator = Estimator::Path)
{
	const Result<SceneFile> file = open_scene(name);
	REQUIRE(file);
	RenderSettings settings;
	settings.width = width;
	settings.height = height;
	settings.seed = seed;
	settings.estimator = estimator;
	Result<PackedScene> packed = pack_scene(file->base, settings, {0, 0, width, height});
	REQUIRE(packed);
	return std::move(packed).value();
}

AdaptiveResult render_to(const PackedScene& packed, const std::vector<const TestDevice*>& devices,
                         AdaptiveOptions options)
{
	std::vector<DeviceHandle> handles;
	for (const TestDevice* device : devices) {
		handles.push_back(device->device);
		options.session.software_roots = options.session.software_roots || device->needs_software_roots;
	}
	Result<AdaptiveResult> result = render_adaptive(packed, handles, options);
	if (!result)
		FAIL(devices.front()->name << ": " << result.error().message << "\n" << result.error().log);
	return std::move(result).value();
}

AdaptiveOptions to_error(double error, std::uint32_t limit = 256)
{
	AdaptiveOptions options;
	options.error = error;
	options.limit = limit;
	return options;
}

// The device on which the many renders of a statistic are quickest.
const TestDevice& quick_device()
{
	for (const TestDevice& device : test_devices())
		if (!device.is_reference())
			return device;
	return reference_device();
}

std::set<std::uint32_t> counts_of(const AdaptiveReport& report)
{
	std::set<std::uint32_t> counts;
	for (const TileResult& tile : report.tiles)
		counts.insert(tile.samples);
	return counts;
}

double luminance(const Film& film, std::uint32_t x, std::uint32_t y)
{
	const std::size_t pixel = std::size_t(y) * film.window().width + x;
	const std::int64_t* sums = &film.sums()[3 * pixel];
	const double sum = 54.0 * double(sums[0]) + 183.0 * double(sums[1]) + 19.0 * double(sums[2]);
	return std::ldexp(sum / film.samples()[pixel], -film.exponent() - 8);
}

// RMS of the luminance's error in a tile over its true mean luminance + 0.01.
double relative_error(const Film& film, const Film& truth, const Window& tile)
{
	double squares = 0, mean = 0;
	for (std::uint32_t y = tile.y; y < tile.y + tile.height; ++y)
		for (std::uint32_t x = tile.x; x < tile.x + tile.width; ++x) {
			const double expected = luminance(truth, x, y), difference = luminance(film, x, y) - expected;
			squares += difference * difference;
			mean += expected;
		}
	const double pixels = tile.width * tile.height;
	return std::sqrt(squares / pixels) / (mean / pixels + 0.01);
}

struct Coverage {
	double of_all = 0, of_worst_tile = 1; // shares of the seeds in which the error was below the bound
	double of_smaller = 0;                // the same for bounds that are 15 % smaller
	double ratio = 0;                     // bound over RMS error, mean
	double samples = 0;                   // a pixel, mean
	double unfinished = 0;                // share of the tiles
};

struct CoverageCase {
	const char* scene;
	double error;
	std::uint32_t limit;
	Estimator estimator = Estimator::Path;
	std::uint32_t true_samples = 4096;
	Estimator true_estimator = Estimator::Path;
};

Coverage measure_coverage(const CoverageCase& wanted)
{
	constexpr std::uint32_t width = 64, height = 36, seeds = 200;
	const TestDevice& device = quick_device();
	const Film truth =
	    render(pack(wanted.scene, width, height, 0x7fffffff, wanted.true_estimator), device, {}, wanted.true_samples);
	PackedScene packed = pack(wanted.scene, width, height, 0, wanted.estimator);
	const TileStatistics tiles(width, height);
	std::vector<double> covered(tiles.count()), squared_error(tiles.count()), bound(tiles.count());
	Coverage coverage;
	for (std::uint32_t seed = 0; seed < seeds; ++seed) {
		packed.scene.seed = seed;
		const AdaptiveResult result = render_to(packed, {&device}, to_error(wanted.error, wanted.limit));
		coverage.unfinished += double(result.report.unfinished);
		for (std::size_t i = 0; i < tiles.count(); ++i) {
			const TileResult& tile = result.report.tiles[i];
			const double actual = relative_error(result.session.film, truth, tiles.tile(i));
			covered[i] += actual <= tile.bound ? 1 : 0;
			coverage.of_smaller += actual <= 0.85 * tile.bound ? 1 : 0;
			squared_error[i] += actual * actual / seeds;
			bound[i] += tile.bound / seeds;
			coverage.samples += double(tile.samples) * tiles.tile(i).width * tiles.tile(i).height;
		}
	}
	std::size_t noisy = 0;
	for (std::size_t i = 0; i < tiles.count(); ++i) {
		coverage.of_all += covered[i];
		coverage.of_worst_tile = std::min(coverage.of_worst_tile, covered[i] / seeds);
		if (squared_error[i] > 0) {
			coverage.ratio += bound[i] / std::sqrt(squared_error[i]);
			noisy++;
		}
	}
	const double all = double(seeds) * double(tiles.count());
	coverage.of_all /= all;
	coverage.of_smaller /= all;
	coverage.ratio /= double(noisy);
	coverage.samples /= double(seeds) * width * height;
	coverage.unfinished /= all;
	return coverage;
}

void print(const CoverageCase& wanted, const Coverage& coverage)
{
	std::cout << wanted.scene << ", " << estimator_name(wanted.estimator) << ", error " << wanted.error << ": covered "
	          << 100 * coverage.of_all << " %, of the worst tile " << 100 * coverage.of_worst_tile
	          << " %; bound / error " << coverage.ratio << "; " << coverage.samples << " samples a pixel; "
	          << 100 * coverage.unfinished << " % of the tiles unfinished" << std::endl;
}

} // namespace

TEST_CASE("rule 20: decisions fall at fixed numbers of samples")
{
	std::vector<std::uint32_t> ends;
	for (std::uint32_t samples = 0; samples < 256;) {
		const std::uint32_t length = stage_length(samples);
		CHECK((length & (length - 1)) == 0);
		CHECK(length % 2 == 0);
		samples += length;
		if (samples >= adaptive_least_samples)
			ends.push_back(samples);
	}
	CHECK(ends == std::vector<std::uint32_t>{32, 40, 48, 56, 64, 80, 96, 112, 128, 160, 192, 224, 256});
}

TEST_CASE("rule 20: a tile goes on while one beside it is noisy")
{
	std::vector<bool> active(20, true), noisy(20, false); // 5 across, 4 down
	noisy[7] = true;                                      // (2, 1)
	active[6] = false;                                    // stopped before: it does not come back
	std::vector<bool> expected(20, false);
	for (const std::size_t i : {1u, 2u, 3u, 7u, 8u, 11u, 12u, 13u})
		expected[i] = true;
	CHECK(still_active(active, noisy, 5) == expected);
	CHECK(still_active(active, std::vector<bool>(20, false), 5) == std::vector<bool>(20, false));
}

TEST_CASE("windows cover the active tiles and nothing else")
{
	std::mt19937 random(5);
	for (const auto& [width, height] :
	     {std::pair(1u, 1u), std::pair(16u, 40u), std::pair(100u, 75u), std::pair(33u, 64u)}) {
		const TileStatistics tiles(width, height);
		for (int share = 0; share <= 8; ++share) {
			std::vector<bool> active(tiles.count());
			std::vector<int> expected(width * height), covered(width * height);
			const auto add = [w = width](std::vector<int>& pixels, const Window& window) {
				for (std::uint32_t y = window.y; y < window.y + window.height; ++y)
					for (std::uint32_t x = window.x; x < window.x + window.width; ++x)
						pixels[y * w + x]++;
			};
			for (std::size_t i = 0; i < tiles.count(); ++i)
				if ((active[i] = int(random() % 8) < share))
					add(expected, tiles.tile(i));
			const std::vector<Window> windows = windows_of(active, tiles);
			for (const Window& window : windows)
				add(covered, window);
			CHECK(covered == expected);
			if (share == 8)
				CHECK(windows.size() == 1);
		}
	}
}

TEST_CASE("rule 20: the estimate is that of the definition, and nothing overflows")
{
	// A film of numbers, sample by sample, each scale or a quarter of it; up to the largest that one may be.
	for (const int exponent : {12, 20, 40}) {
		const double scale = std::ldexp(1.0, exponent);
		const std::uint32_t width = 20, height = 18; // tiles of 16x16, 4x16, 16x2, 4x2
		TileStatistics tiles(width, height);
		Film film(width, height, {0, 0, width, height}, exponent);
		std::mt19937 random(11);
		const std::vector<bool> active(tiles.count(), true);
		std::vector<long double> variance(width * height); // of the sum of samples
		std::uint32_t samples = 0;
		for (int stage = 0; stage < 17; ++stage) {
			const std::uint32_t length = stage_length(samples);
			std::vector<long double> halves[2];
			for (int half = 0; half < 2; ++half) {
				halves[half].resize(width * height);
				for (std::size_t i = 0; i < film.pixels(); ++i) {
					const std::int64_t before[3] = {film.sums()[3 * i], film.sums()[3 * i + 1], film.sums()[3 * i + 2]};
					for (std::uint32_t k = 0; k < length / 2; ++k)
						for (std::size_t c = 0; c < 3; ++c)
							film.sums()[3 * i + c] += static_cast<std::int64_t>(scale * (random() % 4 == 0 ? 1 : 0.25));
					film.samples()[i] += length / 2;
					const long double weights[3] = {54, 183, 19};
					for (std::size_t c = 0; c < 3; ++c)
						halves[half][i] += weights[c] * static_cast<long double>(film.sums()[3 * i + c] - before[c]);
				}
				if (half == 0)
					tiles.end_half(film, active);
				else
					tiles.end_stage(film, active);
			}
			samples += length;
			for (std::size_t i = 0; i < variance.size(); ++i)
				variance[i] += (halves[0][i] - halves[1][i]) * (halves[0][i] - halves[1][i]);
		}
		CHECK(samples == 160);
		for (std::size_t index = 0; index < tiles.count(); ++index) {
			const Window tile = tiles.tile(index);
			long double sum = 0, squares = 0, mean = 0;
			for (std::uint32_t y = tile.y; y < tile.y + tile.height; ++y)
				for (std::uint32_t x = tile.x; x < tile.x + tile.width; ++x) {
					const long double v = variance[y * width + x];
					sum += v;
					squares += v * v;
					mean += static_cast<long double>(luminance(film, x, y));
				}
			const long double pixels = tile.width * tile.height;
			// In the film's units: (error of a pixel's mean)^2, averaged, with its spread.
			const long double error = std::sqrt((sum + 2 * std::sqrt(2 * squares)) / pixels) / samples;
			const long double seen = std::ldexp(error, -exponent - 8) / (mean / pixels + 0.01L);
			const long double expected = std::sqrt(seen * seen + 9 / pixels / samples / samples);
			const double bound = relative_error_bound(tiles.sums(index), film.exponent());
			INFO("scale " << scale << ", tile " << index);
			// At 2^12 the rounding of variances to whole units of half^2 shows.
			CHECK(bound == Approx(double(expected)).epsilon(1e-4));
			CHECK(tiles.sums(index).samples == 160);
		}
	}
	CHECK(relative_error_bound(TileSums(), 30) == std::numeric_limits<double>::infinity());
}

TEST_CASE("rule 20: one film, whatever the devices, lanes and launches")
{
	const PackedScene packed = pack("three-spheres", 96, 54, 3);
	const AdaptiveOptions options = to_error(0.12);
	AdaptiveOptions oracle = options;
	oracle.session.lanes = 1;
	oracle.session.specialise = false;
	const AdaptiveResult expected = render_to(packed, {&reference_device()}, oracle);
	const std::string hash = expected.session.film.hash().hex();
	REQUIRE(counts_of(expected.report).size() > 2);
	CHECK(expected.report.unfinished == 0);
	CHECK(expected.session.film.rejected == 0);

	struct Shape {
		std::uint32_t rows, samples, group, slices;
	};
	std::vector<const TestDevice*> all;
	for (const TestDevice& device : test_devices()) {
		all.push_back(&device);
		for (const std::uint32_t lanes : {0u, 1u, 4u, 8u, 16u}) {
			if (lanes > 1 && !device.has_lanes())
				continue;
			AdaptiveOptions other = options;
			other.session.lanes = lanes;
			other.session.specialise = lanes == 0;
			INFO(device.name << ", " << lanes << " lanes");
			const AdaptiveResult result = render_to(packed, {&device}, other);
			CHECK(result.session.film.hash().hex() == hash);
			CHECK(result.session.film.segments == expected.session.film.segments);
			for (std::size_t i = 0; i < result.report.tiles.size(); ++i) {
				CHECK(result.report.tiles[i].samples == expected.report.tiles[i].samples);
				CHECK(result.report.tiles[i].bound == expected.report.tiles[i].bound);
			}
		}
		for (const Shape& shape : {Shape{1, 1, 32, 1}, Shape{5, 3, 0, 2}, Shape{54, 1, 8, 5}}) {
			AdaptiveOptions other = options;
			other.session.rows_per_launch = shape.rows;
			other.session.samples_per_launch = shape.samples;
			other.session.group_size = shape.group;
			other.session.slices = shape.slices;
			INFO(device.name << ", " << shape.rows << " rows, " << shape.samples << " samples a launch");
			CHECK(render_to(packed, {&device}, other).session.film.hash().hex() == hash);
		}
	}
	AdaptiveOptions shared = options;
	shared.session.rows_per_launch = 3; // so that each device gets some
	CHECK(render_to(packed, all, shared).session.film.hash().hex() == hash);

	// Controls: films that are not the same for nothing.
	CHECK(render_to(packed, {&reference_device()}, to_error(0.11)).session.film.hash().hex() != hash);
	CHECK(render_to(pack("three-spheres", 96, 54, 4), {&reference_device()}, options).session.film.hash().hex() !=
	      hash);
}

TEST_CASE("rule 20: decisions from floats would depend on their order")
{
	// What the rule forbids: a tile's sum of squares in float, its pixels taken from the first and from the last on.
	const PackedScene packed = pack("three-spheres", 96, 54, 3);
	const Film first = render(packed, reference_device(), {}, 16),
	           second = render(packed, reference_device(), {}, 16, 16);
	const TileStatistics tiles(96, 54);
	std::size_t different = 0;
	for (std::size_t i = 0; i < tiles.count(); ++i) {
		std::vector<float> squares;
		std::vector<std::uint64_t> whole;
		const Window tile = tiles.tile(i);
		for (std::uint32_t y = tile.y; y < tile.y + tile.height; ++y)
			for (std::uint32_t x = tile.x; x < tile.x + tile.width; ++x) {
				const auto difference = static_cast<float>(luminance(first, x, y) - luminance(second, x, y));
				squares.push_back(difference * difference);
				whole.push_back(static_cast<std::uint64_t>(std::ldexp(squares.back(), 40)));
			}
		const auto sum = [](const auto& values, auto zero) {
			const auto forward = std::accumulate(values.begin(), values.end(), zero);
			return std::pair(forward, std::accumulate(values.rbegin(), values.rend(), zero));
		};
		const auto [forward, backward] = sum(squares, 0.0f);
		different += forward != backward ? 1 : 0;
		const auto [up, down] = sum(whole, std::uint64_t(0));
		CHECK(up == down);
	}
	CHECK(different > 0);
}

TEST_CASE("rule 20: a pixel of an adaptive film holds its first samples")
{
	const PackedScene packed = pack("weekend", 80, 45, 1);
	// A limit that is no number at which decisions fall.
	const AdaptiveResult result = render_to(packed, {&quick_device()}, to_error(0.1, 50));
	const Film& film = result.session.film;
	const TileStatistics tiles(80, 45);
	REQUIRE(result.report.tiles.size() == tiles.count());
	CHECK(counts_of(result.report).size() >= 2);
	CHECK(*counts_of(result.report).rbegin() == 50);
	CHECK(result.report.unfinished > 0);
	std::map<std::uint32_t, Film> even;
	for (const std::uint32_t count : counts_of(result.report))
		even[count] = render(packed, quick_device(), {}, count);
	for (std::size_t i = 0; i < tiles.count(); ++i) {
		const Window tile = tiles.tile(i);
		const std::uint32_t count = result.report.tiles[i].samples;
		for (std::uint32_t y = tile.y; y < tile.y + tile.height; ++y)
			for (std::uint32_t x = tile.x; x < tile.x + tile.width; ++x) {
				const std::size_t pixel = std::size_t(y) * 80 + x;
				if (film.samples()[pixel] != count ||
				    !std::equal(&film.sums()[3 * pixel], &film.sums()[3 * pixel] + 3, &even[count].sums()[3 * pixel]))
					FAIL("pixel (" << x << ", " << y << ") is not that of " << count << " samples");
			}
	}
}

TEST_CASE("rule 20: a render that the clock ends is made again without one")
{
	const PackedScene packed = pack("weekend", 80, 45, 1);
	AdaptiveOptions timed = to_error(0.001, 1 << 20);
	timed.seconds = 0.2;
	const AdaptiveResult result = render_to(packed, {&quick_device()}, timed);
	CHECK(result.report.timed_out);
	CHECK_FALSE(result.session.interrupted);
	REQUIRE(result.report.limit < timed.limit);
	CHECK(result.session.film.max_samples() == result.report.limit);
	const AdaptiveResult again = render_to(packed, {&reference_device()}, to_error(0.001, result.report.limit));
	CHECK_FALSE(again.report.timed_out);
	CHECK(again.session.film.hash().hex() == result.session.film.hash().hex());
}

TEST_CASE("what is without noise ends at once, what is too short is even, a part is refused")
{
	// Every sample of a closed scene that glows is the same.
	const AdaptiveResult closed = render_to(pack("closed", 40, 30), {&reference_device()}, to_error(0.01));
	CHECK(counts_of(closed.report) == std::set<std::uint32_t>{adaptive_least_samples});
	CHECK(closed.report.unfinished == 0);
	const PackedScene packed = pack("three-spheres", 40, 30);
	for (const std::uint32_t limit : {1u, 2u, 5u, 31u}) {
		const AdaptiveResult few = render_to(packed, {&reference_device()}, to_error(0.01, limit));
		CHECK(few.session.film.hash().hex() == render(packed, reference_device(), {}, limit).hash().hex());
		CHECK(few.report.unfinished > 0);
	}
	PackedScene part = packed;
	part.scene.window_width = 20;
	CHECK_FALSE(render_adaptive(part, {reference_device().device}, to_error(0.1)));
}

TEST_CASE("the error lies under the bound in 95 of 100 renders")
{
	const CoverageCase wanted{"three-spheres", 0.1, 512};
	const Coverage coverage = measure_coverage(wanted);
	print(wanted, coverage);
	CHECK(coverage.of_all >= 0.945);
	CHECK(coverage.of_worst_tile >= 0.85);
	// Nor is it honest by being far too large.
	CHECK(coverage.ratio < 1.35);
	CHECK(coverage.of_smaller < 0.9);
}

// By hand: test_adaptive "[coverage]", or with -c "lamp, nee" one of them; docs/manual.md has the figures. Where lamps
// are found by chance only, the truth is taken with aimed rays, which know it better.
TEST_CASE("coverage of the bound on more scenes", "[.coverage]")
{
	for (const CoverageCase& wanted : {CoverageCase{"three-spheres", 0.1, 1024}, CoverageCase{"weekend", 0.07, 1024},
	                                   CoverageCase{"floating", 0.05, 1024},
	                                   CoverageCase{"cornell", 0.4, 1024, Estimator::Path, 8192, Estimator::Nee},
	                                   CoverageCase{"cornell", 0.2, 1024, Estimator::Nee, 8192, Estimator::Nee},
	                                   CoverageCase{"lamp", 0.1, 1024, Estimator::Nee, 16384, Estimator::Nee},
	                                   CoverageCase{"lamp", 0.5, 1024, Estimator::Path, 16384, Estimator::Nee}})
		DYNAMIC_SECTION(wanted.scene << ", " << estimator_name(wanted.estimator))
		{
			print(wanted, measure_coverage(wanted));
		}
}
