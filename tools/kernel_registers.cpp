// kernel_registers: what the programs of the shipped scenes take of a GPU, told by NVRTC's assembler; needs no GPU.
//
//     kernel_registers [CAPABILITY...]        75 and 90 if none is named
//
// Without NVRTC it says so, and that is no failure: nothing of rt's bits or of its tests hangs on these figures.
#include "backends/cuda/nvrtc.h"
#include "render/bvh.h"
#include "render/pack.h"
#include "render/scene_file.h"
#include "render/session.h"
#include "tools/ptxas_use.h"

#include <fmt/format.h>

#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

namespace {

constexpr const char* scenes[] = {"three-spheres", "planets", "floating", "weekend", "cornell", "cloud-1000"};

rt::Result<std::string> usage_of(const rt::Nvrtc& nvrtc, const std::string& scene_name, int capability)
{
	RT_TRY_ASSIGN(const rt::SceneFile file, rt::open_scene(scene_name));
	const rt::RenderSettings& settings = file.base.render;
	RT_TRY_ASSIGN(rt::PackedScene packed, rt::pack_scene(file.base, settings, {0, 0, settings.width, settings.height}));
	if (rt::wants_bvh(packed, 1, rt::Acceleration::Auto)) {
		RT_TRY_ASSIGN(packed, rt::with_bvh(packed, 1));
	}
	const rt::ProgramSpec spec = rt::render_program(packed, rt::imagined_gpu(), {});
	RT_TRY_ASSIGN(const rt::PtxasUse use, rt::ptxas_use(nvrtc, spec, capability));
	std::string result = "the assembler's log has no registers";
	if (use.registers)
		result = fmt::format("{} registers", *use.registers);
	if (use.stack_bytes)
		result += fmt::format(", {} bytes of stack, {} bytes spilled", *use.stack_bytes, use.spilled_bytes.value_or(0));
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
