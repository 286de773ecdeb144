#include "kernels/srgb_table.h"
#include "render/display.h"
#include "render/display_table.h"
#include "tests/catch.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

using rt::Film;
using rt::Transfer;
using rt::Window;

namespace {

const Transfer transfers[] = {Transfer::Srgb, Transfer::Gamma2, Transfer::Linear};

std::vector<std::uint8_t> codes(const std::vector<std::int64_t>& sums, std::uint32_t samples, std::int32_t exponent,
                                Transfer transfer, double stops = 0)
{
	const auto pixels = static_cast<std::uint32_t>(sums.size() / 3);
	Film film(pixels, 1, Window{0, 0, pixels, 1}, exponent);
	std::copy(sums.begin(), sums.end(), film.sums().begin());
	std::fill(film.samples().begin(), film.samples().end(), samples);
	return rt::to_8bit(film, {transfer, stops});
}

int code(std::int64_t sum, std::uint32_t samples, std::int32_t exponent, Transfer transfer, double stops = 0)
{
	const auto all = codes({0, sum, 0}, samples, exponent, transfer, stops);
	REQUIRE(all[0] == 0);
	REQUIRE(all[2] == 0);
	return all[1];
}

// The textbook's formulas, in the direction that the tables do not use.
long double encode(long double value, Transfer transfer)
{
	value = value > 1 ? 1 : value;
	if (transfer == Transfer::Linear)
		return value;
	if (transfer == Transfer::Gamma2)
		return std::sqrt(value);
	return value <= 0.0031308L ? 12.92L * value : 1.055L * std::pow(value, 1 / 2.4L) - 0.055L;
}

const std::uint64_t* thresholds(Transfer transfer)
{
	return transfer == Transfer::Srgb     ? rt::srgb_thresholds
	       : transfer == Transfer::Gamma2 ? rt::gamma2_thresholds
	                                      : rt::linear_thresholds;
}

} // namespace

TEST_CASE("8-bit values agree with the transfer functions")
{
	std::mt19937_64 random(3);
	for (const Transfer transfer : transfers) {
		int wrong = 0, undecided = 0;
		for (int round = 0; round < 200; ++round) {
			const auto samples = static_cast<std::uint32_t>(random() % 5000 + 1);
			const int exponent = static_cast<int>(random() % 30) + 20;
			std::vector<std::int64_t> sums;
			for (int i = 0; i < 999; ++i) {
				const double radiance = std::ldexp(static_cast<double>(random() >> 11), -53 - i % 12) * 1.2;
				sums.push_back(static_cast<std::int64_t>(std::ldexp(radiance * samples, exponent)));
			}
			const auto got = codes(sums, samples, exponent, transfer);
			for (std::size_t i = 0; i < sums.size(); ++i) {
				const long double value = std::ldexp(static_cast<long double>(sums[i]) / samples, -exponent);
				const long double position = encode(value, transfer) * 255 + 0.5L;
				if (std::fabs(position - std::round(position)) < 1e-6L)
					++undecided; // too near an edge for this arithmetic, or exactly 255
				else
					wrong += static_cast<int>(std::floor(position)) != got[i];
			}
		}
		CHECK(wrong == 0);
		CHECK(undecided < 200);
	}
}

TEST_CASE("rule 19: each threshold is the least radiance of its code")
{
	for (const Transfer transfer : transfers) {
		const std::uint64_t* const table = thresholds(transfer);
		for (int k = 0; k < 255; ++k) {
			const auto edge = static_cast<std::int64_t>(table[k]);
			REQUIRE(code(edge, 1, 48, transfer) == k + 1);
			REQUIRE(code(edge - 1, 1, 48, transfer) == k);
			// The same radiance with other samples and exponents; one unit of the sum less must not reach it.
			for (const std::uint32_t samples : {3u, 1000u, 32749u}) {
				REQUIRE(code(edge * samples, samples, 48, transfer) == k + 1);
				REQUIRE(code(edge * samples - 1, samples, 48, transfer) == k);
			}
			REQUIRE(code(edge * 1024, 1, 58, transfer) == k + 1);
			REQUIRE(code(edge * 1024 - 1, 1, 58, transfer) == k);
			const std::int64_t coarse = (edge + 255) / 256; // the first multiple of 2^-40 at or above the edge
			REQUIRE(code(coarse, 1, 40, transfer) == k + 1);
			REQUIRE(code(coarse - 1, 1, 40, transfer) == k);
			// The edges are where the formulas put them.
			const long double position = encode(std::ldexp(static_cast<long double>(edge), -48), transfer) * 255;
			REQUIRE(std::fabs(position - (k + 0.5L)) < 1e-6L);
		}
	}
}

