// The samplers beside the independent one, and Russian roulette: points against the textbook's matrices, nets,
// scrambles and pads without pattern, the same mean image with less noise.
//
// All seeds are fixed; a family of p-values fails as in test_samplers.cpp. What is claimed of a sampler is shown to be
// noticed where it does not hold.
#include "tests/catch.h"
#include "tests/devices.h"
#include "tests/faulty_device.h"
#include "tests/statistics.h"

#include "kernels/path.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <map>
#include <random>
#include <string>
#include <vector>

using namespace rt;

namespace {

constexpr double level = 1e-4;

#define CHECK_FAMILY(family)                                               \
	do {                                                                   \
		INFO("worst of " << (family).tests() << ": " << (family).worst()); \
		CHECK((family).p() > level);                                       \
	} while (false)

// ---- the textbook ----

// Sobol 1967 by Bratley and Fox 1988: direction numbers from the recurrence of a primitive polynomial. The first
// dimension has m_k = 1, the second the polynomial x + 1: m_k = 2 m_(k-1) xor m_(k-1).
std::array<std::uint32_t, 2> textbook_sobol(std::uint32_t index)
{
	std::array<std::uint32_t, 2> point{};
	std::uint32_t m = 1;
	for (unsigned k = 0; k < 32; ++k) {
		if ((index >> k) & 1u) {
			point[0] ^= 1u << (31 - k);
			point[1] ^= m << (31 - k);
		}
		m ^= m << 1;
	}
	return point;
}

std::uint32_t textbook_reverse(std::uint32_t v)
{
	std::uint32_t reversed = 0;
	for (unsigned k = 0; k < 32; ++k)
		reversed |= ((v >> k) & 1u) << (31 - k);
	return reversed;
}

// ---- nets ----

struct Point {
	std::uint32_t x, y; // 24 bits
};

Point point_of(rt_float a, rt_float b)
{
	return {static_cast<std::uint32_t>(a * 0x1p24f), static_cast<std::uint32_t>(b * 0x1p24f)};
}

using PointOf = std::function<Point(std::uint32_t sample)>;

// How many of the boxes of 2^-k by 2^(k - m) do not have one point, over all k, all m up to `most` and the first four
// runs of 2^m samples.
std::uint64_t net_defects(const PointOf& point_at, unsigned most)
{
	std::uint64_t defects = 0;
	for (unsigned m = 0; m <= most; ++m)
		for (std::uint32_t run = 0; run < 4; ++run) {
			std::vector<Point> points;
			for (std::uint32_t i = 0; i < 1u << m; ++i)
				points.push_back(point_at((run << m) + i));
			for (unsigned k = 0; k <= m; ++k) {
				std::vector<unsigned> boxes(std::size_t(1) << m);
				for (const Point& point : points)
					++boxes[((point.x >> (24 - k)) << (m - k)) | (point.y >> (24 - (m - k)))];
				defects += static_cast<std::uint64_t>(
				    std::count_if(boxes.begin(), boxes.end(), [](unsigned count) { return count != 1; }));
			}
		}
	return defects;
}

// A hash that is no nested scramble.
std::uint32_t plain_hash(std::uint32_t v, std::uint32_t seed)
{
	rt_words4 words;
	words.x = v;
	words.y = words.z = seed;
	words.w = 0;
	return rt_pcg4d(words).x;
}

// ---- patterns between numbers of one pixel ----

double sign_of_digit(rt_float u, unsigned digit)
{
	return (static_cast<std::uint32_t>(u * 0x1p24f) >> (24 - digit)) & 1u ? -1.0 : 1.0;
}

using PairOf = std::function<std::array<rt_float, 2>(std::uint32_t key, std::uint32_t sample)>;

struct Coupling {
	TestFamily family; // that the products' mean is 0
	double worst = 0;  // largest mean square of a pixel's sum, over the number of samples: 1 for independent numbers
};

// Sums over each pixel's samples of the product of two numbers' binary digits (Walsh functions). If the sums of many
// pixels have mean 0, no pattern is common to them; if their squares are not large, none is in a pixel of its own.
Coupling coupling_of(const std::string& name, const PairOf& pair_of, std::uint32_t samples)
{
	constexpr std::uint32_t keys = 4096;
	constexpr unsigned digits = 4;
	std::array<double, digits * digits> sum{}, squares{};
	for (std::uint32_t key = 0; key < keys; ++key) {
		std::array<double, digits * digits> total{};
		for (std::uint32_t sample = 0; sample < samples; ++sample) {
			const std::array<rt_float, 2> u = pair_of(key, sample);
			for (unsigned j = 0; j < digits; ++j)
				for (unsigned k = 0; k < digits; ++k)
					total[j * digits + k] += sign_of_digit(u[0], j + 1) * sign_of_digit(u[1], k + 1);
		}
		for (std::size_t i = 0; i < total.size(); ++i) {
			sum[i] += total[i];
			squares[i] += total[i] * total[i];
		}
	}
	Coupling coupling;
	for (std::size_t i = 0; i < sum.size(); ++i) {
		coupling.family.add(name, normal_p(sum[i] / std::sqrt(std::max(squares[i], 1e-9))));
		coupling.worst = std::max(coupling.worst, squares[i] / keys / samples);
	}
	return coupling;
}

// ---- images ----

PackedScene packed_scene(const std::string& name, Sampler sampler, std::uint32_t roulette, std::uint32_t seed,
                         std::uint32_t width, std::uint32_t height)
{
	TestScene scene;
	scene.name = name;
	scene.width = width;
	scene.height = height;
	scene.samples = 1; // films may have any number
	scene.seed = seed;
	scene.sampler = sampler;
	scene.roulette = roulette;
	return pack_test_scene(scene);
}

double mean_square_difference(const Film& film, const Film& truth)
{
	double sum = 0;
	const Window window = film.window();
	for (std::uint32_t y = 0; y < window.height; ++y)
		for (std::uint32_t x = 0; x < window.width; ++x)
			for (int channel = 0; channel < 3; ++channel) {
				const double difference = film.radiance(x, y, channel) - truth.radiance(x, y, channel);
				sum += difference * difference;
			}
	return sum / (3.0 * static_cast<double>(film.pixels()));
}

constexpr std::uint32_t small_width = 24, small_height = 16;

const Film& converged(const std::string& name)
{
	static std::map<std::string, Film> films;
	const auto found = films.find(name);
	if (found != films.end())
		return found->second;
	// Other numbers than those of any film that is held against it.
	return films
	    .emplace(name, render(packed_scene(name, Sampler::Independent, 0, 77777, small_width, small_height),
	                          reference_device(), {}, 8192))
	    .first->second;
}

double mse(const std::string& name, const TestDevice& device, Sampler sampler, std::uint32_t samples,
           std::uint32_t seeds)
{
	double sum = 0;
	for (std::uint32_t seed = 0; seed < seeds; ++seed)
		sum += mean_square_difference(
		    render(packed_scene(name, sampler, 0, seed, small_width, small_height), device, {}, samples),
		    converged(name));
	return sum / seeds;
}

// Mean radiance of the image's quarters, by channel, one set a seed.
using Means = std::array<double, 12>;
std::vector<Means> means_of_seeds(PackedScene packed, std::uint32_t samples, std::uint32_t first_seed)
{
	std::vector<Means> all;
	for (std::uint32_t seed = 0; seed < 48; ++seed) {
		packed.scene.seed = first_seed + seed;
		const Film film = render(packed, reference_device(), {}, samples);
		CHECK(film.rejected == 0);
		Means means{};
		const Window window = film.window();
		for (std::uint32_t y = 0; y < window.height; ++y)
			for (std::uint32_t x = 0; x < window.width; ++x)
				for (std::size_t channel = 0; channel < 3; ++channel) {
					const std::size_t quarter = (2 * x >= window.width ? 1u : 0u) + (2 * y >= window.height ? 2u : 0u);
					means[3 * quarter + channel] += film.radiance(x, y, static_cast<int>(channel));
				}
		all.push_back(means);
	}
	return all;
}

// p of the hypothesis that both have the same mean: z of the seeds' means, whose scatter is their own.
double same_mean_p(const std::vector<Means>& a, const std::vector<Means>& b)
{
	TestFamily family;
	for (std::size_t i = 0; i < Means{}.size(); ++i) {
		const auto moments = [i](const std::vector<Means>& means) {
			double mean = 0, variance = 0;
			const double n = static_cast<double>(means.size());
			for (const Means& m : means)
				mean += m[i] / n;
			for (const Means& m : means)
				variance += (m[i] - mean) * (m[i] - mean) / (n - 1);
			return std::array<double, 2>{mean, variance / n};
		};
		const auto [mean_a, error_a] = moments(a);
		const auto [mean_b, error_b] = moments(b);
		family.add("block", normal_p((mean_a - mean_b) / std::sqrt(std::max(error_a + error_b, 1e-24))));
	}
	return family.p();
}

} // namespace

