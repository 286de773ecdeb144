#include "tools/measuring.h"

#include "backends/self_test.h"
#include "tools/render_stats.h"
#include "version.h"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <cstdio>
#include <ctime>

namespace rt {

std::string measuring_usage(const MeasuringOptions& defaults)
{
	return fmt::format(
	    R"(  --device X      index, part of a name, pci:... or uuid:... (rt devices); the best one if left out
  --backend B     auto, cuda, opencl, reference
  --size WxH      of the image ({}x{})
  --spp N         samples a pixel ({})
  --rounds N      how often everything is measured ({})
  --json FILE     write the results there, too
)",
	    defaults.width, defaults.height, defaults.samples, defaults.rounds);
}

Status read_measuring_options(int argc, char** argv, const char* program, const OwnOption& own,
                              MeasuringOptions& options)
{
	for (int i = 1; i < argc; ++i) {
		const std::string name = argv[i];
		if (name == "--help" || name == "-h") {
			options.help = true;
			continue;
		}
		if (name.rfind("--", 0) != 0) {
			options.scenes.push_back(name);
			continue;
		}
		const char* value = i + 1 < argc ? argv[++i] : "";
		bool good = *value != '\0';
		if (name == "--device")
			options.device.device = value;
		else if (name == "--backend")
			options.device.backend = value;
		else if (name == "--size")
			good = std::sscanf(value, "%ux%u", &options.width, &options.height) == 2;
		else if (name == "--spp")
			good = std::sscanf(value, "%u", &options.samples) == 1;
		else if (name == "--rounds")
			good = std::sscanf(value, "%u", &options.rounds) == 1 && options.rounds > 0;
		else if (name == "--json")
			options.json = value;
		else
			good = good && own(name, value);
		if (!good)
			return Error{ErrorKind::Usage, fmt::format("{} '{}' is not understood", name, value), "command line",
			             fmt::format("{} --help lists the options", program), ""};
	}
	if (options.scenes.empty())
		options.scenes = {"three-spheres"};
	return success();
}

Result<MeasuredDevice> open_measured_device(const DeviceRequest& request)
{
	RT_TRY_ASSIGN(const std::vector<DeviceInfo> chosen, find_devices(request));
	RT_TRY_ASSIGN(DeviceHandle device, open_device(chosen.front()));
	RT_TRY_ASSIGN(const SelfTestReport tested, self_test(device));
	if (!tested.passed)
		return failed_self_test(chosen.front(), tested, "is an option of rt alone");
	return MeasuredDevice{std::move(device), tested.needs_software_roots};
}

double median(std::vector<double> values)
{
	std::sort(values.begin(), values.end());
	return values[values.size() / 2];
}

nlohmann::ordered_json measuring_head(const MeasuringOptions& options, const DeviceInfo& info)
{
	return {{"version", RT_VERSION},
	        {"revision", RT_REVISION},
	        {"date", fmt::format("{:%Y-%m-%dT%H:%M:%SZ}", fmt::gmtime(std::time(nullptr)))},
	        {"device", device_json(info)},
	        {"width", options.width},
	        {"height", options.height},
	        {"samples", options.samples},
	        {"rounds", options.rounds}};
}

} // namespace rt
