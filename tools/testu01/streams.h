// streams.h: rt's random numbers as sequences of 32-bit words, in the orders in which a picture consumes them.
//
// A generator without state has no sequence of its own: which numbers follow each other is decided by who asks. So a
// battery of tests must be shown several orders (struct Order), each of them two ways (enum Bits). Used by
// tools/testu01 and by tests/test_random.cpp.
#pragma once

#include "kernels/rng.h"

#include <array>
#include <cstdint>

namespace rt {

// What of each 32-bit word goes into the sequence.
enum class Bits {
	Raw,  // all 32 bits, of which rt throws the low 8 away
	Used, // the 24 bits that become a number, packed without gaps: 4 numbers are 3 words
};

// The coordinates of rt_random(), in the order in which they count up, fastest first. Coordinate 'w' is the word within
// a block; those that do not occur stay 0.
struct Order {
	struct Digit {
		char coordinate; // 'p' pixel, 's' sample, 'b' block, 'd' seed, 'w' word
		std::uint64_t count;
	};
	const char* name;
	const char* what;
	std::array<Digit, 5> digits;
};

// A whole image of 3840 x 2160 is 2^23 pixels nearly; the last coordinate counts on without an end (up to 2^32).
constexpr std::uint64_t endless = std::uint64_t(1) << 32;
inline constexpr std::array<Order, 6> orders = {{
    {"path",
     "as one thread renders: a path's 9 blocks, 128 samples a pixel, pixel by pixel",
     {{{'w', 4}, {'b', 9}, {'s', 128}, {'p', 3840 * 2160}, {'d', endless}}}},
    {"pixels",
     "one block of all pixels of an image, then the next sample, then the next block",
     {{{'w', 4}, {'p', 1920 * 1080}, {'s', 4096}, {'b', 65}, {'d', endless}}}},
    {"samples",
     "one block of 4096 samples of a pixel, then the next pixel",
     {{{'w', 4}, {'s', 4096}, {'p', 3840 * 2160}, {'b', 65}, {'d', endless}}}},
    {"dimension",
     "one number alone (the first of a block) over samples, then pixels: what a single integral sees",
     {{{'s', 128}, {'p', 3840 * 2160}, {'b', 65}, {'w', 4}, {'d', endless}}}},
    {"neighbours",
     "one number alone over the pixels of an image: what the eye sees as a pattern",
     {{{'p', 1920 * 1080}, {'s', 4096}, {'w', 4}, {'b', 65}, {'d', endless}}}},
    {"seeds",
     "the first block of a pixel over seeds, as in frames of a film, then the next pixel",
     {{{'w', 4}, {'d', 65536}, {'p', 3840 * 2160}, {'s', 4096}, {'b', 65}}}},
}};

class Stream {
public:
	// `seed` is added to the seed coordinate: another seed gives other numbers.
	Stream(const Order& order, Bits bits, std::uint32_t seed) : order_(order), bits_(bits), seed_(seed) {}

	std::uint32_t next()
	{
		if (bits_ == Bits::Raw)
			return word();
		// 24 bits at a time into a reservoir; the low end goes out.
		while (held_ < 32) {
			reservoir_ |= std::uint64_t(word() >> 8) << held_;
			held_ += 24;
		}
		const auto out = static_cast<std::uint32_t>(reservoir_);
		reservoir_ >>= 32;
		held_ -= 32;
		return out;
	}

private:
	std::uint32_t word()
	{
		const std::uint32_t component = at_[3];
		// A block holds four words: hashed once if they are asked for one after the other.
		if (order_.digits[0].coordinate != 'w' || component == 0 || !hashed_) {
			const rt_words4 v = rt_pcg4d({at_[0], at_[1], at_[2], at_[4] + seed_});
			block_ = {v.x, v.y, v.z, v.w};
			hashed_ = true;
		}
		const std::uint32_t out = block_[component];
		step();
		return out;
	}

	void step()
	{
		for (std::size_t i = 0; i < order_.digits.size(); ++i) {
			const Order::Digit& digit = order_.digits[i];
			std::uint32_t& place = at_[place_of(digit.coordinate)];
			if (std::uint64_t(place) + 1 < digit.count) {
				++place;
				return;
			}
			place = 0;
		}
	}

	static constexpr std::size_t place_of(char coordinate)
	{
		return coordinate == 'p' ? 0 : coordinate == 's' ? 1 : coordinate == 'b' ? 2 : coordinate == 'w' ? 3 : 4;
	}

	const Order& order_;
	Bits bits_;
	std::uint32_t seed_;
	std::array<std::uint32_t, 5> at_{}; // pixel, sample, block, word, seed
	std::array<std::uint32_t, 4> block_{};
	bool hashed_ = false;
	std::uint64_t reservoir_ = 0;
	int held_ = 0;
};

} // namespace rt
