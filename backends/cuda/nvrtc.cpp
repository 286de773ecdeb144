#include "backends/cuda/nvrtc.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>

namespace rt {

namespace {

constexpr int nvrtc_success = 0;
constexpr int nvrtc_error_compilation = 6;
constexpr int nvrtc_error_builtin_operation_failure = 7;

struct SharedName {
	int major; // CUDA version of the compiler behind it; 0 if the name does not say
	const char* file;
};
constexpr SharedName shared_names[] = {
    {13, "libnvrtc.so.13"}, {12, "libnvrtc.so.12"}, {11, "libnvrtc.so.11.2"}, {0, "libnvrtc.so"}};

// File names to try, the most promising first.
std::vector<std::string> candidates(int driver_major)
{
	std::vector<std::string> files, newer;
	for (const SharedName& name : shared_names)
		(driver_major != 0 && name.major > driver_major ? newer : files).push_back(name.file);
	files.insert(files.end(), newer.begin(), newer.end());

	std::vector<std::string> folders = {""};
	for (const char* variable : {"CUDA_HOME", "CUDA_PATH"})
		if (const char* folder = std::getenv(variable); folder && *folder)
			folders.push_back(std::string(folder) + "/lib64/");
	folders.push_back("/usr/local/cuda/lib64/");

	std::vector<std::string> result;
	for (const std::string& folder : folders)
		for (const std::string& file : files)
			result.push_back(folder + file);
	return result;
}

} // namespace

std::string NvrtcTarget::option() const
{
	return fmt::format("--gpu-architecture={}_{}", binary ? "sm" : "compute", capability);
}

const Result<const Nvrtc*>& Nvrtc::load(int driver_major)
{
	// Never destroyed: NVRTC keeps threads and state of its own that do not survive being unloaded at exit.
	static const auto& loaded = *[driver_major] {
		auto* const nvrtc = new Nvrtc;
		const Status opened = nvrtc->open(driver_major);
		return opened ? new Result<const Nvrtc*>(nvrtc) : new Result<const Nvrtc*>(opened.error());
	}();
	return loaded;
}

Status Nvrtc::open(int driver_major)
{
	auto library = DynamicLibrary::open(candidates(driver_major));
	if (!library)
		return Error{ErrorKind::NoDevice, "NVRTC, NVIDIA's run-time compiler, was not found", "CUDA",
		             fmt::format("install NVRTC, or set CUDA_HOME to the CUDA toolkit's folder\n{}", nvrtc_packages()),
		             library.error().log};
	library_ = std::move(library).value();

	std::string missing;
#define RT_NVRTC_LOAD(name, parameters)  \
	if (!library_->load(name##_, #name)) \
		missing += (missing.empty() ? "" : ", ") + std::string(#name);
	RT_NVRTC_SYMBOLS(RT_NVRTC_LOAD)
#undef RT_NVRTC_LOAD
	if (!library_->load(nvrtcGetErrorString_, "nvrtcGetErrorString"))
		missing += (missing.empty() ? "" : ", ") + std::string("nvrtcGetErrorString");
	if (!missing.empty())
		return Error{ErrorKind::NoDevice,
		             fmt::format("this NVRTC is too old: it lacks {}", missing),
		             path(),
		             fmt::format("install NVRTC of CUDA 11.2 or later\n{}", nvrtc_packages()),
		             {}};

	if (const int result = nvrtcVersion_(&major_, &minor_); result != nvrtc_success)
		return error(result, "nvrtcVersion", path());
	int count = 0;
	if (const int result = nvrtcGetNumSupportedArchs_(&count); result != nvrtc_success)
		return error(result, "nvrtcGetNumSupportedArchs", path());
	capabilities_.resize(static_cast<std::size_t>(std::max(count, 0)));
	if (const int result = nvrtcGetSupportedArchs_(capabilities_.data()); result != nvrtc_success)
		return error(result, "nvrtcGetSupportedArchs", path());
	std::sort(capabilities_.begin(), capabilities_.end());
	return success();
}

std::string Nvrtc::version() const { return fmt::format("NVRTC {}.{}", major_, minor_); }

Error Nvrtc::error(int result, const char* call, const std::string& where) const
{
	Error failure{ErrorKind::Build, fmt::format("{} failed: {}", call, nvrtcGetErrorString_(result)), where, {}, {}};
	if (result == nvrtc_error_builtin_operation_failure)
		failure.cure = "libnvrtc-builtins must lie beside " + path() + ": install NVRTC's package again";
	return failure;
}

Result<NvrtcTarget> Nvrtc::target_for(int capability) const
{
	const auto above = std::upper_bound(capabilities_.begin(), capabilities_.end(), capability);
	if (above == capabilities_.begin())
		return Error{
		    ErrorKind::NoDevice,
		    fmt::format("{} makes no code for compute capability {}.{}", version(), capability / 10, capability % 10),
		    path(),
		    "install an older NVRTC beside it: CUDA 12 serves 5.0 and later, CUDA 11 serves 3.5",
		    {}};
	const int best = *(above - 1);
	return NvrtcTarget{best, best == capability};
}

std::string Nvrtc::program_log(Program program) const
{
	std::size_t bytes = 0;
	if (nvrtcGetProgramLogSize_(program, &bytes) != nvrtc_success || bytes <= 1)
		return {};
	std::string log(bytes, '\0');
	if (nvrtcGetProgramLog_(program, log.data()) != nvrtc_success)
		return {};
	log.resize(log.find_last_not_of(std::string("\0 \n", 3)) + 1);
	return log;
}

Result<NvrtcOutput> Nvrtc::compile(const std::string& text, const std::string& name, const NvrtcTarget& target,
                                   const std::vector<std::string>& options) const
{
	Program created = nullptr;
	if (const int result = nvrtcCreateProgram_(&created, text.c_str(), name.c_str(), 0, nullptr, nullptr);
	    result != nvrtc_success)
		return error(result, "nvrtcCreateProgram", name);
	const auto destroy = [this](Program program) { nvrtcDestroyProgram_(&program); };
	const std::unique_ptr<NvrtcProgram, decltype(destroy)> program(created, destroy);

	const std::string architecture = target.option();
	std::vector<const char*> arguments = {architecture.c_str()};
	for (const std::string& option : options)
		arguments.push_back(option.c_str());
	const int compiled = nvrtcCompileProgram_(program.get(), static_cast<int>(arguments.size()), arguments.data());
	NvrtcOutput output;
	output.log = program_log(program.get());
	if (compiled != nvrtc_success) {
		Error failure = error(compiled, "nvrtcCompileProgram", name);
		if (compiled == nvrtc_error_compilation)
			failure.message = fmt::format("{} did not compile under {}", name, version());
		failure.log = output.log;
		return failure;
	}

	const auto get_size = target.binary ? nvrtcGetCUBINSize_ : nvrtcGetPTXSize_;
	const auto get_image = target.binary ? nvrtcGetCUBIN_ : nvrtcGetPTX_;
	std::size_t bytes = 0;
	if (const int result = get_size(program.get(), &bytes); result != nvrtc_success)
		return error(result, target.binary ? "nvrtcGetCUBINSize" : "nvrtcGetPTXSize", name);
	// One zero byte more than reported: the driver reads PTX up to a zero.
	std::vector<char> image(bytes + 1, '\0');
	if (const int result = get_image(program.get(), image.data()); result != nvrtc_success)
		return error(result, target.binary ? "nvrtcGetCUBIN" : "nvrtcGetPTX", name);
	while (!target.binary && image.size() > 1 && image[image.size() - 2] == '\0')
		image.pop_back();
	if (target.binary)
		image.pop_back();
	if (image.size() <= 1)
		return Error{ErrorKind::Build, fmt::format("{} made no code", version()), name, {}, output.log};
	output.image.assign(image.begin(), image.end());
	return output;
}

std::vector<std::string> nvrtc_options(bool contract, bool flush, std::uint32_t registers)
{
	std::vector<std::string> options = {"--std=c++17", contract ? "--fmad=true" : "--fmad=false",
	                                    flush ? "--ftz=true" : "--ftz=false", "--prec-div=true", "--prec-sqrt=true"};
	if (registers != 0)
		options.push_back(fmt::format("--maxrregcount={}", registers));
	return options;
}

const char* nvrtc_packages()
{
	return "Debian, Ubuntu: nvidia-cuda-toolkit, or libnvrtc12 alone\n"
	       "Fedora: cuda-nvrtc (NVIDIA's repository)\n"
	       "Arch: cuda";
}

} // namespace rt
