// provenance.h: how an image was made, as key and value, in the order in which it is written.
//
// The keys are the same in PNG text chunks, EXR attributes (both prefixed "rt:") and .rtfilm headers: Software,
// Contract, Scene, SceneHash, Frame, Width, Height, Window, Samples, Error, SampleLimit, TimeLimit, Seed, MaxDepth,
// Sampler, Estimator, Roulette (these six only where they are not the default), Precision, KernelHash, Backend, Device,
// Driver, Compiler, BuildOptions, SelfTest, Rejected, FilmHash, Transfer, Exposure.
#pragma once

#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace rt {

using Provenance = std::vector<std::pair<std::string, std::string>>;

// The value of a key; empty if absent.
inline std::string provenance_value(const Provenance& provenance, const std::string& key)
{
	for (const auto& [name, value] : provenance)
		if (name == key)
			return value;
	return {};
}

// Text that every format and terminal can hold: what is not valid UTF-8 becomes '?', a control character other than a
// line feed a space. Drivers put anything into their strings, and so may the writer of a file.
std::string clean_text(std::string_view text);

// What a key's value has to do with the pixels.
enum class KeyEffect {
	Image,   // decides them: another value, another image
	Display, // decides how 8-bit pixels are made of them
	Device,  // must not change a bit where the precision is exact and the device verified
	Trust,   // says whether that is so
	Result,  // follows from the pixels
	Unknown, // not of this version
};
KeyEffect effect_of(const std::string& key);

// A key whose values differ; one that is absent has an empty value.
struct MetadataDifference {
	std::string key, a, b;
	KeyEffect effect = KeyEffect::Unknown;
};
// In the order of the first, then what only the second has.
std::vector<MetadataDifference> metadata_differences(const Provenance& a, const Provenance& b);

// Whether images with these provenances may differ, and why, as a sentence without a full stop.
enum class Expectation {
	Same,      // nothing in the metadata explains a difference
	Different, // something does
	Unknown,   // a file does not say how it was made
};
struct Expected {
	Expectation expectation = Expectation::Unknown;
	std::string reason;
};
Expected expected_difference(const Provenance& a, const Provenance& b, bool is_encoded);

} // namespace rt
