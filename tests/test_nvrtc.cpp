// The kernels under NVRTC, which needs no GPU: they compile without a warning, and the PTX has no operation that the
// contract forbids (docs/contract.md, rules 2 to 4).
#include "backends/cuda/generic_program.h"
#include "backends/cuda/nvrtc.h"
#include "backends/kernel_text.h"
#include "backends/precision.h"
#include "common/rt_features.h"
#include "render/pack.h"
#include "render/scene_file.h"
#include "tests/catch.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <set>
#include <sstream>

using namespace rt;

namespace {

// nullptr, with a warning that says why, where there is no NVRTC; a failure if RT_REQUIRE asks for it.
const Nvrtc* find_nvrtc()
{
	const auto& nvrtc = Nvrtc::load();
	if (nvrtc)
		return nvrtc.value();
	const char* required = std::getenv("RT_REQUIRE");
	if (required && std::string(required).find("nvrtc") != std::string::npos)
		FAIL("RT_REQUIRE asks for NVRTC: " << nvrtc.error().message << "\n" << nvrtc.error().log);
	WARN("skipped: " << nvrtc.error().message);
	return nullptr;
}

// Whether `line`, an fma, multiplies by a constant +-2^k ("0f33800000"): such a product is exact, so that the fma and a
// product with a sum after it have the same bits.
bool has_exact_product(const std::string& line)
{
	std::istringstream operands(line);
	std::string operand;
	std::getline(operands, operand, ','); // the operation and its result
	for (int factor = 0; factor < 2 && std::getline(operands, operand, ','); ++factor) {
		const std::size_t at = operand.find("0f");
		if (at == std::string::npos)
			continue;
		const unsigned long bits = std::strtoul(operand.c_str() + at + 2, nullptr, 16);
		if ((bits & 0x7fffffu) == 0 && (bits & 0x7f800000u) != 0)
			return true;
	}
	return false;
}

// How often each operation occurs: "fma.rn.f32" -> 225.
using Operations = std::map<std::string, int>;

Operations operations(const NvrtcOutput& output)
{
	Operations result;
	std::istringstream ptx(std::string(output.image.begin(), output.image.end() - 1));
	for (std::string line; std::getline(ptx, line);) {
		std::istringstream words(line);
		std::string word;
		words >> word;
		if (!word.empty() && word[0] == '{') // "{ operation": a block of inline PTX
			word.erase(0, 1);
		if (word.empty())
			words >> word;
		if (!word.empty() && word[0] == '@') // "@%p1 operation"
			words >> word;
		while (!word.empty() && word.back() == ';')
			word.pop_back();
		if (word.empty() || word[0] < 'a' || word[0] > 'z')
			continue;
		if (word == "fma.rn.f32" && has_exact_product(line))
			word = "exact product, fma.rn.f32";
		++result[word];
	}
	return result;
}

bool contains(const std::string& text, const char* part) { return text.find(part) != std::string::npos; }
bool starts_with(const std::string& text, const char* start) { return text.rfind(start, 0) == 0; }

int count(const Operations& found, const char* start)
{
	int sum = 0;
	for (const auto& [name, times] : found)
		if (starts_with(name, start))
			sum += times;
	return sum;
}

// What the contract forbids in `found`, one line each; empty if it keeps the contract.
std::string forbidden(const Operations& found)
{
	std::string result;
	for (const auto& [name, times] : found) {
		const bool seed = starts_with(name, "rsqrt.approx") || starts_with(name, "rcp.approx");
		const bool arithmetic = starts_with(name, "add.") || starts_with(name, "sub.") || starts_with(name, "mul.") ||
		                        starts_with(name, "div.");
		if (contains(name, ".f64"))
			result += name + ": double precision\n";
		if (contains(name, ".approx") && !seed)
			result += name + ": an approximation that is not a seed\n";
		if (contains(name, ".ftz") && !seed)
			result += name + ": flushes subnormals\n";
		if (arithmetic && contains(name, ".f32") && !contains(name, ".rn"))
			result += name + ": no rounding mode, so that the assembler may fuse it\n";
		if (contains(name, ".full"))
			result += name + ": not correctly rounded\n";
	}
	return result;
}

// The value; a failure of the test with the error's own words if there is none.
template <class T>
T expect(Result<T> result)
{
	if (!result)
		FAIL(result.error().message << "\n" << result.error().where << "\n" << result.error().log);
	return std::move(result).value();
}

NvrtcOutput compile(const Nvrtc& nvrtc, const std::string& text, const NvrtcTarget& target,
                    const std::vector<std::string>& options = nvrtc_options())
{
	return expect(nvrtc.compile(text, "kernels/test.cl", target, options));
}

// Programs that ask devices about the rules and are not embedded: as verify/exhaustive.cpp and tests/test_paths.cpp
// build them, with everything that a scene may need.
std::vector<ProgramSpec> asking_programs()
{
	std::vector<ProgramSpec> specs;
	for (const char* const native_roots : {"0", "1"}) {
		specs.push_back(
		    {"kernels/exhaust.cl", {{"RT_DEF_NATIVE_ROOTS", native_roots}}, {"rt_exhaust", "rt_exhaust_rays"}});
		specs.push_back({"kernels/probe_paths.cl", {{"RT_DEF_NATIVE_ROOTS", native_roots}}, {"rt_probe_paths"}});
	}
	return specs;
}

// The contract's options with one replaced: ("--fmad=false", "--fmad=true").
std::vector<std::string> options_with(const std::string& old_option, const std::string& new_option)
{
	std::vector<std::string> options = nvrtc_options();
	const auto found = std::find(options.begin(), options.end(), old_option);
	REQUIRE(found != options.end());
	*found = new_option;
	return options;
}

// The masks that the shipped scenes need, also with rays aimed at their lamps, and all features together.
std::set<std::uint32_t> shipped_feature_masks()
{
	std::set<std::uint32_t> masks = {RT_FEATURE_ALL};
	int scenes = 0;
	for (const auto& file : std::filesystem::directory_iterator(RT_SOURCE_DIR "/scenes")) {
		if (file.path().extension() != ".json" || file.path().stem().extension() == ".schema")
			continue;
		INFO(file.path().string());
		const SceneFile loaded = expect(load_scene_file(file.path().string()));
		const Scene scene = expect(loaded.at_frame(0));
		const Window window{0, 0, scene.render.width, scene.render.height};
		RenderSettings settings = scene.render;
		for (const Estimator estimator : {settings.estimator, Estimator::Mis}) {
			settings.estimator = estimator;
			masks.insert(expect(pack_scene(scene, settings, window)).features);
		}
		++scenes;
	}
	CHECK(scenes > 0);
	return masks;
}

constexpr const char* multiply_add = "extern \"C\" __global__ void test(float* p) { p[0] = p[1] * p[2] + p[3]; p[4] = "
                                     "p[1] / p[2]; p[5] = sqrtf(p[3]); }\n";

} // namespace

