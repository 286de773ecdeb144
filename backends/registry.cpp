#include "backends/registry.h"

#include "backends/cuda/cuda_backend.h"
#include "backends/opencl/opencl_backend.h"
#include "backends/reference/reference_backend.h"
#ifdef RT_WITH_NAIVE_PORT
#include "examples/naive_port/naive_backend.h"
#endif

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cstdlib>
#include <iterator>
#include <string_view>

namespace rt {

const std::vector<Backend*>& backends()
{
	static const std::vector<Backend*> list = {
	    &cuda_backend(),
	    &opencl_backend(),
	    &reference_backend(),
#ifdef RT_WITH_NAIVE_PORT // in examples/naive_port's programs only
	    &naive_backend(),
#endif
	};
	return list;
}

namespace {

constexpr const char* any_backend = "auto";

void enumerate_into(Enumeration& all, Backend& backend)
{
	Enumeration found = backend.enumerate();
	std::move(found.devices.begin(), found.devices.end(), std::back_inserter(all.devices));
	std::move(found.absences.begin(), found.absences.end(), std::back_inserter(all.absences));
}

std::string lower(std::string_view text)
{
	std::string result(text);
	for (char& c : result)
		c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
	return result;
}

std::string_view trim(std::string_view text)
{
	while (!text.empty() && std::isspace(static_cast<unsigned char>(text.front())))
		text.remove_prefix(1);
	while (!text.empty() && std::isspace(static_cast<unsigned char>(text.back())))
		text.remove_suffix(1);
	return text;
}

// Tools write one address as 3b:00.0, 0000:3b:00.0 (lspci) and 00000000:3B:00.0 (nvidia-smi).
std::string pci_address(std::string_view text)
{
	std::string address = lower(text);
	if (std::count(address.begin(), address.end(), ':') == 1)
		address = "0000:" + address;
	const std::size_t domain = address.find(':');
	if (domain != std::string::npos && domain > 4 && address.compare(0, domain - 4, std::string(domain - 4, '0')) == 0)
		address.erase(0, domain - 4);
	return address;
}

// nvidia-smi writes GPU-xxxxxxxx-xxxx-...; other tools leave out the dashes.
std::string uuid_digits(std::string_view text)
{
	std::string digits = lower(text);
	if (digits.compare(0, 4, "gpu-") == 0 || digits.compare(0, 4, "mig-") == 0)
		digits.erase(0, 4);
	digits.erase(std::remove(digits.begin(), digits.end(), '-'), digits.end());
	return digits;
}

bool has_prefix(std::string_view text, std::string_view prefix) { return text.substr(0, prefix.size()) == prefix; }

// Does one item of --device, other than an index, mean this device?
bool matches(const DeviceInfo& device, const std::string& item)
{
	const std::string wanted = lower(item);
	if (has_prefix(wanted, "pci:"))
		return !device.pci.empty() && device.pci == pci_address(wanted.substr(4));
	if (has_prefix(wanted, "uuid:"))
		return !device.uuid.empty() && uuid_digits(device.uuid) == uuid_digits(wanted.substr(5));
	return lower(device.id) == wanted || lower(device.backend + ":" + device.name).find(wanted) != std::string::npos;
}

using Indices = std::vector<std::size_t>; // into Enumeration::devices, ascending

// A request with everything that its error messages need.
class Selection {
public:
	Selection(const DeviceRequest& request, const Enumeration& found) : request_(request), found_(found) {}

	// The best device, without --device: by kind, and within a kind by the order of backends.
	Result<std::size_t> best() const
	{
		const auto rank = [this](std::size_t index) {
			if (found_.devices[index].only_if_named)
				return 4;
			switch (found_.devices[index].kind) {
			case DeviceKind::Gpu:
				return 0;
			case DeviceKind::Accelerator:
				return 1;
			case DeviceKind::Cpu:
				return 2;
			case DeviceKind::Host:
				break;
			}
			return 3;
		};
		Indices usable = usable_of(allowed());
		const bool any = !usable.empty();
		usable.erase(
		    std::remove_if(usable.begin(), usable.end(),
		                   [this](std::size_t i) { return !check_precision(found_.devices[i], request_.precision); }),
		    usable.end());
		const auto best = std::min_element(usable.begin(), usable.end(),
		                                   [&](std::size_t a, std::size_t b) { return rank(a) < rank(b); });
		if (best != usable.end())
			return *best;
		if (any)
			return failure(fmt::format("no usable device{} computes in precision {}", of_backend(),
			                           precision_name(request_.precision)));
		return failure(any_backend == request_.backend
		                   ? std::string("no backend has a usable device")
		                   : fmt::format("the {} backend has no usable device", request_.backend));
	}