// ---- points ----

TEST_CASE("Sobol's points are those of the textbook's matrices")
{
	std::mt19937 engine(1);
	const auto check = [](std::uint32_t index) {
		const std::array<std::uint32_t, 2> point = textbook_sobol(index);
		if (rt_reverse_bits(index) != point[0] || rt_reverse_bits(rt_pascal(index)) != point[1])
			FAIL_CHECK("point " << index);
	};
	for (std::uint32_t index = 0; index < 4096; ++index)
		check(index);
	for (int i = 0; i < 100000; ++i)
		check(static_cast<std::uint32_t>(engine()));
	// The first points as they stand in print.
	const std::array<double, 8> second = {0, 0.5, 0.75, 0.25, 0.625, 0.125, 0.375, 0.875};
	for (std::uint32_t i = 0; i < 8; ++i)
		CHECK(rt_reverse_bits(rt_pascal(i)) * 0x1p-32 == second[i]);
	CHECK(rt_reverse_bits(1) == 0x80000000u);
}

TEST_CASE("a number of a block is the textbook's point, reordered and scrambled")
{
	for (std::uint32_t i = 0; i < 1000; ++i) {
		const std::uint32_t pixel = i * 7919u, sample = i % 67, block = i % 5, seed = i / 100;
		const rt_random4 u = rt_sobol(seed, pixel, sample, block);
		for (std::uint32_t pad = 0; pad < 2; ++pad) {
			rt_words4 words;
			words.x = pixel;
			words.y = pad == 0 ? 0xfffffffeu : 0xffffffffu;
			words.z = block;
			words.w = seed;
			words = rt_pcg4d(words);
			const auto scramble = [](std::uint32_t v, std::uint32_t word) {
				return textbook_reverse(rt_nested_flips(textbook_reverse(v), word ^ (word >> 16)));
			};
			const std::array<std::uint32_t, 2> point = textbook_sobol(scramble(sample, words.x));
			const Point expected = {scramble(point[0], words.y) >> 8, scramble(point[1], words.z) >> 8};
			const Point found = pad == 0 ? point_of(u.a, u.b) : point_of(u.c, u.d);
			if (found.x != expected.x || found.y != expected.y)
				FAIL_CHECK("pixel " << pixel << ", sample " << sample << ", block " << block << ", pad " << pad);
		}
	}
}