TEST_CASE("NVRTC: the check of PTX finds what it looks for")
{
	const Nvrtc* const nvrtc = find_nvrtc();
	if (!nvrtc)
		return;
	const NvrtcTarget target{75, false};
	const auto strict = operations(compile(*nvrtc, multiply_add, target));
	CHECK(count(strict, "fma") == 0);
	CHECK(count(strict, "mul.rn.f32") == 1);
	CHECK(count(strict, "add.rn.f32") == 1);
	CHECK(count(strict, "div.rn.f32") == 1);
	CHECK(count(strict, "sqrt.rn.f32") == 1);
	CHECK(forbidden(strict).empty());

	CHECK(count(operations(compile(*nvrtc, multiply_add, target, options_with("--fmad=false", "--fmad=true"))),
	            "fma") == 1);
	CHECK(contains(forbidden(operations(
	                   compile(*nvrtc, multiply_add, target, options_with("--prec-div=true", "--prec-div=false")))),
	               "div."));
	CHECK(contains(forbidden(operations(
	                   compile(*nvrtc, multiply_add, target, options_with("--prec-sqrt=true", "--prec-sqrt=false")))),
	               "sqrt.approx"));
	CHECK(contains(
	    forbidden(operations(compile(*nvrtc, multiply_add, target, options_with("--ftz=false", "--ftz=true")))),
	    ".ftz"));
	// A product by 2^k is exact and may be fused; one by 2 is rewritten as a sum, which then fuses with the product in
	// it.
	const char* const scaled = "extern \"C\" __global__ void test(float* p) { p[0] = p[1] * 0.25f + p[2]; }\n";
	const char* const doubled = "extern \"C\" __global__ void test(float* p) { p[0] = p[1] * p[2] * 2.0f; }\n";
	const auto contracting = options_with("--fmad=false", "--fmad=true");
	CHECK(count(operations(compile(*nvrtc, scaled, target, contracting)), "exact product, fma") == 1);
	CHECK(count(operations(compile(*nvrtc, doubled, target, contracting)), "fma") == 1);
	CHECK(count(operations(compile(*nvrtc, doubled, target)), "fma") == 0);
	const char* const unsuffixed = "extern \"C\" __global__ void test(float* p) { p[0] = p[1] * 1.1; }\n";
	CHECK(contains(forbidden(operations(compile(*nvrtc, unsuffixed, target))), ".f64"));
}

