#include "tools/verify_json.h"

#include "tools/render_stats.h"

#include <nlohmann/json.hpp>

namespace rt {

namespace {

using Json = nlohmann::ordered_json;

Json probe_json(const VerifiedDevice& device)
{
	if (device.error)
		return {{"passed", false}, {"error", device.error->message}, {"log", device.error->log}};
	const SelfTestReport& probe = device.probe;
	Json items = Json::array();
	for (const SelfTestItem& item : probe.items)
		items.push_back({{"group", item.group},
		                 {"name", item.name},
		                 {"passed", item.passed},
		                 {"required", item.required},
		                 {"detail", item.detail}});
	return {{"passed", probe.passed},
	        {"needs_software_roots", probe.needs_software_roots},
	        {"native_roots_failure", probe.native_roots_failure},
	        {"seconds", probe.seconds},
	        {"items", items}};
}

Json device_verdict(const VerifyReport& report, const VerifiedDevice& device)
{
	Json films = Json::array();
	for (const FilmCheck& film : device.films)
		films.push_back({{"scene", report.verification.scenes[film.scene].name},
		                 {"variant", variant_name(film.variant)},
		                 {"passed", film.passed},
		                 {"film", film.film},
		                 {"why", film.why},
		                 {"log", film.log},
		                 {"lanes", film.lanes},
		                 {"seconds", film.seconds}});
	Json json = {{"index", device.index}};
	json.update(device_json(device.info));
	json["passed"] = device.passed();
	json["first_failure"] = device.first_failure();
	json["self_test"] = probe_json(device);
	json["films"] = films;
	json["speed"] = nullptr;
	if (device.speed)
		json["speed"] = {{"scene", device.speed->scene},
		                 {"width", device.speed->width},
		                 {"height", device.speed->height},
		                 {"samples", device.speed->samples},
		                 {"seconds", device.speed->seconds},
		                 {"rays_per_second", device.speed->rays_per_second},
		                 {"samples_per_second", device.speed->samples_per_second},
		                 {"share_of_peak", device.speed->share_of_peak ? Json(*device.speed->share_of_peak) : Json()}};
	json["seconds"] = device.seconds;
	return json;
}

} // namespace

const char* depth_name(VerifyDepth depth)
{
	switch (depth) {
	case VerifyDepth::Quick:
		return "quick";
	case VerifyDepth::Standard:
		return "standard";
	case VerifyDepth::Full:
		return "full";
	}
	return "";
}

Json verify_json(const VerifyReport& report)
{
	const HostFacts& host = report.host;
	const Verification& tested = report.verification;
	Json devices = Json::array(), matrix = Json::array(), scenes = Json::array(), missing = Json::array(),
	     unusable = Json::array(), odd = Json::array(), variables = Json::object();
	for (const VerifiedDevice& device : tested.devices)
		devices.push_back(device_verdict(report, device));
	for (std::size_t a = 0; a < tested.devices.size(); ++a) {
		Json row = Json::array();
		for (std::size_t b = 0; b < tested.devices.size(); ++b) {
			const auto pixels = tested.differing_pixels(a, b);
			row.push_back(pixels ? Json(*pixels) : Json());
		}
		matrix.push_back(std::move(row));
	}
	for (const GoldenScene& scene : tested.scenes)
		scenes.push_back({{"name", scene.name},
		                  {"width", scene.width},
		                  {"height", scene.height},
		                  {"samples", scene.samples},
		                  {"seed", scene.seed},
		                  {"sampler", sampler_name(scene.sampler)},
		                  {"estimator", estimator_name(scene.estimator)},
		                  {"roulette", scene.roulette},
		                  {"film", scene.film}});
	for (const Absence& absence : report.found.absences)
		missing.push_back({{"backend", absence.backend}, {"reason", absence.reason}, {"cure", absence.cure}});
	for (std::size_t i = 0; i < report.found.devices.size(); ++i)
		if (const DeviceInfo& info = report.found.devices[i]; !info.usable)
			unusable.push_back(
			    {{"index", i}, {"backend", info.backend}, {"name", info.name}, {"why_not", info.why_not}});
	for (const Oddity& oddity : report.odd)
		odd.push_back({{"what", oddity.what}, {"meaning", oddity.meaning}, {"devices", oddity.devices}});
	for (const auto& [name, value] : report.environment)
		variables[name] = value;
	return {{"passed", tested.passed()},
	        {"version", host.version},
	        {"revision", host.revision},
	        {"contract", host.contract},
	        {"kernel_hash", host.kernels},
	        {"date", host.date},
	        {"depth", report.probe_only ? "probe only" : depth_name(report.depth)},
	        {"host",
	         {{"system", host.system},
	          {"kernel", host.kernel},
	          {"processor", host.processor},
	          {"threads", host.threads},
	          {"memory_bytes", host.memory_bytes},
	          {"compiler", host.compiler}}},
	        {"seconds", tested.seconds},
	        {"scenes", scenes},
	        {"devices", devices},
	        {"differing_pixels", matrix},
	        {"compared_pixels", tested.compared_pixels()},
	        {"missing", missing},
	        {"unusable", unusable},
	        {"left_out", report.left_out},
	        {"odd", odd},
	        {"environment", variables}};
}

} // namespace rt
