#include "tools/command_devices.h"

#include "backends/kernel_text.h"
#include "backends/odd_environment.h"
#include "backends/registry.h"
#include "backends/self_test.h"
#include "common/rt_contract.h"
#include "tools/render_stats.h"
#include "tools/report.h"
#include "version.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <cstddef>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace rt {

namespace {

using Json = nlohmann::ordered_json;

// What a self-test said, or why there is none.
struct TestOutcome {
	std::optional<SelfTestReport> report;
	std::string error;
	std::string log;
};

TestOutcome test_device(const DeviceInfo& info, bool use_cache)
{
	const auto failed = [](const Error& error) { return TestOutcome{{}, error.message, error.log}; };
	const Result<DeviceHandle> device = open_device(info);
	if (!device)
		return failed(device.error());
	Result<SelfTestReport> report = self_test(*device, use_cache);
	if (!report)
		return failed(report.error());
	return TestOutcome{std::move(*report), "", ""};
}

class DeviceList {
public:
	explicit DeviceList(const DevicesOptions& options) : options_(options), found_(enumerate_all())
	{
		if (const auto best = select_devices({}, found_))
			for (std::size_t i = 0; i < found_.devices.size(); i++)
				if (is_same(found_.devices[i], best->front()))
					best_ = i;
		tests_.resize(found_.devices.size());
	}

	Status run()
	{
		if (options_.verbose)
			run_tests();
		print_result(options_.json ? to_text(json()) : text());
		const bool any = std::any_of(found_.devices.begin(), found_.devices.end(),
		                             [](const DeviceInfo& device) { return device.usable; });
		if (any)
			return success();
		return Error{ErrorKind::NoDevice, "there is no usable device", "", "see what is missing above", ""};
	}

private:
	static bool is_same(const DeviceInfo& a, const DeviceInfo& b)
	{
		return a.backend == b.backend && a.index_in_backend == b.index_in_backend;
	}

	void run_tests()
	{
		const bool tell = has_terminal(stderr);
		for (std::size_t i = 0; i < found_.devices.size(); i++) {
			if (!found_.devices[i].usable)
				continue;
			if (tell)
				print_message(fmt::format("\r\033[Ktesting device {} of {}", i, found_.devices.size()));
			tests_[i] = test_device(found_.devices[i], !options_.self_test_afresh);
		}
		if (tell)
			print_message("\r\033[K");
	}

	// ---- for people ----

	std::string text() const
	{
		std::string out = table();
		out += oddities();
		if (best_)
			out += fmt::format("* is what --backend auto takes\n");
		if (options_.verbose) {
			for (std::size_t i = 0; i < found_.devices.size(); i++)
				out += "\n" + details(i);
		}
		out += absences();
		if (options_.verbose)
			out += environment();
		return out;
	}

	std::string table() const
	{
		std::vector<std::vector<std::string>> rows = {{">", "", "backend", "kind", "name", "driver", ">memory",
		                                               ">lanes", options_.verbose ? "self-test" : "usable"}};
		for (std::size_t i = 0; i < found_.devices.size(); i++) {
			const DeviceInfo& device = found_.devices[i];
			rows.push_back({std::to_string(i), best_ == i ? "*" : "", device.backend, kind_name(device.kind),
			                device.name, short_version(device.driver), format_bytes(device.memory_bytes),
			                std::to_string(device.native_lanes),
			                options_.verbose ? outcome(i)
			                : device.usable  ? "yes"
			                                 : "no: " + device.why_not});
		}
		return format_table(rows);
	}

	// Some drivers tell half their configuration in brackets; -v shows it.
	static std::string short_version(const std::string& driver) { return driver.substr(0, driver.find(" (")); }

	std::string outcome(std::size_t i) const
	{
		if (!found_.devices[i].usable)
			return "unusable: " + found_.devices[i].why_not;
		if (!tests_[i].report)
			return "could not be run";
		return tests_[i].report->passed ? "passed" : "FAILED";
	}

	// What should make the reader look twice. Where nothing is odd, nothing is said.
	std::string oddities() const
	{
		std::string out;
		for (const Oddity& odd : odd_environment(found_))
			out += options_.verbose ? fmt::format("odd: {}\n     {}\n", odd.headline(), odd.meaning)
			                        : fmt::format("odd: {}\n", odd.headline());
		return out;
	}

	static std::string yes_no(bool value) { return value ? "yes" : "no"; }

	std::string details(std::size_t i) const
	{
		const DeviceInfo& device = found_.devices[i];
		std::vector<std::vector<std::string>> rows;
		const auto add = [&rows](const char* name, std::string value) {
			if (!value.empty())
				rows.push_back({name, std::move(value)});
		};
		add("platform", device.platform);
		add("driver", device.driver);
		add("compiler", device.compiler);
		add("id", device.id);
		if (!device.pci.empty() && device.id != "pci:" + device.pci)
			add("pci", device.pci);
		if (!device.uuid.empty() && device.id != "uuid:" + device.uuid)
			add("uuid", device.uuid);
		add("compute units", std::to_string(device.compute_units));
		add("memory", fmt::format("{}, largest buffer {}", format_bytes(device.memory_bytes),
		                          format_bytes(device.max_alloc_bytes)));
		add("lanes", std::to_string(device.native_lanes));
		add("says of itself",
		    fmt::format("correct rounding: {}; subnormals: {}; double: {}", yes_no(device.reports_correct_rounding),
		                yes_no(device.reports_subnormals), yes_no(device.reports_fp64)));
		for (const Quirk& quirk : device.quirks)
			add("quirk", fmt::format("{}: {}", quirk.flag, quirk.reason));
		add("self-test", test_text(i));
		return fmt::format("{}  {} ({})\n", i, device.name, device.backend) + format_table(rows, "   ") +
		       test_failures(i);
	}

