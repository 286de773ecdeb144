#include "tools/command_verify.h"

#include "support/files.h"
#include "tools/progress.h"
#include "tools/report.h"
#include "tools/verify_json.h"
#include "verify/ledger.h"
#include "verify/verify_report.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

namespace rt {

namespace {

// ---- the screen -------------------------------------------------------------------------------------------------

using Row = std::vector<std::string>;

// A driver's own version without what it adds in brackets.
std::string short_version(const std::string& driver) { return driver.substr(0, driver.find(" (")); }

class VerifyText {
public:
	explicit VerifyText(const VerifyReport& report) : report_(report), tested_(report.verification) {}

	std::string text() const
	{
		std::string out = head() + '\n' + devices() + absences() + odd() + '\n' + verdicts();
		if (!report_.probe_only && list().size() > 1)
			out += '\n' + matrix();
		return out + failures() + '\n' + conclusion();
	}

private:
	const std::vector<VerifiedDevice>& list() const { return tested_.devices; }

	std::string head() const
	{
		const HostFacts& host = report_.host;
		return fmt::format("rt {} ({}), numeric contract {}, kernels {}\n{}, {}\n{}, {}, {}, built by {}\n",
		                   host.version, host.revision, host.contract, host.kernels, host.system, host.kernel,
		                   host.processor, plural(host.threads, "thread"), format_bytes(host.memory_bytes),
		                   host.compiler);
	}

	std::string devices() const
	{
		std::vector<Row> rows = {{">", "backend", "device", "driver", "compiler"}};
		for (const VerifiedDevice& device : list()) {
			const DeviceInfo& info = device.info;
			rows.push_back({std::to_string(device.index), info.backend, info.name,
			                info.platform + " " + short_version(info.driver),
			                info.compiler == info.driver ? "" : short_version(info.compiler)});
		}
		return format_table(rows);
	}

	std::string absences() const
	{
		std::string out;
		for (std::size_t i = 0; i < report_.found.devices.size(); ++i)
			if (const DeviceInfo& info = report_.found.devices[i]; !info.usable)
				out += fmt::format("unusable: {} ({}): {}\n", info.name, info.backend, info.why_not);
		for (const std::size_t i : report_.left_out)
			out += fmt::format("left out: {} ({}), which is slow: name it with --device {}\n",
			                   report_.found.devices[i].name, report_.found.devices[i].backend, i);
		for (const Absence& absence : report_.found.absences)
			out += fmt::format("missing: {}: {}\n", absence.backend, absence.reason);
		return out;
	}

	std::string odd() const
	{
		std::string out;
		for (const Oddity& oddity : report_.odd)
			out += fmt::format("odd: {}\n     {}\n", oddity.headline(), oddity.meaning);
		return out;
	}

	// A column for each device.
	std::string verdicts() const
	{
		Row heads = {report_.probe_only ? "arithmetic" : "arithmetic, films, speed"};
		for (const VerifiedDevice& device : list())
			heads.push_back(fmt::format("device {}", device.index));
		std::vector<Row> rows = {heads};
		add_groups(rows);
		add_row(rows, "sqrt and reciprocal are", [](const VerifiedDevice& device) -> std::string {
			if (device.error)
				return "";
			return device.probe.needs_software_roots ? "ours: its own are wrong" : "its own";
		});
		add_row(rows, "atomic operations", [](const VerifiedDevice&) -> std::string { return "int + alone"; });
		if (!report_.probe_only) {
			for (const FilmVariant variant :
			     {FilmVariant::Generic, FilmVariant::Specialised, FilmVariant::SoftwareRoots, FilmVariant::Tree})
				add_films(rows, variant);
			add_row(rows, "path segments/s", [](const VerifiedDevice& device) -> std::string {
				return device.speed ? format_quantity(device.speed->rays_per_second) : "not measured";
			});
			const bool any_peak = std::any_of(list().begin(), list().end(), [](const VerifiedDevice& device) {
				return device.speed && device.speed->share_of_peak;
			});
			if (any_peak)
				add_row(rows, "of its measured peak", [](const VerifiedDevice& device) -> std::string {
					return device.speed && device.speed->share_of_peak
					           ? fmt::format("{:.1f} %", *device.speed->share_of_peak * 100)
					           : "not measured";
				});
		}
		add_row(rows, "verdict",
		        [](const VerifiedDevice& device) -> std::string { return device.passed() ? "passed" : "FAILED"; });
		return format_table(rows);
	}

