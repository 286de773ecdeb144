// verify_report.h: everything that a verification says, for the screen, for JSON, for HTML and for the ledger.
#pragma once

#include "backends/odd_environment.h"
#include "backends/registry.h"
#include "verify/host_facts.h"
#include "verify/verification.h"

#include <string>
#include <utility>
#include <vector>

namespace rt {

struct VerifyReport {
	HostFacts host;
	Enumeration found;
	std::vector<Oddity> odd;
	std::vector<std::pair<std::string, std::string>> environment; // variables that matter
	std::vector<std::size_t> left_out;                            // usable devices that only a name asks for
	VerifyDepth depth = VerifyDepth::Standard;
	bool probe_only = false;
	Verification verification;
};

// What the kernels ask of atomic operations.
constexpr const char* atomics_text =
    "additions of integers alone, where the lanes of a warp share pixels (NVIDIA); elsewhere none";

// Items of the self-test by group: how many there are and passed, and whether those that did not are required.
struct ProbeGroup {
	std::string name;
	std::size_t items = 0, passed = 0;
	bool refused = false; // a required one failed
};
std::vector<ProbeGroup> probe_groups(const SelfTestReport& probe);

// One HTML file with its style and its pictures in it.
std::string html_report(const VerifyReport& report);

} // namespace rt
