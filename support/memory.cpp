#include "support/memory.h"

#include <fstream>
#include <string>

namespace rt {

std::uint64_t available_host_bytes()
{
	std::ifstream file("/proc/meminfo");
	std::string key, unit;
	for (std::uint64_t kilobytes; file >> key >> kilobytes; std::getline(file, unit))
		if (key == "MemAvailable:")
			return kilobytes * 1024;
	return 0;
}

} // namespace rt
