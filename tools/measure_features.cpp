// measure_features.cpp: what each feature costs a scene that does not use it.
//
// Builds a scene's program as rt does, with its features only; then with one more, for each that it lacks; then with
// all. Renders them in turns, so that a change of the machine's speed meets them all, and takes ratios of each round.
// All must give the same film. Code size: of what the driver makes (PoCL's shared objects; elsewhere its binaries).
// Registers, their code and its compilation are NVRTC's for a GPU of the capability that --sm says, where NVRTC is
// there; that needs no GPU. Drivers' caches are kept away, so that build times are those of a first run.
//
// The scene's own program is measured twice: how far the two lie apart is how far this measurement can be trusted.
//
// The time of one more feature says what it would cost to leave it in: a scene's own program has none of it, which
// tests/test_feature_text.cpp holds.
#include "backends/program_cache.h"
#include "common/rt_features.h"
#include "render/bvh.h"
#include "render/scene_file.h"
#include "render/session.h"
#include "support/clock.h"
#include "support/files.h"
#include "tools/measuring.h"
#include "tools/ptxas_use.h"
#include "tools/report.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace rt {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* usage = R"(usage: rt_measure_features [SCENE...] [options]

Tells what each feature costs a scene that does not use it, on one device.

  SCENE           a file or a shipped scene (three-spheres)
{}  --sm N          the capability of the GPU that registers and code are told of ({}); 0 leaves them out
)";

struct Wanted : MeasuringOptions {
	Wanted() : MeasuringOptions(160, 90, 16, 9) {}
	int capability = 90;
};

Result<Wanted> read_arguments(int argc, char** argv)
{
	Wanted wanted;
	const auto own = [&wanted](const std::string& name, const char* value) {
		return name == "--sm" && std::sscanf(value, "%d", &wanted.capability) == 1;
	};
	RT_TRY(read_measuring_options(argc, argv, "rt_measure_features", own, wanted));
	return wanted;
}

// A directory that is gone at the end.
class Scratch {
public:
	Scratch()
	{
		std::string name = (std::filesystem::temp_directory_path() / "rt-measure-features-XXXXXX").string();
		if (mkdtemp(name.data()))
			path_ = name;
	}
	~Scratch()
	{
		std::error_code ignored;
		std::filesystem::remove_all(path_, ignored);
	}
	Scratch(const Scratch&) = delete;
	Scratch& operator=(const Scratch&) = delete;
	const std::filesystem::path& path() const { return path_; }

	// Bytes of the machine code that lies here.
	std::uint64_t code_bytes() const
	{
		std::uint64_t objects = 0, binaries = 0;
		std::error_code error;
		for (std::filesystem::recursive_directory_iterator at(path_, error), end; !error && at != end;
		     at.increment(error)) {
			if (at->path().extension() == ".so" && at->is_regular_file(error))
				objects += at->file_size(error);
			else if (at->path().extension() == ".bin" && at->is_regular_file(error))
				binaries += at->file_size(error);
		}
		return objects > 0 ? objects : binaries;
	}

private:
	std::filesystem::path path_;
};

struct Candidate {
	std::string name;
	std::uint32_t features = 0; // beside the scene's own
	bool specialise = true;
	double build_seconds = 0; // to the end of the first small render: some drivers compile only then
	std::uint64_t code_bytes = 0;
	std::vector<double> seconds;
	std::optional<PtxasUse> ptxas;
};

// The scene's own program first and again, the generic one last.
std::vector<Candidate> candidates_for(std::uint32_t features)
{
	std::vector<Candidate> all(2);
	all[0].name = "its own features";
	all[1].name = "the same again";
	const auto add = [&](std::uint32_t bit, const char* name) {
		if ((features & bit) != 0)
			return;
		Candidate one;
		one.name = fmt::format("  and {}", name);
		one.features = bit; // with what it needs (common/rt_features.h)
		if (bit == RT_FEATURE_BVH)
			one.features |= bvh_features;
		if (bit == RT_FEATURE_LIGHTS)
			one.features |= RT_FEATURE_LAMBERTIAN | RT_FEATURE_EMISSION;
		all.push_back(std::move(one));
	};
#define RT_ADD(bit, name, text) add(bit, name);
	RT_FEATURE_LIST(RT_ADD)
#undef RT_ADD
	Candidate generic;
	generic.name = "all (generic)";
	generic.specialise = false;
	all.push_back(std::move(generic));
	return all;
}

