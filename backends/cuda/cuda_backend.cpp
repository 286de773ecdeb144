#include "backends/cuda/cuda_backend.h"

#include "backends/cuda/cuda_api.h"
#include "backends/cuda/cuda_device.h"
#include "backends/cuda/generic_program.h"
#include "backends/cuda/nvrtc.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <fstream>

namespace rt {

namespace {

// What turns kernels into code here: NVRTC, or the programs embedded at build time.
struct Compiler {
	const Nvrtc* nvrtc = nullptr;
	Error missing; // why there is no NVRTC
};

Compiler find_compiler(int driver_version)
{
	const auto& loaded = Nvrtc::load(driver_version / 1000);
	return loaded ? Compiler{loaded.value(), {}} : Compiler{nullptr, loaded.error()};
}

// The first word of the driver's own version line that looks like a version: "580.95.05"; empty if it does not say.
std::string kernel_driver_version()
{
	std::ifstream file("/proc/driver/nvidia/version");
	std::string line;
	while (std::getline(file, line)) {
		if (line.find("NVRM") == std::string::npos)
			continue;
		std::size_t start = 0;
		while ((start = line.find_first_of("0123456789", start)) != std::string::npos) {
			const std::size_t end = std::min(line.find_first_not_of("0123456789.", start), line.size());
			const std::string word = line.substr(start, end - start);
			const bool alone = start == 0 || line[start - 1] == ' ';
			if (alone && word.find('.') != std::string::npos && word.back() != '.')
				return word;
			start = end;
		}
	}
	return {};
}

std::string driver_version_text(int version)
{
	std::string text = fmt::format("CUDA {}.{}", version / 1000, version % 1000 / 10);
	if (const std::string kernel = kernel_driver_version(); !kernel.empty())
		text += ", driver " + kernel;
	return text;
}

// "01234567-89ab-cdef-0123-456789abcdef"; nvidia-smi writes "GPU-" before it.
std::string uuid_text(const CuUuid& uuid)
{
	std::string text;
	for (int i = 0; i < 16; ++i)
		text += fmt::format("{}{:02x}", i == 4 || i == 6 || i == 8 || i == 10 ? "-" : "", uuid.bytes[i]);
	return text;
}

int attribute(const CudaApi& api, int which, CuDevice device)
{
	int value = 0;
	return api.cuDeviceGetAttribute(&value, which, device) == cu_success ? value : 0;
}

void find_identity(const CudaApi& api, CuDevice device, DeviceInfo& info)
{
	char pci[32] = {};
	if (api.cuDeviceGetPCIBusId(pci, sizeof pci, device) == cu_success) {
		info.pci = pci;
		std::transform(info.pci.begin(), info.pci.end(), info.pci.begin(),
		               [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
	}
	const auto get_uuid = api.cuDeviceGetUuid_v2 ? api.cuDeviceGetUuid_v2 : api.cuDeviceGetUuid;
	CuUuid uuid{};
	if (get_uuid && get_uuid(&uuid, device) == cu_success) {
		info.uuid = uuid_text(uuid);
		info.id = "uuid:" + info.uuid;
	} else if (!info.pci.empty())
		info.id = "pci:" + info.pci;
}

void refuse(DeviceInfo& info, std::string why)
{
	info.usable = false;
	info.why_not = std::move(why);
}

// Decides what will compile for this device, and whether anything can.
void find_program_source(const Compiler& compiler, int capability, DeviceInfo& info)
{
	if (compiler.nvrtc) {
		info.compiler = compiler.nvrtc->version();
		if (const auto target = compiler.nvrtc->target_for(capability); !target)
			refuse(info, target.error().message + "; " + target.error().cure);
		return;
	}
	const bool embedded = embedded_ptx[0].key != nullptr;
	if (!embedded || capability < generic_capability) {
		std::string why = compiler.missing.message + ", and ";
		why += embedded ? fmt::format("the embedded programs need compute capability {}.{}", generic_capability / 10,
		                              generic_capability % 10)
		                : "no programs were embedded when rt was built";
		refuse(info, why + "; " + compiler.missing.cure);
		return;
	}
	info.compiler = fmt::format("{} (when rt was built)", embedded_ptx_compiler);
	info.quirks.push_back({"generic-program", fmt::format("{}: the generic program embedded in rt serves every scene, "
	                                                      "slower and with the same image; {}",
	                                                      compiler.missing.message, compiler.missing.cure)});
}

Result<DeviceInfo> describe_device(const CudaApi& api, const Compiler& compiler, int ordinal)
{
	const std::string where = fmt::format("CUDA device {}", ordinal);
	CuDevice device = 0;
	if (const CuResult result = api.cuDeviceGet(&device, ordinal); result != cu_success)
		return api.error(result, "cuDeviceGet", where);
	DeviceInfo info;
	info.backend = "cuda";
	info.platform = "NVIDIA CUDA";
	info.kind = DeviceKind::Gpu;
	info.index_in_backend = ordinal;
	char name[256] = {};
	if (const CuResult result = api.cuDeviceGetName(name, sizeof name, device); result != cu_success)
		return api.error(result, "cuDeviceGetName", where);
	info.name = name;
	find_identity(api, device, info);
	std::size_t memory = 0;
	if (const CuResult result = api.cuDeviceTotalMem_v2(&memory, device); result != cu_success)
		return api.error(result, "cuDeviceTotalMem", where);
	info.memory_bytes = info.max_alloc_bytes = memory;
	info.compute_units = static_cast<std::uint32_t>(attribute(api, cu_attribute_multiprocessor_count, device));
	// True of every GPU that CUDA supports, with the options of nvrtc_options().
	info.reports_correct_rounding = info.reports_subnormals = info.reports_fp64 = true;

	RT_TRY_ASSIGN(const int capability, cuda_capability(api, device));
	find_program_source(compiler, capability, info);
	if (attribute(api, cu_attribute_compute_mode, device) == cu_compute_mode_prohibited)
		refuse(info, "its compute mode is 'prohibited'; run 'nvidia-smi -c DEFAULT' as root");
	return info;
}

class CudaBackend final : public Backend {
public:
	const char* name() const override { return "cuda"; }

	Enumeration enumerate() override
	{
		Enumeration found;
		const auto& loaded = CudaApi::load();
		if (!loaded)
			return absent(loaded.error());
		const CudaApi& api = *loaded.value();
		if (const CuResult result = api.cuInit(0); result != cu_success)
			return absent(api.error(result, "cuInit", "CUDA"));
		int version = 0, count = 0;
		if (const CuResult result = api.cuDriverGetVersion(&version); result != cu_success)
			return absent(api.error(result, "cuDriverGetVersion", "CUDA"));
		if (const CuResult result = api.cuDeviceGetCount(&count); result != cu_success)
			return absent(api.error(result, "cuDeviceGetCount", "CUDA"));
		if (count == 0)
			return absent(api.error(cu_error_no_device, "cuDeviceGetCount", "CUDA"));

		const Compiler compiler = find_compiler(version);
		const std::string driver = driver_version_text(version);
		for (int ordinal = 0; ordinal < count; ++ordinal) {
			auto info = describe_device(api, compiler, ordinal);
			if (!info) {
				found.absences.push_back(absence(info.error()));
				continue;
			}
			info->driver = driver;
			found.devices.push_back(std::move(info).value());
		}
		return found;
	}

	Result<DeviceHandle> open(const DeviceInfo& info) override
	{
		const auto& loaded = CudaApi::load();
		if (!loaded)
			return loaded.error();
		const CudaApi& api = *loaded.value();
		if (const CuResult result = api.cuInit(0); result != cu_success)
			return api.error(result, "cuInit", "CUDA");
		int version = 0;
		if (const CuResult result = api.cuDriverGetVersion(&version); result != cu_success)
			return api.error(result, "cuDriverGetVersion", "CUDA");
		return CudaDevice::open(api, find_compiler(version).nvrtc, info);
	}

private:
	static Absence absence(const Error& error)
	{
		std::string reason = error.message;
		if (!error.where.empty() && error.where != "CUDA")
			reason += " (" + error.where + ")";
		return {"cuda", reason, error.cure};
	}
	static Enumeration absent(const Error& error)
	{
		Enumeration none;
		none.absences.push_back(absence(error));
		return none;
	}
};

} // namespace

Backend& cuda_backend()
{
	static CudaBackend backend;
	return backend;
}

} // namespace rt
