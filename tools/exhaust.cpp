// exhaust.cpp: the contract's operations over all their inputs, and 1e9 rays, on one device.
//
// The functions and what they are held against: verify/exhaustive.h. With --state a run that was stopped goes on where
// it was, if device, driver, kernels, stride and counts are the same. Exit status 0: nothing failed; 4: something did;
// 130: stopped.
#include "backends/kernel_text.h"
#include "backends/registry.h"
#include "backends/self_test.h"
#include "common/rt_contract.h"
#include "support/files.h"
#include "tools/progress.h"
#include "tools/report.h"
#include "tools/signals.h"
#include "verify/exhaustive.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <string>
#include <utility>
#include <vector>

namespace rt {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* usage = R"(usage: rt_exhaust [options]

Tries the contract's operations over all their inputs on one device and compares every result with the answer.

  --device X      index, part of a name, pci:... or uuid:... (rt devices); the best one if left out
  --backend B     auto, cuda, opencl, reference
  --function F    only this one; may be given again
  --stride N      only every N-th input, N odd (1)
  --count N       so many inputs where they are drawn: quotient, add, multiply, fma, atan2, asin,
                  roulette, random, sobol, rehit
  --state FILE    keep there what was done; go on from there
  --log FILE      write the results there as JSON
  --progress P    auto, plain, json, none
  --list          the functions and their inputs
)";

struct Wanted {
	DeviceRequest device;
	std::vector<const ExhaustiveFunction*> functions;
	std::uint64_t stride = 1, count = 0;
	std::string state, log;
	ProgressMode progress = ProgressMode::Auto;
	bool help = false, list = false;
};

bool read_number(const char* text, std::uint64_t& number)
{
	char* end = nullptr;
	number = std::strtoull(text, &end, 10);
	return *text >= '0' && *text <= '9' && *end == '\0' && number >= 1 && number <= UINT32_MAX;
}

bool read_progress(const std::string& text, ProgressMode& mode)
{
	for (const auto& [name, value] : {std::pair("auto", ProgressMode::Auto), std::pair("plain", ProgressMode::Plain),
	                                  std::pair("json", ProgressMode::Json), std::pair("none", ProgressMode::None)})
		if (text == name) {
			mode = value;
			return true;
		}
	return false;
}

Result<Wanted> read_arguments(int argc, char** argv)
{
	Wanted wanted;
	for (int i = 1; i < argc; ++i) {
		const std::string name = argv[i];
		if (name == "--help" || name == "-h") {
			wanted.help = true;
			continue;
		}
		if (name == "--list") {
			wanted.list = true;
			continue;
		}
		const char* value = i + 1 < argc ? argv[++i] : "";
		bool good = *value != '\0';
		if (name == "--device" || name == "-d")
			wanted.device.device = value;
		else if (name == "--backend")
			wanted.device.backend = value;
		else if (name == "--stride")
			good = read_number(value, wanted.stride) && wanted.stride % 2 == 1; // even ones never try an odd mantissa
		else if (name == "--count")
			good = read_number(value, wanted.count);
		else if (name == "--state")
			wanted.state = value;
		else if (name == "--log")
			wanted.log = value;
		else if (name == "--progress")
			good = read_progress(value, wanted.progress);
		else if (name == "--function") {
			wanted.functions.push_back(find_exhaustive(value));
			good = wanted.functions.back() != nullptr;
		} else
			good = false;
		if (!good)
			return Error{ErrorKind::Usage, fmt::format("{} '{}' is not understood", name, value), "command line",
			             "rt_exhaust --help shows the options, --list the functions", ""};
	}
	if (wanted.functions.empty())
		for (const ExhaustiveFunction& function : exhaustive_functions())
			wanted.functions.push_back(&function);
	return wanted;
}

// ---- results as JSON, for the log and the state ----

Json to_json(const ExhaustiveResult& r)
{
	return {{"function", r.name},       {"software_roots", r.software_roots},
	        {"required", r.required},   {"stride", r.stride},
	        {"total", r.total},         {"done", r.done},
	        {"tried", r.tried},         {"failures", r.failures},
	        {"outward", r.outward},     {"controls", r.controls},
	        {"bits", r.bits},           {"max_ulp", r.max_ulp},
	        {"max_error", r.max_error}, {"seconds", r.seconds},
	        {"note", r.note},           {"first_failure", r.first_failure}};
}

