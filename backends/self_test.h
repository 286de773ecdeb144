// self_test.h: does this device keep the contract? Asked once a (device, driver, compiler, rt build), remembered in
// the cache, and asked again with --self-test or when anything of the key changes.
#pragma once

#include "backends/backend.h"
#include "backends/precision.h"
#include "support/result.h"

#include <optional>
#include <string>
#include <vector>

namespace rt {

struct SelfTestItem {
	std::string name;  // "fma", "square root", "subnormal products", "stress tile", ...
	std::string group; // what it is a part of: "float arithmetic", "conversions", ...
	bool passed = false;
	bool required = true; // false: told, but no reason to refuse the device (flushed subnormals, rule 5)
	std::string detail;   // first difference: operands, expected and got, in hex
};

struct SelfTestReport {
	std::vector<SelfTestItem> items;
	bool needs_software_roots = false; // the device's own square root or reciprocal is at fault: build with ours
	std::string native_roots_failure;  // what they did wrong then; not remembered in the cache
	bool passed = false;               // the exact rung may be used
	bool from_cache = false;
	double seconds = 0;
	std::string first_failure() const; // "sqrt: sqrt(0x3f800001) gave ..., contract says ..."; empty if none
};

// Does the device lay the shared structs out as the host does? The first question of the self-test.
Result<SelfTestItem> test_layout(const DeviceHandle& device);

// What an earlier self-test of this device with all that its result depends on said, if it passed.
std::optional<SelfTestReport> remembered_self_test(const DeviceInfo& info, Precision precision = Precision::Exact);

// Runs the arithmetic probe and the stress tile. If only the device's own square root or reciprocal is at fault, the
// test is repeated with the software ones. An Error means that the test could not be run (build failure, driver error);
// a device that runs it and fails is a report with passed == false.
//
// The fast rung promises nothing beyond the exact one, so its test is the exact rung's. That of the double rung is the
// stress tile in double; NoDevice error if the device has no fp64, or says that it has and cannot compile for it.
Result<SelfTestReport> self_test(const DeviceHandle& device, bool use_cache = true,
                                 Precision precision = Precision::Exact);

// What to say of a device that failed; `and_then` is what --force-unverified does with it.
Error failed_self_test(const DeviceInfo& info, const SelfTestReport& report, const std::string& and_then);

} // namespace rt
