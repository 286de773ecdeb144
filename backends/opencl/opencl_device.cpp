#include "backends/opencl/opencl_device.h"

#include "backends/kernel_text.h"
#include "backends/precision.h"
#include "backends/program_cache.h"
#include "backends/staging.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cstring>
#include <map>
#include <memory>
#include <optional>

namespace rt {

namespace {

// Context and queue; buffers and programs keep it alive.
struct Context {
	const OpenClApi& api;
	std::string device_name;
	cl_device_id device = nullptr;
	cl_context context = nullptr;
	cl_command_queue queue = nullptr;
	cl_mem staging_memory = nullptr; // mapped at `staging`
	void* staging = nullptr;
	bool staging_failed = false;

	Context(const OpenClApi& functions, std::string name, cl_device_id id)
	    : api(functions), device_name(std::move(name)), device(id)
	{
	}
	Context(const Context&) = delete;
	Context& operator=(const Context&) = delete;
	~Context()
	{
		if (staging && api.EnqueueUnmapMemObject(queue, staging_memory, staging, 0, nullptr, nullptr) == CL_SUCCESS)
			api.Finish(queue);
		if (staging_memory)
			api.ReleaseMemObject(staging_memory);
		if (queue)
			api.ReleaseCommandQueue(queue);
		if (context)
			api.ReleaseContext(context);
	}
	Error error(const char* call, cl_int code) const { return opencl_error(call, code, device_name); }

	// Memory for read_through_staging, or null where there is none to be had. Drivers of GPUs page-lock what they
	// allocate on the host's side.
	std::uint8_t* staging_halves()
	{
		if (!staging && !staging_failed) {
			cl_int code = CL_SUCCESS;
			staging_memory =
			    api.CreateBuffer(context, CL_MEM_READ_WRITE | CL_MEM_ALLOC_HOST_PTR, 2 * staging_bytes, nullptr, &code);
			if (code == CL_SUCCESS)
				staging = api.EnqueueMapBuffer(queue, staging_memory, CL_TRUE, CL_MAP_READ | CL_MAP_WRITE, 0,
				                               2 * staging_bytes, 0, nullptr, nullptr, &code);
			staging_failed = code != CL_SUCCESS || staging == nullptr;
		}
		return static_cast<std::uint8_t*>(staging);
	}
};
using ContextHandle = std::shared_ptr<Context>;

class OpenClBuffer : public Buffer {
public:
	OpenClBuffer(ContextHandle context, cl_mem memory, std::size_t bytes)
	    : context_(std::move(context)), memory_(memory), bytes_(bytes)
	{
	}
	~OpenClBuffer() override { context_->api.ReleaseMemObject(memory_); }
	std::size_t bytes() const override { return bytes_; }
	const cl_mem& memory() const { return memory_; }
	const Context* context() const { return context_.get(); }

private:
	ContextHandle context_;
	cl_mem memory_;
	std::size_t bytes_;
};

class OpenClProgram : public Program {
public:
	OpenClProgram(ContextHandle context, cl_program program) : context_(std::move(context)), program_(program) {}
	~OpenClProgram() override
	{
		for (const auto& [name, kernel] : kernels_)
			context_->api.ReleaseKernel(kernel);
		context_->api.ReleaseProgram(program_);
	}
	cl_program program() const { return program_; }
	const Context* context() const { return context_.get(); }
	BuildReport& editable_report() { return report_; }

