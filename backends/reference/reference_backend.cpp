#include "backends/reference/reference_backend.h"

#include "backends/reference/reference_kernels.h"
#include "common/rt_features.h"
#include "support/thread_pool.h"

#include <algorithm>
#include <cstring>
#include <fmt/format.h>
#include <fstream>
#include <new>
#include <unistd.h>

namespace rt {
namespace {

#if defined(__clang__)
const char* const compiler_version = "clang++ " __clang_version__;
#else
const char* const compiler_version = "g++ " __VERSION__;
#endif

class HostBuffer final : public Buffer {
public:
	explicit HostBuffer(std::size_t bytes) : memory_(new (std::nothrow) unsigned char[bytes ? bytes : 1]), bytes_(bytes)
	{
	}
	std::size_t bytes() const override { return bytes_; }
	unsigned char* data() const { return memory_.get(); }

private:
	std::unique_ptr<unsigned char[]> memory_;
	std::size_t bytes_;
};

class HostProgram final : public Program {
public:
	HostProgram(const ReferenceVariant& variant, BuildReport report) : variant_(variant)
	{
		report_ = std::move(report);
	}
	const ReferenceKernel* find(const std::string& entry) const
	{
		for (unsigned i = 0; i < variant_.kernel_count; ++i)
			if (entry == variant_.kernels[i].entry)
				return &variant_.kernels[i];
		return nullptr;
	}

private:
	const ReferenceVariant& variant_;
};

bool host_has_x86_64_v3()
{
#if defined(__x86_64__)
	return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2");
#else
	return false;
#endif
}

// The variant with the fewest features that has all that are needed; x86-64-v3 before the baseline.
const ReferenceVariant* choose_variant(std::uint32_t features, bool native_roots, bool contracted)
{
	const bool v3 = host_has_x86_64_v3();
	const ReferenceVariant* best = nullptr;
	const auto rank = [](const ReferenceVariant& v) {
		return std::make_pair(v.needs_x86_64_v3 ? 0 : 1, __builtin_popcount(v.features));
	};
	for (unsigned i = 0; i < reference_variant_count; ++i) {
		const ReferenceVariant& variant = *reference_variants[i];
		if (variant.traced || (features & ~variant.features) != 0 || variant.native_roots != native_roots ||
		    variant.contracted != contracted || (variant.needs_x86_64_v3 && !v3))
			continue;
		if (!best || rank(variant) < rank(*best))
			best = &variant;
	}
	return best;
}

// Slow and generic: it traces single samples.
const ReferenceVariant* traced_variant()
{
	for (unsigned i = 0; i < reference_variant_count; ++i)
		if (reference_variants[i]->traced)
			return reference_variants[i];
	return nullptr;
}

class HostDevice final : public Device {
public:
	explicit HostDevice(DeviceInfo info) { info_ = std::move(info); }

	Result<ProgramHandle> build(const ProgramSpec& spec) override
	{
		const std::uint32_t lanes = integer_define(spec, "RT_LANES", 1);
		if (lanes != 1)
			return Error{ErrorKind::Build,
			             fmt::format("the reference backend has no kernels of {} lanes", lanes),
			             {},
			             "use 1 lane",
			             {}};
		if (!spec.edits.empty())
			return Error{ErrorKind::Build,
			             "the reference backend's kernels were compiled with rt and cannot be edited",
			             spec.edits.front().file,
			             "plant faults in a device that compiles the kernels' text",
			             {}};
		const std::uint32_t features = integer_define(spec, "RT_FEATURES", RT_FEATURE_ALL);
		const bool native_roots = integer_define(spec, "RT_DEF_NATIVE_ROOTS", 1) != 0;
		const bool contracted = integer_define(spec, "RT_DEF_CONTRACT", 0) != 0;
		const ReferenceVariant* variant =
		    spec.traced ? traced_variant() : choose_variant(features, native_roots, contracted);
		if (!variant)
			return Error{
			    ErrorKind::Build,
			    fmt::format("no compiled variant of the kernels has features {:#x} with {} roots for this processor",
			                features, native_roots ? "native" : "software"),
			    {},
			    {},
			    {}};
		BuildReport report;
		report.variant = variant->name;
		report.options = variant->traced ? "-O1" : variant->needs_x86_64_v3 ? "-O3 -march=x86-64-v3" : "-O3";
		report.options += contracted ? " -ffp-contract=fast" : " -ffp-contract=off";
		auto program = std::make_shared<HostProgram>(*variant, std::move(report));
		for (const std::string& entry : spec.entries)
			if (!program->find(entry))
				return Error{ErrorKind::Build, "there is no kernel of the name " + entry, spec.root, {}, {}};
		return ProgramHandle(std::move(program));
	}

