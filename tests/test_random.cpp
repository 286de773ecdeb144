// The random numbers as a generator: the published hash, no two streams alike, and no pattern in any order of use.
//
// Batteries of others' making (TestU01) are run by tools/testu01; docs/random.md has the result. The tests here are
// the classical ones that fit into a second (Knuth, TAOCP 2, section 3.3.2; Marsaglia and Tsay 1985), over the same
// orders, and each has to reject a generator that is wrong in the way it looks for.
#include "kernels/material.h"
#include "tests/catch.h"
#include "tests/statistics.h"
#include "tools/testu01/streams.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <string>
#include <vector>

using namespace rt;

namespace {

constexpr double level = 1e-4; // as in test_samplers.cpp

using Key = std::array<std::uint32_t, 4>;

Key hash_of(const Key& v)
{
	const rt_words4 h = rt_pcg4d({v[0], v[1], v[2], v[3]});
	return {h.x, h.y, h.z, h.w};
}

// Undoes rt_pcg4d() step by step, which is possible because each step changes one word by a function of the others.
Key preimage_of(Key v)
{
	std::uint32_t &x = v[0], &y = v[1], &z = v[2], &w = v[3];
	const auto undo_round = [&] {
		w -= y * z;
		z -= x * y;
		y -= z * x;
		x -= y * w;
	};
	undo_round();
	for (std::uint32_t& word : v)
		word ^= word >> 16;
	undo_round();
	// 1664525 is odd, so it has an inverse modulo 2^32: Newton's iteration doubles its right bits.
	std::uint32_t inverse = 1664525u;
	for (int i = 0; i < 5; ++i)
		inverse *= 2u - 1664525u * inverse;
	for (std::uint32_t& word : v)
		word = (word - 1013904223u) * inverse;
	return v;
}

// ---- tests of a sequence of 32-bit words ----

using Words = std::function<std::uint32_t()>;

double poisson_p(double count, double mean) { return normal_p((count - mean) / std::sqrt(mean)); }

// 4096 birthdays in a year of 2^32 days: the spacings that occur twice are Poisson with mean n^3 / (4 m) = 4.
double birthday_spacings_p(const Words& next)
{
	constexpr std::size_t rounds = 64, birthdays = 4096;
	double repeated = 0;
	for (std::size_t round = 0; round < rounds; ++round) {
		std::vector<std::uint32_t> days(birthdays);
		std::generate(days.begin(), days.end(), next);
		std::sort(days.begin(), days.end());
		for (std::size_t i = birthdays - 1; i > 0; --i)
			days[i] -= days[i - 1];
		std::sort(days.begin(), days.end());
		for (std::size_t i = 1; i < birthdays; ++i)
			repeated += days[i] == days[i - 1] ? 1 : 0;
	}
	return poisson_p(repeated, 4.0 * rounds);
}

// Ranks of 64 x 64 matrices of bits, two words a row. Probabilities of full rank, one less, and the rest: Marsaglia
// and Tsay 1985.
double matrix_rank_p(const Words& next)
{
	constexpr double count = 2000;
	std::array<double, 3> ranks{};
	for (int k = 0; k < static_cast<int>(count); ++k) {
		std::array<std::uint64_t, 64> rows{};
		for (std::uint64_t& row : rows) {
			row = std::uint64_t(next()) << 32;
			row |= next();
		}
		std::size_t rank = 0;
		for (std::uint64_t bit = std::uint64_t(1) << 63; bit != 0; bit >>= 1) {
			const auto pivot = std::find_if(rows.begin() + static_cast<std::ptrdiff_t>(rank), rows.end(),
			                                [bit](std::uint64_t row) { return row & bit; });
			if (pivot == rows.end())
				continue;
			std::swap(rows[rank], *pivot);
			for (std::size_t i = rank + 1; i < rows.size(); ++i)
				rows[i] ^= rows[i] & bit ? rows[rank] : 0;
			++rank;
		}
		++ranks[std::min<std::size_t>(64 - rank, 2)];
	}
	const std::array<double, 3> expected = {0.2887880951 * count, 0.5775761902 * count, 0.1336357147 * count};
	double statistic = 0;
	for (std::size_t i = 0; i < ranks.size(); ++i)
		statistic += (ranks[i] - expected[i]) * (ranks[i] - expected[i]) / expected[i];
	return chi_squared_p(statistic, 2);
}

// 2^17 points of a space of `words` successive words in 2^24 cells: few enough cells are met twice.
double collision_p(const Words& next, unsigned words)
{
	constexpr std::size_t points = std::size_t(1) << 17;
	const unsigned bits = 24 / words;
	std::vector<bool> taken(std::size_t(1) << 24);
	double collisions = 0;
	for (std::size_t i = 0; i < points; ++i) {
		std::uint32_t cell = 0;
		for (unsigned k = 0; k < words; ++k)
			cell = cell << bits | next() >> (32 - bits);
		collisions += taken[cell] ? 1 : 0;
		taken[cell] = true;
	}
	const double m = 0x1p24, n = static_cast<double>(points);
	return poisson_p(collisions, n - m + m * std::exp(n * std::log1p(-1 / m)));
}

// Each bit alone, and each with the same bit of the word before.
void add_bits(TestFamily& family, const std::string& name, const Words& next)
{
	constexpr std::uint32_t count = 1u << 18;
	std::array<std::array<double, 2>, 32> sums{};
	std::uint32_t before = next();
	for (std::uint32_t i = 0; i < count; ++i) {
		const std::uint32_t word = next();
		for (unsigned bit = 0; bit < 32; ++bit) {
			sums[bit][0] += word >> bit & 1u;
			sums[bit][1] += (word ^ before) >> bit & 1u;
		}
		before = word;
	}
	for (unsigned bit = 0; bit < 32; ++bit)
		for (const double sum : sums[bit])
			family.add(name + ", bit " + std::to_string(bit), binomial_p(sum, count, 0.5));
}

void examine(TestFamily& family, const std::string& name, const Words& next)
{
	family.add(name + ", birthday spacings", birthday_spacings_p(next));
	family.add(name + ", matrix rank", matrix_rank_p(next));
	for (const unsigned words : {1u, 2u, 4u, 8u})
		family.add(name + ", collisions in " + std::to_string(words) + " dimensions", collision_p(next, words));
	add_bits(family, name, next);
}

} // namespace