	// The device that one item of --device means.
	Result<std::size_t> find(const std::string& item) const
	{
		if (const Result<std::size_t> index = by_index(item); !index || *index < found_.devices.size())
			return index;
		Indices candidates;
		for (std::size_t index : allowed())
			if (matches(found_.devices[index], item))
				candidates.push_back(index);
		if (candidates.empty())
			return failure(fmt::format("no device matches '{}'{}", item, of_backend()));
		// A device that cannot be used does not make a name ambiguous.
		if (const Indices usable = usable_of(candidates); !usable.empty())
			candidates = usable;
		if (any_backend == request_.backend)
			candidates = without_second_views(candidates);
		if (candidates.size() == 1)
			return checked(candidates[0]);
		return Error{ErrorKind::NoDevice,
		             fmt::format("'{}' matches {} devices", item, candidates.size()),
		             "--device",
		             "name one of them by its index or a longer part of its name:\n" + table(candidates),
		             {}};
	}

private:
	bool is_allowed(std::size_t index) const
	{
		return any_backend == request_.backend || found_.devices[index].backend == request_.backend;
	}

	Indices allowed() const
	{
		Indices result;
		for (std::size_t i = 0; i < found_.devices.size(); ++i)
			if (is_allowed(i))
				result.push_back(i);
		return result;
	}

	Indices usable_of(const Indices& from) const
	{
		Indices result;
		std::copy_if(from.begin(), from.end(), std::back_inserter(result),
		             [this](std::size_t i) { return found_.devices[i].usable; });
		return result;
	}

	// Of the views of one GPU, only the first: that of the better backend. Parts of a GPU, which share its address and
	// are shown by one backend, stay apart.
	Indices without_second_views(const Indices& from) const
	{
		Indices result;
		for (std::size_t i : from) {
			const DeviceInfo& device = found_.devices[i];
			const bool seen = std::any_of(result.begin(), result.end(), [&](std::size_t j) {
				const DeviceInfo& other = found_.devices[j];
				return !device.pci.empty() && device.pci == other.pci && device.backend != other.backend;
			});
			if (!seen)
				result.push_back(i);
		}
		return result;
	}

	// The device of that number; the count of devices if the item is to be taken as a name. A number too large for an
	// index is one if it has at least three digits: "4090" means a name, "7" on a machine with three devices a mistake.
	Result<std::size_t> by_index(const std::string& item) const
	{
		const std::size_t none = found_.devices.size();
		if (item.empty() || item.size() > 9 || item.find_first_not_of("0123456789") != std::string::npos)
			return none;
		const std::size_t index = std::strtoul(item.c_str(), nullptr, 10);
		if (index >= none && item.size() >= 3)
			return none;
		if (index >= none)
			return failure(fmt::format("there is no device {}", index));
		if (!is_allowed(index))
			return failure(fmt::format("device {} ({}) is not of the {} backend", index, found_.devices[index].name,
			                           request_.backend));
		return checked(index);
	}

	Result<std::size_t> checked(std::size_t index) const
	{
		const DeviceInfo& device = found_.devices[index];
		if (device.usable) {
			RT_TRY(check_precision(device, request_.precision));
			return index;
		}
		return Error{ErrorKind::NoDevice,
		             fmt::format("{} cannot be used: {}", device.name, device.why_not),
		             fmt::format("device {} ({})", index, device.backend),
		             "choose another device (`rt devices` lists them)",
		             {}};
	}

	std::string of_backend() const
	{
		return any_backend == request_.backend ? "" : fmt::format(" of the {} backend", request_.backend);
	}