	template <class Cell>
	void add_row(std::vector<Row>& rows, const std::string& name, Cell cell) const
	{
		Row row = {name};
		for (const VerifiedDevice& device : list())
			row.push_back(cell(device));
		rows.push_back(std::move(row));
	}

	void add_groups(std::vector<Row>& rows) const
	{
		std::vector<std::vector<ProbeGroup>> groups;
		std::size_t longest = 0;
		for (const VerifiedDevice& device : list()) {
			groups.push_back(probe_groups(device.probe));
			if (groups.back().size() > groups[longest].size())
				longest = groups.size() - 1;
		}
		for (std::size_t i = 0; !groups.empty() && i < groups[longest].size(); ++i) {
			Row row = {groups[longest][i].name};
			for (const std::vector<ProbeGroup>& of_device : groups)
				row.push_back(i < of_device.size() ? group_text(of_device[i]) : "not tested");
			rows.push_back(std::move(row));
		}
	}

	static std::string group_text(const ProbeGroup& group)
	{
		const std::string count = fmt::format("{} of {}", group.passed, group.items);
		if (group.passed == group.items)
			return count;
		return count + (group.refused ? " WRONG" : " (allowed)");
	}

	void add_films(std::vector<Row>& rows, FilmVariant variant) const
	{
		const auto is_variant = [variant](const FilmCheck& film) { return film.variant == variant; };
		const bool any = std::any_of(list().begin(), list().end(), [&](const VerifiedDevice& device) {
			return std::any_of(device.films.begin(), device.films.end(), is_variant);
		});
		if (!any)
			return;
		add_row(rows, fmt::format("films, {}", variant_name(variant)),
		        [&](const VerifiedDevice& device) -> std::string {
			        std::size_t right = 0, all = 0;
			        for (const FilmCheck& film : device.films)
				        if (is_variant(film)) {
					        all += 1;
					        right += film.passed ? 1 : 0;
				        }
			        if (all == 0)
				        return device.error ? "not tested" : "as above";
			        return fmt::format("{} of {}{}", right, all, right == all ? "" : " WRONG");
		        });
	}

	std::string matrix() const
	{
		Row heads = {fmt::format("differing pixels of {}", tested_.compared_pixels())};
		for (const VerifiedDevice& device : list())
			heads.push_back(fmt::format("device {}", device.index));
		std::vector<Row> rows = {heads};
		for (std::size_t a = 0; a < list().size(); ++a) {
			Row row = {fmt::format("device {}", list()[a].index)};
			for (std::size_t b = 0; b < list().size(); ++b) {
				const auto pixels = tested_.differing_pixels(a, b);
				row.push_back(a == b ? "." : pixels ? std::to_string(*pixels) : "?");
			}
			rows.push_back(std::move(row));
		}
		return format_table(rows);
	}

	// All that is wrong, with operands; of films the first of each device, since the others tend to say the same.
	std::string failures() const
	{
		std::string out;
		const auto add = [&out](const VerifiedDevice& device, const std::string& text) {
			out += fmt::format("device {}: {}\n", device.index, text);
		};
		for (const VerifiedDevice& device : list()) {
			if (device.error) {
				add(device, device.error->message);
				std::string_view log = device.error->log;
				for (int line = 0; line < 10 && !log.empty(); ++line) { // the whole log is in --json and --html
					const std::size_t end = std::min(log.find('\n'), log.size());
					out += fmt::format("     | {}\n", log.substr(0, end));
					log.remove_prefix(std::min(end + 1, log.size()));
				}
			}
			if (!device.probe.native_roots_failure.empty())
				add(device, "its own " + device.probe.native_roots_failure);
			for (const SelfTestItem& item : device.probe.items)
				if (!item.passed)
					add(device, fmt::format("{}{}: {}", item.required ? "" : "(allowed) ", item.name, item.detail));
			for (const FilmCheck& film : device.films)
				if (!film.passed) {
					add(device, fmt::format("film of {}, {}: {}", tested_.scenes[film.scene].name,
					                        variant_name(film.variant), film.why));
					break;
				}
			if (!device.speed_error.empty())
				add(device, "speed: " + device.speed_error);
		}
		return out.empty() ? out : '\n' + out;
	}