TEST_CASE("NVRTC: every shipped feature mask compiles and keeps the contract")
{
	const Nvrtc* const nvrtc = find_nvrtc();
	if (!nvrtc)
		return;
	for (const std::uint32_t mask : shipped_feature_masks())
		for (const char* native_roots : {"0", "1"})
			for (const int capability : {75, 90}) {
				INFO(fmt::format("features {:#x}, native roots {}, capability {}", mask, native_roots, capability));
				const std::string text = expect(flatten_program(
				    {"kernels/render.cl",
				     {{"RT_FEATURES", fmt::format("{:#x}u", mask)}, {"RT_DEF_NATIVE_ROOTS", native_roots}},
				     {}}));
				const NvrtcOutput output = compile(*nvrtc, text, {capability, false});
				CHECK(output.log.empty());
				const Operations found = operations(output);
				CHECK(forbidden(found).empty());
				CHECK(count(found, "fma.rn.f32") > 0);
				if (capability != generic_capability)
					continue; // contraction happens above the PTX: once is enough
				// Contract rule 3: contraction finds nothing to fuse that the source does not fuse itself.
				const Operations contracted =
				    operations(compile(*nvrtc, text, {capability, false}, options_with("--fmad=false", "--fmad=true")));
				CHECK(count(contracted, "fma") == count(found, "fma"));
			}
}

TEST_CASE("NVRTC: what asks devices about the rules compiles and keeps them itself")
{
	const Nvrtc* const nvrtc = find_nvrtc();
	if (!nvrtc)
		return;
	for (const ProgramSpec& spec : asking_programs()) {
		INFO(generic_key(spec));
		const std::string text = expect(flatten_program(spec));
		const NvrtcTarget target{generic_capability, false};
		const NvrtcOutput output = compile(*nvrtc, text, target);
		CHECK(output.log.empty());
		const Operations found = operations(output);
		CHECK(forbidden(found).empty());
		CHECK(count(found, "fma.rn.f32") > 0);
		CHECK(count(found, "add.rn.f32") > 0);
		const std::string ptx(output.image.begin(), output.image.end() - 1);
		for (const std::string& entry : spec.entries)
			CHECK(contains(ptx, (".entry " + entry + "(").c_str()));
	}
}