TEST_CASE("rule 14: the hash is the published pcg4d")
{
	// From the authors' own C++ (github.com/markjarzynski/HashFunctionsForGPURendering_TestU01, random.h of 2021).
	const std::vector<std::array<Key, 2>> vectors = {
	    {{{0, 0, 0, 0}, {0x0f02f829, 0x2d568769, 0x32b0c43b, 0xd32548ea}}},
	    {{{1, 0, 0, 0}, {0x0b3cefc3, 0xa31dc1d5, 0x5ffbe5a5, 0x623d099e}}},
	    {{{0, 1, 0, 0}, {0x2a9d71a8, 0xa13cdd97, 0xe9c89c0e, 0xc4b7884c}}},
	    {{{0, 0, 1, 0}, {0x2eda6c9d, 0x681d2eed, 0x306c117d, 0xb0607dce}}},
	    {{{0, 0, 0, 1}, {0x8d9effe2, 0xa833f3dc, 0x8246b1b2, 0x58ab6650}}},
	    {{{1, 2, 3, 4}, {0x3622cd16, 0xf11471d8, 0xe1109b3f, 0x02b94c2f}}},
	    {{{8294399, 4095, 65, 1}, {0x98f03607, 0xb34ec058, 0x937d47fb, 0x4dfd4b42}}},
	    {{{0xffffffff, 0xffffffff, 0xffffffff, 0xffffffff}, {0x974ed892, 0xc015dc67, 0x9f955760, 0xa1bba208}}},
	    {{{0x80000000, 0x7fffffff, 0xdeadbeef, 0x2545f491}, {0x21231a3f, 0xd7113a50, 0xb2c0ebd5, 0xa511e618}}},
	    {{{123456789, 362436069, 521288629, 88675123}, {0x7267305a, 0xb1cc9c92, 0xc8b19a8d, 0x308865ac}}},
	};
	for (const auto& [input, output] : vectors)
		CHECK(hash_of(input) == output);
	// And rt_random() is its top 24 bits, keyed by (pixel, sample, block, seed).
	const Key words = hash_of({8294399, 4095, 65, 1});
	const rt_random4 u = rt_random(1, 8294399, 4095, 65);
	const std::array<float, 4> numbers = {u.a, u.b, u.c, u.d};
	for (std::size_t i = 0; i < 4; ++i)
		CHECK(static_cast<double>(numbers[i]) == (words[i] >> 8) * 0x1p-24);
}

TEST_CASE("rule 12: no random number is 1, so the cosine lobe never lies flat")
{
	CHECK(rt_unit(0xffffffffu) == 1 - 0x1p-24f);
	CHECK(rt_sqrt(1.0f - rt_unit(0xffffffffu)) > 0.0f);
	CHECK(rt_unit(0) == 0);
	// What the usual conversion of all 32 bits would do.
	CHECK(static_cast<float>(0xffffffffu) * 0x1p-32f == 1.0f);
}

