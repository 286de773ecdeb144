#include "render/provenance.h"

#include <fmt/format.h>

#include <algorithm>

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
    {"Samples", KeyEffect::Image},   {"Seed", KeyEffect::Image},          {"MaxDepth", KeyEffect::Image},
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

} // namespace

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