	std::string conclusion() const
	{
		const auto passed =
		    std::count_if(list().begin(), list().end(), [](const auto& device) { return device.passed(); });
		return fmt::format("{}: {} of {} {} the numeric contract ({}, {})\n", tested_.passed() ? "passed" : "FAILED",
		                   passed, plural(list().size(), "device"), passed == 1 ? "keeps" : "keep",
		                   report_.probe_only ? "arithmetic only" : depth_name(report_.depth),
		                   format_seconds(tested_.seconds));
	}

	const VerifyReport& report_;
	const Verification& tested_;
};

// ---- the command ------------------------------------------------------------------------------------------------

// Indices into found of what was asked for: by --device and --backend, or all that auto might take.
Result<std::vector<std::size_t>> devices_to_verify(const VerifyOptions& options, VerifyReport& report)
{
	std::vector<std::size_t> indices;
	const std::vector<DeviceInfo>& found = report.found.devices;
	if (!options.device.device.empty()) {
		RT_TRY_ASSIGN(const std::vector<DeviceInfo> chosen, select_devices(options.device, report.found));
		for (const DeviceInfo& info : chosen)
			for (std::size_t i = 0; i < found.size(); ++i)
				if (found[i].backend == info.backend && found[i].index_in_backend == info.index_in_backend)
					indices.push_back(i);
		return indices;
	}
	// An unknown or empty backend is told as for a render.
	RT_TRY(select_devices(options.device, report.found));
	for (std::size_t i = 0; i < found.size(); ++i) {
		if (!found[i].usable || (options.device.backend != "auto" && options.device.backend != found[i].backend))
			continue;
		if (found[i].only_if_named)
			report.left_out.push_back(i);
		else
			indices.push_back(i);
	}
	if (indices.empty())
		std::swap(indices, report.left_out);
	return indices;
}

// The exit status is that of the worst: an arithmetic that is not the contract's, before a device that does not work.
Status conclude(const Verification& tested)
{
	if (tested.passed())
		return success();
	std::string failed;
	const VerifiedDevice* worst = nullptr;
	for (const VerifiedDevice& device : tested.devices) {
		if (device.passed())
			continue;
		failed += fmt::format("{}{}", failed.empty() ? "" : ", ", device.index);
		if (!worst || (worst->error && !device.error))
			worst = &device;
	}
	Error error;
	error.kind = worst->error ? worst->error->kind : ErrorKind::SelfTest;
	error.message = fmt::format("{} {}: {}", failed.find(',') == std::string::npos ? "device" : "devices", failed,
	                            worst->first_failure());
	error.where = fmt::format("{} ({}), driver {}", worst->info.name, worst->info.backend, worst->info.driver);
	error.cure = "report the screen above to the driver's makers, or take another device or driver; --html FILE writes "
	             "pictures of what differs";
	return error;
}

} // namespace

Status run_verify(const VerifyOptions& options)
{
	for (const std::string* file : {&options.json, &options.html, &options.ledger})
		if (!file->empty())
			RT_TRY(check_writable(*file));
	ProgressDisplay display(options.progress);
	display.status("looking for devices");
	VerifyReport report;
	report.host = host_facts();
	report.found = enumerate_all();
	report.depth = options.depth;
	report.probe_only = options.probe_only;
	RT_TRY_ASSIGN(const std::vector<std::size_t> indices, devices_to_verify(options, report));
	VerificationOptions how;
	how.depth = options.depth;
	how.probe_only = options.probe_only;
	how.with_pictures = !options.html.empty();
	how.status = [&display](const std::string& text) { display.status(text); };
	RT_TRY_ASSIGN(report.verification, verify_devices(report.found, indices, how));
	report.odd = odd_environment(report.found);
	report.environment = telling_environment();
	display.clear();

	// The screen gives way where standard output carries the JSON.
	const std::string screen = VerifyText(report).text();
	if (options.json == "-")
		print_message(screen);
	else
		print_result(screen);
	if (options.json == "-")
		print_result(to_text(verify_json(report)));
	else if (!options.json.empty())
		RT_TRY(write_file(options.json, to_text(verify_json(report))));
	if (!options.html.empty())
		RT_TRY(write_file(options.html, html_report(report)));
	if (!options.ledger.empty())
		RT_TRY(add_to_ledger(options.ledger, report));
	RT_TRY(flush_results());
	return conclude(report.verification);
}

} // namespace rt
