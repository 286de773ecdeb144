#include "backends/opencl/opencl_backend.h"

#include "backends/opencl/opencl_api.h"
#include "backends/opencl/opencl_device.h"
#include "support/hash.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <mutex>

namespace rt {

namespace {

// ---- what drivers tell ------------------------------------------------------------------------------------------

// cl_nv_device_attribute_query, for headers that lack it.
constexpr cl_device_info nv_pci_bus = 0x4008, nv_pci_slot = 0x4009, nv_pci_domain = 0x400A;

// Text of clGetPlatformInfo or clGetDeviceInfo; empty if the driver does not answer.
template <class Function, class Handle>
std::string text_info(Function* function, Handle handle, cl_uint what)
{
	std::size_t bytes = 0;
	if (function(handle, what, 0, nullptr, &bytes) != CL_SUCCESS || bytes == 0)
		return {};
	std::string text(bytes, '\0');
	if (function(handle, what, bytes, text.data(), nullptr) != CL_SUCCESS)
		return {};
	text.resize(std::strlen(text.c_str())); // drivers count a final zero, some of them several
	const std::size_t first = text.find_first_not_of(" \t\n");
	const std::size_t last = text.find_last_not_of(" \t\n");
	return first == std::string::npos ? std::string() : text.substr(first, last - first + 1);
}

// A value of clGetDeviceInfo; `otherwise` if the driver does not answer.
template <class T>
T value_info(const OpenClApi& api, cl_device_id device, cl_device_info what, T otherwise)
{
	T value = otherwise;
	return api.GetDeviceInfo(device, what, sizeof value, &value, nullptr) == CL_SUCCESS ? value : otherwise;
}

bool contains(const std::string& text, const char* part) { return text.find(part) != std::string::npos; }

// {1, 2} of "OpenCL 1.2 something"; {0, 0} of anything else.
std::pair<int, int> opencl_version(const std::string& text)
{
	int major = 0, minor = 0;
	return std::sscanf(text.c_str(), "OpenCL %d.%d", &major, &minor) == 2 ? std::pair(major, minor) : std::pair(0, 0);
}

struct Platform {
	cl_platform_id id = nullptr;
	std::string name, vendor, version;
	bool is_oclgrind() const { return contains(name, "Oclgrind") || contains(vendor, "Oclgrind"); }
	bool is_rusticl() const { return contains(name, "rusticl"); }
	bool is_pocl() const { return contains(name, "Portable Computing Language"); }
	bool is_intel() const { return contains(name, "Intel"); }
	bool is_amd() const { return contains(name, "AMD Accelerated Parallel Processing"); }
};

// A device, and what tells it from others of its kind.
struct Record : OpenClDeviceRecord {
	std::string platform_version;
	cl_uint ordinal = 0; // in its platform
};

std::string pci_address(const OpenClApi& api, cl_device_id device, const std::string& extensions)
{
	if (contains(extensions, "cl_khr_pci_bus_info")) {
		cl_device_pci_bus_info_khr pci = {};
		if (api.GetDeviceInfo(device, CL_DEVICE_PCI_BUS_INFO_KHR, sizeof pci, &pci, nullptr) == CL_SUCCESS)
			return fmt::format("{:04x}:{:02x}:{:02x}.{:x}", pci.pci_domain, pci.pci_bus, pci.pci_device,
			                   pci.pci_function);
	}
	if (contains(extensions, "cl_nv_device_attribute_query")) {
		cl_uint bus = 0, slot = 0;
		if (api.GetDeviceInfo(device, nv_pci_bus, sizeof bus, &bus, nullptr) == CL_SUCCESS &&
		    api.GetDeviceInfo(device, nv_pci_slot, sizeof slot, &slot, nullptr) == CL_SUCCESS)
			return fmt::format("{:04x}:{:02x}:{:02x}.0", value_info<cl_uint>(api, device, nv_pci_domain, 0), bus, slot);
	}
	return {};
}

std::string device_uuid(const OpenClApi& api, cl_device_id device, const std::string& extensions)
{
	unsigned char bytes[CL_UUID_SIZE_KHR] = {};
	if (!contains(extensions, "cl_khr_device_uuid") ||
	    api.GetDeviceInfo(device, CL_DEVICE_UUID_KHR, sizeof bytes, bytes, nullptr) != CL_SUCCESS)
		return {};
	std::string text;
	for (int i = 0; i < CL_UUID_SIZE_KHR; ++i)
		text += fmt::format("{}{:02x}", i == 4 || i == 6 || i == 8 || i == 10 ? "-" : "", bytes[i]);
	return text;
}

// Why the exact rung cannot run there; empty if nothing speaks against it (the self-test has the last word).
std::string unusable_because(const OpenClApi& api, cl_device_id device, cl_device_fp_config floats)
{
	if (!value_info<cl_bool>(api, device, CL_DEVICE_AVAILABLE, CL_FALSE))
		return "the driver says that it is not available";
	if (!value_info<cl_bool>(api, device, CL_DEVICE_COMPILER_AVAILABLE, CL_FALSE))
		return "its driver has no compiler";
	if (text_info(api.GetDeviceInfo, device, CL_DEVICE_PROFILE) != "FULL_PROFILE")
		return "it has OpenCL's embedded profile, which does not promise rounding to nearest";
	const std::string version = text_info(api.GetDeviceInfo, device, CL_DEVICE_VERSION);
	if (opencl_version(version) < std::pair(1, 2))
		return fmt::format("its version is '{}' and rt needs OpenCL 1.2", version);
	if (!value_info<cl_bool>(api, device, CL_DEVICE_ENDIAN_LITTLE, CL_FALSE))
		return "it is big-endian, and rt shares its structs as they lie in memory";
	if (!(floats & CL_FP_ROUND_TO_NEAREST))
		return "it does not round to nearest";
	if (!(floats & CL_FP_INF_NAN))
		return "it has no infinities and NaNs";
	return {};
}

void add_quirks(const Platform& platform, DeviceInfo& info)
{
	if (platform.is_oclgrind())
		info.quirks.push_back({"-cl-opt-disable", "Oclgrind's interpreter crashes on optimised code"});
	if (!info.indexes_parameters)
		info.quirks.push_back(
		    {"spheres in memory",
		     "rusticl's compiler crashes on an array among a kernel's parameters (seen in Mesa 22.3)"});
	if (platform.is_rusticl())
		info.quirks.push_back({"1 lane",
		                       "rusticl's compiler does not finish vector kernels; its devices show only where "
		                       "RUSTICL_ENABLE names their driver"});
	if (platform.is_pocl())
		info.quirks.push_back({"driver's cache",
		                       "asking PoCL for a compiled program makes it compile every kernel a second "
		                       "time; its own cache makes the next start as fast"});
	const auto flag_variable = [&info](const char* name, const char* reason =
	                                                         "this variable hands the driver's compiler "
	                                                         "options of its own, which may change the "
	                                                         "arithmetic") {
		if (const char* value = std::getenv(name))
			info.quirks.push_back({fmt::format("{}={}", name, value), reason, true});
	};
	if (platform.is_pocl()) {
		flag_variable("POCL_EXTRA_BUILD_FLAGS");
		flag_variable("POCL_KERNELLIB_NAME", "this variable makes PoCL compile for another processor; one without fma "
		                                     "is slow, and exact only if its emulation is");
	}
	if (platform.is_intel())
		flag_variable("CL_CONFIG_USE_FAST_RELAXED_MATH");
	if (platform.is_amd()) {
		flag_variable("AMD_OCL_BUILD_OPTIONS");
		flag_variable("AMD_OCL_BUILD_OPTIONS_APPEND");
	}
}

Record describe(const OpenClApi& api, const Platform& platform, cl_device_id device, cl_uint ordinal)
{
	Record record;
	record.id = device;
	record.platform = platform.id;
	record.platform_version = platform.version;
	record.ordinal = ordinal;
	const std::string extensions = text_info(api.GetDeviceInfo, device, CL_DEVICE_EXTENSIONS);
	record.may_take_ptx = contains(extensions, "cl_nv_");
	record.driver_caches_code = platform.is_pocl();
	const auto floats = value_info<cl_device_fp_config>(api, device, CL_DEVICE_SINGLE_FP_CONFIG, 0);
	const auto type = value_info<cl_device_type>(api, device, CL_DEVICE_TYPE, 0);

	DeviceInfo& info = record.info;
	info.backend = "opencl";
	info.platform = platform.name;
	info.name = text_info(api.GetDeviceInfo, device, CL_DEVICE_NAME);
	info.driver = fmt::format("{} ({})", text_info(api.GetDeviceInfo, device, CL_DRIVER_VERSION), platform.version);
	info.compiler = info.driver;
	info.pci = pci_address(api, device, extensions);
	info.uuid = device_uuid(api, device, extensions);
	if (!info.pci.empty())
		info.id = "pci:" + info.pci;
	else if (!info.uuid.empty())
		info.id = "uuid:" + info.uuid;
	else // the ordinal tells equal devices apart
		info.id = "cl:" + hash_text(fmt::format("{}\n{}\n{}", platform.name, info.name, ordinal)).hex().substr(0, 16);
	info.kind = type & CL_DEVICE_TYPE_CPU   ? DeviceKind::Cpu // first: simulators say that they are everything
	            : type & CL_DEVICE_TYPE_GPU ? DeviceKind::Gpu
	                                        : DeviceKind::Accelerator;
	info.only_if_named = platform.is_oclgrind() || contains(info.name, "llvmpipe");
	info.memory_bytes = value_info<cl_ulong>(api, device, CL_DEVICE_GLOBAL_MEM_SIZE, 0);
	info.max_alloc_bytes = value_info<cl_ulong>(api, device, CL_DEVICE_MAX_MEM_ALLOC_SIZE, 0);
	info.compute_units = value_info<cl_uint>(api, device, CL_DEVICE_MAX_COMPUTE_UNITS, 0);
	const auto width = value_info<cl_uint>(api, device, CL_DEVICE_NATIVE_VECTOR_WIDTH_FLOAT, 1);
	if (info.kind == DeviceKind::Cpu && !platform.is_rusticl())
		info.native_lanes = width >= 16 ? 16 : width >= 8 ? 8 : width >= 4 ? 4 : 1;
	info.indexes_parameters = !platform.is_rusticl();
	info.reports_correct_rounding = (floats & CL_FP_CORRECTLY_ROUNDED_DIVIDE_SQRT) != 0;
	info.reports_subnormals = (floats & CL_FP_DENORM) != 0;
	info.reports_fp64 = contains(extensions, "cl_khr_fp64");
	add_quirks(platform, info);
	info.why_not = unusable_because(api, device, floats);
	if (opencl_version(platform.version) < std::pair(1, 2)) // the loader could not even pass on the calls
		info.why_not = fmt::format("its platform's version is '{}' and rt needs OpenCL 1.2", platform.version);
	info.usable = info.why_not.empty();

	// Never a flag that lets the compiler change values. Without the second one NVIDIA's compiler approximates
	// division and square root; where it is not reported, passing it is an error.
	record.options = "-cl-std=CL1.2";
	if (info.reports_correct_rounding)
		record.options += " -cl-fp32-correctly-rounded-divide-sqrt";
	if (platform.is_oclgrind())
		record.options += " -cl-opt-disable";
	return record;
}

// Is this the device `other`, shown a second time because its driver is registered twice? Equal devices of one
// platform are several devices; equal ones of equal platforms are one.
bool is_second_showing(const Record& record, const Record& other)
{
	if (record.id == other.id)
		return true;
	return record.platform != other.platform && record.info.platform == other.info.platform &&
	       record.platform_version == other.platform_version && record.info.name == other.info.name &&
	       record.ordinal == other.ordinal && record.info.pci == other.info.pci;
}

// ---- the backend ------------------------------------------------------------------------------------------------

class OpenClBackend : public Backend {
public:
	const char* name() const override { return "opencl"; }