TEST_CASE("NVRTC: the double rung computes in double alone, and fast takes what the GPU has")
{
	const Nvrtc* const nvrtc = find_nvrtc();
	if (!nvrtc)
		return;
	const auto operations_of = [&](Precision precision, std::uint32_t parts = RT_FAST_ALL) {
		ProgramSpec spec{"kernels/render.cl", {}, {}};
		set_precision(spec, precision, parts);
		const NvrtcOutput output = compile(*nvrtc, expect(flatten_program(spec)), {generic_capability, false},
		                                   nvrtc_options(lets_compiler_fuse(spec), flushes_subnormals(spec)));
		CHECK(output.log.empty());
		return operations(output);
	};
	const Operations in_double = operations_of(Precision::Double);
	CHECK(count(in_double, "fma.rn.f64") > 0);
	CHECK(count(in_double, "sqrt.rn.f64") > 0);
	CHECK(count(in_double, "rcp.rn.f64") > 0);
	for (const auto& [name, times] : in_double) {
		INFO(name);
		const bool memory = starts_with(name, "ld.") || starts_with(name, "cvt.f64.f32") || starts_with(name, "mov.") ||
		                    starts_with(name, "selp.") || starts_with(name, "setp.");
		CHECK((memory ||
		       !contains(name,
		                 "f32"))); // the scene's numbers are float and may be compared as such; what is computed is not
		CHECK_FALSE(contains(name, ".approx"));
		const bool arithmetic = starts_with(name, "add.") || starts_with(name, "sub.") || starts_with(name, "mul.");
		CHECK((!arithmetic || !contains(name, ".f64") || contains(name, ".rn")));
	}
	const Operations fast = operations_of(Precision::Fast);
	CHECK(count(fast, "rsqrt.approx.ftz") > 0);
	CHECK(count(fast, "sqrt.approx.ftz") > 0);
	CHECK(count(fast, "rcp.approx.ftz") > 0);
	CHECK(count(fast, "sin.approx.ftz") > 0);
	CHECK(count(fast, "cos.approx.ftz") > 0);
	CHECK(count(fast, "fma.rn.ftz") > 0);
	for (const auto& [name, times] : fast) {
		INFO(name);
		CHECK_FALSE(contains(name, ".f64"));
	}
	// Each part brings its own operation and no other's.
	CHECK(forbidden(operations_of(Precision::Fast, 0)).empty());
	CHECK(count(operations_of(Precision::Fast, RT_FAST_SINCOS), "sin.approx") > 0);
	CHECK(count(operations_of(Precision::Fast, RT_FAST_SINCOS), "sqrt.approx") == 0);
	CHECK(count(operations_of(Precision::Fast, RT_FAST_ROOTS), "sqrt.approx") > 0);
	CHECK(count(operations_of(Precision::Fast, RT_FAST_ROOTS), "sin.approx") == 0);
	CHECK(count(operations_of(Precision::Fast, RT_FAST_RECIPROCALS), "rcp.approx") > 0);
	CHECK(count(operations_of(Precision::Fast, RT_FAST_FLUSH), "fma.rn.ftz") > 0);
}

TEST_CASE("NVRTC: binary code of all programs is made without a warning")
{
	const Nvrtc* const nvrtc = find_nvrtc();
	if (!nvrtc)
		return;
	std::vector<ProgramSpec> specs = generic_programs();
	for (const ProgramSpec& spec : asking_programs())
		specs.push_back(spec);
	for (const ProgramSpec& spec : specs)
		for (const int capability : {75, 90}) {
			INFO(generic_key(spec) << ", capability " << capability);
			const NvrtcOutput output = compile(*nvrtc, expect(flatten_program(spec)), {capability, true});
			CHECK(output.log.empty());
			REQUIRE(output.image.size() > 4);
			CHECK(std::string(output.image.begin(), output.image.begin() + 4) == "\x7f"
			                                                                     "ELF");
		}
}

