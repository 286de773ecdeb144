#include "tools/film_provenance.h"

#include "backends/kernel_text.h"
#include "common/rt_contract.h"
#include "support/files.h"
#include "version.h"

#include <fmt/format.h>

#include <algorithm>
#include <functional>
#include <utility>

namespace rt {

namespace {

// Keys whose values decide the bits of a film's samples: two films may be joined if all of them agree.
constexpr const char* identity_keys[] = {"Contract", "KernelHash", "SceneHash", "Width",   "Height",    "Window",
                                         "Seed",     "MaxDepth",   "Precision", "Sampler", "Estimator", "Roulette"};

// The different values, in the order in which they come, those of the resumed film first.
class Union {
public:
	explicit Union(const std::string& resumed)
	{
		if (!resumed.empty())
			values_.push_back(resumed);
	}
	void add(const std::string& value)
	{
		if (!value.empty() && std::find(values_.begin(), values_.end(), value) == values_.end())
			values_.push_back(value);
	}
	std::string text() const
	{
		std::string text;
		for (const std::string& value : values_)
			text += (text.empty() ? "" : "; ") + value;
		return text;
	}

private:
	std::vector<std::string> values_;
};

// A film is as trustworthy as its worst part.
std::string self_test_of(const FilmOrigin& origin)
{
	const std::string before = provenance_value(origin.resumed, "SelfTest");
	return before.empty() || before == "passed" ? origin.self_test : before;
}

} // namespace

std::string contract_text(Precision precision)
{
	return precision == Precision::Fast ? "none: precision fast, other devices make other bits"
	                                    : std::to_string(RT_CONTRACT_VERSION);
}

std::string software_text() { return fmt::format("rt {} ({})", RT_VERSION, RT_REVISION); }

std::string window_text(const Window& window)
{
	return fmt::format("{},{},{},{}", window.x, window.x + window.width, window.y, window.y + window.height);
}

std::string samples_text(const Film& film)
{
	const std::uint32_t least = film.min_samples(), most = film.max_samples();
	return least == most ? std::to_string(least) : fmt::format("{} to {}", least, most);
}

Provenance provenance_of(const FilmOrigin& origin, const Film& film, const std::vector<DeviceStats>& stats)
{
	const auto of_devices = [&origin](const char* key, const std::function<std::string(const DeviceInfo&)>& value) {
		Union all(provenance_value(origin.resumed, key));
		for (const DeviceHandle& device : origin.devices)
			all.add(value(device->info()));
		return all.text();
	};
	Union build_options(provenance_value(origin.resumed, "BuildOptions"));
	for (const DeviceStats& device : stats)
		build_options.add(device.build.options);
	// A setting that is left as it is goes without saying.
	const RenderSettings& settings = origin.settings;
	const RenderSettings plain;
	const auto unless_plain = [](bool is_plain, const std::string& value) { return is_plain ? std::string() : value; };
	Provenance all = {
	    {"Software", software_text()},
	    {"Contract", contract_text(origin.precision)},
	    {"Scene", origin.scene},
	    {"SceneHash", origin.scene_hash.hex()},
	    {"Frame", std::to_string(origin.frame)},
	    {"Width", std::to_string(origin.settings.width)},
	    {"Height", std::to_string(origin.settings.height)},
	    {"Window", window_text(origin.window)},
	    {"Samples", samples_text(film)},
	    {"Error", origin.error ? fmt::format("{}", *origin.error) : ""},
	    {"SampleLimit", origin.error ? std::to_string(origin.sample_limit) : ""},
	    {"TimeLimit", origin.time_limit ? fmt::format("{}", *origin.time_limit) : ""},
	    {"Seed", std::to_string(origin.settings.seed)},
	    {"MaxDepth", std::to_string(origin.settings.max_depth)},
	    {"Sampler", unless_plain(settings.sampler == plain.sampler, sampler_name(settings.sampler))},
	    {"Estimator", unless_plain(settings.estimator == plain.estimator, estimator_name(settings.estimator))},
	    {"Roulette", unless_plain(settings.roulette == plain.roulette, std::to_string(settings.roulette))},
	    {"Precision", precision_name(origin.precision)},
	    {"KernelHash", kernel_hash()},
	    {"Backend", of_devices("Backend", [](const DeviceInfo& info) { return info.backend; })},
	    {"Device", of_devices("Device", [](const DeviceInfo& info) { return info.name; })},
	    {"Driver", of_devices("Driver", [](const DeviceInfo& info) { return info.driver; })},
	    {"Compiler", of_devices("Compiler", [](const DeviceInfo& info) { return info.compiler; })},
	    {"BuildOptions", build_options.text()},
	    {"SelfTest", self_test_of(origin)},
	    {"Rejected", std::to_string(film.rejected)},
	    {"FilmHash", film.hash().hex()},
	    {"Transfer", transfer_name(origin.display.transfer)},
	    {"Exposure", fmt::format("{}", origin.display.exposure_stops)},
	};
	// What is not known, or does not apply, is left out.
	all.erase(std::remove_if(all.begin(), all.end(), [](const auto& entry) { return entry.second.empty(); }),
	          all.end());
	return all;
}

Result<LoadedFilm> load_film_to_resume(const std::string& path, const FilmOrigin& origin, std::int32_t exponent)
{
	const std::string where = "--resume " + path;
	RT_TRY_ASSIGN(const std::vector<std::uint8_t> bytes, read_file(path));
	RT_TRY_ASSIGN(LoadedFilm loaded, decode_rtfilm(bytes.data(), bytes.size(), path));
	const Film& film = loaded.film;
	const Film ours(origin.settings.width, origin.settings.height, {}, exponent);
	const Provenance wanted = provenance_of(origin, ours, {});
	std::string differences;
	const auto compare = [&differences](const std::string& what, const std::string& has, const std::string& wants) {
		if (has != wants)
			differences +=
			    fmt::format("\n{}: the film has {}, this render {}", what, has.empty() ? "none" : has, wants);
	};
	for (const char* key : identity_keys)
		compare(key, provenance_value(loaded.provenance, key), provenance_value(wanted, key));
	// The header and the provenance are written by different hands: both must be right.
	compare("image size", fmt::format("{}x{}", film.image_width(), film.image_height()),
	        fmt::format("{}x{}", ours.image_width(), ours.image_height()));
	compare("window", window_text(film.window()), window_text(origin.window));
	compare("fixed-point exponent", std::to_string(film.exponent()), std::to_string(exponent));
	if (!differences.empty())
		return Error{ErrorKind::Usage, "the film is not of this render", where + differences,
		             "give the scene and the options that it was begun with, or render afresh without --resume", ""};
	if (!film.is_even())
		return Error{
		    ErrorKind::Usage,
		    fmt::format("the film has unequal numbers of samples ({}) and cannot be gone on from", samples_text(film)),
		    where, "resume a file that --checkpoint wrote", ""};
	if (film.max_samples() > origin.settings.samples)
		return Error{ErrorKind::Usage,
		             fmt::format("the film already has {} samples a pixel, more than the {} wanted", film.max_samples(),
		                         origin.settings.samples),
		             where, fmt::format("ask for at least as many: --samples {}", film.max_samples()), ""};
	return loaded;
}

} // namespace rt