	Enumeration enumerate() override
	{
		const std::lock_guard<std::mutex> lock(mutex_);
		return enumerate_locked();
	}

	Result<DeviceHandle> open(const DeviceInfo& info) override
	{
		const std::lock_guard<std::mutex> lock(mutex_);
		if (records_.empty())
			enumerate_locked();
		const auto index = static_cast<std::size_t>(info.index_in_backend);
		if (index >= records_.size() || records_[index].info.name != info.name)
			return Error{ErrorKind::NoDevice,
			             fmt::format("the OpenCL device '{}' is gone", info.name),
			             {},
			             "see `rt devices` for those that are there",
			             {}};
		const Record& record = records_[index];
		if (!record.info.usable)
			return Error{ErrorKind::NoDevice,
			             fmt::format("{} cannot be used: {}", info.name, record.info.why_not),
			             {},
			             "choose another device (`rt devices` lists them)",
			             {}};
		return open_opencl_device(*opencl_api().value(), record);
	}

private:
	Enumeration enumerate_locked()
	{
		Enumeration found;
		records_.clear();
		const Result<const OpenClApi*>& loaded = opencl_api();
		if (!loaded) {
			found.absences.push_back({"opencl", loaded.error().message, loaded.error().cure});
			return found;
		}
		const OpenClApi& api = *loaded.value();
		std::vector<std::string> vendors;
		for (const Platform& platform : platforms(api)) {
			vendors.push_back(platform.vendor);
			add_devices(api, platform, found);
		}
		if (vendors.empty())
			found.absences.push_back(
			    {"opencl", "no OpenCL driver is registered with the loader",
			     "for a GPU, install its vendor's driver; for the processor, PoCL: Debian and Ubuntu "
			     "pocl-opencl-icd, Fedora pocl, Arch pocl"});
		for (Absence& absence : opencl_registration_absences(vendors))
			found.absences.push_back(std::move(absence));
		for (const Record& record : records_)
			found.devices.push_back(record.info);
		return found;
	}

