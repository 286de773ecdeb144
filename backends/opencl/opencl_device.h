// opencl_device.h: one OpenCL device, opened: context, queue, buffers, programs and their cache.
#pragma once

#include "backends/backend.h"
#include "backends/opencl/opencl_api.h"
#include "support/result.h"

#include <string>

namespace rt {

// What enumeration finds out about a device, for its opening.
struct OpenClDeviceRecord {
	cl_device_id id = nullptr;
	cl_platform_id platform = nullptr;
	DeviceInfo info;
	std::string options;             // for its compiler
	bool may_take_ptx = false;       // worth trying inline PTX
	bool driver_caches_code = false; // leave the keeping of compiled kernels to the driver
};

Result<DeviceHandle> open_opencl_device(const OpenClApi& api, const OpenClDeviceRecord& record);

} // namespace rt
