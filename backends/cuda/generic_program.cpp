#include "backends/cuda/generic_program.h"

#include "common/rt_compat.h" // the defaults of the defines below

#include <fmt/format.h>

#include <algorithm>

namespace rt {

namespace {

// Defines that only delete code, that mean nothing to CUDA, or that only name the program.
constexpr const char* ignored[] = {"RT_FEATURES", "RT_DEF_SPHERE_COUNT", "RT_DEF_WIDE_COUNT", "RT_DEF_PTX",
                                   "RT_PROGRAM_ID"};

bool is_ignored(const std::string& name)
{
	return std::any_of(std::begin(ignored), std::end(ignored), [&](const char* other) { return name == other; });
}

bool is_default(const std::string& name, const std::string& value)
{
	return (name == "RT_PRECISION" && value == fmt::to_string(RT_PRECISION)) ||
	       (name == "RT_LANES" && value == fmt::to_string(RT_LANES)) ||
	       (name == "RT_DEF_NATIVE_ROOTS" && value == fmt::to_string(RT_DEF_NATIVE_ROOTS));
}

} // namespace

std::vector<ProgramSpec> generic_programs()
{
	std::vector<ProgramSpec> specs;
	for (const char* root : {"kernels/render.cl", "kernels/probe.cl"})
		for (const char* native_roots : {"0", "1"})
			specs.push_back(ProgramSpec{root, {{"RT_DEF_NATIVE_ROOTS", native_roots}}, {}});
	specs.push_back(ProgramSpec{"kernels/peak.cl", {}, {}});
	return specs;
}

std::string generic_key(const ProgramSpec& spec)
{
	auto defines = spec.defines;
	std::sort(defines.begin(), defines.end());
	std::string key = spec.root;
	for (const auto& [name, value] : defines)
		if (!is_ignored(name) && !is_default(name, value))
			key += fmt::format(" {}={}", name, value);
	return key;
}

} // namespace rt
