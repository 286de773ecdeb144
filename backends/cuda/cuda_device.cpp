#include "backends/cuda/cuda_device.h"

#include "backends/cuda/generic_program.h"
#include "backends/kernel_text.h"
#include "backends/precision.h"
#include "backends/program_cache.h"
#include "backends/staging.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cstring>
#include <map>

namespace rt {

namespace {

constexpr std::uint32_t warp_size = 32;
constexpr std::uint32_t default_group_size = 128;
constexpr std::size_t jit_log_bytes = 16384;

std::string gigabytes(std::size_t bytes) { return fmt::format("{:.2f} GB", static_cast<double>(bytes) * 1e-9); }

} // namespace

// A retained primary context and a stream in it.
class CudaContext {
public:
	CudaContext(const CudaApi& api, CuDevice device, std::string where)
	    : api_(api), device_(device), where_(std::move(where))
	{
	}
	CudaContext(const CudaContext&) = delete;
	CudaContext& operator=(const CudaContext&) = delete;
	~CudaContext()
	{
		if (stream_ && make_current())
			api_.cuStreamDestroy_v2(stream_);
		if (staging_ && make_current())
			api_.cuMemFreeHost(staging_);
		if (context_) {
			api_.cuCtxSetCurrent(nullptr);
			const auto release =
			    api_.cuDevicePrimaryCtxRelease_v2 ? api_.cuDevicePrimaryCtxRelease_v2 : api_.cuDevicePrimaryCtxRelease;
			if (release)
				release(device_);
		}
	}

	Status start()
	{
		RT_TRY(check(api_.cuDevicePrimaryCtxRetain(&context_, device_), "cuDevicePrimaryCtxRetain"));
		RT_TRY(make_current());
		// Apart from the default stream, so that other users of the primary context do not serialise with it.
		return check(api_.cuStreamCreate(&stream_, cu_stream_non_blocking), "cuStreamCreate");
	}

	// Twice staging_bytes of page-locked memory, or null where there is none to be had: the driver copies into it
	// several times as fast as into pages that it must lock first.
	std::uint8_t* staging()
	{
		if (!staging_ && !staging_failed_) {
			void* memory = nullptr;
			staging_failed_ = api_.cuMemHostAlloc(&memory, 2 * staging_bytes, 0) != cu_success;
			staging_ = staging_failed_ ? nullptr : static_cast<std::uint8_t*>(memory);
		}
		return staging_;
	}

	CuDevice device() const { return device_; }
	Status make_current() const { return check(api_.cuCtxSetCurrent(context_), "cuCtxSetCurrent"); }
	Status start_read(void* target, CuDevicePtr source, std::size_t bytes) const
	{
		return check(api_.cuMemcpyDtoHAsync_v2(target, source, bytes, stream_), "cuMemcpyDtoHAsync");
	}
	Status synchronize() const { return check(api_.cuStreamSynchronize(stream_), "cuStreamSynchronize"); }
	Status check(CuResult result, const char* call) const
	{
		if (result == cu_success)
			return success();
		return api_.error(result, call, where_);
	}

	const CudaApi& api() const { return api_; }
	CuStream stream() const { return stream_; }
	const std::string& where() const { return where_; }

private:
	const CudaApi& api_;
	CuDevice device_;
	std::string where_;
	CuContext context_ = nullptr;
	CuStream stream_ = nullptr;
	std::uint8_t* staging_ = nullptr;
	bool staging_failed_ = false;
};

namespace {

class CudaBuffer final : public Buffer {
public:
	CudaBuffer(std::shared_ptr<CudaContext> context, CuDevicePtr pointer, std::size_t bytes)
	    : context_(std::move(context)), pointer_(pointer), bytes_(bytes)
	{
	}
	CudaBuffer(const CudaBuffer&) = delete;
	CudaBuffer& operator=(const CudaBuffer&) = delete;
	~CudaBuffer() override
	{
		// A launch that still uses the memory must end first.
		if (context_->make_current() && context_->synchronize())
			context_->api().cuMemFree_v2(pointer_);
	}
	std::size_t bytes() const override { return bytes_; }
	CuDevicePtr pointer() const { return pointer_; }
	const CudaContext* context() const { return context_.get(); }

private:
	std::shared_ptr<CudaContext> context_;
	CuDevicePtr pointer_;
	std::size_t bytes_;
};

// The buffer as one of this context's; an error for another device's.
Result<CudaBuffer*> own_buffer(const BufferHandle& buffer, const CudaContext& context)
{
	auto* const own = dynamic_cast<CudaBuffer*>(buffer.get());
	if (!own || own->context() != &context)
		return Error{ErrorKind::Failure, "the buffer does not belong to this device", context.where(), {}, {}};
	return own;
}

Status check_range(const CudaBuffer& buffer, std::size_t offset, std::size_t bytes, const char* call,
                   const CudaContext& context)
{
	if (offset <= buffer.bytes() && bytes <= buffer.bytes() - offset)
		return success();
	return Error{
	    ErrorKind::Failure,
	    fmt::format("{} of {} bytes at {} reaches past the buffer's {} bytes", call, bytes, offset, buffer.bytes()),
	    context.where(),
	    {},
	    {}};
}

struct CudaKernel {
	CuFunction function = nullptr;
	std::uint32_t max_group_size = 0;
	bool parameters_known = false; // drivers before CUDA 12.4 do not tell
	std::vector<std::size_t> parameter_bytes;
};

} // namespace

class CudaProgram final : public Program {
public:
	explicit CudaProgram(std::shared_ptr<CudaContext> context) : context_(std::move(context)) {}
	CudaProgram(const CudaProgram&) = delete;
	CudaProgram& operator=(const CudaProgram&) = delete;
	~CudaProgram() override { unload(); }