	// The kernel object of an entry, made at its first use.
	Result<cl_kernel> kernel(const std::string& entry)
	{
		if (const auto known = kernels_.find(entry); known != kernels_.end())
			return known->second;
		cl_int code = CL_SUCCESS;
		cl_kernel kernel = context_->api.CreateKernel(program_, entry.c_str(), &code);
		if (code != CL_SUCCESS) {
			Error error = context_->error("clCreateKernel", code);
			error.message += fmt::format(" for '{}'", entry);
			return error;
		}
		kernels_[entry] = kernel;
		return kernel;
	}

private:
	ContextHandle context_;
	cl_program program_;
	std::map<std::string, cl_kernel> kernels_;
};
using OpenClProgramHandle = std::shared_ptr<OpenClProgram>;

// Work-items of one group. On GPUs the kernels vote in warps of 32, and four of these hide each other's latency. On
// processors the number is small, so that small images reach all cores, and always the same: PoCL compiles a kernel
// anew for every group size, and left to itself it would choose one for each image size.
constexpr std::size_t warp = 32;
constexpr std::size_t gpu_group = 4 * warp;
constexpr std::size_t cpu_group = 8;

class OpenClDevice : public Device {
public:
	OpenClDevice(OpenClDeviceRecord record, ContextHandle context)
	    : api_(context->api), context_(std::move(context)), record_(std::move(record))
	{
		info_ = record_.info;
	}
	~OpenClDevice() override
	{
		for (cl_event event : launched_)
			api_.ReleaseEvent(event);
	}

	Result<ProgramHandle> build(const ProgramSpec& spec) override
	{
		const auto start = std::chrono::steady_clock::now();
		ProgramSpec with_probe = spec;
		if (takes_ptx())
			with_probe.defines.emplace_back("RT_DEF_PTX", "1");
		RT_TRY_ASSIGN(const std::string text, flatten_program(with_probe));
		std::string options = record_.options;
		if (flushes_subnormals(spec))
			options += " -cl-denorms-are-zero";
		if (spec.registers != 0 && record_.may_take_ptx)
			options += fmt::format(" -cl-nv-maxrregcount={}", spec.registers);
		RT_TRY_ASSIGN(OpenClProgramHandle program, build_text(text, spec.entries, options));
		program->editable_report().seconds =
		    std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
		return ProgramHandle(std::move(program));
	}

	Status launch(const ProgramHandle& program, const std::string& entry, std::uint64_t items,
	              const std::vector<Argument>& arguments, std::uint32_t group_size) override
	{
		const auto own = std::dynamic_pointer_cast<OpenClProgram>(program);
		if (!own || own->context() != context_.get())
			return Error{ErrorKind::Failure, "launch with a program of another device", info_.name, {}, {}};
		if (items == 0)
			return success();
		RT_TRY_ASSIGN(cl_kernel kernel, own->kernel(entry));
		RT_TRY(set_arguments(kernel, entry, arguments));

		const std::size_t group = group_of(kernel, group_size);
		const std::size_t global = round_up(items, group);
		if (global > UINT32_MAX)
			return Error{ErrorKind::Failure,
			             fmt::format("a launch of {} work-items: their indices have 32 bits", items),
			             entry,
			             {},
			             {}};
		cl_event event = nullptr;
		const cl_int code =
		    api_.EnqueueNDRangeKernel(context_->queue, kernel, 1, nullptr, &global, &group, 0, nullptr, &event);
		if (code != CL_SUCCESS)
			return with_entry(context_->error("clEnqueueNDRangeKernel", code), entry);
		launched_.push_back(event);
		if (const cl_int flushed = api_.Flush(context_->queue); flushed != CL_SUCCESS)
			return with_entry(context_->error("clFlush", flushed), entry);
		return success();
	}

	Result<BufferHandle> alloc(std::size_t bytes) override
	{
		cl_int code = CL_MEM_OBJECT_ALLOCATION_FAILURE; // some drivers promise any size and fail at the first use
		cl_mem memory = nullptr;
		if (bytes <= info_.memory_bytes)
			// OpenCL has no empty buffers, scenes have empty lists.
			memory = api_.CreateBuffer(context_->context, CL_MEM_READ_WRITE, std::max<std::size_t>(bytes, 16), nullptr,
			                           &code);
		if (code != CL_SUCCESS)
			return with_figures(context_->error("clCreateBuffer", code), bytes);
		return BufferHandle(std::make_shared<OpenClBuffer>(context_, memory, bytes));
	}