TEST_CASE("rule 14: no two samples of an image share a block of numbers")
{
	// A bijection cannot give two keys the same words; that it is one is shown by undoing it.
	Key key = {1, 2, 3, 4};
	for (int i = 0; i < 1 << 18; ++i) {
		const Key next = hash_of(key);
		REQUIRE(preimage_of(next) == key);
		key = next;
	}

	// Of each word only 24 bits are used. Structured keys, such as an image has: powers of two apart in every
	// coordinate, and the far corners of 4K at 4096 samples.
	std::vector<Key> used;
	for (int pixel_bit = -1; pixel_bit < 23; ++pixel_bit)
		for (int sample_bit = -1; sample_bit < 12; ++sample_bit)
			for (const std::uint32_t block : {0u, 1u, 2u, 4u, 8u, 16u, 32u, 64u})
				for (const std::uint32_t end : {0u, 1u})
					for (std::uint32_t seed = 0; seed < 16; ++seed) {
						const std::uint32_t pixel = pixel_bit < 0 ? 0 : 1u << pixel_bit;
						const std::uint32_t sample = sample_bit < 0 ? 0 : 1u << sample_bit;
						Key words = hash_of(
						    {end ? 3840 * 2160 - 1 - pixel : pixel, end ? 4095 - sample % 4096 : sample, block, seed});
						for (std::uint32_t& word : words)
							word >>= 8;
						used.push_back(words);
					}
	std::sort(used.begin(), used.end());
	CHECK(used.size() > 79000);
	CHECK(std::adjacent_find(used.begin(), used.end()) == used.end());

	// A state of 32 bits would fail by the birthday bound: of n = 2^18 streams about n^2 / 2^33 = 8 coincide.
	std::vector<std::uint32_t> states;
	for (std::uint32_t pixel = 0; pixel < 1u << 14; ++pixel)
		for (std::uint32_t sample = 0; sample < 16; ++sample)
			states.push_back(hash_of({pixel, sample, 0, 0})[0]);
	std::sort(states.begin(), states.end());
	CHECK(std::adjacent_find(states.begin(), states.end()) != states.end());
}

TEST_CASE("rule 14: interleaved over pixels, samples, bounces and seeds the numbers show no pattern")
{
	TestFamily family;
	for (const Order& order : orders) {
		Stream stream(order, Bits::Used, 1);
		examine(family, order.name, [&stream] { return stream.next(); });
	}
	INFO("worst of " << family.tests() << ": " << family.worst());
	CHECK(family.p() > level);

	// The low bits of the hash itself do: bit b is a function of the low b + 17 bits of the key, so along pixels bit 0
	// comes back after 2^17 of them, and such short cycles need not be balanced. rt uses bits 8 to 31 only.
	TestFamily raw;
	Stream neighbours(orders[4], Bits::Raw, 1);
	add_bits(raw, orders[4].name, [&neighbours] { return neighbours.next(); });
	INFO("worst raw bit of " << raw.tests() << ": " << raw.worst());
	CHECK(std::string(orders[4].name) == "neighbours");
	CHECK(raw.p() < level);
}

TEST_CASE("generators with a pattern are noticed")
{
	// A congruential generator of 32 bits: its numbers lie on a lattice.
	std::uint32_t state = 1;
	CHECK(birthday_spacings_p([&state] { return state = state * 1664525u + 1013904223u; }) < level);
	// A shift register of 32 bits: every row is a linear function of the 32 bits of its state.
	state = 1;
	CHECK(matrix_rank_p([&state] {
		      state ^= state << 13;
		      state ^= state >> 17;
		      return state ^= state << 5;
	      }) < level);
	// The hash with its last round left out: neighbours share their low bits.
	TestFamily unfinished;
	Key key{};
	examine(unfinished, "one round", [&key] {
		std::uint32_t x = rt_congruence(key[0]++), w = rt_congruence(3u);
		x += rt_congruence(1u) * w;
		return x ^ x >> 16;
	});
	CHECK(unfinished.p() < level);
	// Numbers too even: every cell once before any twice.
	std::uint32_t counter = 0;
	CHECK(collision_p([&counter] { return counter++ * 0x9e3779b9u; }, 1) < level);
	// One bit in 64 wrong.
	TestFamily biased;
	Stream stream(orders[0], Bits::Raw, 1);
	std::uint32_t calls = 0;
	add_bits(biased, "biased", [&] { return stream.next() | (++calls % 64 == 0 ? 8u : 0u); });
	CHECK(biased.p() < level);
}

TEST_CASE("an order counts every coordinate, and the bits in use are packed without a gap")
{
	// 4 words of 24 bits are 3 words of 32.
	Stream raw(orders[0], Bits::Raw, 7), used(orders[0], Bits::Used, 7);
	std::uint64_t low = 0;
	for (int i = 0; i < 4; ++i) {
		const std::uint32_t number = raw.next() >> 8;
		if (i < 2)
			low |= std::uint64_t(number) << (24 * i);
	}
	const std::uint64_t first = used.next();
	CHECK((first | std::uint64_t(used.next()) << 32) % (std::uint64_t(1) << 48) == low);
	// In every order, the first 2^16 words are of different keys or different words of one.
	for (const Order& order : orders) {
		Stream stream(order, Bits::Raw, 0);
		std::vector<std::uint32_t> words(1 << 16);
		std::generate(words.begin(), words.end(), [&stream] { return stream.next(); });
		std::sort(words.begin(), words.end());
		const auto last = std::unique(words.begin(), words.end());
		CHECK(last - words.begin() > (1 << 16) - 8); // 0.5 repetitions are expected
	}
	CHECK(std::string(orders[3].name) == "dimension");
	Stream dimension(orders[3], Bits::Raw, 0);
	CHECK(dimension.next() == hash_of({0, 0, 0, 0})[0]);
	CHECK(dimension.next() == hash_of({0, 1, 0, 0})[0]);
}