	// Loads a cubin or zero-terminated PTX and finds the entries in it. Can be called again after a failure.
	Status load(const std::uint8_t* image, const std::vector<std::string>& entries)
	{
		unload();
		std::string info(jit_log_bytes, '\0'), errors(jit_log_bytes, '\0');
		int names[] = {cu_jit_info_log_buffer, cu_jit_info_log_buffer_size, cu_jit_error_log_buffer,
		               cu_jit_error_log_buffer_size};
		// The sizes travel as integers in the pointers' place.
		const auto log_size = reinterpret_cast<void*>(static_cast<std::uintptr_t>(jit_log_bytes));
		void* values[] = {info.data(), log_size, errors.data(), log_size};
		const CuResult result = context_->api().cuModuleLoadDataEx(&module_, image, 4, names, values);
		info.resize(std::strlen(info.c_str()));
		errors.resize(std::strlen(errors.c_str()));
		if (result != cu_success) {
			module_ = nullptr;
			Error failure = context_->api().error(result, "cuModuleLoadDataEx", context_->where());
			failure.kind = result == cu_error_out_of_memory ? ErrorKind::Memory : ErrorKind::Build;
			failure.log = errors + info;
			return failure;
		}
		report_.log += info;
		for (const std::string& entry : entries)
			RT_TRY(kernel(entry));
		return success();
	}

	Result<const CudaKernel*> kernel(const std::string& entry)
	{
		if (const auto found = kernels_.find(entry); found != kernels_.end())
			return &found->second;
		const CudaApi& api = context_->api();
		CudaKernel kernel;
		if (const CuResult result = api.cuModuleGetFunction(&kernel.function, module_, entry.c_str());
		    result != cu_success) {
			Error failure = api.error(result, "cuModuleGetFunction", context_->where());
			failure.kind = ErrorKind::Build;
			failure.message += fmt::format(" for kernel '{}'", entry);
			return failure;
		}
		int threads = 0;
		RT_TRY(context_->check(api.cuFuncGetAttribute(&threads, cu_function_max_threads_per_block, kernel.function),
		                       "cuFuncGetAttribute"));
		kernel.max_group_size = static_cast<std::uint32_t>(std::max(threads, 0)) / warp_size * warp_size;
		if (api.cuFuncGetParamInfo) {
			std::size_t offset = 0, bytes = 0;
			// The first index past the end is refused: that is how the count is told.
			while (api.cuFuncGetParamInfo(kernel.function, kernel.parameter_bytes.size(), &offset, &bytes) ==
			       cu_success)
				kernel.parameter_bytes.push_back(bytes);
			kernel.parameters_known = true;
		}
		report_.kernels.push_back(use_of(entry, kernel));
		return &kernels_.emplace(entry, std::move(kernel)).first->second;
	}

