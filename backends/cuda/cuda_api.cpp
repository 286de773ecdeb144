#include "backends/cuda/cuda_api.h"

#include <fmt/format.h>

namespace rt {

namespace {

Result<const CudaApi*> load_library(std::shared_ptr<DynamicLibrary>& library, CudaApi& api)
{
	auto opened = DynamicLibrary::open({"libcuda.so.1"});
	if (!opened)
		return Error{ErrorKind::NoDevice, "no NVIDIA driver: libcuda.so.1 was not found", "CUDA",
		             "install NVIDIA's driver and restart\n"
		             "Debian: nvidia-driver (section non-free)\n"
		             "Ubuntu: nvidia-driver-NNN (ubuntu-drivers list says which)\n"
		             "Fedora: akmod-nvidia xorg-x11-drv-nvidia-cuda (RPM Fusion)\n"
		             "Arch: nvidia-utils",
		             opened.error().log};
	library = std::move(opened).value();

	std::string missing;
#define RT_CUDA_LOAD_REQUIRED(name, parameters) \
	if (!library->load(api.name, #name))        \
		missing += (missing.empty() ? "" : ", ") + std::string(#name);
	RT_CUDA_REQUIRED(RT_CUDA_LOAD_REQUIRED)
#undef RT_CUDA_LOAD_REQUIRED
#define RT_CUDA_LOAD_OPTIONAL(name, parameters) library->load(api.name, #name);
	RT_CUDA_OPTIONAL(RT_CUDA_LOAD_OPTIONAL)
#undef RT_CUDA_LOAD_OPTIONAL
	if (!missing.empty())
		return Error{ErrorKind::NoDevice,
		             fmt::format("the NVIDIA driver is too old: it lacks {}", missing),
		             library->path(),
		             "install a newer NVIDIA driver",
		             {}};
	return static_cast<const CudaApi*>(&api);
}

// What helps against a driver's result; empty where nothing general can be said.
const char* cure_for(CuResult result)
{
	switch (result) {
	case cu_error_out_of_memory:
		return "close other programs on this GPU, or render a smaller image or scene";
	case cu_error_stub_library:
		return "libcuda.so.1 is the toolkit's stub: take its folder out of LD_LIBRARY_PATH";
	case cu_error_device_unavailable:
		return "another process holds this GPU exclusively: end it, or run 'nvidia-smi -c DEFAULT' as root";
	case cu_error_no_device:
		return "look at CUDA_VISIBLE_DEVICES, at the rights on /dev/nvidia*, and whether nvidia-smi shows the GPU";
	case cu_error_invalid_image:
	case cu_error_no_binary_for_gpu:
	case cu_error_unsupported_ptx_version:
		return "the kernel compiler is newer than the driver: install a newer driver, or an NVRTC of the driver's CUDA "
		       "version";
	case cu_error_jit_compiler_not_found:
		return "install the driver's PTX compiler (libnvidia-ptxjitcompiler.so.1; Debian: libnvidia-ptxjitcompiler1)";
	case cu_error_ecc_uncorrectable:
		return "the GPU's memory is faulty: see 'nvidia-smi -q -d ECC'";
	case cu_error_illegal_address:
		return "this is a bug of rt; please report it with the command line and the scene";
	case cu_error_launch_timeout:
		return "the display's watchdog ended a long launch: take fewer samples a launch, or a GPU without a display";
	case cu_error_system_not_ready:
		return "start the fabric manager: systemctl start nvidia-fabricmanager";
	case cu_error_system_driver_mismatch:
	case cu_error_compat_not_supported:
		return "the kernel's driver and libcuda.so.1 differ in version: restart after the driver's update";
	case cu_error_unknown:
		return "the driver could not start: try 'nvidia-modprobe -u -c=0' as root, or restart";
	default:
		return "";
	}
}

} // namespace

const Result<const CudaApi*>& CudaApi::load()
{
	// Never destroyed: devices in static storage may be released after this file's statics would be.
	static const auto& loaded = *[] {
		auto api = std::make_unique<CudaApi>();
		const auto* const result = new Result<const CudaApi*>(load_library(api->library_, *api));
		if (*result)
			static_cast<void>(api.release());
		return result;
	}();
	return loaded;
}

std::string CudaApi::describe(CuResult result) const
{
	const char* name = nullptr;
	const char* text = nullptr;
	if (cuGetErrorName(result, &name) != cu_success || !name)
		return fmt::format("CUDA error {}", result);
	if (cuGetErrorString(result, &text) != cu_success || !text)
		return name;
	return fmt::format("{} ({})", name, text);
}

Error CudaApi::error(CuResult result, const char* call, const std::string& where) const
{
	const ErrorKind kind = result == cu_error_out_of_memory ? ErrorKind::Memory : ErrorKind::Failure;
	return Error{kind, fmt::format("{} failed: {}", call, describe(result)), where, cure_for(result), {}};
}

} // namespace rt