class Measuring {
public:
	Measuring(const Wanted& wanted, const Scratch& scratch, DeviceHandle device, bool software_roots)
	    : wanted_(wanted), scratch_(scratch), device_(std::move(device)), software_roots_(software_roots)
	{
	}

	Result<Json> run(const std::string& name)
	{
		RT_TRY_ASSIGN(const SceneFile file, open_scene(name));
		RT_TRY_ASSIGN(const Scene scene, file.at_frame(0));
		settings_ = scene.render;
		settings_.width = wanted_.width;
		settings_.height = wanted_.height;
		settings_.samples = wanted_.samples;
		RT_TRY_ASSIGN(packed_, pack_scene(scene, settings_, {0, 0, settings_.width, settings_.height}));
		// What a session on this device would render.
		SessionOptions options;
		const std::uint32_t lanes = render_lanes(packed_, device_->info(), options);
		has_tree_ = wants_bvh(packed_, lanes, options.bvh);
		std::vector<Candidate> all = candidates_for(packed_.features | (has_tree_ ? bvh_features : 0u));
		for (Candidate& candidate : all)
			RT_TRY(build(name, candidate));
		for (std::uint32_t round = 0; round < wanted_.rounds; ++round)
			for (Candidate& candidate : all) {
				show(fmt::format("{}, round {} of {}: {}", name, round + 1, wanted_.rounds, candidate.name));
				RT_TRY_ASSIGN(const double seconds, render(candidate, settings_.samples));
				candidate.seconds.push_back(seconds);
			}
		show("");
		return report(name, all);
	}

private:
	static void show(const std::string& text)
	{
		if (has_terminal(stderr))
			print_message("\r\033[K" + text);
	}

	SessionOptions options_of(const Candidate& candidate, std::uint32_t samples) const
	{
		SessionOptions options;
		options.samples = samples;
		options.specialise = candidate.specialise;
		options.software_roots = software_roots_;
		return options;
	}

	PackedScene packed_for(const Candidate& candidate) const
	{
		PackedScene packed = packed_;
		packed.features |= candidate.features;
		return packed;
	}

	// Seconds; of all cores on a processor, which others may have in between.
	Result<double> render(const Candidate& candidate, std::uint32_t samples)
	{
		const double start = cpu_seconds();
		RT_TRY_ASSIGN(const SessionResult result,
		              render_scene(packed_for(candidate), {device_}, options_of(candidate, samples)));
		const double seconds = device_->info().is_processor() ? cpu_seconds() - start : result.render_seconds;
		if (samples == settings_.samples) {
			const Hash128 hash = result.film.hash();
			if (hash_ && *hash_ != hash)
				return Error{ErrorKind::Failure, fmt::format("with {} the film is another", candidate.name),
				             device_->info().name, "leaving a feature in must not change a bit: this is a bug of rt",
				             ""};
			hash_ = hash;
		}
		return seconds;
	}

	Status build(const std::string& scene, Candidate& candidate)
	{
		show(fmt::format("{}: building with {}", scene, candidate.name));
		const std::uint64_t before = scratch_.code_bytes();
		const double start = cpu_seconds();
		RT_TRY(render(candidate, 1));
		candidate.build_seconds = cpu_seconds() - start;
		candidate.code_bytes = scratch_.code_bytes() - before;
		const auto& nvrtc = Nvrtc::load();
		if (!nvrtc || wanted_.capability == 0)
			return success();
		PackedScene packed = packed_for(candidate);
		if (has_tree_)
			packed.features |= bvh_features;
		RT_TRY_ASSIGN(candidate.ptxas,
		              ptxas_use(*nvrtc.value(), render_program(packed, imagined_gpu(), options_of(candidate, 1)),
		                        wanted_.capability));
		return success();
	}

