#include "tools/ptxas_use.h"

#include "backends/kernel_text.h"

#include <chrono>
#include <regex>
#include <string>
#include <vector>

namespace rt {

DeviceInfo imagined_gpu()
{
	DeviceInfo gpu;
	gpu.backend = "cuda";
	gpu.kind = DeviceKind::Gpu;
	gpu.reports_fp64 = true;
	return gpu;
}

Result<PtxasUse> ptxas_use(const Nvrtc& nvrtc, const ProgramSpec& spec, int capability)
{
	RT_TRY_ASSIGN(const std::string text, flatten_program(spec));
	std::vector<std::string> options = nvrtc_options(false, false, spec.registers);
	options.emplace_back("--ptxas-options=-v");
	PtxasUse use;
	const auto start = std::chrono::steady_clock::now();
	RT_TRY_ASSIGN(const NvrtcOutput output, nvrtc.compile(text, spec.root, {capability, true}, options));
	use.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
	use.code_bytes = output.image.size();
	// "ptxas info : Compiling entry function 'rt_render' for 'sm_90'", lines on its stack and spills, "Used 64
	// registers"
	const std::size_t entry = output.log.find("'rt_render'");
	const std::string tail = entry == std::string::npos ? std::string() : output.log.substr(entry);
	const auto number = [](const std::ssub_match& match) { return static_cast<unsigned>(std::stoul(match.str())); };
	std::smatch found;
	if (std::regex_search(tail, found, std::regex("Used (\\d+) registers")))
		use.registers = number(found[1]);
	if (std::regex_search(tail, found, std::regex("(\\d+) bytes stack frame, (\\d+) bytes spill stores"))) {
		use.stack_bytes = number(found[1]);
		use.spilled_bytes = number(found[2]);
	}
	return use;
}

} // namespace rt
