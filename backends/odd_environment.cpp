#include "backends/odd_environment.h"

#include "backends/program_cache.h"
#include "support/float_environment.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>
#include <string_view>

extern char** environ;

namespace rt {

namespace {

// Beside those that change a driver's code (changes_code()). A name that ends in _ stands for all that begin with it.
constexpr const char* telling_variables[] = {
    "GLIBC_TUNABLES",
    "GPU_DEVICE_ORDINAL",
    "HSA_",
    "LD_LIBRARY_PATH",
    "LD_PRELOAD",
    "LIBGL_ALWAYS_SOFTWARE",
    "NO_COLOR",
    "NVIDIA_",
    "OCL_ICD_",
    "OMP_NUM_THREADS",
    "OPENCL_VENDOR_PATH",
    "ROCR_VISIBLE_DEVICES",
    "RT_",
    "XDG_CACHE_HOME",
    "ZE_AFFINITY_MASK",
};

bool is_telling(std::string_view name)
{
	return changes_code(name) ||
	       std::any_of(std::begin(telling_variables), std::end(telling_variables), [name](std::string_view v) {
		       return v.back() == '_' ? name.substr(0, v.size()) == v : name == v;
	       });
}

void add_float_environment(std::vector<Oddity>& odd)
{
	const auto describe = [](const FloatEnvironment& environment) {
		std::string text = environment.flushes_subnormals ? "subnormals are flushed" : "";
		if (!environment.rounds_to_nearest)
			text += fmt::format("{}rounding is not to nearest", text.empty() ? "" : ", ");
		return text;
	};
	if (const FloatEnvironment start = inherited_float_environment(); !start.is_ieee())
		odd.push_back(
		    {"rt was started in a float environment in which " + describe(start),
		     "a preloaded library does that; rt sets its own environment wherever it computes, drivers may not",
		     {}});
	// main() set the contract's environment: whoever changed it since was loaded since.
	else if (const FloatEnvironment now = current_float_environment(); !now.is_ieee())
		odd.push_back({"since a driver was loaded, in this process " + describe(now),
		               "a library built with -ffast-math does that; rt sets its own environment wherever it computes, "
		               "other drivers may not",
		               {}});
}

} // namespace

std::string Oddity::headline() const
{
	if (devices.empty())
		return what;
	return fmt::format("device{} {}: {}", devices.size() == 1 ? "" : "s", fmt::join(devices, ", "), what);
}

std::vector<std::pair<std::string, std::string>> telling_environment()
{
	std::vector<std::pair<std::string, std::string>> found;
	for (char** entry = environ; entry != nullptr && *entry != nullptr; entry++) {
		const std::string_view text = *entry;
		const std::string_view name = text.substr(0, text.find('='));
		if (name.size() < text.size() && is_telling(name))
			found.emplace_back(name, text.substr(name.size() + 1));
	}
	std::sort(found.begin(), found.end());
	return found;
}

std::vector<std::pair<std::size_t, std::size_t>> views_of_one_device(const Enumeration& found)
{
	std::vector<std::pair<std::size_t, std::size_t>> pairs;
	const std::vector<DeviceInfo>& devices = found.devices;
	for (std::size_t i = 0; i < devices.size(); i++)
		for (std::size_t j = i + 1; j < devices.size(); j++) {
			const DeviceInfo &a = devices[i], &b = devices[j];
			// Parts of one GPU share its address within one platform, and have UUIDs of their own.
			const bool same = (!a.pci.empty() && a.pci == b.pci) || (!a.uuid.empty() && a.uuid == b.uuid);
			const bool parts = !a.uuid.empty() && !b.uuid.empty() && a.uuid != b.uuid;
			if (same && !parts && (a.backend != b.backend || a.platform != b.platform))
				pairs.emplace_back(i, j);
		}
	return pairs;
}

std::vector<Oddity> odd_environment(const Enumeration& found)
{
	std::vector<Oddity> odd;
	for (std::size_t i = 0; i < found.devices.size(); i++)
		for (const Quirk& quirk : found.devices[i].quirks) {
			if (!quirk.odd)
				continue;
			const auto known = std::find_if(odd.begin(), odd.end(),
			                                [&quirk](const Oddity& other) { return other.what == quirk.flag; });
			if (known != odd.end())
				known->devices.push_back(i);
			else
				odd.push_back({quirk.flag, quirk.reason, {i}});
		}
	for (const auto& [i, j] : views_of_one_device(found))
		odd.push_back({"one device, seen twice" + (found.devices[i].pci.empty() ? "" : ": pci:" + found.devices[i].pci),
		               "two drivers show it, each with a compiler of its own; a render must not use both at once",
		               {i, j}});
	if (const char* preload = std::getenv("LD_PRELOAD"); preload != nullptr && *preload != '\0')
		odd.push_back({fmt::format("LD_PRELOAD={}", preload),
		               "a library that stands before all others may replace any function of a driver",
		               {}});
	add_float_environment(odd);
	return odd;
}

} // namespace rt