TEST_CASE("8-bit values are monotone and clamped")
{
	for (const Transfer transfer : transfers) {
		std::vector<std::int64_t> sums;
		for (std::int64_t i = 0; i < 3 * 65536; ++i)
			sums.push_back(i);
		const auto got = codes(sums, 3, 16, transfer); // sums up to 3 2^16: the whole range, in steps of 2^-16 / 3
		for (std::size_t i = 1; i < got.size(); ++i)
			REQUIRE(got[i] >= got[i - 1]);
		CHECK(got.front() == 0);
		CHECK(got.back() == 255);
		CHECK(code(INT64_MAX, 1, 10, transfer) == 255);
		CHECK(code(INT64_MAX, 1, 0, transfer, 20) == 255);
		CHECK(code(-5, 1, 0, transfer) == 0);
		CHECK(code(INT64_MIN, 1, 0, transfer) == 0);
		CHECK(code(1000, 0, 0, transfer) == 0); // no samples
		// Exponents beyond the width of the integers.
		CHECK(code(INT64_MAX, 1, 250, transfer, 20) == 0);
		CHECK(code(INT64_MAX, 1, 144, transfer, 20) == 0);
		CHECK(code(std::int64_t(1) << 62, 1, 16, transfer, 20) == 255); // 2^114 in the units of the thresholds
		CHECK(code(1, 0xffffffffu, -250, transfer, -20) == 255);
		CHECK(code(1, 0xffffffffu, -100, transfer, -20) == 255);
	}
}

TEST_CASE("exposure")
{
	const std::uint64_t one = std::uint64_t(1) << 32;
	for (int stops = -20; stops <= 20; ++stops)
		CHECK(rt::exposure_factor(stops) == (stops < 0 ? one >> -stops : one << stops));
	CHECK(rt::exposure_factor(21) == one << 20);
	CHECK(rt::exposure_factor(-1e300) == one >> 20);
	CHECK(rt::exposure_factor(HUGE_VAL) == one << 20);
	CHECK(rt::exposure_factor(std::nan("")) == one);
	CHECK(rt::exposure_factor(0.5) == 6074001000u); // 2^32.5 = 6074000999.95

	std::uint64_t previous = 0;
	for (int i = -20 * 1024; i <= 20 * 1024; ++i) {
		const double stops = i / 1024.0; // exact in 24 fractional bits
		const std::uint64_t factor = rt::exposure_factor(stops);
		REQUIRE(factor >= previous);
		previous = factor;
		const long double exact = std::ldexp(std::exp2(static_cast<long double>(stops)), 32);
		REQUIRE(std::fabs(static_cast<long double>(factor) - exact) < 0.53L);
	}

	std::mt19937_64 random(4);
	std::vector<std::int64_t> sums, doubled;
	for (int i = 0; i < 999; ++i) {
		sums.push_back(static_cast<std::int64_t>(random() >> 24));
		doubled.push_back(2 * sums.back());
	}
	for (const Transfer transfer : transfers) {
		CHECK(codes(sums, 7, 40, transfer, 1) == codes(doubled, 7, 40, transfer));
		CHECK(codes(doubled, 7, 40, transfer, -1) == codes(sums, 7, 40, transfer));
		CHECK(codes(sums, 7, 40, transfer, 0.5) != codes(sums, 7, 40, transfer));
	}
}

TEST_CASE("the sRGB table decodes what the display transform encodes")
{
	CHECK(rt_srgb_table[0] == 0.0f);
	CHECK(rt_srgb_table[255] == 1.0f);
	for (int k = 0; k < 256; ++k) {
		const long double x = k / 255.0L;
		const long double exact = x <= 0.04045L ? x / 12.92L : std::pow((x + 0.055L) / 1.055L, 2.4L);
		REQUIRE(rt_srgb_table[k] == static_cast<float>(exact));
		const auto sum = static_cast<std::int64_t>(std::ldexp(rt_srgb_table[k], 50));
		REQUIRE(code(sum, 1, 50, Transfer::Srgb) == k);
	}
}

TEST_CASE("a large film's pixels get the codes that they get alone")
{
	std::mt19937_64 random(3);
	const std::uint32_t width = 211, height = 173; // more than 2^15 pixels
	for (const Transfer transfer : transfers)
		for (const double stops : {0.0, -3.25, 20.0})
			for (const std::uint32_t samples : {1u, 100u, 4000000000u})
				for (const std::int32_t exponent : {0, 30, 62}) {
					Film film(width, height, Window{0, 0, width, height}, exponent);
					for (auto& sum : film.sums())
						sum = static_cast<std::int64_t>(random() >> (random() % 64)) * (random() % 16 ? 1 : -1);
					// Of every hundredth pixel more samples were taken, of some none.
					std::fill(film.samples().begin(), film.samples().end(), samples);
					for (std::size_t i = 1; i < film.samples().size(); i += 100)
						film.samples()[i] = static_cast<std::uint32_t>(random() % 3 * samples / 2);
					const std::vector<std::uint8_t> all = rt::to_8bit(film, {transfer, stops});
					std::size_t wrong = 0;
					for (std::size_t pixel = 0; pixel < film.samples().size(); pixel += 7) {
						Film alone(1, 1, Window{0, 0, 1, 1}, exponent);
						std::copy_n(film.sums().begin() + 3 * pixel, 3, alone.sums().begin());
						alone.samples()[0] = film.samples()[pixel];
						wrong += rt::to_8bit(alone, {transfer, stops}) !=
						         std::vector<std::uint8_t>(all.begin() + static_cast<std::ptrdiff_t>(3 * pixel),
						                                   all.begin() + static_cast<std::ptrdiff_t>(3 * pixel + 3));
					}
					CHECK(wrong == 0);
				}
}
