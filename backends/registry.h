// registry.h: the list of backends, and the choice of devices for a run.
#pragma once

#include "backends/backend.h"
#include "backends/precision.h"

#include <string>
#include <vector>

namespace rt {

// Every backend, best first. A new backend is one line in registry.cpp.
const std::vector<Backend*>& backends();

// All devices of all backends in the order in which `rt devices` numbers them, and why others are missing.
// Two views of one GPU (CUDA and OpenCL) carry the same `pci`.
Enumeration enumerate_all();

struct DeviceRequest {
	std::string backend = "auto"; // auto, cuda, opencl, reference
	std::string device;           // empty, or a comma list of: index, part of a name, pci:..., uuid:...
	// A device that cannot compute in it is passed over, or refused if it is named.
	Precision precision = Precision::Exact;
};

// The devices that a request means. Without `device`, the best usable one of the backend asked for: CUDA GPU,
// other GPU, CPU OpenCL, reference. Errors: Usage for an unknown backend, NoDevice for no match (lists what
// there is, with absences) and for a name that matches several (lists the candidates).
Result<std::vector<DeviceInfo>> select_devices(const DeviceRequest& request, const Enumeration& found);

// The same of this machine's devices. A driver takes up to a tenth of a second to look for its own: those are left
// alone whose devices could not be chosen.
Result<std::vector<DeviceInfo>> find_devices(const DeviceRequest& request);

Result<DeviceHandle> open_device(const DeviceInfo& info);

} // namespace rt
