// Which devices a request means, on machines that are made up.
#include "tests/catch.h"

#include "backends/registry.h"

#include <string>
#include <vector>

namespace {

rt::DeviceInfo device(const char* backend, const char* name, rt::DeviceKind kind, const char* pci = "",
                      const char* uuid = "")
{
	rt::DeviceInfo info;
	info.backend = backend;
	info.name = name;
	info.kind = kind;
	info.pci = pci;
	info.uuid = uuid;
	info.id = *pci ? std::string("pci:") + pci : *uuid ? std::string("uuid:") + uuid : std::string();
	return info;
}

// 0 and 1: two H100 through CUDA; 2 and 3: the same through OpenCL; 4: a Radeon; 5: a processor; 6: the host.
rt::Enumeration workstation()
{
	rt::Enumeration found;
	found.devices = {
	    device("cuda", "NVIDIA H100 80GB", rt::DeviceKind::Gpu, "0000:3b:00.0", "1daeee60-b005-0c67-bbae-6347430637ed"),
	    device("cuda", "NVIDIA H100 80GB", rt::DeviceKind::Gpu, "0000:af:00.0", "2daeee60-b005-0c67-bbae-6347430637ed"),
	    device("opencl", "NVIDIA H100 80GB", rt::DeviceKind::Gpu, "0000:3b:00.0",
	           "1daeee60-b005-0c67-bbae-6347430637ed"),
	    device("opencl", "NVIDIA H100 80GB", rt::DeviceKind::Gpu, "0000:af:00.0",
	           "2daeee60-b005-0c67-bbae-6347430637ed"),
	    device("opencl", "Radeon RX 7900", rt::DeviceKind::Gpu, "0001:03:00.0"),
	    device("opencl", "pthread-AMD EPYC", rt::DeviceKind::Cpu),
	    device("reference", "AMD EPYC (host compiler)", rt::DeviceKind::Host),
	};
	found.absences = {{"opencl", "a driver is not registered", "register it"}};
	return found;
}

// What a request selects, as indices into `found`.
std::vector<int> indices(const rt::DeviceRequest& request, const rt::Enumeration& found)
{
	rt::Enumeration numbered = found;
	for (std::size_t i = 0; i < numbered.devices.size(); ++i)
		numbered.devices[i].index_in_backend = static_cast<int>(i);
	const auto selected = rt::select_devices(request, numbered);
	if (!selected) {
		FAIL(selected.error().message);
		return {};
	}
	std::vector<int> result;
	for (const rt::DeviceInfo& info : selected.value())
		result.push_back(info.index_in_backend);
	return result;
}

rt::Error error(const rt::DeviceRequest& request, const rt::Enumeration& found)
{
	const auto selected = rt::select_devices(request, found);
	REQUIRE_FALSE(selected);
	return selected.error();
}

bool contains(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

using Indices = std::vector<int>;

} // namespace

TEST_CASE("without a device, the best usable one of the backend")
{
	rt::Enumeration found = workstation();
	CHECK(indices({"auto", ""}, found) == Indices{0});
	CHECK(indices({"cuda", ""}, found) == Indices{0});
	CHECK(indices({"opencl", " "}, found) == Indices{2});
	CHECK(indices({"reference", ""}, found) == Indices{6});
	// Take the best away, one after the other.
	const std::vector<std::pair<int, int>> steps = {{0, 1}, {1, 2}, {2, 3}, {3, 4}, {4, 5}, {5, 6}};
	for (const auto& [gone, next] : steps) {
		found.devices[static_cast<std::size_t>(gone)].usable = false;
		CHECK(indices({"auto", ""}, found) == Indices{next});
	}
	found.devices[6].usable = false;
	const rt::Error none = error({"auto", ""}, found);
	CHECK(none.kind == rt::ErrorKind::NoDevice);
	CHECK(contains(none.cure, "register it"));
}

TEST_CASE("rank goes by kind before the order of backends")
{
	rt::Enumeration found;
	found.devices = {device("cuda", "a strange CPU", rt::DeviceKind::Cpu),
	                 device("opencl", "a host", rt::DeviceKind::Host),
	                 device("opencl", "an FPGA", rt::DeviceKind::Accelerator)};
	CHECK(indices({"auto", ""}, found) == Indices{2});
	found.devices.push_back(device("opencl", "a GPU", rt::DeviceKind::Gpu));
	CHECK(indices({"auto", ""}, found) == Indices{3});
	// An interpreter comes last, whatever it says that it is.
	found.devices[3].only_if_named = found.devices[2].only_if_named = true;
	CHECK(indices({"auto", ""}, found) == Indices{0});
	CHECK(indices({"auto", "GPU"}, found) == Indices{3});
}

TEST_CASE("by index")
{
	const rt::Enumeration found = workstation();
	CHECK(indices({"auto", "4"}, found) == Indices{4});
	CHECK(indices({"auto", "2, 0,6"}, found) == Indices{2, 0, 6}); // both views of a GPU may be asked for, in any order
	CHECK(indices({"opencl", "3"}, found) == Indices{3});
	const rt::Error other = error({"opencl", "0"}, found);
	CHECK(other.kind == rt::ErrorKind::NoDevice);
	CHECK(contains(other.message, "not of the opencl backend"));
	CHECK(contains(error({"auto", "7"}, found).message, "no device 7")); // and not the Radeon RX 7900
	CHECK(indices({"auto", "7900"}, found) == Indices{4});               // too large for an index, but part of a name
	CHECK(error({"auto", "99999999999999999999"}, found).kind == rt::ErrorKind::NoDevice);
}

TEST_CASE("by name")
{
	const rt::Enumeration found = workstation();
	CHECK(indices({"auto", "radeon"}, found) == Indices{4});
	CHECK(contains(error({"auto", "EPYC"}, found).message, "matches 2 devices")); // through OpenCL and the host
	CHECK(indices({"auto", "opencl:pthread"}, found) == Indices{5});
	CHECK(indices({"reference", "epyc"}, found) == Indices{6});
	CHECK(indices({"auto", "radeon,pthread"}, found) == Indices{4, 5});

	const rt::Error ambiguous = error({"auto", "h100"}, found);
	CHECK(ambiguous.kind == rt::ErrorKind::NoDevice);
	// Two GPUs, each with two views: the candidates are the CUDA views.
	CHECK(contains(ambiguous.message, "matches 2 devices"));
	CHECK(contains(ambiguous.cure, "0  cuda  NVIDIA H100 80GB"));
	CHECK(contains(ambiguous.cure, "1  cuda  NVIDIA H100 80GB"));
	CHECK_FALSE(contains(ambiguous.cure, "opencl"));
	CHECK(contains(error({"opencl", "h100"}, found).cure, "3  opencl  NVIDIA H100 80GB"));

	const rt::Error none = error({"auto", "voodoo"}, found);
	CHECK(none.kind == rt::ErrorKind::NoDevice);
	CHECK(contains(none.message, "voodoo"));
	CHECK(contains(none.cure, "4  opencl  Radeon RX 7900"));
	CHECK(contains(none.cure, "a driver is not registered"));
	CHECK(contains(none.cure, "register it"));
	CHECK_FALSE(contains(error({"cuda", "radeon"}, found).cure, "register it")); // another backend's absence
}

TEST_CASE("by PCI address and UUID")
{
	const rt::Enumeration found = workstation();
	for (const char* address : {"pci:0000:af:00.0", "PCI:AF:00.0", "pci:00000000:AF:00.0"}) {
		CHECK(indices({"auto", address}, found) == Indices{1}); // the CUDA view
		CHECK(indices({"opencl", address}, found) == Indices{3});
	}
	CHECK(indices({"auto", "pci:0001:03:00.0"}, found) == Indices{4});
	CHECK(error({"auto", "pci:03:00.0"}, found).kind == rt::ErrorKind::NoDevice); // domain 0 is meant
	CHECK(error({"auto", "pci:"}, found).kind == rt::ErrorKind::NoDevice);
	for (const char* uuid :
	     {"uuid:2daeee60-b005-0c67-bbae-6347430637ed", "uuid:GPU-2DAEEE60-b005-0c67-bbae-6347430637ed",
	      "uuid:2daeee60b0050c67bbae6347430637ed"}) {
		CHECK(indices({"auto", uuid}, found) == Indices{1});
		CHECK(indices({"opencl", uuid}, found) == Indices{3});
	}
	CHECK(error({"auto", "uuid:"}, found).kind == rt::ErrorKind::NoDevice);
}

TEST_CASE("views of one GPU, and parts of one")
{
	rt::Enumeration found = workstation();
	found.devices.erase(found.devices.begin() + 3);
	found.devices.erase(found.devices.begin() + 1);
	CHECK(indices({"auto", "h100"}, found) == Indices{0}); // one GPU, two views: CUDA's
	found.devices[0].usable = false;
	CHECK(indices({"auto", "h100"}, found) == Indices{1}); // the other view still works
	// Two parts of one GPU have one address and are two devices.
	found = {};
	found.devices = {device("cuda", "H100 MIG 1g", rt::DeviceKind::Gpu, "0000:3b:00.0", "a"),
	                 device("cuda", "H100 MIG 1g", rt::DeviceKind::Gpu, "0000:3b:00.0", "b")};
	CHECK(contains(error({"auto", "pci:3b:00.0"}, found).message, "matches 2 devices"));
	CHECK(indices({"auto", "uuid:b"}, found) == Indices{1});
}

TEST_CASE("a device that cannot be used is refused with its reason")
{
	rt::Enumeration found = workstation();
	found.devices[4].usable = false;
	found.devices[4].why_not = "its driver has no compiler";
	for (const char* item : {"4", "radeon", "pci:0001:03:00.0"}) {
		const rt::Error refused = error({"auto", item}, found);
		CHECK(refused.kind == rt::ErrorKind::NoDevice);
		CHECK(contains(refused.message, "its driver has no compiler"));
	}
}

TEST_CASE("requests that cannot be understood")
{
	const rt::Enumeration found = workstation();
	const rt::Error unknown = error({"metal", ""}, found);
	CHECK(unknown.kind == rt::ErrorKind::Usage);
	CHECK(contains(unknown.cure, "auto, cuda, opencl, reference"));
	for (const char* list : {"0,", ",0", "0,,1"})
		CHECK(error({"auto", list}, found).kind == rt::ErrorKind::Usage);
	CHECK(error({"auto", "4,radeon"}, found).kind == rt::ErrorKind::Usage); // one device twice
}

TEST_CASE("the machine's own devices")
{
	std::vector<std::string> names;
	for (const rt::Backend* backend : rt::backends())
		names.emplace_back(backend->name());
	CHECK(names == std::vector<std::string>{"cuda", "opencl", "reference"});
	const rt::Enumeration found = rt::enumerate_all();
	for (const rt::DeviceInfo& info : found.devices) {
		CHECK_FALSE(info.name.empty());
		CHECK(info.usable == info.why_not.empty());
	}
	for (const rt::Absence& absence : found.absences) {
		CHECK_FALSE(absence.reason.empty());
		CHECK_FALSE(absence.cure.empty());
	}
	CHECK(indices({"reference", ""}, found).size() == 1); // there is always the host
	rt::DeviceInfo unknown;
	unknown.backend = "metal";
	CHECK_FALSE(rt::open_device(unknown));
}

TEST_CASE("devices are the same whoever is asked for them")
{
	const rt::Enumeration found = rt::enumerate_all();
	const auto told = [](const rt::Result<std::vector<rt::DeviceInfo>>& devices) {
		std::string text;
		if (!devices)
			return devices.error().message + devices.error().where + devices.error().cure;
		for (const rt::DeviceInfo& info : *devices)
			text += info.backend + ":" + std::to_string(info.index_in_backend) + ":" + info.name + "\n";
		return text;
	};
	for (const char* backend : {"auto", "cuda", "opencl", "reference", "metal"})
		for (const char* device : {"", "0", "77", "no such device"}) {
			INFO(backend << ", " << device);
			const rt::DeviceRequest request{backend, device};
			CHECK(told(rt::find_devices(request)) == told(rt::select_devices(request, found)));
		}
}