	std::string test_text(std::size_t i) const
	{
		if (!found_.devices[i].usable)
			return outcome(i);
		if (!tests_[i].report)
			return "could not be run: " + tests_[i].error;
		const SelfTestReport& report = *tests_[i].report;
		const auto passed = std::count_if(report.items.begin(), report.items.end(),
		                                  [](const SelfTestItem& item) { return item.passed; });
		// Only the verdict of a passed test is remembered, not its items.
		const std::string items = report.from_cache ? " (remembered)"
		                                            : fmt::format(": {} of {} items, {}", passed, report.items.size(),
		                                                          format_seconds(report.seconds));
		return outcome(i) + items + (report.needs_software_roots ? ", with our own square root and reciprocal" : "");
	}

	std::string test_failures(std::size_t i) const
	{
		std::string out;
		if (tests_[i].report)
			for (const SelfTestItem& item : tests_[i].report->items)
				if (!item.passed)
					out += fmt::format("     {}{}: {}\n", item.required ? "" : "(allowed) ", item.name, item.detail);
		std::string_view log = tests_[i].log;
		while (!log.empty()) {
			const std::size_t end = std::min(log.find('\n'), log.size());
			out += fmt::format("     | {}\n", log.substr(0, end));
			log.remove_prefix(std::min(end + 1, log.size()));
		}
		return out;
	}

	std::string absences() const
	{
		if (found_.absences.empty())
			return {};
		std::string out = "\nmissing:\n";
		for (const Absence& absence : found_.absences) {
			out += fmt::format("  {}: {}\n", absence.backend, absence.reason);
			std::string_view cure = absence.cure;
			while (!cure.empty()) {
				const std::size_t end = std::min(cure.find('\n'), cure.size());
				out += fmt::format("    {}\n", cure.substr(0, end));
				cure.remove_prefix(std::min(end + 1, cure.size()));
			}
		}
		return out;
	}

	static std::string environment()
	{
		std::string out = "\nenvironment (what changes devices, arithmetic or rt's files):\n";
		const auto variables = telling_environment();
		for (const auto& [name, value] : variables)
			out += fmt::format("  {}={}\n", name, value);
		if (variables.empty())
			out += "  nothing is set\n";
		return out + fmt::format("\nrt {} ({}), numeric contract {}, kernels {}\n", RT_VERSION, RT_REVISION,
		                         RT_CONTRACT_VERSION, kernel_hash());
	}

	// ---- for programs ----

	Json json() const
	{
		Json devices = Json::array();
		for (std::size_t i = 0; i < found_.devices.size(); i++) {
			Json device = {{"index", i}};
			device.update(device_json(found_.devices[i]));
			if (options_.verbose && found_.devices[i].usable)
				device["self_test"] = test_json(i);
			devices.push_back(std::move(device));
		}
		Json missing = Json::array();
		for (const Absence& absence : found_.absences)
			missing.push_back({{"backend", absence.backend}, {"reason", absence.reason}, {"cure", absence.cure}});
		Json odd = Json::array();
		for (const Oddity& oddity : odd_environment(found_))
			odd.push_back({{"what", oddity.what}, {"meaning", oddity.meaning}, {"devices", oddity.devices}});
		Json variables = Json::object();
		for (const auto& [name, value] : telling_environment())
			variables[name] = value;
		return {{"version", RT_VERSION},
		        {"revision", RT_REVISION},
		        {"contract", RT_CONTRACT_VERSION},
		        {"kernel_hash", kernel_hash()},
		        {"auto", best_ ? Json(*best_) : Json(nullptr)},
		        {"devices", devices},
		        {"missing", missing},
		        {"odd", odd},
		        {"environment", variables}};
	}

	Json test_json(std::size_t i) const
	{
		if (!tests_[i].report)
			return {{"passed", false}, {"error", tests_[i].error}, {"log", tests_[i].log}};
		const SelfTestReport& report = *tests_[i].report;
		Json items = Json::array();
		for (const SelfTestItem& item : report.items)
			items.push_back(
			    {{"name", item.name}, {"passed", item.passed}, {"required", item.required}, {"detail", item.detail}});
		return {{"passed", report.passed},
		        {"needs_software_roots", report.needs_software_roots},
		        {"from_cache", report.from_cache},
		        {"seconds", report.seconds},
		        {"items", items}};
	}

	const DevicesOptions& options_;
	Enumeration found_;
	std::optional<std::size_t> best_;
	std::vector<TestOutcome> tests_;
};

} // namespace

Status run_devices(const DevicesOptions& options) { return DeviceList(options).run(); }

} // namespace rt
