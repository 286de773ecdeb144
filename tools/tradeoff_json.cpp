#include "tools/tradeoff_json.h"

#include "backends/kernel_text.h"
#include "common/rt_contract.h"
#include "support/thread_pool.h"
#include "tools/render_stats.h"
#include "version.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <cmath>
#include <utility>

namespace rt {

namespace {

using Json = nlohmann::ordered_json;

constexpr std::array<const char*, 3> channel_names = {"red", "green", "blue"};
constexpr std::array<Precision, 3> all_precisions{Precision::Exact, Precision::Fast, Precision::Double};

Json configuration_json(const Configuration& configuration)
{
	return {{"precision", precision_name(configuration.precision)},
	        {"sampler", sampler_name(configuration.sampler)},
	        {"estimator", estimator_name(configuration.estimator)},
	        {"roulette", configuration.roulette}};
}

Json noise_json(const Noise& noise)
{
	return {{"rmse", noise.rmse()}, {"rel_mse", noise.rel_mse}, {"rel_rmse", noise.rel_rmse()}};
}

Json point_json(const TradePoint& point)
{
	Json json = {{"device", point.device}};
	json.update(configuration_json(point.configuration));
	json["samples"] = point.samples;
	json["seconds"] = point.seconds;
	json["most_seconds"] = point.most_seconds;
	json["repeats"] = point.repeats;
	json["cpu_seconds"] = point.cpu_seconds ? Json(*point.cpu_seconds) : Json();
	json.update(noise_json(point.error.noise));
	json["is_bound"] = point.error.is_bound;
	json["rel_mse_trimmed"] = point.error.rel_mse_trimmed;
	json["flip"] = point.error.flip;
	Json bias = Json::object();
	for (std::size_t c = 0; c < channel_names.size(); ++c)
		bias[channel_names[c]] = {{"relative", point.error.bias[c].relative}, {"z", point.error.bias[c].z}};
	json["bias"] = bias;
	json["on_front"] = point.on_front;
	json["film_hash"] = point.film_hash;
	return json;
}

Json recommendation_json(const Tradeoff& measured, const std::optional<Recommendation>& way)
{
	if (!way)
		return {};
	Json json = {{"device", way->device}};
	json.update(configuration_json(way->configuration));
	json["samples"] = way->samples;
	json["seconds"] = way->seconds;
	json["rel_rmse"] = way->rel_rmse;
	json["extrapolated"] = way->extrapolated;
	json["command"] = command_line(measured, *way);
	return json;
}

// The value whose name the text has; an exception of the library's kind for any other.
template <class T, std::size_t count>
T named(const Json& json, const std::array<T, count>& all, const char* (*name)(T))
{
	if (const std::optional<T> found = find_named(json.get<std::string>(), all, name))
		return *found;
	throw Json::other_error::create(501, "no such name: " + json.get<std::string>(), nullptr);
}

TradePoint point_of(const Json& json)
{
	TradePoint point;
	point.device = json.at("device");
	point.configuration = {named(json.at("precision"), all_precisions, precision_name),
	                       named(json.at("sampler"), all_samplers, sampler_name),
	                       named(json.at("estimator"), all_estimators, estimator_name), json.at("roulette")};
	point.samples = json.at("samples");
	point.seconds = json.at("seconds");
	point.most_seconds = json.at("most_seconds");
	point.repeats = json.at("repeats");
	if (json.contains("cpu_seconds") && !json["cpu_seconds"].is_null())
		point.cpu_seconds = json["cpu_seconds"].get<double>();
	const double rmse = json.at("rmse");
	point.error.noise = {rmse * rmse, json.at("rel_mse")};
	point.error.is_bound = json.at("is_bound");
	point.error.rel_mse_trimmed = json.at("rel_mse_trimmed");
	point.error.flip = json.at("flip");
	for (std::size_t c = 0; c < channel_names.size(); ++c) {
		const Json& bias = json.at("bias").at(channel_names[c]);
		point.error.bias[c] = {bias.at("relative"), bias.at("z")};
	}
	point.on_front = json.at("on_front");
	point.film_hash = json.at("film_hash");
	return point;
}

} // namespace

Json tradeoff_json(const Tradeoff& measured)
{
	const RenderSettings& settings = measured.settings;
	Json devices = Json::array();
	for (std::size_t i = 0; i < measured.devices.size(); ++i) {
		Json device = device_json(measured.devices[i]);
		device["arguments"] = measured.device_arguments[i];
		devices.push_back(std::move(device));
	}
	Json points = Json::array();
	for (const TradePoint& point : measured.points)
		points.push_back(point_json(point));
	const TradeoffReference& reference = measured.reference;
	Json reference_json = configuration_json(reference.configuration);
	reference_json.update({{"samples", reference.samples},
	                       {"remembered", reference.remembered},
	                       {"device", reference.device},
	                       {"seconds", reference.seconds}});
	reference_json.update(noise_json(reference.noise));
	reference_json["film_hash"] = reference.film_hash;
	return {{"version", RT_VERSION},
	        {"revision", RT_REVISION},
	        {"contract", RT_CONTRACT_VERSION},
	        {"kernel_hash", kernel_hash()},
	        {"date", measured.date},
	        {"threads", thread_count()},
	        {"scene", measured.scene},
	        {"scene_hash", measured.scene_hash.hex()},
	        {"width", settings.width},
	        {"height", settings.height},
	        {"seed", settings.seed},
	        {"max_depth", settings.max_depth},
	        {"image",
	         {{"width", measured.image_width}, {"height", measured.image_height}, {"samples", measured.image_samples}}},
	        {"seconds", measured.seconds},
	        {"complete", !measured.interrupted},
	        {"left_out", measured.left_out},
	        {"devices", devices},
	        {"reference", reference_json},
	        {"points", points}};
}

Json advice_json(const Tradeoff& measured, const TradeoffAdvice& advice)
{
	return {{"target_error", advice.goal.rel_rmse ? Json(*advice.goal.rel_rmse) : Json()},
	        {"budget", advice.goal.seconds ? Json(*advice.goal.seconds) : Json()},
	        {"as_it_is", recommendation_json(measured, advice.as_it_is)},
	        {"recommended", recommendation_json(measured, advice.way)}};
}

Result<Tradeoff> tradeoff_of_json(const std::string& text)
{
	try {
		const Json json = Json::parse(text);
		Tradeoff measured;
		measured.scene = json.at("scene");
		measured.date = json.at("date");
		measured.settings.width = json.at("width");
		measured.settings.height = json.at("height");
		measured.settings.seed = json.at("seed");
		measured.settings.max_depth = json.at("max_depth");
		measured.image_width = json.at("image").at("width");
		measured.image_height = json.at("image").at("height");
		measured.image_samples = json.at("image").at("samples");
		measured.interrupted = !json.at("complete").get<bool>();
		measured.seconds = json.at("seconds");
		for (const Json& device : json.at("devices")) {
			DeviceInfo info;
			info.backend = device.at("backend");
			info.name = device.at("name");
			info.driver = device.at("driver");
			measured.devices.push_back(std::move(info));
			measured.device_arguments.push_back(device.at("arguments"));
		}
		measured.reference.samples = json.at("reference").at("samples");
		for (const Json& point : json.at("points")) {
			measured.points.push_back(point_of(point));
			if (measured.points.back().device >= measured.devices.size())
				return Error{ErrorKind::InputOutput, "a point is of a device that is not listed", "", "", ""};
		}
		return measured;
	} catch (const Json::exception& error) {
		return Error{ErrorKind::InputOutput, fmt::format("this is no measurement of rt tradeoff: {}", error.what()), "",
		             "measure again", ""};
	}
}

std::string tradeoff_csv(const Tradeoff& measured)
{
	std::string text = "backend,device,precision,sampler,estimator,roulette,samples,seconds,most_seconds,repeats,rmse,"
	                   "rel_mse,rel_rmse,is_bound,rel_mse_trimmed,flip,bias_red,z_red,bias_green,z_green,bias_blue,"
	                   "z_blue,on_front,film_hash\n";
	for (const TradePoint& point : measured.points) {
		const DeviceInfo& device = measured.devices[point.device];
		std::string name = device.name;
		for (std::size_t at = 0; (at = name.find('"', at)) != std::string::npos; at += 2)
			name.insert(at, 1, '"');
		const ImageError& error = point.error;
		text += fmt::format("{},\"{}\",{},{},{},{},{},{},{},{},{},{},{},{},{},{}", device.backend, name,
		                    precision_name(point.configuration.precision), sampler_name(point.configuration.sampler),
		                    estimator_name(point.configuration.estimator), point.configuration.roulette, point.samples,
		                    point.seconds, point.most_seconds, point.repeats, error.noise.rmse(), error.noise.rel_mse,
		                    error.noise.rel_rmse(), error.is_bound ? 1 : 0, error.rel_mse_trimmed, error.flip);
		for (const ChannelBias& bias : error.bias)
			text += fmt::format(",{},{}", bias.relative, bias.z);
		text += fmt::format(",{},{}\n", point.on_front ? 1 : 0, point.film_hash);
	}
	return text;
}

} // namespace rt
