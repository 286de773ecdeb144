#include "verify/host_facts.h"

#include "backends/kernel_text.h"
#include "backends/reference/reference_backend.h"
#include "common/rt_contract.h"
#include "support/thread_pool.h"
#include "version.h"

#include <fmt/format.h>

#include <ctime>
#include <fstream>

#include <sys/utsname.h>

namespace rt {

namespace {

std::string system_name()
{
	std::ifstream file("/etc/os-release");
	const std::string key = "PRETTY_NAME=";
	for (std::string line; std::getline(file, line);)
		if (line.compare(0, key.size(), key) == 0) {
			std::string name = line.substr(key.size());
			if (name.size() >= 2 && name.front() == '"' && name.back() == '"')
				name = name.substr(1, name.size() - 2);
			return name;
		}
	return "Linux";
}

std::string kernel_name()
{
	utsname names = {};
	if (uname(&names) != 0)
		return {};
	return fmt::format("{} {} {}", names.sysname, names.release, names.machine);
}

std::string today()
{
	const std::time_t now = std::time(nullptr);
	std::tm local = {};
	char text[16] = {};
	if (localtime_r(&now, &local) == nullptr || std::strftime(text, sizeof text, "%Y-%m-%d", &local) == 0)
		return {};
	return text;
}

} // namespace

HostFacts host_facts()
{
	HostFacts facts;
	facts.version = RT_VERSION;
	facts.revision = RT_REVISION;
	facts.contract = RT_CONTRACT_VERSION;
	facts.kernels = kernel_hash();
	facts.system = system_name();
	facts.kernel = kernel_name();
	facts.threads = thread_count();
	facts.date = today();
	for (const DeviceInfo& host : reference_backend().enumerate().devices) {
		facts.processor = host.name;
		facts.memory_bytes = host.memory_bytes;
		facts.compiler = host.compiler;
	}
	return facts;
}

} // namespace rt
