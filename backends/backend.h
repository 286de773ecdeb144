// backend.h: the whole interface between the renderer and a device.
//
// Eight calls, mandatory in every backend: enumerate, open, build, launch, alloc, write, read, wait. A ninth,
// read_pieces, is there for speed and has a default.
// Nothing above backends/ sees a driver's type, and nothing outside a backend asks which backend it is:
// what a device can do is in DeviceInfo, found out by probes.
//
// Ownership is by handle: a Buffer or Program keeps what it needs of its device alive and releases it when
// the last handle goes. A Device is used by one thread at a time; different devices may run in parallel.
#pragma once

#include "support/result.h"

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

namespace rt {

// A driver's peculiarity that rt works round, and why; shown by `rt devices -v`.
struct Quirk {
	std::string flag;
	std::string reason;
	bool odd = false; // comes from the surroundings and may change results: told before a verdict (odd_environment.h)
};

enum class DeviceKind { Gpu, Cpu, Accelerator, Host };

// What is known of a device before it is opened.
struct DeviceInfo {
	std::string backend;  // "cuda", "opencl", "reference"
	std::string platform; // OpenCL platform, "NVIDIA CUDA", "host compiler"
	std::string name;     // as the driver says it
	std::string driver;   // version
	std::string compiler; // what turns kernel text into code, with version; empty if not known yet
	std::string id;       // stable: "pci:0000:3b:00.0", "uuid:...", "cpu:..."; empty if there is none
	std::string pci;      // PCI address "0000:3b:00.0" or empty; equal in all views of one GPU
	std::string uuid;     // 8-4-4-4-12 lower-case hex digits or empty; tells parts of one PCI device apart
	DeviceKind kind = DeviceKind::Cpu;
	std::uint64_t memory_bytes = 0;    // device memory (host memory for a CPU)
	std::uint64_t max_alloc_bytes = 0; // largest single buffer
	std::uint32_t compute_units = 0;
	std::uint32_t native_lanes = 1;        // RT_LANES this device is best given: its native float width
	bool indexes_parameters = true;        // its compiler can read an array among a kernel's parameters
	bool reports_correct_rounding = false; // the driver says / and sqrt are correctly rounded (not relied on)
	bool reports_subnormals = false;
	bool reports_fp64 = false;
	std::vector<Quirk> quirks;
	bool only_if_named = false; // so slow (an interpreter) that it is chosen only where nothing else is, or by name
	bool usable = true;
	std::string why_not;      // when not usable
	int index_in_backend = 0; // what open() uses to find it again