	Status write(const BufferHandle& buffer, std::size_t offset, const void* data, std::size_t bytes) override
	{
		RT_TRY_ASSIGN(const OpenClBuffer* own, own_buffer(buffer, "write", offset, bytes));
		if (bytes == 0)
			return success();
		const auto start = [&](const void* source, std::size_t first, std::size_t count, cl_bool blocking) {
			const cl_int code = api_.EnqueueWriteBuffer(context_->queue, own->memory(), blocking, offset + first, count,
			                                            source, 0, nullptr, nullptr);
			return transferred("clEnqueueWriteBuffer", code, blocking, own->bytes());
		};
		if (std::uint8_t* const halves = bytes >= min_staged_bytes ? staging() : nullptr)
			return write_through_staging(
			    halves, data, bytes,
			    [&](const void* source, std::size_t first, std::size_t count) {
				    return start(source, first, count, CL_FALSE);
			    },
			    [&] { return wait(); });
		return start(data, 0, bytes, CL_TRUE);
	}

	Status read(const BufferHandle& buffer, std::size_t offset, void* data, std::size_t bytes) override
	{
		if (bytes >= min_staged_bytes && staging())
			return read_pieces(buffer, offset, bytes, copy_to(data));
		RT_TRY_ASSIGN(const OpenClBuffer* own, own_buffer(buffer, "read", offset, bytes));
		if (bytes == 0)
			return success();
		return start_read(*own, offset, data, bytes, CL_TRUE);
	}

	Status read_pieces(const BufferHandle& buffer, std::size_t offset, std::size_t bytes,
	                   const TakePiece& take) override
	{
		std::uint8_t* const halves = staging();
		if (!halves)
			return Device::read_pieces(buffer, offset, bytes, take);
		RT_TRY_ASSIGN(const OpenClBuffer* own, own_buffer(buffer, "read", offset, bytes));
		if (bytes == 0)
			return success();
		return read_through_staging(
		    halves, bytes,
		    [&](void* target, std::size_t first, std::size_t count) {
			    return start_read(*own, offset + first, target, count, CL_FALSE);
		    },
		    [&] { return wait(); }, take);
	}

	Status wait() override
	{
		const cl_int code = api_.Finish(context_->queue);
		RT_TRY(check_launches());
		if (code != CL_SUCCESS)
			return context_->error("clFinish", code);
		return success();
	}

private:
	static std::size_t round_up(std::size_t count, std::size_t multiple)
	{
		return (count + multiple - 1) / multiple * multiple;
	}

	Error with_figures(Error error, std::size_t buffer_bytes) const
	{
		const auto mebibytes = [](std::uint64_t bytes) { return static_cast<double>(bytes) / (1024.0 * 1024.0); };
		error.message +=
		    fmt::format(" (a buffer of {:.1f} MiB; the device has {:.1f} MiB in all and promises {:.1f} MiB "
		                "at once)",
		                mebibytes(buffer_bytes), mebibytes(info_.memory_bytes), mebibytes(info_.max_alloc_bytes));
		return error;
	}

	static Error with_entry(Error error, const std::string& entry)
	{
		error.message += fmt::format(" (kernel {})", entry);
		return error;
	}

	std::size_t group_of(cl_kernel kernel, std::uint32_t asked) const
	{
		const std::size_t unit = info_.kind == DeviceKind::Cpu ? 1 : warp; // only whole warps may vote
		std::size_t group = info_.kind == DeviceKind::Cpu ? cpu_group : gpu_group;
		if (asked != 0)
			group = round_up(asked, unit);
		std::size_t limit = 0; // a kernel that takes many registers may have a lower one than its device
		const cl_int code = api_.GetKernelWorkGroupInfo(kernel, context_->device, CL_KERNEL_WORK_GROUP_SIZE,
		                                                sizeof limit, &limit, nullptr);
		if (code == CL_SUCCESS && limit >= unit)
			group = std::min(group, limit / unit * unit);
		return group;
	}

