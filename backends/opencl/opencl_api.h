// opencl_api.h: OpenCL 1.2 as rt uses it: the ICD loader's functions found at run time, error codes in words, and what
// is registered with the loader.
//
// The loader is never unloaded: drivers start threads and exit handlers of their own, which crash if the code under
// them goes away before the process does.
#pragma once

#include "backends/backend.h"
#include "support/result.h"

#define CL_TARGET_OPENCL_VERSION 120
#include <CL/cl.h>
#include <CL/cl_ext.h>

#include <string>
#include <vector>

// X(name): every function that rt calls, without its prefix "cl".
#define RT_OPENCL_FUNCTIONS(X) \
	X(GetPlatformIDs)          \
	X(GetPlatformInfo)         \
	X(GetDeviceIDs)            \
	X(GetDeviceInfo)           \
	X(CreateContext)           \
	X(ReleaseContext)          \
	X(CreateCommandQueue)      \
	X(ReleaseCommandQueue)     \
	X(CreateProgramWithSource) \
	X(CreateProgramWithBinary) \
	X(BuildProgram)            \
	X(GetProgramInfo)          \
	X(GetProgramBuildInfo)     \
	X(ReleaseProgram)          \
	X(CreateKernel)            \
	X(SetKernelArg)            \
	X(GetKernelWorkGroupInfo)  \
	X(ReleaseKernel)           \
	X(CreateBuffer)            \
	X(ReleaseMemObject)        \
	X(EnqueueWriteBuffer)      \
	X(EnqueueReadBuffer)       \
	X(EnqueueMapBuffer)        \
	X(EnqueueUnmapMemObject)   \
	X(EnqueueNDRangeKernel)    \
	X(Flush)                   \
	X(Finish)                  \
	X(GetEventInfo)            \
	X(ReleaseEvent)

namespace rt {

struct OpenClApi {
#define RT_DECLARE(name) decltype(::cl##name)* name = nullptr;
	RT_OPENCL_FUNCTIONS(RT_DECLARE)
#undef RT_DECLARE
};

// The functions, loaded at the first call; NoDevice with the package to install if there is no loader.
const Result<const OpenClApi*>& opencl_api();

// "CL_OUT_OF_RESOURCES (-5): the driver ran out of resources, or a kernel failed"
std::string opencl_code_in_words(cl_int code);

// An error of `call` ("clFinish") on `device`. Codes that mean too little memory become kind Memory.
Error opencl_error(const char* call, cl_int code, const std::string& device);

// What is registered with the loader and cannot serve, and an NVIDIA driver that is not registered at all.
// `platform_vendors` are those of the platforms that the loader showed.
std::vector<Absence> opencl_registration_absences(const std::vector<std::string>& platform_vendors);

} // namespace rt