	BuildReport& report_to_fill() { return report_; }
	const CudaContext* context() const { return context_.get(); }

private:
	// Told to users and relied on by nobody, so what the driver does not say is left out.
	KernelUse use_of(const std::string& entry, const CudaKernel& kernel) const
	{
		const CudaApi& api = context_->api();
		KernelUse use;
		use.entry = entry;
		use.group_size = std::min(default_group_size, kernel.max_group_size);
		int value = 0, threads = 0;
		if (api.cuFuncGetAttribute(&value, cu_function_registers, kernel.function) == cu_success)
			use.registers = static_cast<std::uint32_t>(value);
		if (api.cuFuncGetAttribute(&value, cu_function_local_size_bytes, kernel.function) == cu_success)
			use.private_bytes = static_cast<std::uint32_t>(value);
		if (api.cuOccupancyMaxActiveBlocksPerMultiprocessor &&
		    api.cuOccupancyMaxActiveBlocksPerMultiprocessor(&value, kernel.function, static_cast<int>(use.group_size),
		                                                    0) == cu_success &&
		    api.cuDeviceGetAttribute(&threads, cu_attribute_max_threads_per_multiprocessor, context_->device()) ==
		        cu_success &&
		    threads > 0)
			use.occupancy = static_cast<double>(value) * use.group_size / threads;
		return use;
	}

	void unload()
	{
		kernels_.clear();
		report_.kernels.clear();
		if (module_ && context_->make_current() && context_->synchronize())
			context_->api().cuModuleUnload(module_);
		module_ = nullptr;
	}