TEST_CASE("rule 14: every run of 2^m Sobol points is a (0, m, 2)-net, scrambled or not")
{
	CHECK(net_defects(
	          [](std::uint32_t i) {
		          return point_of(rt_unit(rt_reverse_bits(i)), rt_unit(rt_reverse_bits(rt_pascal(i))));
	          },
	          10) == 0);
	for (std::uint32_t key = 0; key < 24; ++key) {
		const std::uint32_t pixel = key * 104729u, block = key % 6, seed = key / 8;
		INFO("pixel " << pixel << ", block " << block << ", seed " << seed);
		CHECK(net_defects(
		          [&](std::uint32_t i) {
			          const rt_random4 u = rt_sobol(seed, pixel, i, block);
			          return point_of(u.a, u.b);
		          },
		          9) == 0);
		CHECK(net_defects(
		          [&](std::uint32_t i) {
			          const rt_random4 u = rt_sobol(seed, pixel, i, block);
			          return point_of(u.c, u.d);
		          },
		          9) == 0);
	}
	// What is none: random numbers, a scramble that is not nested, the second dimension without its last step.
	CHECK(net_defects(
	          [](std::uint32_t i) {
		          const rt_random4 u = rt_random(0, 0, i, 0);
		          return point_of(u.a, u.b);
	          },
	          9) > 1000);
	CHECK(net_defects(
	          [](std::uint32_t i) {
		          return point_of(rt_unit(rt_reverse_bits(i)), rt_unit(rt_reverse_bits(plain_hash(rt_pascal(i), 1))));
	          },
	          9) > 1000);
	CHECK(net_defects(
	          [](std::uint32_t i) {
		          const std::uint32_t wrong = rt_pascal(i) ^ ((rt_pascal(i) >> 8) & 0x00ff00ffu);
		          return point_of(rt_unit(rt_reverse_bits(i)), rt_unit(rt_reverse_bits(wrong)));
	          },
	          10) > 0);
}