	Status set_arguments(cl_kernel kernel, const std::string& entry, const std::vector<Argument>& arguments)
	{
		for (cl_uint i = 0; i < arguments.size(); ++i) {
			const void* value = nullptr;
			std::size_t bytes = 0;
			if (const auto* scalar = std::get_if<std::uint32_t>(&arguments[i])) {
				value = scalar;
				bytes = sizeof *scalar;
			} else if (const auto* bytes_of_struct = std::get_if<StructBytes>(&arguments[i])) {
				value = bytes_of_struct->data();
				bytes = bytes_of_struct->size();
			} else {
				RT_TRY_ASSIGN(const OpenClBuffer* own,
				              own_buffer(*std::get_if<BufferHandle>(&arguments[i]), "launch", 0, 0));
				value = &own->memory();
				bytes = sizeof(cl_mem);
			}
			if (const cl_int code = api_.SetKernelArg(kernel, i, bytes, value); code != CL_SUCCESS) {
				Error error = context_->error("clSetKernelArg", code);
				error.message += fmt::format(" (kernel {}, argument {})", entry, i);
				return error;
			}
		}
		return success();
	}

	Result<const OpenClBuffer*> own_buffer(const BufferHandle& buffer, const char* operation, std::size_t offset,
	                                       std::size_t bytes) const
	{
		const auto* own = dynamic_cast<const OpenClBuffer*>(buffer.get());
		if (!own || own->context() != context_.get())
			return Error{
			    ErrorKind::Failure, fmt::format("{} with a buffer of another device", operation), info_.name, {}, {}};
		if (offset > own->bytes() || bytes > own->bytes() - offset)
			return Error{
			    ErrorKind::Failure,
			    fmt::format("{} of {} bytes at {} in a buffer of {} bytes", operation, bytes, offset, own->bytes()),
			    info_.name,
			    {},
			    {}};
		return own;
	}

	// Only a GPU's driver gains by staging.
	std::uint8_t* staging() { return info_.kind == DeviceKind::Gpu ? context_->staging_halves() : nullptr; }

	Status start_read(const OpenClBuffer& buffer, std::size_t offset, void* target, std::size_t bytes, cl_bool blocking)
	{
		const cl_int code = api_.EnqueueReadBuffer(context_->queue, buffer.memory(), blocking, offset, bytes, target, 0,
		                                           nullptr, nullptr);
		return transferred("clEnqueueReadBuffer", code, blocking, buffer.bytes());
	}

	// A blocking copy waited for the launches before it; those before another are asked at the next wait().
	Status transferred(const char* call, cl_int code, cl_bool blocking, std::size_t buffer_bytes)
	{
		if (blocking == CL_TRUE)
			RT_TRY(check_launches());
		if (code != CL_SUCCESS)
			return with_figures(context_->error(call, code), buffer_bytes);
		return success();
	}

	// Asks every launch since the last wait how it ended: clFinish alone need not tell.
	Status check_launches()
	{
		cl_int failure = CL_SUCCESS;
		for (cl_event event : launched_) {
			cl_int state = CL_COMPLETE;
			const cl_int code =
			    api_.GetEventInfo(event, CL_EVENT_COMMAND_EXECUTION_STATUS, sizeof state, &state, nullptr);
			if (failure == CL_SUCCESS && (code < 0 || state < 0))
				failure = code < 0 ? code : state;
			api_.ReleaseEvent(event);
		}
		launched_.clear();
		if (failure != CL_SUCCESS)
			return context_->error("a kernel launch", failure);
		return success();
	}

	// ---- building ----

	Result<OpenClProgramHandle> build_text(const std::string& text, const std::vector<std::string>& entries,
	                                       const std::string& options)
	{
		const CacheKey key{"opencl", info_.platform, info_.name, info_.driver, cache_environment(), options, text};
		const CacheTurn turn(key); // of several equal devices one compiles
		if (record_.driver_caches_code)
			return from_source(text, entries, options);
		if (const auto binary = cache_load(key))
			if (OpenClProgramHandle program = from_binary(*binary, text, entries, options))
				return program;
		RT_TRY_ASSIGN(OpenClProgramHandle program, from_source(text, entries, options));
		if (const std::vector<std::uint8_t> binary = binary_of(*program); !binary.empty())
			cache_store(key, binary);
		return program;
	}

