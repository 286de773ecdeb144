#include "backends/opencl/opencl_api.h"

#include "support/dynamic_library.h"
#include "support/files.h"

#include <fmt/format.h>

#include <glob.h>
#include <sys/stat.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>

namespace rt {

namespace {

Result<const OpenClApi*> load_api()
{
	Result<std::shared_ptr<DynamicLibrary>> library = DynamicLibrary::open({"libOpenCL.so.1", "libOpenCL.so"});
	if (!library)
		return Error{ErrorKind::NoDevice,
		             "no OpenCL loader: libOpenCL.so.1 was not found",
		             {},
		             "install it: Debian and Ubuntu ocl-icd-libopencl1, Fedora ocl-icd, Arch ocl-icd",
		             library.error().log};
	// Both objects stay for the life of the process; opencl_api.h says why.
	static const auto* keep = new std::shared_ptr<DynamicLibrary>(*library);
	auto api = std::make_unique<OpenClApi>();
	const char* missing = nullptr;
#define RT_LOAD(name)                          \
	if (!(*keep)->load(api->name, "cl" #name)) \
		missing = "cl" #name;
	RT_OPENCL_FUNCTIONS(RT_LOAD)
#undef RT_LOAD
	if (missing)
		return Error{ErrorKind::NoDevice,
		             fmt::format("{} lacks the function {}", (*keep)->path(), missing),
		             {},
		             "install a loader for OpenCL 1.2 or later: Debian and Ubuntu ocl-icd-libopencl1, Fedora ocl-icd, "
		             "Arch ocl-icd",
		             {}};
	return api.release();
}

struct CodeInWords {
	cl_int code;
	const char* name;
	const char* meaning;
};

constexpr CodeInWords codes[] = {
    {CL_DEVICE_NOT_FOUND, "CL_DEVICE_NOT_FOUND", "the platform has no such device"},
    {CL_DEVICE_NOT_AVAILABLE, "CL_DEVICE_NOT_AVAILABLE", "the device is there but cannot be used now"},
    {CL_COMPILER_NOT_AVAILABLE, "CL_COMPILER_NOT_AVAILABLE", "the driver has no compiler"},
    {CL_MEM_OBJECT_ALLOCATION_FAILURE, "CL_MEM_OBJECT_ALLOCATION_FAILURE", "the device has too little free memory"},
    {CL_OUT_OF_RESOURCES, "CL_OUT_OF_RESOURCES", "the device ran out of resources, or a kernel failed on it"},
    {CL_OUT_OF_HOST_MEMORY, "CL_OUT_OF_HOST_MEMORY", "the driver found too little host memory"},
    {CL_BUILD_PROGRAM_FAILURE, "CL_BUILD_PROGRAM_FAILURE", "the driver's compiler refused the kernels"},
    {CL_MAP_FAILURE, "CL_MAP_FAILURE", "device memory could not be mapped"},
    {CL_EXEC_STATUS_ERROR_FOR_EVENTS_IN_WAIT_LIST, "CL_EXEC_STATUS_ERROR_FOR_EVENTS_IN_WAIT_LIST",
     "an earlier command failed"},
    {CL_INVALID_VALUE, "CL_INVALID_VALUE", "the driver refused an argument"},
    {CL_INVALID_DEVICE, "CL_INVALID_DEVICE", "the driver does not know the device"},
    {CL_INVALID_CONTEXT, "CL_INVALID_CONTEXT", "the device's context is gone"},
    {CL_INVALID_COMMAND_QUEUE, "CL_INVALID_COMMAND_QUEUE", "the queue is gone, often after an earlier failure"},
    {CL_INVALID_MEM_OBJECT, "CL_INVALID_MEM_OBJECT", "a buffer is not one of this device"},
    {CL_INVALID_BINARY, "CL_INVALID_BINARY", "the compiled program does not suit this driver"},
    {CL_INVALID_BUILD_OPTIONS, "CL_INVALID_BUILD_OPTIONS", "the driver's compiler does not know an option"},
    {CL_INVALID_PROGRAM_EXECUTABLE, "CL_INVALID_PROGRAM_EXECUTABLE", "the program was not built for this device"},
    {CL_INVALID_KERNEL_NAME, "CL_INVALID_KERNEL_NAME", "the program has no kernel of this name"},
    {CL_INVALID_KERNEL_DEFINITION, "CL_INVALID_KERNEL_DEFINITION", "the kernel differs between devices"},
    {CL_INVALID_ARG_INDEX, "CL_INVALID_ARG_INDEX", "the kernel has fewer arguments"},
    {CL_INVALID_ARG_VALUE, "CL_INVALID_ARG_VALUE", "an argument does not suit the kernel"},
    {CL_INVALID_ARG_SIZE, "CL_INVALID_ARG_SIZE", "an argument's size is not the kernel's"},
    {CL_INVALID_KERNEL_ARGS, "CL_INVALID_KERNEL_ARGS", "an argument of the kernel was not set"},
    {CL_INVALID_WORK_GROUP_SIZE, "CL_INVALID_WORK_GROUP_SIZE", "the group size does not suit the kernel"},
    {CL_INVALID_WORK_ITEM_SIZE, "CL_INVALID_WORK_ITEM_SIZE", "the group size is above the device's limit"},
    {CL_INVALID_GLOBAL_WORK_SIZE, "CL_INVALID_GLOBAL_WORK_SIZE", "the number of work-items is above the limit"},
    {CL_INVALID_OPERATION, "CL_INVALID_OPERATION", "the driver cannot do this"},
    {CL_INVALID_BUFFER_SIZE, "CL_INVALID_BUFFER_SIZE", "the buffer is larger than the device allows"},
    {-9999, "NVIDIA's code -9999", "a kernel read or wrote outside its buffers"},
    {CL_PLATFORM_NOT_FOUND_KHR, "CL_PLATFORM_NOT_FOUND_KHR", "no OpenCL driver is registered"},
};

bool means_memory(cl_int code)
{
	return code == CL_MEM_OBJECT_ALLOCATION_FAILURE || code == CL_OUT_OF_RESOURCES || code == CL_OUT_OF_HOST_MEMORY ||
	       code == CL_INVALID_BUFFER_SIZE;
}

std::string variable(const char* name)
{
	const char* value = std::getenv(name);
	return value ? value : "";
}

bool ends_with(const std::string& text, const std::string& end)
{
	return text.size() >= end.size() && text.compare(text.size() - end.size(), end.size(), end) == 0;
}

std::vector<std::string> files_like(const std::string& pattern)
{
	std::vector<std::string> paths;
	glob_t found = {};
	if (glob(pattern.c_str(), 0, nullptr, &found) == 0)
		paths.assign(found.gl_pathv, found.gl_pathv + found.gl_pathc);
	globfree(&found);
	return paths;
}

constexpr const char* vendors_directory = "/etc/OpenCL/vendors";

// A driver as it is registered: the library, and the file that names it.
struct Registration {
	std::string library, file;
};

// What the loaders in use look at: the vendors' directory, or what the environment names instead of it (a directory,
// an .icd file or a library), and OCL_ICD_FILENAMES besides.
std::vector<Registration> registrations()
{
	std::vector<Registration> found;
	std::vector<std::string> icd_files;
	std::string where = variable("OCL_ICD_VENDORS");
	if (where.empty())
		where = variable("OPENCL_VENDOR_PATH");
	if (where.empty())
		where = vendors_directory;
	struct stat status;
	if (stat(where.c_str(), &status) == 0 && S_ISDIR(status.st_mode))
		icd_files = files_like(where + "/*.icd");
	else if (ends_with(where, ".icd"))
		icd_files = {where.find('/') == std::string::npos ? fmt::format("{}/{}", vendors_directory, where) : where};
	else if (where != vendors_directory)
		found.push_back({where, "the environment"});
	for (const std::string& file : icd_files) {
		const Result<std::vector<std::uint8_t>> bytes = read_file(file, 65536);
		const std::string text = bytes ? std::string(bytes.value().begin(), bytes.value().end()) : std::string();
		const std::string library = text.substr(0, text.find_first_of(" \t\r\n"));
		found.push_back({library, file});
	}
	const std::string more = variable("OCL_ICD_FILENAMES");
	for (std::size_t start = 0; start < more.size();) {
		const std::size_t end = std::min(more.find(':', start), more.size());
		if (end > start)
			found.push_back({more.substr(start, end - start), "OCL_ICD_FILENAMES"});
		start = end + 1;
	}
	return found;
}

constexpr const char* nvidia_library = "libnvidia-opencl.so.1";

// Where NVIDIA's OpenCL driver lies: its bare name if the system's loader finds it, a path otherwise, or nothing.
std::string find_nvidia_library()
{
	std::vector<std::string> names = {nvidia_library};
	for (const char* directory : {"/usr/lib/*", "/usr/lib64", "/usr/local/nvidia/lib64", "/usr/lib/wsl/lib"})
		for (const std::string& path : files_like(fmt::format("{}/{}", directory, nvidia_library)))
			names.push_back(path);
	const Result<std::shared_ptr<DynamicLibrary>> library = DynamicLibrary::open(names);
	if (!library)
		return {};
	[[maybe_unused]] static const auto* const keep = new std::shared_ptr<DynamicLibrary>(*library); // never unloaded
	return library.value()->path();
}

} // namespace

const Result<const OpenClApi*>& opencl_api()
{
	static const auto* api = new Result<const OpenClApi*>(load_api());
	return *api;
}

std::string opencl_code_in_words(cl_int code)
{
	for (const CodeInWords& known : codes)
		if (known.code == code)
			return fmt::format("{} ({}): {}", known.name, code, known.meaning);
	return fmt::format("OpenCL error {}", code);
}

Error opencl_error(const char* call, cl_int code, const std::string& device)
{
	const std::string message = fmt::format("{} failed with {}", call, opencl_code_in_words(code));
	if (means_memory(code))
		return {ErrorKind::Memory,
		        message,
		        device,
		        "free memory on the device, render a smaller image or part of it, or choose another device",
		        {}};
	return {ErrorKind::Failure, message, device, "try another device or driver (`rt devices` lists them)", {}};
}

std::vector<Absence> opencl_registration_absences(const std::vector<std::string>& platform_vendors)
{
	std::vector<Absence> absences;
	const bool nvidia_shown =
	    std::any_of(platform_vendors.begin(), platform_vendors.end(),
	                [](const std::string& vendor) { return vendor.find("NVIDIA") != std::string::npos; });
	bool nvidia_registered = false;
	for (const auto& [library, file] : registrations()) {
		if (library.empty()) {
			absences.push_back({"opencl", fmt::format("{} names no library", file), "remove or correct that file"});
			continue;
		}
		// Those that the loader could load are loaded already: this only counts a reference.
		if (const auto opened = DynamicLibrary::open({library}); !opened) {
			std::string reason = opened.error().log;
			reason.erase(std::min(reason.find('\n'), reason.size()));
			absences.push_back(
			    {"opencl", fmt::format("the driver {} (registered in {}) cannot be loaded: {}", library, file, reason),
			     "install the driver's package again, or remove that registration"});
		} else if (library.find("libnvidia-opencl") != std::string::npos && !nvidia_shown) {
			nvidia_registered = true;
			absences.push_back(
			    {"opencl", fmt::format("NVIDIA's driver {} (registered in {}) shows no platform", library, file),
			     "check that nvidia-smi lists the GPU and that the loader in use reads that registration "
			     "(not all read the same environment variables)"});
		}
	}
	if (nvidia_shown || nvidia_registered)
		return absences;
	if (const std::string library = find_nvidia_library(); !library.empty())
		absences.push_back(
		    {"opencl",
		     fmt::format("NVIDIA's OpenCL driver ({}) is installed but not registered with the loader", library),
		     fmt::format("register it: sudo mkdir -p {1} && echo {0} | sudo tee {1}/nvidia.icd\n"
		                 "or install the package that does: Debian nvidia-opencl-icd, Ubuntu libnvidia-compute-NNN "
		                 "(NNN: the driver's version), Fedora xorg-x11-drv-nvidia-cuda, Arch opencl-nvidia",
		                 library, vendors_directory)});
	return absences;
}

} // namespace rt