	std::shared_ptr<CudaContext> context_;
	CuModule module_ = nullptr;
	std::map<std::string, CudaKernel> kernels_;
};

Result<int> cuda_capability(const CudaApi& api, CuDevice device)
{
	int major = 0, minor = 0;
	for (const auto& [attribute, value] : {std::pair(cu_attribute_compute_capability_major, &major),
	                                       std::pair(cu_attribute_compute_capability_minor, &minor)})
		if (const CuResult result = api.cuDeviceGetAttribute(value, attribute, device); result != cu_success)
			return api.error(result, "cuDeviceGetAttribute", fmt::format("CUDA device {}", device));
	return 10 * major + minor;
}

CudaDevice::CudaDevice(std::shared_ptr<CudaContext> context, const Nvrtc* nvrtc, int capability, const DeviceInfo& info)
    : context_(std::move(context)), nvrtc_(nvrtc), capability_(capability)
{
	info_ = info;
}

Result<DeviceHandle> CudaDevice::open(const CudaApi& api, const Nvrtc* nvrtc, const DeviceInfo& info)
{
	const std::string where = fmt::format("CUDA device {} ({})", info.index_in_backend, info.name);
	CuDevice device = 0;
	if (const CuResult result = api.cuDeviceGet(&device, info.index_in_backend); result != cu_success)
		return api.error(result, "cuDeviceGet", where);
	RT_TRY_ASSIGN(const int capability, cuda_capability(api, device));
	auto context = std::make_shared<CudaContext>(api, device, where);
	RT_TRY(context->start());
	return DeviceHandle(new CudaDevice(std::move(context), nvrtc, capability, info));
}

Result<ProgramHandle> CudaDevice::build(const ProgramSpec& spec)
{
	const auto start = std::chrono::steady_clock::now();
	RT_TRY(context_->make_current());
	auto program = std::make_shared<CudaProgram>(context_);
	RT_TRY(nvrtc_ ? build_compiled(spec, *program) : build_embedded(spec, *program));
	program->report_to_fill().seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
	return ProgramHandle(std::move(program));
}

Status CudaDevice::build_compiled(const ProgramSpec& spec, CudaProgram& program)
{
	RT_TRY_ASSIGN(const NvrtcTarget target, nvrtc_->target_for(capability_));
	RT_TRY_ASSIGN(std::string text, flatten_program(spec));
	const std::vector<std::string> options =
	    nvrtc_options(lets_compiler_fuse(spec), flushes_subnormals(spec), spec.registers);
	BuildReport& report = program.report_to_fill();
	report.options = target.option();
	for (const std::string& option : options)
		report.options += " " + option;
	CacheKey key{"cuda", info_.platform, info_.name, info_.driver, nvrtc_->version(), report.options, std::move(text)};

	const CacheTurn turn(key); // of several equal GPUs one compiles
	if (const auto cached = cache_load(key); cached && !cached->empty() && program.load(cached->data(), spec.entries)) {
		report.from_cache = true;
		return success();
	}
	RT_TRY_ASSIGN(const NvrtcOutput output, nvrtc_->compile(key.text, spec.root, target, options));
	report.log = output.log;
	RT_TRY(program.load(output.image.data(), spec.entries));
	cache_store(key, output.image);
	return success();
}

Status CudaDevice::build_embedded(const ProgramSpec& spec, CudaProgram& program)
{
	if (const std::uint32_t precision = integer_define(spec, "RT_PRECISION", RT_PRECISION_EXACT);
	    precision != RT_PRECISION_EXACT)
		return Error{ErrorKind::Build,
		             fmt::format("the kernels that are shipped compiled are exact, and precision {} needs a compiler",
		                         precision_name(static_cast<Precision>(precision))),
		             context_->where(),
		             fmt::format("use --precision exact, or install NVRTC\n{}", nvrtc_packages()),
		             {}};
	if (!spec.edits.empty())
		return Error{ErrorKind::Build,
		             "the kernels embedded when rt was built cannot be edited",
		             context_->where(),
		             fmt::format("install NVRTC\n{}", nvrtc_packages()),
		             {}};
	if (spec.traced)
		return Error{ErrorKind::Build,
		             "traced kernels were not embedded when rt was built",
		             context_->where(),
		             fmt::format("install NVRTC\n{}", nvrtc_packages()),
		             {}};
	const std::string key = generic_key(spec);
	for (const EmbeddedPtx* row = embedded_ptx; row->key; ++row) {
		if (key != row->key)
			continue;
		BuildReport& report = program.report_to_fill();
		report.embedded = true;
		report.options = fmt::format("generic program, made by {} for compute capability {}.{}", embedded_ptx_compiler,
		                             generic_capability / 10, generic_capability % 10);
		return program.load(reinterpret_cast<const std::uint8_t*>(row->ptx), spec.entries);
	}
	return Error{ErrorKind::Build,
	             fmt::format("no generic program '{}' was embedded when rt was built", key),
	             context_->where(),
	             fmt::format("install NVRTC\n{}", nvrtc_packages()),
	             {}};
}

Status CudaDevice::launch(const ProgramHandle& program, const std::string& entry, std::uint64_t items,
                          const std::vector<Argument>& arguments, std::uint32_t group_size)
{
	auto* const own = dynamic_cast<CudaProgram*>(program.get());
	if (!own || own->context() != context_.get())
		return Error{ErrorKind::Failure, "the program does not belong to this device", context_->where(), {}, {}};
	if (items == 0)
		return success();
	RT_TRY(context_->make_current());
	RT_TRY_ASSIGN(const CudaKernel* const kernel, own->kernel(entry));

	// Whole warps: the kernels vote in warps, and every thread of one must exist.
	const std::uint64_t wanted = group_size ? group_size : std::min(default_group_size, kernel->max_group_size);
	const std::uint64_t group = (wanted + warp_size - 1) / warp_size * warp_size;
	if (group == 0 || group > kernel->max_group_size)
		return Error{
		    ErrorKind::Failure,
		    fmt::format("kernel '{}' takes at most {} threads a group, not {}", entry, kernel->max_group_size, group),
		    context_->where(),
		    "ask for a smaller group",
		    {}};
	const std::uint64_t groups = items / group + (items % group != 0);
	// The kernels number their work-items in 32 bits: beyond, the numbers of the padding would start again at 0.
	if (items > UINT32_MAX || groups * group > std::uint64_t(UINT32_MAX) + 1)
		return Error{ErrorKind::Failure,
		             fmt::format("{} work-items do not fit one launch", items),
		             context_->where(),
		             "launch fewer items at a time",
		             {}};

	// All values first, then pointers to them: the driver copies each parameter by the size the kernel declares.
	std::vector<CuDevicePtr> values(arguments.size());
	std::vector<void*> parameters(arguments.size());
	if (kernel->parameters_known && kernel->parameter_bytes.size() != arguments.size())
		return Error{ErrorKind::Failure,
		             fmt::format("kernel '{}' takes {} arguments, not {}", entry, kernel->parameter_bytes.size(),
		                         arguments.size()),
		             context_->where(),
		             {},
		             {}};
	for (std::size_t i = 0; i < arguments.size(); ++i) {
		std::size_t bytes = sizeof(std::uint32_t);
		if (const auto* const scalar = std::get_if<std::uint32_t>(&arguments[i])) {
			std::memcpy(&values[i], scalar, bytes);
			parameters[i] = &values[i];
		} else if (const auto* const value = std::get_if<StructBytes>(&arguments[i])) {
			bytes = value->size();
			parameters[i] = const_cast<std::uint8_t*>(value->data()); // only read
		} else {
			RT_TRY_ASSIGN(CudaBuffer* const buffer, own_buffer(*std::get_if<BufferHandle>(&arguments[i]), *context_));
			values[i] = buffer->pointer();
			bytes = sizeof(CuDevicePtr);
			parameters[i] = &values[i];
		}
		if (kernel->parameters_known && kernel->parameter_bytes[i] != bytes)
			return Error{ErrorKind::Failure,
			             fmt::format("argument {} of kernel '{}' has {} bytes, not {}", i, entry,
			                         kernel->parameter_bytes[i], bytes),
			             context_->where(),
			             {},
			             {}};
	}
	return context_->check(context_->api().cuLaunchKernel(kernel->function, static_cast<unsigned>(groups), 1, 1,
	                                                      static_cast<unsigned>(group), 1, 1, 0, context_->stream(),
	                                                      parameters.data(), nullptr),
	                       "cuLaunchKernel");
}

Result<BufferHandle> CudaDevice::alloc(std::size_t bytes)
{
	RT_TRY(context_->make_current());
	const CudaApi& api = context_->api();
	CuDevicePtr pointer = 0;
	// The driver refuses to allocate nothing; a kernel may still get a pointer to an empty array.
	const CuResult result = api.cuMemAlloc_v2(&pointer, std::max<std::size_t>(bytes, 1));
	if (result != cu_success) {
		Error failure = api.error(result, "cuMemAlloc", context_->where());
		std::size_t free = 0, total = 0;
		if (result == cu_error_out_of_memory && api.cuMemGetInfo_v2(&free, &total) == cu_success)
			failure.message +=
			    fmt::format(": {} asked, {} of {} free", gigabytes(bytes), gigabytes(free), gigabytes(total));
		return failure;
	}
	return BufferHandle(std::make_shared<CudaBuffer>(context_, pointer, bytes));
}

Status CudaDevice::write(const BufferHandle& buffer, std::size_t offset, const void* data, std::size_t bytes)
{
	RT_TRY_ASSIGN(CudaBuffer* const own, own_buffer(buffer, *context_));
	RT_TRY(check_range(*own, offset, bytes, "a write", *context_));
	if (bytes == 0)
		return success();
	RT_TRY(context_->make_current());
	// On our stream, behind the launches before it: the plain copy knows only the default stream.
	const auto start = [&](const void* source, std::size_t first, std::size_t count) {
		return context_->check(
		    context_->api().cuMemcpyHtoDAsync_v2(own->pointer() + offset + first, source, count, context_->stream()),
		    "cuMemcpyHtoDAsync");
	};
	if (std::uint8_t* const staging = bytes >= min_staged_bytes ? context_->staging() : nullptr)
		return write_through_staging(staging, data, bytes, start, [&] { return context_->synchronize(); });
	RT_TRY(start(data, 0, bytes));
	return context_->synchronize();
}

Status CudaDevice::read(const BufferHandle& buffer, std::size_t offset, void* data, std::size_t bytes)
{
	RT_TRY(context_->make_current());
	if (bytes >= min_staged_bytes && context_->staging())
		return read_pieces(buffer, offset, bytes, copy_to(data));
	RT_TRY_ASSIGN(CudaBuffer* const own, own_buffer(buffer, *context_));
	RT_TRY(check_range(*own, offset, bytes, "a read", *context_));
	if (bytes == 0)
		return success();
	RT_TRY(context_->start_read(data, own->pointer() + offset, bytes));
	return context_->synchronize();
}

Status CudaDevice::read_pieces(const BufferHandle& buffer, std::size_t offset, std::size_t bytes, const TakePiece& take)
{
	RT_TRY(context_->make_current());
	std::uint8_t* const staging = context_->staging();
	if (!staging)
		return Device::read_pieces(buffer, offset, bytes, take);
	RT_TRY_ASSIGN(CudaBuffer* const own, own_buffer(buffer, *context_));
	RT_TRY(check_range(*own, offset, bytes, "a read", *context_));
	if (bytes == 0)
		return success();
	return read_through_staging(
	    staging, bytes,
	    [&](void* target, std::size_t first, std::size_t count) {
		    return context_->start_read(target, own->pointer() + offset + first, count);
	    },
	    [&] { return context_->synchronize(); }, take);
}

Status CudaDevice::wait()
{
	RT_TRY(context_->make_current());
	return context_->synchronize();
}

} // namespace rt