	// The host's own cores do its work, so that their time is its time.
	bool is_processor() const { return kind == DeviceKind::Host || kind == DeviceKind::Cpu; }
};

// "AMD EPYC (opencl)": a device in a message.
std::string describe(const DeviceInfo& info);

// A reason for which devices may be missing: a driver absent, or present and not registered.
struct Absence {
	std::string backend;
	std::string reason; // "no NVIDIA driver: libcuda.so.1 was not found"
	std::string cure;   // packages for Debian/Ubuntu, Fedora and Arch; may have several lines
};

struct Enumeration {
	std::vector<DeviceInfo> devices;
	std::vector<Absence> absences;
};

// Device memory. Contents are undefined until written.
class Buffer {
public:
	virtual ~Buffer() = default;
	virtual std::size_t bytes() const = 0;
};
using BufferHandle = std::shared_ptr<Buffer>;

// Puts `replace` in the place of `find`, which must stand exactly once in the kernel file `file`. For tests that plant
// a fault and want it found: nothing that renders has any.
struct TextEdit {
	std::string file, find, replace;
};

// Kernel text with everything that chooses a variant of it. All of it enters the cache key.
struct ProgramSpec {
	std::string root;                                         // embedded kernel file: "kernels/render.cl"
	std::vector<std::pair<std::string, std::string>> defines; // emitted as #define lines above the text
	std::vector<std::string> entries;                         // kernel functions that will be launched
	std::uint32_t registers = 0;      // a work-item may take, where a GPU's compiler can be told; 0: its choice
	bool traced = false;              // with a note behind every operation (backends/traced_text.h)
	std::vector<TextEdit> edits = {}; // applied in order; an error where one does not apply,
	                                  // or where the kernels are not compiled from text
};

// The value of an integer define ("0x1fu", "8"), or `fallback` where the spec has none of that name.
inline std::uint32_t integer_define(const ProgramSpec& spec, const std::string& name, std::uint32_t fallback)
{
	for (const auto& [key, value] : spec.defines)
		if (key == name)
			return static_cast<std::uint32_t>(std::strtoul(value.c_str(), nullptr, 0));
	return fallback;
}

// What a kernel takes of its device, where the driver tells; shown by `rt bench`.
struct KernelUse {
	std::string entry;
	std::uint32_t group_size = 0;               // work-items of a group that rt launches if nobody asks for others
	std::optional<std::uint32_t> registers;     // a work-item
	std::optional<std::uint32_t> private_bytes; // a work-item's memory outside of registers: spills and arrays
	std::optional<double> occupancy;            // work-items that a compute unit holds at once, of those that it could
};

struct BuildReport {
	double seconds = 0; // wall time of build(), compilation and loading
	bool from_cache = false;
	bool embedded = false;          // the generic program compiled when rt was built (no run-time compiler found)
	std::string options;            // what the device's compiler was given
	std::string log;                // compiler's output, may be empty
	std::string variant;            // reference: which compiled variant serves; otherwise empty
	std::vector<KernelUse> kernels; // of the entries that the driver says something about
};

class Program {
public:
	virtual ~Program() = default;
	const BuildReport& report() const { return report_; }

protected:
	BuildReport report_;
};
using ProgramHandle = std::shared_ptr<Program>;

// A kernel's argument: a buffer, a 32-bit scalar, or a struct by value.
using StructBytes = std::vector<std::uint8_t>;
using Argument = std::variant<BufferHandle, std::uint32_t, StructBytes>;

template <class Struct>
StructBytes by_value(const Struct& value)
{
	const auto* bytes = reinterpret_cast<const std::uint8_t*>(&value);
	return StructBytes(bytes, bytes + sizeof value);
}

// Gets bytes [first, first + bytes) of what is read; the memory is its own during the call only.
using TakePiece = std::function<void(const void* data, std::size_t first, std::size_t bytes)>;

class Device {
public:
	virtual ~Device() = default;
	const DeviceInfo& info() const { return info_; }

	// Compiles (or loads from the cache) a program. Error kind Build carries the compiler's whole log.
	virtual Result<ProgramHandle> build(const ProgramSpec& spec) = 0;
	// Enqueues `items` work-items of `entry`; group_size 0 lets the backend choose. The backend may start
	// more items than asked (whole groups): kernels get their bounds as arguments and mask the rest.
	virtual Status launch(const ProgramHandle& program, const std::string& entry, std::uint64_t items,
	                      const std::vector<Argument>& arguments, std::uint32_t group_size = 0) = 0;
	virtual Result<BufferHandle> alloc(std::size_t bytes) = 0;
	// Copies between host and device; both wait until the copy is done.
	virtual Status write(const BufferHandle& buffer, std::size_t offset, const void* data, std::size_t bytes) = 0;
	virtual Status read(const BufferHandle& buffer, std::size_t offset, void* data, std::size_t bytes) = 0;
	// Reads for someone who looks at the bytes once: piece by piece in order, cut at multiples of 64 bytes, and a
	// device that can copies one while another is looked at. Not overridden, it is read() for each piece.
	virtual Status read_pieces(const BufferHandle& buffer, std::size_t offset, std::size_t bytes,
	                           const TakePiece& take);
	// Waits until everything enqueued is done; reports errors of launches before it.
	virtual Status wait() = 0;

protected:
	DeviceInfo info_;
};
using DeviceHandle = std::shared_ptr<Device>;

class Backend {
public:
	virtual ~Backend() = default;
	virtual const char* name() const = 0;
	// Never fails: what is missing is told as an Absence.
	virtual Enumeration enumerate() = 0;
	virtual Result<DeviceHandle> open(const DeviceInfo& info) = 0;
};

} // namespace rt