	Result<OpenClProgramHandle> from_source(const std::string& text, const std::vector<std::string>& entries,
	                                        const std::string& options)
	{
		const char* start = text.data();
		const std::size_t bytes = text.size();
		cl_int code = CL_SUCCESS;
		cl_program handle = api_.CreateProgramWithSource(context_->context, 1, &start, &bytes, &code);
		if (code != CL_SUCCESS)
			return context_->error("clCreateProgramWithSource", code);
		auto program = std::make_shared<OpenClProgram>(context_, handle);
		code = api_.BuildProgram(handle, 1, &context_->device, options.c_str(), nullptr, nullptr);
		fill_report(*program, text, options);
		if (code != CL_SUCCESS) {
			Error error = context_->error("clBuildProgram", code);
			if (error.kind != ErrorKind::Memory)
				error.kind = ErrorKind::Build;
			error.cure =
			    "report this with the log; meanwhile choose another device or driver (`rt devices` lists them)";
			error.log = program->editable_report().log;
			return error;
		}
		for (const std::string& entry : entries)
			if (Result<cl_kernel> kernel = program->kernel(entry); !kernel) {
				Error error = kernel.error();
				error.kind = ErrorKind::Build;
				error.log = program->editable_report().log;
				return error;
			}
		fill_use(*program, entries);
		return program;
	}

	// Null if the driver does not take its own binary any more: a reason to compile again, not an error.
	OpenClProgramHandle from_binary(const std::vector<std::uint8_t>& binary, const std::string& text,
	                                const std::vector<std::string>& entries, const std::string& options)
	{
		const unsigned char* start = binary.data();
		const std::size_t bytes = binary.size();
		cl_int status = CL_SUCCESS, code = CL_SUCCESS;
		cl_program handle =
		    api_.CreateProgramWithBinary(context_->context, 1, &context_->device, &bytes, &start, &status, &code);
		if (!handle)
			return nullptr;
		auto program = std::make_shared<OpenClProgram>(context_, handle);
		if (code != CL_SUCCESS || status != CL_SUCCESS ||
		    api_.BuildProgram(handle, 1, &context_->device, options.c_str(), nullptr, nullptr) != CL_SUCCESS)
			return nullptr;
		for (const std::string& entry : entries)
			if (!program->kernel(entry))
				return nullptr;
		fill_report(*program, text, options);
		fill_use(*program, entries);
		program->editable_report().from_cache = true;
		return program;
	}

	// Empty if the driver gives none.
	std::vector<std::uint8_t> binary_of(const OpenClProgram& program) const
	{
		std::size_t bytes = 0;
		if (api_.GetProgramInfo(program.program(), CL_PROGRAM_BINARY_SIZES, sizeof bytes, &bytes, nullptr) !=
		    CL_SUCCESS)
			return {};
		std::vector<std::uint8_t> binary(bytes);
		unsigned char* start = binary.data();
		if (bytes == 0 ||
		    api_.GetProgramInfo(program.program(), CL_PROGRAM_BINARIES, sizeof start, &start, nullptr) != CL_SUCCESS)
			return {};
		return binary;
	}

	// OpenCL tells neither registers nor occupancy; private memory says whether a kernel spills.
	void fill_use(OpenClProgram& program, const std::vector<std::string>& entries) const
	{
		for (const std::string& entry : entries) {
			const Result<cl_kernel> kernel = program.kernel(entry);
			if (!kernel)
				continue;
			KernelUse use;
			use.entry = entry;
			use.group_size = static_cast<std::uint32_t>(group_of(*kernel, 0));
			cl_ulong bytes = 0;
			if (api_.GetKernelWorkGroupInfo(*kernel, context_->device, CL_KERNEL_PRIVATE_MEM_SIZE, sizeof bytes, &bytes,
			                                nullptr) == CL_SUCCESS)
				use.private_bytes = static_cast<std::uint32_t>(bytes);
			program.editable_report().kernels.push_back(std::move(use));
		}
	}