TEST_CASE("scrambles are nested: a digit's flip depends on the digits before it only")
{
	std::mt19937 engine(2);
	const auto violations = [&engine](const std::function<std::uint32_t(std::uint32_t, std::uint32_t)>& scramble) {
		std::uint32_t count = 0;
		for (int i = 0; i < 20000; ++i) {
			const unsigned digit = static_cast<unsigned>(engine()) % 32;
			const std::uint32_t v = static_cast<std::uint32_t>(engine()), seed = static_cast<std::uint32_t>(engine());
			// The same up to `digit`, different in it, anything after it.
			const std::uint32_t after = digit == 31 ? 0 : static_cast<std::uint32_t>(engine()) << (digit + 1);
			const std::uint32_t differing = (scramble(v, seed) ^ scramble(v ^ (1u << digit) ^ after, seed));
			count += (differing & ((2u << digit) - 1u)) == 1u << digit ? 0 : 1;
		}
		return count;
	};
	CHECK(violations(rt_nested_flips) == 0);
	CHECK(violations(plain_hash) > 1000);
}

TEST_CASE("flips are fair, and those of different digits and beginnings independent")
{
	// Flips of the digits 0 to 7 behind two beginnings, for seeds as kernels draw them.
	constexpr std::uint32_t keys = 1u << 14;
	const auto family_of = [](const std::function<std::uint32_t(std::uint32_t, std::uint32_t)>& scramble) {
		std::array<std::uint32_t, 16> one{};
		std::array<std::array<std::uint32_t, 16>, 16> two{};
		for (std::uint32_t key = 0; key < keys; ++key) {
			rt_words4 words;
			words.x = key;
			words.y = RT_SCRAMBLE_AB;
			words.z = 1;
			words.w = 0;
			words = rt_pcg4d(words);
			const std::uint32_t seed = words.y ^ (words.y >> 16);
			const std::uint32_t flips =
			    ((scramble(0, seed) & 0xffu) | ((scramble(0xaau, seed) ^ 0xaau) & 0xffu) << 8) & 0xffffu;
			for (unsigned j = 0; j < 16; ++j)
				for (unsigned k = 0; k < 16; ++k) {
					one[j] += k == 0 ? (flips >> j) & 1u : 0u;
					two[j][k] += ((flips >> j) ^ (flips >> k)) & 1u;
				}
		}
		TestFamily family;
		for (unsigned j = 0; j < 16; ++j) {
			family.add("digit", binomial_p(one[j], keys, 0.5));
			for (unsigned k = 0; k < j; ++k)
				// 0 and 0xaa begin alike in the lowest digit, which is therefore flipped for both.
				if (!(j == 8 && k == 0) && !(j == 9 && k == 1))
					family.add("digits " + std::to_string(j) + ", " + std::to_string(k),
					           binomial_p(two[j][k], keys, 0.5));
		}
		return family;
	};
	const TestFamily family = family_of(rt_nested_flips);
	CHECK_FAMILY(family);
	// A digital shift flips a digit whatever went before.
	CHECK(family_of([](std::uint32_t v, std::uint32_t seed) { return v ^ seed; }).p() < level);
}