	static std::vector<Platform> platforms(const OpenClApi& api)
	{
		cl_uint count = 0;
		if (api.GetPlatformIDs(0, nullptr, &count) != CL_SUCCESS)
			return {};
		std::vector<cl_platform_id> ids(count);
		if (count == 0 || api.GetPlatformIDs(count, ids.data(), nullptr) != CL_SUCCESS)
			return {};
		std::vector<Platform> result;
		for (cl_platform_id id : ids)
			result.push_back({id, text_info(api.GetPlatformInfo, id, CL_PLATFORM_NAME),
			                  text_info(api.GetPlatformInfo, id, CL_PLATFORM_VENDOR),
			                  text_info(api.GetPlatformInfo, id, CL_PLATFORM_VERSION)});
		return result;
	}

	void add_devices(const OpenClApi& api, const Platform& platform, Enumeration& found)
	{
		cl_uint count = 0;
		cl_int code = api.GetDeviceIDs(platform.id, CL_DEVICE_TYPE_ALL, 0, nullptr, &count);
		std::vector<cl_device_id> ids(code == CL_SUCCESS ? count : 0);
		if (!ids.empty())
			code = api.GetDeviceIDs(platform.id, CL_DEVICE_TYPE_ALL, count, ids.data(), nullptr);
		if (ids.empty() || code != CL_SUCCESS) {
			const bool none = code == CL_SUCCESS || code == CL_DEVICE_NOT_FOUND;
			found.absences.push_back(
			    {"opencl",
			     none ? fmt::format("the platform '{}' has no devices", platform.name)
			          : fmt::format("the platform '{}' does not give its devices: {}", platform.name,
			                        opencl_code_in_words(code)),
			     platform.is_rusticl()
			         ? "name the drivers that rusticl may use: RUSTICL_ENABLE=radeonsi, iris, nouveau or llvmpipe"
			         : "check that its hardware is there and that you may use it (groups render and video)"});
			return;
		}
		for (cl_uint ordinal = 0; ordinal < ids.size(); ++ordinal) {
			Record record = describe(api, platform, ids[ordinal], ordinal);
			const auto first = std::find_if(records_.begin(), records_.end(), [&record](const Record& other) {
				return is_second_showing(record, other);
			});
			if (first != records_.end()) {
				first->info.quirks.push_back({"registered twice",
				                              "its driver is registered twice with the OpenCL loader; "
				                              "rt uses the first",
				                              true});
				continue;
			}
			record.info.index_in_backend = static_cast<int>(records_.size());
			records_.push_back(std::move(record));
		}
	}

	std::mutex mutex_;
	std::vector<Record> records_; // of the last enumeration
};

} // namespace

Backend& opencl_backend()
{
	static OpenClBackend* backend = new OpenClBackend; // never destroyed: opencl_api.h says why
	return *backend;
}

} // namespace rt
