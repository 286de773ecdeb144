#include "backends/reference/reference_backend.h"

#include "backends/precision.h"
#include "backends/reference/reference_kernels.h"
#include "common/rt_features.h"
#include "common/rt_structs.h"
#include "support/float_environment.h"
#include "support/thread_pool.h"

#include <algorithm>
#include <cstring>
#include <fmt/format.h>
#include <fstream>
#include <new>
#include <optional>
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

const ReferenceKernel* find_kernel(const ReferenceVariant& variant, const std::string& entry)
{
	for (unsigned i = 0; i < variant.kernel_count; ++i)
		if (entry == variant.kernels[i].entry)
			return &variant.kernels[i];
	return nullptr;
}

class HostProgram final : public Program {
public:
	HostProgram(const ReferenceVariant& variant, bool flushes, BuildReport report)
	    : variant_(variant), flushes_(flushes)
	{
		report_ = std::move(report);
	}
	std::uint32_t lanes() const { return variant_.lanes; }
	const ReferenceKernel* find(const std::string& entry) const { return find_kernel(variant_, entry); }

	bool flushes() const { return flushes_; }

private:
	const ReferenceVariant& variant_;
	bool flushes_;
};

// The instruction set of ReferenceVariant that this processor has.
unsigned host_instruction_set()
{
#if defined(__x86_64__)
	if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma") || !__builtin_cpu_supports("bmi2"))
		return 0;
	for (const bool there : {__builtin_cpu_supports("avx512f") != 0, __builtin_cpu_supports("avx512bw") != 0,
	                         __builtin_cpu_supports("avx512cd") != 0, __builtin_cpu_supports("avx512dq") != 0,
	                         __builtin_cpu_supports("avx512vl") != 0})
		if (!there)
			return 3;
	return 4;
#else
	return 0;
#endif
}

// What a program asks of its variant.
struct Wanted {
	std::uint32_t lanes = 1;
	std::uint32_t features = RT_FEATURE_ALL;
	bool native_roots = true;
	bool contracted = false;
	std::uint32_t precision = RT_PRECISION_EXACT;
	bool traced = false; // one slow, generic variant: it traces single samples
};

// The variant with the fewest features that has all that are needed; the newest instruction set before the others.
const ReferenceVariant* choose_variant(const Wanted& wanted, const std::vector<std::string>& entries)
{
	const unsigned instruction_set = host_instruction_set();
	const ReferenceVariant* best = nullptr;
	const auto rank = [](const ReferenceVariant& v) {
		return std::make_pair(-static_cast<int>(v.instruction_set), __builtin_popcount(v.features));
	};
	for (unsigned i = 0; i < reference_variant_count; ++i) {
		const ReferenceVariant& variant = *reference_variants[i];
		if (variant.traced != wanted.traced || variant.lanes != wanted.lanes ||
		    (wanted.features & ~variant.features) != 0 || variant.native_roots != wanted.native_roots ||
		    variant.contracted != wanted.contracted || variant.precision != wanted.precision ||
		    variant.instruction_set > instruction_set)
			continue;
		if (!std::all_of(entries.begin(), entries.end(),
		                 [&](const std::string& entry) { return find_kernel(variant, entry); }))
			continue;
		if (!best || rank(variant) < rank(*best))
			best = &variant;
	}
	return best;
}

// The lanes of the most specialised variants that run here (ReferenceVariants.cmake).
std::uint32_t fastest_lanes()
{
	const unsigned instruction_set = host_instruction_set();
	const ReferenceVariant* best = nullptr;
	const auto rank = [](const ReferenceVariant& v) {
		return std::make_pair(__builtin_popcount(v.features), -static_cast<int>(v.instruction_set));
	};
	for (unsigned i = 0; i < reference_variant_count; ++i) {
		const ReferenceVariant& variant = *reference_variants[i];
		if (variant.precision == RT_PRECISION_EXACT && variant.instruction_set <= instruction_set &&
		    (!best || rank(variant) < rank(*best)))
			best = &variant;
	}
	return best ? best->lanes : 1;
}

class HostDevice final : public Device {
public:
	explicit HostDevice(DeviceInfo info) { info_ = std::move(info); }

	Result<ProgramHandle> build(const ProgramSpec& spec) override
	{
		Wanted wanted;
		wanted.lanes = integer_define(spec, "RT_LANES", 1);
		wanted.features = integer_define(spec, "RT_FEATURES", RT_FEATURE_ALL);
		wanted.precision = integer_define(spec, "RT_PRECISION", RT_PRECISION_EXACT);
		wanted.native_roots =
		    wanted.precision != RT_PRECISION_EXACT || integer_define(spec, "RT_DEF_NATIVE_ROOTS", 1) != 0;
		wanted.contracted = integer_define(spec, "RT_DEF_CONTRACT", 0) != 0;
		wanted.traced = spec.traced;
		if (wanted.traced)
			wanted.native_roots = true;
		if (integer_define(spec, "RT_DEF_FAST", RT_FAST_ALL) != RT_FAST_ALL)
			return Error{ErrorKind::Build,
			             "the reference backend has the fast rung only as a whole",
			             {},
			             "measure its parts on another backend",
			             {}};
		if (!spec.edits.empty())
			return Error{ErrorKind::Build,
			             "the reference backend's kernels were compiled with rt and cannot be edited",
			             spec.edits.front().file,
			             "plant faults in a device that compiles the kernels' text",
			             {}};
		const ReferenceVariant* variant = choose_variant(wanted, spec.entries);
		if (!variant)
			variant = choose_variant(wanted, {}); // an unknown entry is told below
		if (!variant)
			return Error{ErrorKind::Build,
			             fmt::format("no compiled variant of the kernels has {} lanes, features {:#x} and {} roots in "
			                         "precision {} for this processor",
			                         wanted.lanes, wanted.features, wanted.native_roots ? "native" : "software",
			                         precision_name(static_cast<Precision>(wanted.precision))),
			             {},
			             wanted.lanes == info_.native_lanes ? "" : fmt::format("use {} lanes", info_.native_lanes),
			             {}};
		BuildReport report;
		report.variant = variant->name;
		report.options = variant->traced ? "-O1" : "-O3";
		if (variant->instruction_set)
			report.options += fmt::format(" -march=x86-64-v{}", variant->instruction_set);
		report.options += lets_compiler_fuse(spec) ? " -ffp-contract=fast" : " -ffp-contract=off";
		auto program = std::make_shared<HostProgram>(*variant, flushes_subnormals(spec), std::move(report));
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
		// A tile is a piece unless the caller wants other groups; the items of other kernels are small.
		const std::uint32_t piece = entry == "rt_render" ? RT_TILE_ITEMS(host_program->lanes()) : 64;
		parallel_for(items, group_size ? group_size : piece, [&](std::uint64_t begin, std::uint64_t end) {
			std::optional<FlushingFloatEnvironment> flushing;
			if (host_program->flushes())
				flushing.emplace();
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

	Status read_pieces(const BufferHandle& buffer, std::size_t offset, std::size_t bytes,
	                   const TakePiece& take) override
	{
		RT_TRY(check_range(*buffer, offset, bytes));
		if (bytes != 0)
			take(static_cast<const HostBuffer&>(*buffer).data() + offset, 0, bytes);
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
		info.native_lanes = fastest_lanes();
#if defined(__x86_64__)
		if (host_instruction_set() == 0)
			info.quirks.push_back(
			    {"software-fma", "this build or processor has no fma instruction: exact, and slower"});
#endif
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
