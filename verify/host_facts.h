// host_facts.h: the machine and this build of rt, as far as a reader of a report needs them.
#pragma once

#include <cstdint>
#include <string>

namespace rt {

struct HostFacts {
	std::string version, revision; // of rt
	int contract = 0;
	std::string kernels;   // hash of the kernels' text
	std::string system;    // "Debian GNU/Linux 12 (bookworm)"
	std::string kernel;    // "Linux 6.1.0-13-amd64 x86_64"
	std::string processor; // "AMD EPYC"
	unsigned threads = 0;  // that rt uses
	std::uint64_t memory_bytes = 0;
	std::string compiler; // that built rt, which is the reference backend's
	std::string date;     // "2026-11-22"
};

HostFacts host_facts();

} // namespace rt