ExhaustiveResult from_json(const Json& j)
{
	ExhaustiveResult r;
	j.at("function").get_to(r.name);
	j.at("software_roots").get_to(r.software_roots);
	j.at("required").get_to(r.required);
	j.at("stride").get_to(r.stride);
	j.at("total").get_to(r.total);
	j.at("done").get_to(r.done);
	j.at("tried").get_to(r.tried);
	j.at("failures").get_to(r.failures);
	j.at("outward").get_to(r.outward);
	j.at("controls").get_to(r.controls);
	j.at("bits").get_to(r.bits);
	j.at("max_ulp").get_to(r.max_ulp);
	j.at("max_error").get_to(r.max_error);
	j.at("seconds").get_to(r.seconds);
	j.at("note").get_to(r.note);
	j.at("first_failure").get_to(r.first_failure);
	return r;
}

std::string quantity(std::uint64_t count)
{
	std::string digits = std::to_string(count);
	for (std::size_t i = digits.size(); i > 3; i -= 3)
		digits.insert(i - 3, " ");
	return digits;
}

std::string roots_name(const ExhaustiveFunction& function, const ExhaustiveResult& result)
{
	return !function.uses_roots ? "" : result.software_roots ? "ours" : "native";
}

class Exhaust {
public:
	Exhaust(Wanted wanted, DeviceHandle device)
	    : wanted_(std::move(wanted)), device_(std::move(device)), run_(device_), display_(wanted_.progress)
	{
	}

	// The exit status.
	Result<int> run()
	{
		RT_TRY(choose_roots());
		plan();
		RT_TRY(load());
		display_.set_device(device_->info().name);
		display_.set_unit("inputs");
		for (auto& [function, result] : work_) {
			RT_TRY(try_all(*function, result));
			if (stop_requested())
				break;
		}
		display_.clear();
		RT_TRY(save());
		if (!wanted_.log.empty())
			RT_TRY(write_file(wanted_.log, to_text(report())));
		print_result(table());
		if (stop_requested())
			return static_cast<int>(ErrorKind::Interrupted);
		return failed() ? static_cast<int>(ErrorKind::SelfTest) : 0;
	}

private:
	Status choose_roots()
	{
		RT_TRY_ASSIGN(const SelfTestReport report, self_test(device_));
		// What rt renders with must be right; of the other roots it is only told.
		renders_with_ours_ = report.needs_software_roots;
		if (!report.passed)
			report_warning("this device fails its self-test: " + report.first_failure());
		return success();
	}

	void plan()
	{
		for (const ExhaustiveFunction* function : wanted_.functions)
			for (const bool ours : {false, true}) {
				if (!function->uses_roots && ours)
					continue;
				// Rays are as many as asked for: they are not taken twice.
				if (function->kind == ExhaustiveKind::Rays && ours != renders_with_ours_)
					continue;
				ExhaustiveResult result = ExhaustiveRun::begin(*function, wanted_.stride, wanted_.count, ours);
				result.required = !function->uses_roots || ours || !renders_with_ours_;
				work_.emplace_back(function, std::move(result));
			}
	}

	Json identity() const
	{
		const DeviceInfo& info = device_->info();
		return {{"contract", RT_CONTRACT_VERSION}, {"kernels", kernel_hash()},  {"backend", info.backend},
		        {"platform", info.platform},       {"device", info.name},       {"driver", info.driver},
		        {"compiler", info.compiler},       {"lanes", info.native_lanes}};
	}

	Json report() const
	{
		Json json = identity();
		json["results"] = Json::array();
		for (const auto& [function, result] : work_)
			json["results"].push_back(to_json(result));
		return json;
	}

	Status load()
	{
		if (wanted_.state.empty())
			return success();
		RT_TRY(check_writable(wanted_.state));
		const Result<std::vector<std::uint8_t>> bytes = read_file(wanted_.state, 1u << 20);
		if (!bytes)
			return success(); // the first run
		try {
			const Json state = Json::parse(bytes->begin(), bytes->end());
			const Json mine = identity();
			for (const auto& [key, value] : mine.items())
				if (state.at(key) != value)
					return Error{ErrorKind::Usage, "this state is of another device, driver or rt: " + key + " differs",
					             wanted_.state, "remove the file or name another one", ""};
			for (const Json& entry : state.at("results")) {
				const ExhaustiveResult known = from_json(entry);
				for (auto& [function, result] : work_)
					if (known.name == result.name && known.software_roots == result.software_roots &&
					    known.stride == result.stride && (known.total == result.total || known.finished()))
						result = known;
			}
		} catch (const nlohmann::json::exception& exception) {
			return Error{ErrorKind::InputOutput, "this is no state of rt_exhaust", wanted_.state,
			             "remove the file or name another one", exception.what()};
		}
		return success();
	}