TEST_CASE("NVRTC: a target is the GPU's own binary, else PTX of an older one, else an error")
{
	const Nvrtc* const nvrtc = find_nvrtc();
	if (!nvrtc)
		return;
	REQUIRE_FALSE(nvrtc->capabilities().empty());
	const int newest = nvrtc->capabilities().back();
	const auto own = nvrtc->target_for(newest);
	REQUIRE(own);
	CHECK(own->option() == fmt::format("--gpu-architecture=sm_{}", newest));
	const auto later = nvrtc->target_for(newest + 1);
	REQUIRE(later);
	CHECK(later->option() == fmt::format("--gpu-architecture=compute_{}", newest));
	const auto older = nvrtc->target_for(nvrtc->capabilities().front() - 1);
	REQUIRE_FALSE(older);
	CHECK(older.error().kind == ErrorKind::NoDevice);
}

TEST_CASE("NVRTC: a failed build carries the log with the kernel's file and line")
{
	const Nvrtc* const nvrtc = find_nvrtc();
	if (!nvrtc)
		return;
	const auto output = nvrtc->compile("#line 7 \"kernels/wrong.h\"\nint x = nothing_of_this_name;\n",
	                                   "kernels/test.cl", {75, false}, nvrtc_options());
	REQUIRE_FALSE(output);
	CHECK(output.error().kind == ErrorKind::Build);
	CHECK(contains(output.error().log, "kernels/wrong.h(7)"));
	CHECK(contains(output.error().log, "nothing_of_this_name"));
}

TEST_CASE("A generic program stands in for specialised ones and for nothing else")
{
	const ProgramSpec plain{"kernels/render.cl", {}, {}};
	CHECK(generic_key({"kernels/render.cl", {{"RT_FEATURES", "0x1u"}, {"RT_DEF_SPHERE_COUNT", "4"}}, {"rt_render"}}) ==
	      generic_key(plain));
	CHECK(generic_key({"kernels/render.cl", {{"RT_LANES", "1"}, {"RT_DEF_NATIVE_ROOTS", "1"}}, {}}) ==
	      generic_key(plain));
	CHECK(generic_key({"kernels/render.cl", {{"RT_DEF_NATIVE_ROOTS", "0"}}, {}}) != generic_key(plain));
	CHECK(generic_key({"kernels/render.cl", {{"RT_PRECISION", "0"}}, {}}) == generic_key(plain));
	CHECK(generic_key({"kernels/render.cl", {{"RT_PRECISION", "1"}}, {}}) != generic_key(plain));
	CHECK(generic_key({"kernels/render.cl", {{"RT_LANES", "8"}}, {}}) != generic_key(plain));
	CHECK(generic_key({"kernels/render.cl", {{"RT_DEF_UNHEARD_OF", "1"}}, {}}) != generic_key(plain));
	CHECK(generic_key({"kernels/probe.cl", {}, {}}) != generic_key(plain));
	CHECK(generic_key({"kernels/render.cl", {{"B", "2"}, {"A", "1"}}, {}}) ==
	      generic_key({"kernels/render.cl", {{"A", "1"}, {"B", "2"}}, {}}));
}

TEST_CASE("The embedded table holds all generic programs or none")
{
	std::map<std::string, std::string> rows;
	for (const EmbeddedPtx* row = embedded_ptx; row->key; ++row)
		rows[row->key] = row->ptx;
	if (rows.empty()) {
		WARN("skipped: rt was built without NVRTC or with RT_EMBED_PTX off");
		CHECK(std::string(embedded_ptx_compiler).empty());
		return;
	}
	CHECK(starts_with(embedded_ptx_compiler, "NVRTC "));
	CHECK(rows.size() == generic_programs().size());
	for (const ProgramSpec& spec : generic_programs()) {
		INFO(generic_key(spec));
		REQUIRE(rows.count(generic_key(spec)) == 1);
		const std::string& ptx = rows[generic_key(spec)];
		CHECK(contains(ptx, fmt::format(".target sm_{}", generic_capability).c_str()));
		CHECK(contains(ptx, ".entry rt_"));
	}
}
