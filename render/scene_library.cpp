// What a user types for a scene: a path, the name of a shipped scene, or a built-in one.
#include "render/closest_match.h"
#include "render/scene_file.h"
#include "support/files.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <optional>

namespace rt {

namespace {

namespace fs = std::filesystem;

std::vector<fs::path> scene_directories()
{
	std::vector<fs::path> directories;
	if (const char* chosen = std::getenv("RT_SCENES"); chosen && *chosen)
		directories.emplace_back(chosen);
	if (const std::string program = executable_directory(); !program.empty())
		directories.push_back(fs::path(program).parent_path() / "share/rt/scenes");
#ifdef RT_SOURCE_SCENES
	directories.emplace_back(RT_SOURCE_SCENES);
#endif
	return directories;
}

bool is_file(const fs::path& path)
{
	std::error_code ignored;
	return fs::is_regular_file(path, ignored);
}

bool ends_with(const std::string& text, std::string_view end)
{
	return text.size() >= end.size() && text.compare(text.size() - end.size(), end.size(), end) == 0;
}

// Names of the scenes in a directory and its subdirectories of one level ("extremes/grazing").
void list_scenes(const fs::path& directory, const std::string& prefix, std::vector<std::string>& names)
{
	std::error_code error;
	for (fs::directory_iterator i(directory, error), end; !error && i != end; i.increment(error)) {
		const std::string name = i->path().filename().string();
		std::error_code ignored;
		if (prefix.empty() && i->is_directory(ignored))
			list_scenes(i->path(), name + "/", names);
		else if (ends_with(name, ".json") && !ends_with(name, ".schema.json"))
			names.push_back(prefix + i->path().stem().string());
	}
}

// The N of "cloud-N": decimal digits, or a whole number in the form 1e6; nothing for other text. Numbers too large for
// any cloud come back as the largest u64, for make_cloud to refuse.
std::optional<std::uint64_t> count_from(std::string_view text)
{
	const auto digits = [](std::string_view part) -> std::optional<std::uint64_t> {
		if (part.empty())
			return std::nullopt;
		std::uint64_t value = 0;
		for (const char c : part) {
			if (c < '0' || c > '9')
				return std::nullopt;
			value = std::min<std::uint64_t>(value * 10 + static_cast<std::uint64_t>(c - '0'), UINT64_MAX / 16);
		}
		return value;
	};
	const std::size_t e = text.find_first_of("eE");
	const std::optional<std::uint64_t> mantissa = digits(text.substr(0, e));
	if (e == std::string_view::npos || !mantissa)
		return mantissa;
	const std::optional<std::uint64_t> exponent = digits(text.substr(e + 1));
	if (!exponent)
		return std::nullopt;
	std::uint64_t value = *mantissa;
	for (std::uint64_t i = 0; i < *exponent && value != 0 && value < UINT64_MAX / 16; ++i)
		value = std::min<std::uint64_t>(value * 10, UINT64_MAX / 16);
	return value;
}

constexpr std::string_view cloud_prefix = "cloud-";

} // namespace

std::vector<std::string> shipped_scenes()
{
	std::vector<std::string> names;
	for (const fs::path& directory : scene_directories())
		list_scenes(directory, "", names);
	std::sort(names.begin(), names.end());
	names.erase(std::unique(names.begin(), names.end()), names.end());
	return names;
}

Result<SceneFile> open_scene(const std::string& name)
{
	if (std::string_view(name).substr(0, cloud_prefix.size()) == cloud_prefix && !is_file(name)) {
		const std::optional<std::uint64_t> count = count_from(std::string_view(name).substr(cloud_prefix.size()));
		if (!count)
			return Error{ErrorKind::InputOutput,
			             fmt::format("{} does not say how many spheres", in_quotes(name)),
			             name,
			             "write a whole number of spheres: cloud-1000 or cloud-1e6",
			             {}};
		RT_TRY_ASSIGN(Scene cloud, make_cloud(*count));
		SceneFile file;
		file.base = std::move(cloud);
		return file;
	}
	if (is_file(name))
		return load_scene_file(name);
	for (const fs::path& directory : scene_directories())
		if (const fs::path path = directory / (name + ".json"); is_file(path))
			return load_scene_file(path.string());

	std::error_code ignored;
	if (fs::is_directory(name, ignored))
		return Error{ErrorKind::InputOutput,
		             fmt::format("{} is a directory", in_quotes(name)),
		             name,
		             "name a scene's file in it",
		             {}};
	// Those of subdirectories are special cases: they come last.
	std::vector<std::string> names = shipped_scenes();
	const auto plain = [](const std::string& scene) { return scene.find('/') == std::string::npos; };
	names.insert(std::stable_partition(names.begin(), names.end(), plain), "cloud-N");
	std::string word = fs::path(name).filename().string();
	if (ends_with(word, ".json"))
		word.resize(word.size() - 5);
	return Error{ErrorKind::InputOutput,
	             fmt::format("there is no scene {}", in_quotes(name)),
	             name,
	             name_cure(word, "give a scene's file, or one of the shipped scenes", names),
	             {}};
}

} // namespace rt
