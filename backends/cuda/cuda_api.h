// cuda_api.h: the part of the CUDA driver API that rt calls, found in libcuda when rt runs.
//
// Types, numbers and signatures are declared here, so that no CUDA header is needed to build. Function names carry the
// suffix of the library's symbol (_v2): without it a symbol may be an older function with 32-bit sizes.
#pragma once

#include "support/dynamic_library.h"
#include "support/result.h"

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>

namespace rt {

using CuResult = int;
using CuDevice = int;
using CuDevicePtr = unsigned long long;
using CuContext = struct CUctx_st*;
using CuModule = struct CUmod_st*;
using CuFunction = struct CUfunc_st*;
using CuStream = struct CUstream_st*;

struct CuUuid {
	unsigned char bytes[16];
};

// CUresult, CUdevice_attribute, CUfunction_attribute, CUjit_option and CUcomputemode, as far as they are used here.
constexpr CuResult cu_success = 0;
constexpr CuResult cu_error_out_of_memory = 2;
constexpr CuResult cu_error_stub_library = 34;
constexpr CuResult cu_error_device_unavailable = 46;
constexpr CuResult cu_error_no_device = 100;
constexpr CuResult cu_error_invalid_image = 200;
constexpr CuResult cu_error_no_binary_for_gpu = 209;
constexpr CuResult cu_error_ecc_uncorrectable = 214;
constexpr CuResult cu_error_jit_compiler_not_found = 221;
constexpr CuResult cu_error_unsupported_ptx_version = 222;
constexpr CuResult cu_error_illegal_address = 700;
constexpr CuResult cu_error_launch_timeout = 702;
constexpr CuResult cu_error_system_not_ready = 802;
constexpr CuResult cu_error_system_driver_mismatch = 803;
constexpr CuResult cu_error_compat_not_supported = 804;
constexpr CuResult cu_error_unknown = 999;
constexpr int cu_attribute_multiprocessor_count = 16;
constexpr int cu_attribute_compute_mode = 20;
constexpr int cu_attribute_compute_capability_major = 75;
constexpr int cu_attribute_compute_capability_minor = 76;
constexpr int cu_compute_mode_prohibited = 2;
constexpr int cu_attribute_max_threads_per_multiprocessor = 39;
constexpr int cu_function_max_threads_per_block = 0;
constexpr int cu_function_local_size_bytes = 3;
constexpr int cu_function_registers = 4;
constexpr int cu_jit_info_log_buffer = 3;
constexpr int cu_jit_info_log_buffer_size = 4;
constexpr int cu_jit_error_log_buffer = 5;
constexpr int cu_jit_error_log_buffer_size = 6;
constexpr unsigned cu_stream_non_blocking = 1;

// The driver's entry points: X(name, parameters). One list declares and loads them.
#define RT_CUDA_REQUIRED(X)                                                                                        \
	X(cuInit, (unsigned flags))                                                                                    \
	X(cuDriverGetVersion, (int* version))                                                                          \
	X(cuGetErrorName, (CuResult error, const char** name))                                                         \
	X(cuGetErrorString, (CuResult error, const char** text))                                                       \
	X(cuDeviceGetCount, (int* count))                                                                              \
	X(cuDeviceGet, (CuDevice * device, int ordinal))                                                               \
	X(cuDeviceGetName, (char* name, int bytes, CuDevice device))                                                   \
	X(cuDeviceGetAttribute, (int* value, int attribute, CuDevice device))                                          \
	X(cuDeviceGetPCIBusId, (char* id, int bytes, CuDevice device))                                                 \
	X(cuDeviceTotalMem_v2, (std::size_t * bytes, CuDevice device))                                                 \
	X(cuDevicePrimaryCtxRetain, (CuContext * context, CuDevice device))                                            \
	X(cuCtxSetCurrent, (CuContext context))                                                                        \
	X(cuStreamCreate, (CuStream * stream, unsigned flags))                                                         \
	X(cuStreamDestroy_v2, (CuStream stream))                                                                       \
	X(cuStreamSynchronize, (CuStream stream))                                                                      \
	X(cuMemGetInfo_v2, (std::size_t * free, std::size_t * total))                                                  \
	X(cuMemAlloc_v2, (CuDevicePtr * pointer, std::size_t bytes))                                                   \
	X(cuMemFree_v2, (CuDevicePtr pointer))                                                                         \
	X(cuMemHostAlloc, (void** pointer, std::size_t bytes, unsigned flags))                                         \
	X(cuMemFreeHost, (void* pointer))                                                                              \
	X(cuMemcpyHtoDAsync_v2, (CuDevicePtr target, const void* source, std::size_t bytes, CuStream stream))          \
	X(cuMemcpyDtoHAsync_v2, (void* target, CuDevicePtr source, std::size_t bytes, CuStream stream))                \
	X(cuModuleLoadDataEx, (CuModule * module, const void* image, unsigned options, int* names, void** values))     \
	X(cuModuleUnload, (CuModule module))                                                                           \
	X(cuModuleGetFunction, (CuFunction * function, CuModule module, const char* name))                             \
	X(cuFuncGetAttribute, (int* value, int attribute, CuFunction function))                                        \
	X(cuLaunchKernel,                                                                                              \
	  (CuFunction function, unsigned grid_x, unsigned grid_y, unsigned grid_z, unsigned group_x, unsigned group_y, \
	   unsigned group_z, unsigned shared_bytes, CuStream stream, void** parameters, void** extra))

// nullptr in drivers that lack them. The first two have a newer and an older form of the same signature.
#define RT_CUDA_OPTIONAL(X)                                                                                    \
	X(cuDevicePrimaryCtxRelease_v2, (CuDevice device))                                                         \
	X(cuDevicePrimaryCtxRelease, (CuDevice device))                                                            \
	X(cuDeviceGetUuid_v2, (CuUuid * uuid, CuDevice device))                                                    \
	X(cuDeviceGetUuid, (CuUuid * uuid, CuDevice device))                                                       \
	X(cuFuncGetParamInfo, (CuFunction function, std::size_t index, std::size_t * offset, std::size_t * bytes)) \
	X(cuOccupancyMaxActiveBlocksPerMultiprocessor,                                                             \
	  (int* blocks, CuFunction function, int group_size, std::size_t shared_bytes))

class CudaApi {
public:
	// Loads libcuda once a process and keeps it. Error kind NoDevice with the packages that bring a driver, or with the
	// name of the symbol that the driver lacks.
	static const Result<const CudaApi*>& load();

#define RT_CUDA_DECLARE(name, parameters) CuResult(*name) parameters = nullptr;
	RT_CUDA_REQUIRED(RT_CUDA_DECLARE)
	RT_CUDA_OPTIONAL(RT_CUDA_DECLARE)
#undef RT_CUDA_DECLARE

	// "CUDA_ERROR_NAME (the driver's text)"
	std::string describe(CuResult result) const;
	// What a failed call becomes: its name, the driver's words, and what helps against this result.
	Error error(CuResult result, const char* call, const std::string& where) const;

private:
	std::shared_ptr<DynamicLibrary> library_;
};

} // namespace rt
