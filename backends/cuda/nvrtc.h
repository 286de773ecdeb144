// nvrtc.h: NVIDIA's run-time compiler, found when rt runs; it needs no GPU and no driver.
//
// Every program of rt is compiled with the options of nvrtc_options(): no contraction, no flushing of subnormals,
// correctly rounded division and square root (docs/contract.md, rules 3 and 4). The fast rung lets the first two go.
#pragma once

#include "support/dynamic_library.h"
#include "support/result.h"

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace rt {

// What code is made for: a GPU of this compute capability alone (cubin), or it and all later ones (PTX).
struct NvrtcTarget {
	int capability = 0; // 10 major + minor: 90 for 9.0
	bool binary = false;
	std::string option() const; // "--gpu-architecture=sm_90"
};

struct NvrtcOutput {
	std::vector<std::uint8_t> image; // a cubin, or PTX with its final zero byte
	std::string log;                 // warnings; empty if there are none
};

class Nvrtc {
public:
	// Loads NVRTC once a process and keeps it. `driver_major` is the driver's CUDA version (0: no driver): compilers
	// not newer than it are tried first, since a driver may not take a newer one's code. Error kind NoDevice with the
	// packages that bring it.
	static const Result<const Nvrtc*>& load(int driver_major = 0);

	std::string version() const; // "NVRTC 13.0"
	const std::string& path() const { return library_->path(); }
	const std::vector<int>& capabilities() const { return capabilities_; } // ascending: 75, 80, ...

	// The best target for a GPU: its own binary code, else PTX of the highest capability not above it. NoDevice if the
	// GPU is older than all that this NVRTC knows.
	Result<NvrtcTarget> target_for(int capability) const;

	// Compiles `text`, called `name` in messages. Error kind Build carries NVRTC's log.
	Result<NvrtcOutput> compile(const std::string& text, const std::string& name, const NvrtcTarget& target,
	                            const std::vector<std::string>& options) const;

private:
	using Program = struct NvrtcProgram*;

// X(name, parameters), all returning nvrtcResult; present since CUDA 11.2.
#define RT_NVRTC_SYMBOLS(X)                                                                         \
	X(nvrtcVersion, (int* major, int* minor))                                                       \
	X(nvrtcGetNumSupportedArchs, (int* count))                                                      \
	X(nvrtcGetSupportedArchs, (int* archs))                                                         \
	X(nvrtcCreateProgram, (Program * program, const char* text, const char* name, int header_count, \
	                       const char* const* headers, const char* const* header_names))            \
	X(nvrtcDestroyProgram, (Program * program))                                                     \
	X(nvrtcCompileProgram, (Program program, int option_count, const char* const* options))         \
	X(nvrtcGetPTXSize, (Program program, std::size_t * bytes))                                      \
	X(nvrtcGetPTX, (Program program, char* ptx))                                                    \
	X(nvrtcGetCUBINSize, (Program program, std::size_t * bytes))                                    \
	X(nvrtcGetCUBIN, (Program program, char* cubin))                                                \
	X(nvrtcGetProgramLogSize, (Program program, std::size_t * bytes))                               \
	X(nvrtcGetProgramLog, (Program program, char* log))

#define RT_NVRTC_DECLARE(name, parameters) int(*name##_) parameters = nullptr;
	RT_NVRTC_SYMBOLS(RT_NVRTC_DECLARE)
#undef RT_NVRTC_DECLARE
	const char* (*nvrtcGetErrorString_)(int result) = nullptr;

	Status open(int driver_major);
	Error error(int result, const char* call, const std::string& where) const;
	std::string program_log(Program program) const;

	std::shared_ptr<DynamicLibrary> library_;
	int major_ = 0, minor_ = 0;
	std::vector<int> capabilities_;
};

// The options that keep the contract; the target's option is added by compile(). `contract` lets the compiler fuse
// products and sums, for the tests that show that it finds none (RT_DEF_CONTRACT).
// registers: a thread may take at most; 0: the compiler's choice.
std::vector<std::string> nvrtc_options(bool contract = false, bool flush = false, std::uint32_t registers = 0);

// The packages that bring NVRTC, one distribution a line.
const char* nvrtc_packages();

} // namespace rt
