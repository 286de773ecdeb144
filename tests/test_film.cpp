#include "render/film.h"
#include "support/hash.h"
#include "tests/catch.h"

#include <algorithm>
#include <cfloat>
#include <cmath>
#include <cstdint>
#include <limits>
#include <new>
#include <random>
#include <string>
#include <utility>
#include <vector>

using rt::Film;
using rt::Window;

namespace {

static_assert(LDBL_MANT_DIG >= 64, "the checks of rounding count on 64 bits");

// The worked example of docs/formats.md.
Film example()
{
	Film film(2, 1, Window{0, 0, 2, 1}, 30);
	film.sums() = {1073741824, 536870912, 0, 4294967296, 1, 4611686018427387904};
	film.samples() = {4, 4};
	return film;
}

Film one_pixel(std::int64_t sum, std::uint32_t samples, std::int32_t exponent)
{
	Film film(1, 1, Window{0, 0, 1, 1}, exponent);
	film.sums() = {sum, 0, 0};
	film.samples() = {samples};
	return film;
}

// Whether `value` is the rounding of sum / (samples 2^exponent) to nearest, ties to even. The midpoint between two
// neighbours has one bit more than they, so its product with the samples is exact in 64 bits.
template <class Float>
bool is_correctly_rounded(Float value, std::int64_t sum, std::uint32_t samples, int exponent)
{
	const long double exact = std::ldexp(static_cast<long double>(sum), -exponent); // times samples
	const Float infinity = std::numeric_limits<Float>::infinity();
	const auto middle = [&](Float other) {
		return (static_cast<long double>(value) + static_cast<long double>(other)) / 2 * samples;
	};
	const long double below = middle(std::nextafter(value, -infinity)), above = middle(std::nextafter(value, infinity));
	int unused;
	const bool even =
	    std::fmod(std::ldexp(std::frexp(value, &unused), std::numeric_limits<Float>::digits), Float(2)) == Float(0);
	return even ? below <= exact && exact <= above : below < exact && exact < above;
}

} // namespace

TEST_CASE("hashes are XXH3-128 in canonical hex")
{
	CHECK(rt::hash_text("").hex() == "99aa06d3014798d86001c324468d497f");
	rt::Hash128 hash;
	hash.high = 0x0123456789abcdef;
	hash.low = 0xfedcba9876543210;
	CHECK(hash.hex() == "0123456789abcdeffedcba9876543210");

	rt::Hasher hasher;
	hasher.add_u32(0x64636261);
	hasher.add(nullptr, 0);
	hasher.add("e", 1);
	hasher.add_u64(0x6d6c6b6a69686766);
	CHECK(hasher.result() == rt::hash_text("abcdefghijklm"));
	CHECK(hasher.result() != rt::hash_text("abcdefghijkl"));
}

TEST_CASE("the film hash of the documented example")
{
	const Film film = example();
	std::vector<std::uint8_t> bytes;
	const auto put = [&](std::uint64_t value, int count) {
		for (int i = 0; i < count; ++i)
			bytes.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
	};
	for (const std::uint32_t field : {2u, 1u, 4u, 30u})
		put(field, 4);
	for (const std::int64_t sum : film.sums())
		put(static_cast<std::uint64_t>(sum), 8);
	REQUIRE(bytes.size() == 64);
	CHECK(film.hash() == rt::hash_bytes(bytes.data(), bytes.size()));
	CHECK(film.hash().hex() == "195c176578934f30aaa9bffdade356aa");

	Film uneven = example();
	uneven.samples() = {4, 3};
	CHECK(uneven.hash().hex() == "afb86ece6e9a47d5b747f2734d949d8e");
}

TEST_CASE("the hash of a film larger than a block of bytes")
{
	Film film(61, 47, Window{0, 0, 61, 47}, -3);
	std::vector<std::uint8_t> bytes = {61, 0, 0, 0, 47, 0, 0, 0, 0, 0, 0, 0, 0xfd, 0xff, 0xff, 0xff};
	std::mt19937_64 random(6);
	for (auto& sum : film.sums()) {
		const std::uint64_t value = random();
		sum = static_cast<std::int64_t>(value);
		for (int shift = 0; shift < 64; shift += 8)
			bytes.push_back(static_cast<std::uint8_t>(value >> shift));
	}
	CHECK(film.hash() == rt::hash_bytes(bytes.data(), bytes.size()));
}

