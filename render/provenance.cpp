#include "render/provenance.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstddef>

namespace rt {

namespace {

struct Key {
	const char* name;
	KeyEffect effect;
};
constexpr Key keys[] = {
    // Contract stands for what the kernels compute; their hash changes with a comment.
    {"Contract", KeyEffect::Image},  {"SceneHash", KeyEffect::Image},     {"Frame", KeyEffect::Image},
    {"Width", KeyEffect::Image},     {"Height", KeyEffect::Image},        {"Window", KeyEffect::Image},
    {"Error", KeyEffect::Image},     {"SampleLimit", KeyEffect::Image},   {"TimeLimit", KeyEffect::Device},
    {"Samples", KeyEffect::Image},   {"Seed", KeyEffect::Image},          {"MaxDepth", KeyEffect::Image},
    {"Sampler", KeyEffect::Image},   {"Estimator", KeyEffect::Image},     {"Roulette", KeyEffect::Image},
    {"Precision", KeyEffect::Image}, {"Transfer", KeyEffect::Display},    {"Exposure", KeyEffect::Display},
    {"Software", KeyEffect::Device}, {"Scene", KeyEffect::Device},        {"KernelHash", KeyEffect::Device},
    {"Backend", KeyEffect::Device},  {"Device", KeyEffect::Device},       {"Driver", KeyEffect::Device},
    {"Compiler", KeyEffect::Device}, {"BuildOptions", KeyEffect::Device}, {"SelfTest", KeyEffect::Trust},
    {"Rejected", KeyEffect::Result}, {"FilmHash", KeyEffect::Result},
};

bool has_key(const Provenance& provenance, const std::string& key)
{
	return std::any_of(provenance.begin(), provenance.end(), [&](const auto& entry) { return entry.first == key; });
}

// Length of the UTF-8 sequence that begins here, 0 if there is none: no overlong forms, surrogates or values above
// U+10FFFF.
std::size_t utf8_sequence(std::string_view text)
{
	const auto byte = [&](std::size_t i) { return static_cast<unsigned char>(text[i]); };
	const unsigned char first = byte(0);
	if (first < 0x80)
		return 1;
	const std::size_t length = first >= 0xf0 ? 4 : first >= 0xe0 ? 3 : 2;
	if (first < 0xc2 || first > 0xf4 || text.size() < length)
		return 0;
	for (std::size_t i = 1; i < length; ++i)
		if ((byte(i) & 0xc0) != 0x80)
			return 0;
	if ((first == 0xe0 && byte(1) < 0xa0) || (first == 0xed && byte(1) > 0x9f) || (first == 0xf0 && byte(1) < 0x90) ||
	    (first == 0xf4 && byte(1) > 0x8f))
		return 0;
	return length;
}

} // namespace

std::string clean_text(std::string_view text)
{
	std::string clean;
	while (!text.empty()) {
		const std::size_t length = utf8_sequence(text);
		if (length == 0)
			clean += '?';
		else if (length == 1 && (static_cast<unsigned char>(text[0]) < 32 || text[0] == 127) && text[0] != '\n')
			clean += ' ';
		else
			clean += text.substr(0, length);
		text.remove_prefix(std::max<std::size_t>(length, 1));
	}
	return clean;
}

KeyEffect effect_of(const std::string& key)
{
	for (const Key& known : keys)
		if (key == known.name)
			return known.effect;
	return KeyEffect::Unknown;
}

std::vector<MetadataDifference> metadata_differences(const Provenance& a, const Provenance& b)
{
	std::vector<MetadataDifference> differences;
	for (const auto& [key, value] : a)
		if (const std::string other = provenance_value(b, key); other != value)
			differences.push_back({key, value, other, effect_of(key)});
	for (const auto& [key, value] : b)
		if (!has_key(a, key))
			differences.push_back({key, "", value, effect_of(key)});
	return differences;
}

Expected expected_difference(const Provenance& a, const Provenance& b, bool is_encoded)
{
	if (a.empty() || b.empty())
		return {Expectation::Unknown, fmt::format("{} not say how {} made",
		                                          a.empty() && b.empty() ? "the files do"
		                                          : a.empty()            ? "A does"
		                                                                 : "B does",
		                                          a.empty() && b.empty() ? "they were" : "it was")};
	std::vector<std::string> causes;
	bool another_device = false;
	for (const MetadataDifference& difference : metadata_differences(a, b)) {
		if (difference.effect == KeyEffect::Image || (difference.effect == KeyEffect::Display && is_encoded))
			causes.push_back(fmt::format("another {}", difference.key));
		else if (difference.effect == KeyEffect::Unknown)
			causes.push_back(fmt::format("another {}, which this rt does not know", difference.key));
		another_device = another_device || difference.effect == KeyEffect::Device;
	}
	for (const auto* provenance : {&a, &b})
		if (provenance_value(*provenance, "SelfTest") != "passed")
			causes.push_back(fmt::format("{} is of a device that is not verified", provenance == &a ? "A" : "B"));
	if (another_device && causes.empty() && provenance_value(a, "Precision") != "exact")
		causes.push_back(
		    fmt::format("precision {} on another device or of another version", provenance_value(a, "Precision")));
	if (causes.empty())
		return {Expectation::Same, "same scene, settings and contract, on verified devices"};
	return {Expectation::Different, fmt::format("{}", fmt::join(causes, "; "))};
}

} // namespace rt
