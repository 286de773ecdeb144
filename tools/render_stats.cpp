#include "tools/render_stats.h"

#include "backends/kernel_text.h"
#include "common/rt_contract.h"
#include "version.h"

#include <nlohmann/json.hpp>

#include <algorithm>
#include <cstdint>
#include <map>

namespace rt {

using Json = nlohmann::ordered_json;

void PhaseTimes::begin(const char* phase)
{
	end();
	current_ = phase;
}

void PhaseTimes::end()
{
	const auto now = Clock::now();
	const double seconds = std::chrono::duration<double>(now - phase_start_).count();
	phase_start_ = now;
	if (current_.empty())
		return;
	const auto known =
	    std::find_if(phases_.begin(), phases_.end(), [this](const auto& phase) { return phase.first == current_; });
	if (known != phases_.end())
		known->second += seconds;
	else
		phases_.push_back({current_, seconds});
	current_.clear();
}

double PhaseTimes::total() const { return std::chrono::duration<double>(Clock::now() - start_).count(); }

const char* kind_name(DeviceKind kind)
{
	switch (kind) {
	case DeviceKind::Gpu:
		return "GPU";
	case DeviceKind::Cpu:
		return "CPU";
	case DeviceKind::Accelerator:
		return "accelerator";
	case DeviceKind::Host:
		return "host";
	}
	return "";
}

Json device_json(const DeviceInfo& info)
{
	Json quirks = Json::array();
	for (const Quirk& quirk : info.quirks)
		quirks.push_back({{"flag", quirk.flag}, {"reason", quirk.reason}});
	return {{"backend", info.backend},
	        {"platform", info.platform},
	        {"name", info.name},
	        {"driver", info.driver},
	        {"compiler", info.compiler},
	        {"id", info.id},
	        {"pci", info.pci},
	        {"kind", kind_name(info.kind)},
	        {"memory_bytes", info.memory_bytes},
	        {"max_alloc_bytes", info.max_alloc_bytes},
	        {"compute_units", info.compute_units},
	        {"native_lanes", info.native_lanes},
	        {"reports_correct_rounding", info.reports_correct_rounding},
	        {"reports_subnormals", info.reports_subnormals},
	        {"reports_fp64", info.reports_fp64},
	        {"quirks", quirks},
	        {"usable", info.usable},
	        {"why_not", info.why_not}};
}

Json run_json(const FilmOrigin& origin, const PhaseTimes& times)
{
	Json seconds = Json::object();
	for (const auto& [phase, value] : times.phases())
		seconds[phase] = value;
	seconds["total"] = times.total();
	Json devices = Json::array();
	for (const DeviceHandle& device : origin.devices)
		devices.push_back(device_json(device->info()));
	return {{"version", RT_VERSION},
	        {"revision", RT_REVISION},
	        {"contract", RT_CONTRACT_VERSION},
	        {"kernel_hash", kernel_hash()},
	        {"precision", precision_name(origin.precision)},
	        {"self_test", origin.self_test},
	        {"devices", devices},
	        {"seconds", seconds}};
}

namespace {

// How many tiles ended with how many samples a pixel.
Json adaptive_json(const AdaptiveReport& report, const FilmOrigin& origin, const PassResult& result)
{
	std::map<std::uint32_t, std::uint64_t> counts;
	for (const TileResult& tile : report.tiles)
		counts[tile.samples]++;
	Json tiles_by_samples = Json::array();
	for (const auto& [samples, tiles] : counts)
		tiles_by_samples.push_back({{"samples", samples}, {"tiles", tiles}});
	Json json = {{"error", nullptr},
	             {"sample_limit", report.limit},
	             {"tile_size", adaptive_tile},
	             {"tiles", report.tiles.size()},
	             {"tiles_unfinished", report.unfinished},
	             {"samples_mean", static_cast<double>(result.samples) / static_cast<double>(result.film.pixels())},
	             {"tiles_by_samples", tiles_by_samples}};
	if (origin.error)
		json["error"] = *origin.error;
	return json;
}

} // namespace

Json frame_json(const FilmOrigin& origin, const PackedScene& packed, const PassResult& result, const Film& kept,
                const std::string& file)
{
	const auto rate = [&result](std::uint64_t count) {
		return result.seconds > 0 ? static_cast<double>(count) / result.seconds : 0.0;
	};
	Json work = Json::array();
	for (const DeviceStats& device : result.devices)
		work.push_back({{"device", device.device},
		                {"samples", device.samples},
		                {"launches", device.launches},
		                {"lanes", device.lanes},
		                {"bvh", device.bvh},
		                {"native_roots", device.native_roots},
		                {"upload_seconds", device.upload_seconds},
		                {"launch_seconds", device.launch_seconds},
		                {"read_seconds", device.read_seconds},
		                {"build",
		                 {{"seconds", device.build.seconds},
		                  {"from_cache", device.build.from_cache},
		                  {"embedded", device.build.embedded},
		                  {"variant", device.build.variant},
		                  {"options", device.build.options},
		                  {"log", device.build.log}}}});
	const Window& window = origin.window;
	Json stop = nullptr;
	if (result.adaptive)
		stop = adaptive_json(*result.adaptive, origin, result);
	return {{"file", file},
	        {"scene", origin.scene},
	        {"scene_hash", origin.scene_hash.hex()},
	        {"frame", origin.frame},
	        {"width", origin.settings.width},
	        {"height", origin.settings.height},
	        {"window", {window.x, window.x + window.width, window.y, window.y + window.height}},
	        {"samples", origin.settings.samples},
	        {"seed", origin.settings.seed},
	        {"max_depth", origin.settings.max_depth},
	        {"sampler", sampler_name(origin.settings.sampler)},
	        {"estimator", estimator_name(origin.settings.estimator)},
	        {"roulette", origin.settings.roulette},
	        {"features", feature_names(packed.features)},
	        {"spheres", packed.spheres.size()},
	        {"film_exponent", packed.film_exponent},
	        {"device_bytes", device_bytes_needed(packed)},
	        {"host_bytes", host_bytes_needed(packed)},
	        {"interrupted", result.interrupted},
	        {"timed_out", result.timed_out},
	        {"adaptive", stop},
	        {"samples_min", kept.min_samples()},
	        {"samples_max", kept.max_samples()},
	        {"samples_rendered", result.samples},
	        {"segments_rendered", result.segments},
	        {"bvh_seconds", result.bvh_seconds},
	        {"render_seconds", result.seconds},
	        {"samples_per_second", rate(result.samples)},
	        {"rays_per_second", rate(result.segments)},
	        {"rejected", kept.rejected},
	        {"work", work},
	        {"film_hash", kept.hash().hex()}};
}

} // namespace rt