TEST_CASE("no pattern couples the points of other pads, blocks, pixels and seeds")
{
	struct Pair {
		const char* name;
		PairOf of;
	};
	const std::vector<Pair> pairs = {
	    {"pads",
	     [](std::uint32_t key, std::uint32_t i) {
		     const rt_random4 u = rt_sobol(0, key, i, 1);
		     return std::array<rt_float, 2>{u.a, u.c};
	     }},
	    {"pads, second numbers",
	     [](std::uint32_t key, std::uint32_t i) {
		     const rt_random4 u = rt_sobol(0, key, i, 2);
		     return std::array<rt_float, 2>{u.b, u.d};
	     }},
	    {"blocks",
	     [](std::uint32_t key, std::uint32_t i) {
		     return std::array<rt_float, 2>{rt_sobol(0, key, i, 0).a, rt_sobol(0, key, i, 1).a};
	     }},
	    {"blocks further off",
	     [](std::uint32_t key, std::uint32_t i) {
		     return std::array<rt_float, 2>{rt_sobol(3, key, i, 1).b, rt_sobol(3, key, i, 3).a};
	     }},
	    {"pixels",
	     [](std::uint32_t key, std::uint32_t i) {
		     return std::array<rt_float, 2>{rt_sobol(0, key, i, 1).a, rt_sobol(0, key + 1, i, 1).a};
	     }},
	    {"rows",
	     [](std::uint32_t key, std::uint32_t i) {
		     return std::array<rt_float, 2>{rt_sobol(0, key, i, 1).b, rt_sobol(0, key + 640, i, 1).b};
	     }},
	    {"seeds",
	     [](std::uint32_t key, std::uint32_t i) {
		     return std::array<rt_float, 2>{rt_sobol(0, key, i, 1).a, rt_sobol(1, key, i, 1).a};
	     }},
	};
	TestFamily family;
	for (const Pair& pair : pairs)
		for (const std::uint32_t samples : {4u, 16u, 64u}) {
			const Coupling coupling = coupling_of(pair.name, pair.of, samples);
			INFO(pair.name << ", " << samples << " samples: " << coupling.worst);
			family.add(std::string(pair.name) + ", worst " + coupling.family.worst(), coupling.family.p());
			CHECK(coupling.worst < 3);
		}
	CHECK_FAMILY(family);

	// Without an order of its own, every pad's first number would be the same but for its scramble.
	const auto unordered = [](std::uint32_t key, std::uint32_t i) {
		const auto scrambled = [i](std::uint32_t seed) {
			return rt_unit(rt_reverse_bits(rt_nested_flips(i, plain_hash(seed, 5))));
		};
		return std::array<rt_float, 2>{scrambled(key), scrambled(key + 1000000)};
	};
	CHECK(coupling_of("", unordered, 16).worst > 10);
	// And one scramble for all would be a pattern that is common to all pixels.
	const auto unscrambled = [](std::uint32_t key, std::uint32_t i) {
		const rt_float a = rt_sobol(0, key, i, 0).a;
		return std::array<rt_float, 2>{a, a};
	};
	CHECK(coupling_of("", unscrambled, 16).family.p() < level);
}

TEST_CASE("samplers: which numbers a sampler takes from where")
{
	rt_scene scene{};
	scene.seed = 4;
	const auto same = [](rt_random4 u, rt_random4 v) { return u.a == v.a && u.b == v.b && u.c == v.c && u.d == v.d; };
	for (const std::uint32_t sampler : {RT_SAMPLER_INDEPENDENT, RT_SAMPLER_STRATIFIED, RT_SAMPLER_SOBOL}) {
		scene.sampler = sampler;
		INFO("sampler " << sampler);
		CHECK(same(rt_camera_numbers(&scene, 77, 3),
		           sampler == RT_SAMPLER_INDEPENDENT ? rt_random(4, 77, 3, 0) : rt_sobol(4, 77, 3, 0)));
		CHECK(same(rt_scattering_numbers(&scene, 77, 3, 2),
		           sampler == RT_SAMPLER_SOBOL ? rt_sobol(4, 77, 3, 2) : rt_random(4, 77, 3, 2)));
	}
}

// ---- images ----

