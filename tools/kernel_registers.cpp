// kernel_registers: what the programs of the shipped scenes take of a GPU, told by NVRTC's assembler; needs no GPU.
//
//     kernel_registers [CAPABILITY...]        75 and 90 if none is named
//
// Without NVRTC it says so, and that is no failure: nothing of rt's bits or of its tests hangs on these figures.
#include "backends/cuda/nvrtc.h"
#include "backends/kernel_text.h"
#include "render/pack.h"
#include "render/scene_file.h"
#include "render/session.h"

#include <fmt/format.h>

#include <cstdio>
#include <cstdlib>
#include <regex>
#include <string>
#include <vector>

namespace {

constexpr const char* scenes[] = {"three-spheres", "planets", "floating", "weekend", "cornell", "cloud-1000"};

rt::Result<std::string> usage_of(const rt::Nvrtc& nvrtc, const std::string& scene_name, int capability)
{
	RT_TRY_ASSIGN(const rt::SceneFile file, rt::open_scene(scene_name));
	const rt::RenderSettings& settings = file.base.render;
	RT_TRY_ASSIGN(const rt::PackedScene packed,
	              rt::pack_scene(file.base, settings, {0, 0, settings.width, settings.height}));
	rt::DeviceInfo gpu;
	gpu.backend = "cuda";
	gpu.kind = rt::DeviceKind::Gpu;
	gpu.hardware_seeds = true;
	RT_TRY_ASSIGN(const std::string text, rt::flatten_program(rt::render_program(packed, gpu, {})));
	std::vector<std::string> options = rt::nvrtc_options();
	options.emplace_back("--ptxas-options=-v");
	RT_TRY_ASSIGN(const rt::NvrtcOutput output, nvrtc.compile(text, "kernels/render.cl", {capability, true}, options));
	// "ptxas info : Compiling entry function 'rt_render' for 'sm_90'", lines on its stack and spills, "Used 64
	// registers"
	const std::size_t entry = output.log.find("'rt_render'");
	std::smatch found;
	const std::string tail = entry == std::string::npos ? std::string() : output.log.substr(entry);
	std::string result = "the assembler's log has no registers";
	if (std::regex_search(tail, found, std::regex("Used (\\d+) registers")))
		result = fmt::format("{} registers", found[1].str());
	if (std::regex_search(tail, found, std::regex("(\\d+) bytes stack frame, (\\d+) bytes spill stores")))
		result += fmt::format(", {} bytes of stack, {} bytes spilled", found[1].str(), found[2].str());
	return result;
}

} // namespace

int main(int argc, char** argv)
{
	const auto& nvrtc = rt::Nvrtc::load();
	if (!nvrtc) {
		fmt::print("no registers are known: {}\n", nvrtc.error().message);
		return 0;
	}
	std::vector<int> capabilities;
	for (int i = 1; i < argc; ++i)
		capabilities.push_back(std::atoi(argv[i]));
	if (capabilities.empty())
		capabilities = {75, 90};
	for (const int capability : capabilities)
		for (const char* scene : scenes) {
			const rt::Result<std::string> usage = usage_of(*nvrtc.value(), scene, capability);
			if (!usage) {
				fmt::print(stderr, "kernel_registers: {}: {}\n{}\n", scene, usage.error().message, usage.error().log);
				return static_cast<int>(usage.error().kind);
			}
			fmt::print("sm_{} {:14} {}\n", capability, scene, *usage);
		}
	return 0;
}