TEST_CASE("the film hash depends on all that it names, and on nothing else")
{
	const rt::Hash128 hash = example().hash();
	for (std::size_t i = 0; i < 6; ++i) {
		Film film = example();
		film.sums()[i] ^= 1;
		CHECK(film.hash() != hash);
	}
	Film more = example();
	more.samples() = {5, 5};
	CHECK(more.hash() != hash);
	Film other_exponent(2, 1, Window{0, 0, 2, 1}, 31);
	other_exponent.sums() = example().sums();
	other_exponent.samples() = example().samples();
	CHECK(other_exponent.hash() != hash);
	Film upright(1, 2, Window{0, 0, 1, 2}, 30);
	upright.sums() = example().sums();
	upright.samples() = example().samples();
	CHECK(upright.hash() != hash);

	Film elsewhere(9, 9, Window{3, 4, 2, 1}, 30);
	elsewhere.sums() = example().sums();
	elsewhere.samples() = example().samples();
	elsewhere.segments = 77;
	CHECK(elsewhere.hash() == hash);
}

TEST_CASE("evenness and sample counts")
{
	Film film = example();
	CHECK(film.is_even());
	film.samples()[1] = 9;
	CHECK_FALSE(film.is_even());
	CHECK(film.min_samples() == 4);
	CHECK(film.max_samples() == 9);
	CHECK(Film().is_even());
	CHECK(Film().max_samples() == 0);
}

TEST_CASE("rule 15: films add in any order")
{
	std::mt19937_64 random(1);
	std::vector<Film> films;
	for (int i = 0; i < 6; ++i) {
		Film film(5, 4, Window{1, 1, 3, 2}, 20);
		for (auto& sum : film.sums())
			sum = static_cast<std::int64_t>(random() >> 8);
		for (auto& count : film.samples())
			count = static_cast<std::uint32_t>(random() >> 40);
		film.segments = random() >> 20;
		film.rejected = static_cast<std::uint64_t>(i);
		films.push_back(film);
	}
	Film forward(5, 4, Window{1, 1, 3, 2}, 20), tree = films[5];
	for (const Film& film : films)
		REQUIRE(forward.add(film));
	Film pair = films[2];
	REQUIRE(pair.add(films[0]));
	REQUIRE(tree.add(films[4]));
	REQUIRE(tree.add(pair));
	REQUIRE(tree.add(films[3]));
	REQUIRE(tree.add(films[1]));
	CHECK(forward.sums() == tree.sums());
	CHECK(forward.samples() == tree.samples());
	CHECK(forward.segments == tree.segments);
	CHECK(forward.rejected == 15);
	CHECK(forward.hash() == tree.hash());
	CHECK(forward.hash() != films[5].hash());
}

TEST_CASE("films that do not fit together are refused and change nothing")
{
	Film film = example();
	const rt::Hash128 before = film.hash();
	const auto refuses = [&](const Film& other) {
		const rt::Status status = film.add(other);
		return !status && status.error().kind == rt::ErrorKind::Usage && !status.error().cure.empty() &&
		       film.hash() == before && film.segments == 0 && film.samples()[0] == 4;
	};
	CHECK(refuses(Film(3, 1, Window{0, 0, 2, 1}, 30)));
	CHECK(refuses(Film(2, 1, Window{0, 0, 1, 1}, 30)));
	CHECK(refuses(Film(2, 1, Window{0, 0, 2, 1}, 29)));

	// The fields are checked one after the other: the last sum overflows here, and the first must not have moved.
	Film sums = example();
	sums.sums()[5] = std::numeric_limits<std::int64_t>::max() - film.sums()[5] + 1;
	CHECK(refuses(sums));
	sums.sums()[5] -= 1;
	Film target = example();
	CHECK(target.add(sums));
	CHECK(target.sums()[5] == std::numeric_limits<std::int64_t>::max());

	Film counts = example();
	counts.sums() = rt::Zeroed<std::int64_t>(6);
	counts.samples()[1] = 0xfffffffc;
	CHECK(refuses(counts));
	Film segments = example();
	segments.sums() = rt::Zeroed<std::int64_t>(6);
	segments.segments = ~std::uint64_t(0);
	film.segments = 1;
	CHECK_FALSE(film.add(segments));
	CHECK(film.segments == 1);
	CHECK(film.samples()[0] == 4);
}