TEST_CASE("samplers: all have the same mean image")
{
	for (const char* name : {"three-spheres", "weekend", "cornell", "floating"}) {
		const auto packed = [name](Sampler sampler, std::uint32_t roulette) {
			return packed_scene(name, sampler, roulette, 0, small_width, small_height);
		};
		const std::vector<Means> plain = means_of_seeds(packed(Sampler::Independent, 0), 16, 0);
		TestFamily family;
		std::uint32_t first_seed = 1000;
		for (const Sampler sampler : all_samplers)
			for (const std::uint32_t roulette : {0u, 1u, 3u})
				if (sampler != Sampler::Independent || roulette > 0)
					family.add(std::string(sampler_name(sampler)) + ", roulette " + std::to_string(roulette),
					           same_mean_p(plain, means_of_seeds(packed(sampler, roulette), 16, first_seed += 100)));
		INFO(name);
		CHECK_FAMILY(family);

		// The control: light that is 3 % brighter.
		PackedScene wrong = packed(Sampler::Sobol, 0);
		for (float* light : {&wrong.scene.sky_bottom_r, &wrong.scene.sky_bottom_g, &wrong.scene.sky_bottom_b})
			*light *= 1.03f;
		for (rt_material& material : wrong.materials)
			for (float* light : {&material.emission_r, &material.emission_g, &material.emission_b})
				*light *= 1.03f;
		if (std::string(name) != "cornell") // its noise hides that much
			CHECK(same_mean_p(plain, means_of_seeds(wrong, 16, 9000)) < level);
	}
}

TEST_CASE("samplers: at the same number of samples Sobol's error is smaller")
{
	struct Gain {
		const char* scene;
		double sobol, stratified; // at least; 4.1 and 1.5, 4.0 and 3.5 when this was written
	};
	for (const Gain& gain : {Gain{"three-spheres", 2.5, 1.2}, Gain{"floating", 2.5, 2.0}}) {
		const double independent = mse(gain.scene, reference_device(), Sampler::Independent, 64, 4);
		const double stratified = mse(gain.scene, reference_device(), Sampler::Stratified, 64, 4);
		const double sobol = mse(gain.scene, reference_device(), Sampler::Sobol, 64, 4);
		INFO(gain.scene << ": independent " << independent << ", stratified " << stratified << ", sobol " << sobol);
		CHECK(independent > gain.sobol * sobol);
		CHECK(independent > gain.stratified * stratified);
	}
}

TEST_CASE("samplers: a pad without an order of its own spoils the image, and is noticed")
{
	const TestDevice* sound = nullptr;
	for (const TestDevice& device : test_devices())
		if (!device.is_reference())
			sound = &device;
	if (!sound) {
		WARN("skipped: no device here compiles kernels from text");
		return;
	}
	Fault fault;
	fault.name = "no order";
	fault.edits = {{"kernels/sampler.h", "rt_reverse_bits(rt_nested_flips(reversed_sample, order))",
	                "rt_reverse_bits(reversed_sample ^ (order & 0u))"}};
	TestDevice broken = *sound;
	broken.device = make_faulty(sound->device, fault);
	const double sobol = mse("three-spheres", *sound, Sampler::Sobol, 64, 1);
	const double without = mse("three-spheres", broken, Sampler::Sobol, 64, 1);
	INFO("sobol " << sobol << ", without an order " << without);
	CHECK(without > 1.8 * sobol); // the test above asks for 2.5 over independent numbers
}

TEST_CASE("samplers: closed stays exact, and a render goes on where it stopped")
{
	for (const Sampler sampler : all_samplers) {
		INFO(sampler_name(sampler));
		PackedScene closed = packed_scene("closed", sampler, 0, 5, small_width, small_height);
		const Film film = render(closed, reference_device(), {}, 8);
		const std::int64_t one = std::int64_t(1) << film.exponent();
		const std::int64_t sample = one - (one >> closed.scene.max_depth);
		CHECK(std::all_of(film.sums().begin(), film.sums().end(),
		                  [sample](std::int64_t sum) { return sum == 8 * sample; }));

		const PackedScene lens = packed_scene("weekend", sampler, 2, 5, small_width, small_height);
		Film parts = render(lens, reference_device(), {}, 3);
		REQUIRE(parts.add(render(lens, reference_device(), {}, 6, 3)));
		CHECK(parts.hash() == render(lens, reference_device(), {}, 9).hash());
	}
}