	Result<Json> report(const std::string& name, const std::vector<Candidate>& all) const
	{
		const std::string sm = fmt::format("sm_{}", wanted_.capability);
		std::vector<std::vector<std::string>> rows = {{"program with",
		                                               device_->info().is_processor() ? ">CPU seconds" : ">seconds",
		                                               ">of its own", ">least", ">most", ">build s", ">code"}};
		if (all[0].ptxas)
			rows[0].insert(rows[0].end(), {fmt::format(">{} registers", sm), ">code", ">compile s"});
		Json programs = Json::array();
		for (const Candidate& candidate : all) {
			std::vector<double> ratios;
			for (std::size_t i = 0; i < candidate.seconds.size(); ++i)
				ratios.push_back(candidate.seconds[i] / all[0].seconds[i]);
			const auto [least, most] = std::minmax_element(ratios.begin(), ratios.end());
			std::vector<std::string> row = {candidate.name,
			                                fmt::format("{:.3f}", median(candidate.seconds)),
			                                fmt::format("{:.3f}", median(ratios)),
			                                fmt::format("{:.3f}", *least),
			                                fmt::format("{:.3f}", *most),
			                                fmt::format("{:.2f}", candidate.build_seconds),
			                                candidate.code_bytes > 0 ? format_bytes(candidate.code_bytes) : ""};
			Json json = {{"features", candidate.name.substr(candidate.name.find_first_not_of(' '))},
			             {"seconds", median(candidate.seconds)},
			             {"ratio", median(ratios)},
			             {"least_ratio", *least},
			             {"most_ratio", *most},
			             {"build_seconds", candidate.build_seconds},
			             {"code_bytes", candidate.code_bytes > 0 ? Json(candidate.code_bytes) : Json()}};
			if (candidate.ptxas) {
				const PtxasUse& use = *candidate.ptxas;
				row.push_back(use.registers ? std::to_string(*use.registers) : "?");
				row.push_back(format_bytes(use.code_bytes));
				row.push_back(fmt::format("{:.2f}", use.seconds));
				json["ptxas"] = {{"registers", use.registers ? Json(*use.registers) : Json()},
				                 {"spilled_bytes", use.spilled_bytes ? Json(*use.spilled_bytes) : Json()},
				                 {"code_bytes", use.code_bytes},
				                 {"seconds", use.seconds}};
			}
			rows.push_back(std::move(row));
			programs.push_back(std::move(json));
		}
		print_result(fmt::format("{}, {}x{}, {} samples a pixel, {} ({}), {} rounds\n", name, settings_.width,
		                         settings_.height, settings_.samples, device_->info().name, device_->info().backend,
		                         wanted_.rounds));
		print_result(format_table(rows) + '\n');
		RT_TRY(flush_results());
		return Json{{"scene", name}, {"features", feature_names(packed_.features)}, {"programs", programs}};
	}

	const Wanted& wanted_;
	const Scratch& scratch_;
	DeviceHandle device_;
	bool software_roots_;
	bool has_tree_ = false;
	RenderSettings settings_;
	PackedScene packed_;
	std::optional<Hash128> hash_;
};

Result<int> run(int argc, char** argv)
{
	RT_TRY_ASSIGN(const Wanted wanted, read_arguments(argc, argv));
	if (wanted.help) {
		print_result(fmt::format(usage, measuring_usage(Wanted()), Wanted().capability));
		return 0;
	}
	const Scratch scratch;
	// Before a driver is loaded: what was built before must not be found.
	setenv("RT_CACHE_DIR", scratch.path().c_str(), 1);
	setenv("POCL_CACHE_DIR", (scratch.path() / "pocl").c_str(), 1);
	setenv("CUDA_CACHE_DISABLE", "1", 1);
	RT_TRY_ASSIGN(const MeasuredDevice device, open_measured_device(wanted.device));
	const auto& nvrtc = Nvrtc::load();
	Json all = measuring_head(wanted, device.handle->info());
	all["nvrtc"] = nvrtc && wanted.capability != 0 ? Json(nvrtc.value()->version()) : Json();
	all["capability"] = wanted.capability;
	Json& scenes = all["feature_scenes"] = Json::array();
	for (const std::string& scene : wanted.scenes) {
		RT_TRY_ASSIGN(Json json, Measuring(wanted, scratch, device.handle, device.software_roots).run(scene));
		scenes.push_back(std::move(json));
		// After each scene: a run that somebody ends keeps what it has.
		if (!wanted.json.empty())
			RT_TRY(write_file(wanted.json, to_text(all)));
	}
	return 0;
}

} // namespace
} // namespace rt

int main(int argc, char** argv) { return rt::end_program(rt::run(argc, argv)); }
