#include "render/golden_scenes.h"

#include "common/rt_contract.h"
#include "golden_text.h"
#include "render/scene_file.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <array>
#include <cstddef>
#include <optional>
#include <utility>

namespace rt {

namespace {

using Json = nlohmann::ordered_json;

// The choice that a row spells; the default where it spells none. Empty if there is no such choice.
template <typename Choice, std::size_t n>
std::optional<Choice> choice_of(const Json& row, const char* key, const std::array<Choice, n>& all,
                                const char* (*name_of)(Choice))
{
	return find_named(row.value(key, name_of(Choice())), all, name_of);
}

// What of a scene's settings is not the default, each with its key.
std::vector<std::pair<const char*, std::string>> choices_of(const GoldenScene& scene)
{
	std::vector<std::pair<const char*, std::string>> choices;
	if (scene.sampler != Sampler::Independent)
		choices.emplace_back("sampler", sampler_name(scene.sampler));
	if (scene.estimator != Estimator::Path)
		choices.emplace_back("estimator", estimator_name(scene.estimator));
	return choices;
}

Error bad_table(std::string what)
{
	return Error{ErrorKind::Failure, "the table of golden films cannot be used: " + std::move(what),
	             "render/golden.json", "this is a bug of this build of rt; please report it", ""};
}

} // namespace

Result<std::vector<GoldenScene>> golden_scenes()
{
	const Json table = Json::parse(golden_text, nullptr, false);
	if (!table.is_object() || !table.contains("scenes") || !table["scenes"].is_array())
		return bad_table("it is no JSON object with a list of scenes");
	try {
		const bool current = table.value("contract", 0) == RT_CONTRACT_VERSION;
		std::vector<GoldenScene> scenes;
		for (const Json& row : table["scenes"]) {
			const auto sampler = choice_of(row, "sampler", all_samplers, sampler_name);
			const auto estimator = choice_of(row, "estimator", all_estimators, estimator_name);
			if (!sampler || !estimator)
				return bad_table("it names a sampler or an estimator that does not exist");
			scenes.push_back({row.at("name").get<std::string>(), row.at("width").get<std::uint32_t>(),
			                  row.at("height").get<std::uint32_t>(), row.at("samples").get<std::uint32_t>(),
			                  row.at("seed").get<std::uint32_t>(),
			                  current ? row.at("film").get<std::string>() : std::string(), *sampler, *estimator,
			                  row.value("roulette", 0u)});
		}
		return scenes;
	} catch (const Json::exception& exception) {
		return bad_table(exception.what());
	}
}

Result<std::vector<GoldenScene>> golden_and_shipped_scenes()
{
	RT_TRY_ASSIGN(std::vector<GoldenScene> scenes, golden_scenes());
	for (const std::string& name : shipped_scenes())
		if (std::none_of(scenes.begin(), scenes.end(),
		                 [&name](const GoldenScene& known) { return known.name == name; }))
			scenes.push_back({name, 45, 30, 3, 10, ""});
	return scenes;
}

std::string settings_text(const GoldenScene& scene)
{
	std::string text = fmt::format("{}x{}, {} samples, seed {}", scene.width, scene.height, scene.samples, scene.seed);
	for (const auto& [key, name] : choices_of(scene))
		text += fmt::format(", {}", name);
	if (scene.roulette > 0)
		text += fmt::format(", roulette {}", scene.roulette);
	return text;
}

Result<PackedScene> pack_golden_scene(const GoldenScene& scene)
{
	RT_TRY_ASSIGN(const SceneFile file, open_scene(scene.name));
	RT_TRY_ASSIGN(const Scene frame, file.at_frame(0));
	RenderSettings settings = frame.render;
	settings.width = scene.width;
	settings.height = scene.height;
	settings.samples = scene.samples;
	settings.seed = scene.seed;
	settings.sampler = scene.sampler;
	settings.estimator = scene.estimator;
	settings.roulette = scene.roulette;
	return pack_scene(frame, settings, {0, 0, settings.width, settings.height});
}

std::string golden_table(const std::vector<GoldenScene>& scenes)
{
	std::string rows;
	for (const GoldenScene& scene : scenes) {
		rows +=
		    fmt::format("{}\t\t{{\"name\": \"{}\", \"width\": {}, \"height\": {}, \"samples\": {}, \"seed\": {}, ",
		                rows.empty() ? "" : ",\n", scene.name, scene.width, scene.height, scene.samples, scene.seed);
		for (const auto& [key, name] : choices_of(scene))
			rows += fmt::format("\"{}\": \"{}\", ", key, name);
		if (scene.roulette > 0)
			rows += fmt::format("\"roulette\": {}, ", scene.roulette);
		rows += fmt::format("\"film\": \"{}\"}}", scene.film);
	}
	return fmt::format("{{\n\t\"contract\": {},\n\t\"scenes\": [\n{}\n\t]\n}}\n", RT_CONTRACT_VERSION, rows);
}

} // namespace rt