TEST_CASE("mean radiance")
{
	const Film film = example();
	CHECK(film.radiance(0, 0, 0) == 0.25);
	CHECK(film.radiance(0, 0, 1) == 0.125);
	CHECK(film.radiance(0, 0, 2) == 0);
	CHECK(film.radiance(1, 0, 0) == 1);
	CHECK(film.radiance(1, 0, 1) == std::ldexp(1.0, -32));
	CHECK(film.radiance(1, 0, 2) == std::ldexp(1.0, 30));
	CHECK(film.radiance_float(1, 0, 2) == std::ldexp(1.0f, 30));
	CHECK(one_pixel(123, 0, 4).radiance(0, 0, 0) == 0);
	CHECK(one_pixel(-3, 2, 0).radiance(0, 0, 0) == -1.5);
	CHECK(one_pixel(std::numeric_limits<std::int64_t>::min(), 1, 0).radiance(0, 0, 0) == -std::ldexp(1.0, 63));
}

TEST_CASE("rule 19: mean radiance is correctly rounded")
{
	std::mt19937_64 random(2);
	int wrong = 0;
	const auto check = [&](std::int64_t sum, std::uint32_t samples, int exponent) {
		const Film film = one_pixel(sum, samples, exponent);
		wrong += !is_correctly_rounded(film.radiance_float(0, 0, 0), sum, samples, exponent);
		if (samples < 512)
			wrong += !is_correctly_rounded(film.radiance(0, 0, 0), sum, samples, exponent);
	};
	for (int i = 0; i < 200000; ++i) {
		const auto sum = static_cast<std::int64_t>(random() >> (1 + random() % 62)) | 1;
		check(sum, static_cast<std::uint32_t>(random() >> (32 + random() % 32)) | 1u, 10 + i % 50);
	}
	// Quotients at a tie between two floats or doubles, and the least bit to either side.
	for (int i = 0; i < 100000; ++i) {
		const bool for_float = i % 2 == 0;
		const std::int64_t tie = for_float ? static_cast<std::int64_t>(random() >> 40 | 1 << 23) * 2 + 1
		                                   : static_cast<std::int64_t>(random() >> 11 | std::uint64_t(1) << 52) * 2 + 1;
		const auto samples = static_cast<std::uint32_t>(random() % (for_float ? 100000 : 500) + 1);
		for (const int off : {-1, 0, 1})
			check(tie * samples + off, samples, 40);
	}
	// Just above a tie by less than the last of 63 bits: only the remainder tells.
	check(((std::int64_t(1) << 24) + 1) * 3 * (std::int64_t(1) << 37) + 1, 3u << 30, 20);
	check(((std::int64_t(1) << 53) + 1) * 3 * (std::int64_t(1) << 8) + 1, 3, 20);
	CHECK(wrong == 0);
	// Subnormal in float: 2^-150 is half of the least one, a tie that goes to 0; anything more does not.
	CHECK(one_pixel(1, 1, 150).radiance_float(0, 0, 0) == 0.0f);
	CHECK(one_pixel((std::int64_t(1) << 62) + 1, 1, 212).radiance_float(0, 0, 0) ==
	      std::numeric_limits<float>::denorm_min());
}

TEST_CASE("films begin as zeros, also in memory that was used before, and are values")
{
	// 2.3 MB of sums have whole large pages; the least film has none.
	for (const std::uint32_t width : {1u, 307u}) {
		const Window window{0, 0, width, width};
		for (int round = 0; round < 3; ++round) {
			Film film(width, width, window, 30);
			CHECK(std::count(film.sums().begin(), film.sums().end(), 0) == 3 * int(width * width));
			CHECK(std::count(film.samples().begin(), film.samples().end(), 0u) == int(width * width));
			for (auto& sum : film.sums())
				sum = -1;
			for (auto& count : film.samples())
				count = 0xffffffff;
			Film copy = film;
			copy.sums()[0] = 5;
			CHECK(film.sums()[0] == -1);
			film = std::move(copy);
			CHECK(film.sums()[0] == 5);
			CHECK(film.sums() != Film(width, width, window, 30).sums());
		}
	}
	CHECK(Film().sums().empty());
	CHECK_THROWS_AS(rt::Zeroed<std::int64_t>(std::size_t(1) << 61), std::bad_alloc);
}
