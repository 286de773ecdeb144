#include "verify/ledger.h"

#include "support/files.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <cmath>
#include <filesystem>

namespace rt {

namespace {

using Json = nlohmann::ordered_json;

constexpr std::uint64_t max_ledger_bytes = std::uint64_t(1) << 28;

Error not_a_ledger(const std::string& path, const std::string& what)
{
	return Error{ErrorKind::InputOutput, "this is not a ledger: " + what, path,
	             "name a file that `rt verify --ledger` wrote, or one that does not exist yet", ""};
}

Result<Json> load_ledger(const std::string& path)
{
	std::error_code ignored;
	if (!std::filesystem::exists(path, ignored))
		return Json{{"rows", Json::array()}};
	RT_TRY_ASSIGN(const std::vector<std::uint8_t> bytes, read_file(path, max_ledger_bytes));
	Json ledger = Json::parse(bytes.begin(), bytes.end(), nullptr, false);
	if (!ledger.is_object() || !ledger.contains("rows") || !ledger["rows"].is_array())
		return not_a_ledger(path, "it is no JSON object with a list 'rows'");
	for (const Json& row : ledger["rows"])
		if (!row.is_object())
			return not_a_ledger(path, "a row is no object");
	return ledger;
}

bool is_same_row(const Json& a, const Json& b)
{
	for (const char* key : {"backend", "platform", "device", "driver", "compiler", "system", "contract", "kernels",
	                        "rung", "scene", "settings", "variant", "environment"})
		if (a.value(key, Json()) != b.value(key, Json()))
			return false;
	return true;
}

// Only what makes another device of this one: the flags that its compiler was handed.
std::string environment_text(const VerifyReport& report, std::size_t device)
{
	std::string text;
	for (const Oddity& odd : report.odd)
		if (odd.what.find('=') != std::string::npos &&
		    std::find(odd.devices.begin(), odd.devices.end(), device) != odd.devices.end())
			text += (text.empty() ? "" : " ") + odd.what;
	return text;
}

Json device_row(const VerifyReport& report, const VerifiedDevice& device)
{
	const HostFacts& host = report.host;
	const DeviceInfo& info = device.info;
	return {
	    {"date", host.date},       {"backend", info.backend}, {"platform", info.platform},
	    {"device", info.name},     {"driver", info.driver},   {"compiler", info.compiler},
	    {"system", host.system},   {"rt", host.version},      {"contract", host.contract},
	    {"kernels", host.kernels}, {"rung", "exact"},         {"environment", environment_text(report, device.index)}};
}

double rounded(double seconds) { return std::round(seconds * 1e4) / 1e4; }

std::vector<Json> rows_of(const VerifyReport& report)
{
	std::vector<Json> rows;
	for (const VerifiedDevice& device : report.verification.devices) {
		Json row = device_row(report, device);
		row.update({{"scene", "self-test"},
		            {"settings", fmt::format("{} operations", device.probe.items.size())},
		            {"variant", device.probe.needs_software_roots ? "software roots" : "native roots"},
		            {"film", ""},
		            {"lanes", device.info.native_lanes},
		            {"seconds", rounded(device.probe.seconds)},
		            {"passed", !device.error && device.probe.passed},
		            {"why", device.error ? device.error->message : device.probe.first_failure()}});
		rows.push_back(std::move(row));
		for (const FilmCheck& film : device.films) {
			const GoldenScene& scene = report.verification.scenes[film.scene];
			Json entry = device_row(report, device);
			entry.update({{"scene", scene.name},
			              {"settings", settings_text(scene)},
			              {"variant", variant_name(film.variant)},
			              {"film", film.film},
			              {"lanes", film.lanes},
			              {"seconds", rounded(film.seconds)},
			              {"passed", film.passed},
			              {"why", film.why}});
			rows.push_back(std::move(entry));
		}
	}
	return rows;
}

} // namespace

Status add_to_ledger(const std::string& path, const VerifyReport& report)
{
	RT_TRY_ASSIGN(Json ledger, load_ledger(path));
	Json& rows = ledger["rows"];
	for (Json& row : rows_of(report)) {
		rows.erase(std::remove_if(rows.begin(), rows.end(), [&row](const Json& old) { return is_same_row(old, row); }),
		           rows.end());
		rows.push_back(std::move(row));
	}
	return write_file(path, ledger.dump(1, ' ', true, Json::error_handler_t::replace) + '\n');
}

} // namespace rt