	std::string table(const Indices& indices) const
	{
		std::string text;
		for (std::size_t i : indices) {
			const DeviceInfo& device = found_.devices[i];
			text += fmt::format("{}  {}  {}  {}{}\n", i, device.backend, device.name, device.id,
			                    device.usable ? "" : "  (unusable: " + device.why_not + ")");
		}
		return text;
	}

	// A NoDevice error that says what there is and what is missing.
	Error failure(std::string message) const
	{
		const Indices there = allowed();
		std::string cure = there.empty() ? "" : "the devices are:\n" + table(there);
		for (const Absence& absence : found_.absences)
			if (any_backend == request_.backend || absence.backend == request_.backend)
				cure += fmt::format("{}: {}\n{}\n", absence.backend, absence.reason, absence.cure);
		while (!cure.empty() && cure.back() == '\n')
			cure.pop_back();
		return Error{ErrorKind::NoDevice, std::move(message), {}, std::move(cure), {}};
	}

	const DeviceRequest& request_;
	const Enumeration& found_;
};

Status check_backend(const std::string& name)
{
	std::string known = any_backend;
	if (name == known)
		return success();
	for (const Backend* backend : backends()) {
		if (name == backend->name())
			return success();
		known += fmt::format(", {}", backend->name());
	}
	return Error{
	    ErrorKind::Usage, fmt::format("there is no backend '{}'", name), "--backend", "choose one of: " + known, {}};
}

} // namespace

Enumeration enumerate_all()
{
	Enumeration all;
	for (Backend* backend : backends())
		enumerate_into(all, *backend);
	return all;
}

Result<std::vector<DeviceInfo>> find_devices(const DeviceRequest& request)
{
	// Numbers count the devices of all backends, and part of a name may mean any of them.
	if (trim(request.device).empty()) {
		Enumeration found;
		for (Backend* backend : backends()) {
			const bool named = request.backend == backend->name();
			if (!named && request.backend != any_backend)
				continue;
			enumerate_into(found, *backend);
			Result<std::vector<DeviceInfo>> chosen = select_devices(request, found);
			// Among its equals, the first backend's device is the best.
			const bool best = chosen && chosen->front().kind == DeviceKind::Gpu && !chosen->front().only_if_named;
			if (best || (named && chosen))
				return chosen;
		}
		if (request.backend == any_backend)
			return select_devices(request, found);
	}
	// An error that lists the devices has their right numbers only from all of them.
	return select_devices(request, enumerate_all());
}

Result<std::vector<DeviceInfo>> select_devices(const DeviceRequest& request, const Enumeration& found)
{
	RT_TRY(check_backend(request.backend));
	const Selection selection(request, found);
	Indices chosen;
	if (trim(request.device).empty()) {
		RT_TRY_ASSIGN(const std::size_t best, selection.best());
		chosen.push_back(best);
	} else {
		for (std::string_view rest = request.device;;) {
			const std::size_t comma = rest.find(',');
			const std::string item(trim(rest.substr(0, comma)));
			if (item.empty())
				return Error{ErrorKind::Usage,
				             "an item of the device list is empty",
				             "--device " + request.device,
				             "separate indices or names by single commas",
				             {}};
			RT_TRY_ASSIGN(const std::size_t index, selection.find(item));
			if (std::find(chosen.begin(), chosen.end(), index) != chosen.end())
				return Error{ErrorKind::Usage,
				             fmt::format("'{}' means device {}, which the list already has", item, index),
				             "--device " + request.device,
				             "name every device once",
				             {}};
			chosen.push_back(index);
			if (comma == std::string_view::npos)
				break;
			rest.remove_prefix(comma + 1);
		}
	}
	std::vector<DeviceInfo> result;
	for (std::size_t index : chosen)
		result.push_back(found.devices[index]);
	return result;
}

Result<DeviceHandle> open_device(const DeviceInfo& info)
{
	for (Backend* backend : backends())
		if (info.backend == backend->name())
			return backend->open(info);
	return Error{ErrorKind::Failure, fmt::format("there is no backend '{}'", info.backend), info.name, {}, {}};
}

} // namespace rt