	Status save()
	{
		saved_ = std::chrono::steady_clock::now();
		return wanted_.state.empty() ? success() : write_file(wanted_.state, to_text(report()));
	}

	Status try_all(const ExhaustiveFunction& function, ExhaustiveResult& result)
	{
		const std::string roots = roots_name(function, result);
		display_.begin(result.name + (roots.empty() ? "" : ", " + roots), 1);
		const std::uint64_t before = result.done;
		const double seconds = result.seconds;
		while (!result.finished() && !stop_requested()) {
			RT_TRY(run_.advance(function, result));
			catch_stop_signals(); // behind the driver's own, which come with the first compilation
			display_.update({result.done, result.total, result.seconds - seconds}, before);
			if (std::chrono::steady_clock::now() - saved_ > std::chrono::seconds(5))
				RT_TRY(save());
		}
		return success();
	}

	// The textbook's form must fail on the same rays, or the rays show nothing.
	static bool has_no_control(const ExhaustiveFunction& function, const ExhaustiveResult& result)
	{
		return function.kind == ExhaustiveKind::Rays && result.finished() && result.controls == 0;
	}

	bool failed() const
	{
		return std::any_of(work_.begin(), work_.end(), [](const auto& entry) {
			return entry.second.required && (entry.second.failures != 0 || has_no_control(*entry.first, entry.second));
		});
	}

	std::string table() const
	{
		std::vector<std::vector<std::string>> rows = {
		    {"function", "roots", ">tried", ">failures", ">worst ulp", ">time", "inputs"}};
		std::string details;
		for (const auto& [function, r] : work_) {
			const std::string of =
			    fmt::format("{}{}{}", function->inputs_text, r.stride > 1 ? fmt::format(", one in {}", r.stride) : "",
			                r.finished() ? "" : ", not all yet");
			rows.push_back({r.name, roots_name(*function, r), quantity(r.tried),
			                quantity(r.failures) + (r.required || r.failures == 0 ? "" : " (not used)"),
			                r.max_ulp >= 0 ? fmt::format("{:.2f}", r.max_ulp) : "", format_seconds(r.seconds), of});
			if (!r.first_failure.empty())
				details += fmt::format("{}: {}\n", r.name, r.first_failure);
			if (!r.note.empty())
				details += fmt::format("{}: {}\n", r.name, r.note);
			if (function->kind == ExhaustiveKind::Rays && r.done > 0)
				details += fmt::format("{}: {} rays left outward; the textbook's form with t > 1e-3 meets the sphere "
				                       "again in {}{}\n",
				                       r.name, quantity(r.outward), quantity(r.controls),
				                       has_no_control(*function, r) ? ", which shows nothing" : "");
		}
		return fmt::format("{}, {} {}\n", device_->info().name, device_->info().backend, device_->info().driver) +
		       format_table(rows) + details;
	}

	Wanted wanted_;
	DeviceHandle device_;
	ExhaustiveRun run_;
	ProgressDisplay display_;
	std::vector<std::pair<const ExhaustiveFunction*, ExhaustiveResult>> work_;
	std::chrono::steady_clock::time_point saved_ = std::chrono::steady_clock::now();
	bool renders_with_ours_ = false;
};

std::string list_functions()
{
	std::vector<std::vector<std::string>> rows = {{"function", ">inputs", "which"}};
	for (const ExhaustiveFunction& function : exhaustive_functions())
		rows.push_back({function.name, quantity(function.inputs), function.inputs_text});
	return format_table(rows);
}

Result<int> run(int argc, char** argv)
{
	RT_TRY_ASSIGN(const Wanted wanted, read_arguments(argc, argv));
	if (wanted.help || wanted.list) {
		print_result(wanted.help ? usage : list_functions());
		return 0;
	}
	RT_TRY_ASSIGN(const std::vector<DeviceInfo> chosen, find_devices(wanted.device));
	if (chosen.size() != 1)
		return Error{ErrorKind::Usage, "one device at a time", "--device", "name one", ""};
	RT_TRY_ASSIGN(DeviceHandle device, open_device(chosen.front()));
	return Exhaust(wanted, std::move(device)).run();
}

} // namespace
} // namespace rt

int main(int argc, char** argv) { return rt::end_program(rt::run(argc, argv)); }