	Status launch(const ProgramHandle& program, const std::string& entry, std::uint64_t items,
	              const std::vector<Argument>& arguments, std::uint32_t group_size) override
	{
		const auto* host_program = dynamic_cast<const HostProgram*>(program.get());
		const ReferenceKernel* kernel = host_program ? host_program->find(entry) : nullptr;
		if (!kernel || kernel->argument_count != arguments.size())
			return Error{ErrorKind::Failure,
			             fmt::format("kernel {} cannot be launched with {} arguments", entry, arguments.size()),
			             {},
			             {},
			             {}};
		if (items > UINT32_MAX)
			return Error{ErrorKind::Failure, fmt::format("a launch of {} work-items is too large", items), {}, {}, {}};
		std::vector<std::uint32_t> scalars;
		scalars.reserve(arguments.size());
		std::vector<void*> places;
		places.reserve(arguments.size());
		for (const Argument& argument : arguments) {
			if (const auto* buffer = std::get_if<BufferHandle>(&argument)) {
				places.push_back(static_cast<const HostBuffer&>(**buffer).data());
			} else if (const auto* value = std::get_if<StructBytes>(&argument)) {
				places.push_back(const_cast<std::uint8_t*>(value->data())); // only read
			} else {
				scalars.push_back(std::get<std::uint32_t>(argument));
				places.push_back(&scalars.back());
			}
		}
		// A tile of 32 pixels is a piece unless the caller wants other groups.
		parallel_for(items, group_size ? group_size : 32, [&](std::uint64_t begin, std::uint64_t end) {
			kernel->run(places.data(), static_cast<std::uint32_t>(begin), static_cast<std::uint32_t>(end));
		});
		return success();
	}

	Result<BufferHandle> alloc(std::size_t bytes) override
	{
		auto buffer = std::make_shared<HostBuffer>(bytes);
		if (!buffer->data())
			return Error{ErrorKind::Memory,
			             fmt::format("{} bytes of host memory could not be had", bytes),
			             info_.name,
			             "render a smaller image or scene",
			             {}};
		return BufferHandle(std::move(buffer));
	}

	Status write(const BufferHandle& buffer, std::size_t offset, const void* data, std::size_t bytes) override
	{
		RT_TRY(check_range(*buffer, offset, bytes));
		std::memcpy(static_cast<const HostBuffer&>(*buffer).data() + offset, data, bytes);
		return success();
	}

	Status read(const BufferHandle& buffer, std::size_t offset, void* data, std::size_t bytes) override
	{
		RT_TRY(check_range(*buffer, offset, bytes));
		std::memcpy(data, static_cast<const HostBuffer&>(*buffer).data() + offset, bytes);
		return success();
	}

	Status wait() override { return success(); }

private:
	static Status check_range(const Buffer& buffer, std::size_t offset, std::size_t bytes)
	{
		if (offset > buffer.bytes() || bytes > buffer.bytes() - offset)
			return Error{
			    ErrorKind::Failure,
			    fmt::format("a copy of {} bytes at {} does not fit a buffer of {}", bytes, offset, buffer.bytes()),
			    {},
			    {},
			    {}};
		return success();
	}
};

std::string processor_name()
{
	std::ifstream file("/proc/cpuinfo");
	for (std::string line; std::getline(file, line);)
		if (line.rfind("model name", 0) == 0)
			if (const auto colon = line.find(':'); colon != std::string::npos && colon + 2 < line.size())
				return line.substr(colon + 2);
	return "host processor";
}

class ReferenceBackend final : public Backend {
public:
	const char* name() const override { return "reference"; }

	Enumeration enumerate() override
	{
		DeviceInfo info;
		info.backend = name();
		info.platform = "host";
		info.name = processor_name();
		info.driver = compiler_version;
		info.compiler = compiler_version;
		info.id = "cpu:reference";
		info.kind = DeviceKind::Host;
		const long pages = sysconf(_SC_PHYS_PAGES), page = sysconf(_SC_PAGE_SIZE);
		if (pages > 0 && page > 0)
			info.memory_bytes = static_cast<std::uint64_t>(pages) * static_cast<std::uint64_t>(page);
		info.max_alloc_bytes = info.memory_bytes;
		info.compute_units = thread_count();
		info.reports_correct_rounding = info.reports_subnormals = info.reports_fp64 = true;
		if (!host_has_x86_64_v3() && choose_variant(RT_FEATURE_ALL, true, false) != nullptr)
			info.quirks.push_back(
			    {"software-fma", "this build or processor has no fma instruction: exact, and slower"});
		Enumeration found;
		found.devices.push_back(std::move(info));
		return found;
	}

	Result<DeviceHandle> open(const DeviceInfo& info) override
	{
		return DeviceHandle(std::make_shared<HostDevice>(info));
	}
};

} // namespace

Backend& reference_backend()
{
	static ReferenceBackend backend;
	return backend;
}

} // namespace rt