	void fill_report(OpenClProgram& program, const std::string& text, const std::string& options) const
	{
		const auto build_info = [this](cl_program handle, cl_program_build_info what, std::size_t bytes, void* value,
		                               std::size_t* needed) {
			return api_.GetProgramBuildInfo(handle, context_->device, what, bytes, value, needed);
		};
		program.editable_report().options = options;
		std::size_t bytes = 0;
		if (build_info(program.program(), CL_PROGRAM_BUILD_LOG, 0, nullptr, &bytes) != CL_SUCCESS || bytes == 0)
			return;
		std::string log(bytes, '\0');
		if (build_info(program.program(), CL_PROGRAM_BUILD_LOG, bytes, log.data(), nullptr) != CL_SUCCESS)
			return;
		log.resize(std::strlen(log.c_str()));
		log.erase(log.find_last_not_of(" \n") + 1); // some drivers say "all is well" by a line feed
		program.editable_report().log = place_in_files(log, "<kernel>", text);
	}

	// ---- inline PTX ----

	// NVIDIA's compiler takes PTX in OpenCL C, but no document promises it: so try it once and look at the result.
	bool takes_ptx()
	{
		if (!ptx_.has_value()) {
			const Result<bool> works = record_.may_take_ptx ? probe_ptx() : Result<bool>(false);
			ptx_ = works && works.value();
		}
		return *ptx_;
	}

	// Of two warps, the second has one item that votes yes: the first must hear 0 and the second 1.
	Result<bool> probe_ptx()
	{
		static constexpr const char* text = R"(
__kernel void rt_ptx_probe(__global uint* heard)
{
	const uint item = (uint)get_global_id(0);
	const uint vote = item == 37u ? 1u : 0u;
	uint any;
	asm volatile("{\n\t.reg .pred p, q;\n\tsetp.ne.u32 p, %1, 0;\n\tvote.sync.any.pred q, p, 0xffffffff;\n\t"
	             "selp.u32 %0, 1, 0, q;\n\t}" : "=r"(any) : "r"(vote));
	heard[item] = any;
}
)";
		constexpr const char* entry = "rt_ptx_probe";
		RT_TRY_ASSIGN(const OpenClProgramHandle program, build_text(text, {entry}, record_.options));
		std::uint32_t heard[2 * warp] = {};
		RT_TRY_ASSIGN(const BufferHandle buffer, alloc(sizeof heard));
		RT_TRY(write(buffer, 0, heard, sizeof heard));
		RT_TRY(launch(program, entry, 2 * warp, {buffer}, 2 * warp));
		RT_TRY(read(buffer, 0, heard, sizeof heard));
		for (std::size_t i = 0; i < 2 * warp; ++i)
			if (heard[i] != (i < warp ? 0u : 1u))
				return false;
		return true;
	}

	const OpenClApi& api_;
	ContextHandle context_;
	OpenClDeviceRecord record_;
	std::optional<bool> ptx_; // unknown until the first build
	std::vector<cl_event> launched_;
};

} // namespace

Result<DeviceHandle> open_opencl_device(const OpenClApi& api, const OpenClDeviceRecord& record)
{
	auto context = std::make_shared<Context>(api, record.info.name, record.id);
	cl_int code = CL_SUCCESS;
	const cl_context_properties properties[] = {CL_CONTEXT_PLATFORM,
	                                            reinterpret_cast<cl_context_properties>(record.platform), 0};
	context->context = api.CreateContext(properties, 1, &record.id, nullptr, nullptr, &code);
	if (code != CL_SUCCESS)
		return context->error("clCreateContext", code);
	context->queue = api.CreateCommandQueue(context->context, record.id, 0, &code);
	if (code != CL_SUCCESS)
		return context->error("clCreateCommandQueue", code);
	return DeviceHandle(std::make_shared<OpenClDevice>(record, std::move(context)));
}

} // namespace rt