// ---- roulette ----

TEST_CASE("rule 6: roulette: a path goes on with exactly its probability, and no weight exceeds 1")
{
	// Over all 2^24 numbers that the first of a block may be: the probability is a whole number of them.
	std::mt19937 engine(3);
	std::uniform_real_distribution<double> exponent(-60, 0);
	double heaviest = 0;
	for (int i = 0; i < 200000; ++i) {
		const float b = i < 1000 ? std::nextafterf(1.0f, 0.0f) - static_cast<float>(i) * 0x1p-24f
		                         : static_cast<float>(std::exp2(exponent(engine)));
		if (!(b < 1))
			continue;
		for (std::uint32_t sample = 0; sample < 8; ++sample) {
			const std::uint32_t pixel = static_cast<std::uint32_t>(i);
			const float weight = rt_roulette(9, pixel, sample, 1, b);
			const double u = static_cast<double>(rt_random(9, pixel, sample, 1u | RT_ROULETTE_BLOCK).a);
			const double q = (std::floor(static_cast<double>(b) * 0x1p24) + 1) * 0x1p-24;
			if ((weight > 0) != (u < q))
				FAIL_CHECK("throughput " << b << ", number " << u << ", weight " << weight);
			if (weight > 0 && weight != static_cast<float>(1 / q))
				FAIL_CHECK("throughput " << b << ": weight " << weight << " for a probability of " << q);
			heaviest = std::max(heaviest, static_cast<double>(weight * b));
		}
	}
	CHECK(heaviest <= 1);
	CHECK(heaviest > 0.999);
	// A rate, so that it is a probability: b = 3/8 in 2^20 samples.
	std::uint32_t survivors = 0;
	for (std::uint32_t i = 0; i < 1u << 20; ++i)
		survivors += rt_roulette(1, i, 0, 3, 0.375f) > 0 ? 1 : 0;
	CHECK(binomial_p(survivors, 1u << 20, 0.375) > level);
	CHECK(binomial_p(survivors, 1u << 20, 0.38) < level);
}

TEST_CASE("roulette: what loses no light is left alone, and what both glows and scatters keeps its room in the film")
{
	// Every albedo is 1: a path is never dim.
	const PackedScene plain = packed_scene("furnace", Sampler::Independent, 0, 3, small_width, small_height);
	const PackedScene played = packed_scene("furnace", Sampler::Independent, 1, 3, small_width, small_height);
	CHECK(render(plain, reference_device(), {}, 8).hash() == render(played, reference_device(), {}, 8).hash());

	// Half absorbed, half emitted at each of max_depth hits: with roulette a path may gather max_depth halves.
	const PackedScene closed = packed_scene("closed", Sampler::Independent, 1, 3, small_width, small_height);
	const Film film = render(closed, reference_device(), {}, 512);
	CHECK(film.rejected == 0);
	const double bound = std::ldexp(1.0, RT_FILM_BITS - film.exponent());
	CHECK(bound >= 0.5 * closed.scene.max_depth);
	CHECK(closed.film_exponent < packed_scene("closed", Sampler::Independent, 0, 3, 8, 8).film_exponent);
	// The number of hits n has P(n >= k) = 2^(1 - k): a sum of halves with mean 1 and variance 1/2.
	double sum = 0;
	for (const std::int64_t value : film.sums())
		sum += static_cast<double>(value);
	const double samples = 512.0 * static_cast<double>(film.pixels());
	const double mean = sum / 3 / samples / std::ldexp(1.0, film.exponent());
	const double exact = 1 - std::ldexp(1.0, -static_cast<int>(closed.scene.max_depth));
	INFO("mean " << mean << " of " << exact);
	CHECK(normal_p((mean - exact) / std::sqrt(0.5 / samples)) > level);
	CHECK(film.segments < 3 * static_cast<std::uint64_t>(samples)); // instead of max_depth each
}
