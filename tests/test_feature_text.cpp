// A scene pays nothing for what it does not use: of a feature that is left out no word is left in the program, once the
// preprocessor is through with it. What is under a condition that is constant (if (RT_HAS(...))) compilers delete.
#include "tests/catch.h"
#include "tests/run_command.h"

#include "backends/kernel_text.h"
#include "common/rt_features.h"

#include <fmt/format.h>

#include <cstdio>
#include <fstream>
#include <regex>
#include <string>
#include <vector>

namespace {

// The program as an OpenCL compiler sees it behind its preprocessor; fields of structs and comments are no code.
std::string code_with(std::uint32_t features)
{
	rt::ProgramSpec spec;
	spec.root = "kernels/render.cl";
	spec.entries = {"rt_render"};
	spec.defines = {{"RT_LANES", "4"}, {"RT_FEATURES", fmt::format("{:#x}u", features)}};
	const auto text = rt::flatten_program(spec);
	REQUIRE(text);
	const std::string file = "/tmp/rt-test-feature-text-" + std::to_string(std::rand()) + ".c";
	std::ofstream(file) << *text;
	const std::string command = "cc -E -P -undef -x c -D__OPENCL_VERSION__=120 -D__OPENCL_C_VERSION__=120 "
	                            "-D__ENDIAN_LITTLE__=1 '" +
	                            file + "'";
	const Outcome outcome = run_command(command);
	CHECK(outcome.status == 0);
	(void)std::remove(file.c_str());
	return std::regex_replace(outcome.out, std::regex("struct\\s*\\w*\\s*\\{[^}]*\\}"), "");
}

struct Feature {
	std::uint32_t bits; // left out together
	const char* words;  // of its code and of no other's
};

const std::vector<Feature> features = {
    {RT_FEATURE_DIELECTRIC, "dielectric|bent"},
    {RT_FEATURE_EMISSION, "emission"},
    {RT_FEATURE_IMAGE, "texel|height_texels"},
    {RT_FEATURE_CHECKER | RT_FEATURE_IMAGE, "rt_texture_color|rt_cell"},
    {RT_FEATURE_DEFOCUS, "lens_u|lens_v"},
    {RT_FEATURE_SKY | RT_FEATURE_GRADIENT, "rt_sky_radiance"},
    {RT_FEATURE_WIDE, "rt_wide_distance|two_roots"},
    {RT_FEATURE_BVH, "rt_bvh_hit\\w*|\\w*slab\\w*"},
    {RT_FEATURE_SOBOL | RT_FEATURE_STRATIFIED, "\\w*sobol\\w*|\\w*pascal\\w*"},
    {RT_FEATURE_LIGHTS, "rt_light_\\w+|rt_aim_at_lamp"},
    {RT_FEATURE_ROULETTE, "rt_roulette\\w*|at_stake"},
};

} // namespace

TEST_CASE("features: what is left out leaves no word behind")
{
	const std::string all = code_with(RT_FEATURE_ALL);
	REQUIRE(all.find("rt_render") != std::string::npos);
	for (const Feature& feature : features) {
		const std::regex words(std::string("\\b(") + feature.words + ")\\b");
		INFO(feature.words);
		CHECK(std::regex_search(all, words));
		std::uint32_t without = RT_FEATURE_ALL & ~feature.bits;
		if ((feature.bits & RT_FEATURE_EMISSION) != 0)
			without &= ~RT_FEATURE_LIGHTS; // lamps shine
		const std::string code = code_with(without);
		std::smatch left;
		std::regex_search(code, left, words);
		INFO("left: " << left.str());
		CHECK(left.empty());
	}
}
