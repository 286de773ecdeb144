#include "tools/command_reproduce.h"

#include "common/rt_contract.h"
#include "render/compare.h"
#include "render/image_file.h"
#include "render/scene_file.h"
#include "render/scene_ranges.h"
#include "support/files.h"
#include "tools/command_compare.h"
#include "tools/command_render.h"
#include "tools/film_provenance.h"
#include "tools/report.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <charconv>
#include <filesystem>
#include <utility>

namespace rt {

namespace {

class ReproduceCommand {
public:
	explicit ReproduceCommand(const ReproduceOptions& options) : options_(options), render_(options.render) {}

	Result<int> run()
	{
		if (!options_.output.empty()) {
			RT_TRY_ASSIGN(output_format_, image_format_of(options_.output));
			RT_TRY(check_writable(options_.output));
		}
		RT_TRY_ASSIGN(const LoadedImage image, load_image(options_.image));
		RT_TRY(read_recipe(image));
		RT_TRY(find_scene(image.provenance));
		warn_of_trust(image.provenance);
		RT_TRY_ASSIGN(RenderedFilm rendered, render_film(render_));
		if (!options_.output.empty())
			RT_TRY(write_image(rendered.film, options_.output, output_format_, image.display, rendered.provenance));
		const LoadedImage here = image_of(std::move(rendered.film), std::move(rendered.provenance), "rendered here");
		CompareSettings settings;
		RT_TRY_ASSIGN(const Comparison comparison, compare_images(image, here, settings));
		return report(image, here, comparison);
	}

private:
	Error unfit(std::string message, std::string cure) const
	{
		return Error{ErrorKind::Usage, std::move(message), options_.image, std::move(cure), ""};
	}

	Result<std::string> value(const Provenance& provenance, const char* key) const
	{
		std::string text = provenance_value(provenance, key);
		if (text.empty())
			return unfit(fmt::format("the image does not say its {}", key),
			             "only an image that rt wrote and nobody stripped can be reproduced: a PNG, an EXR or a film");
		return text;
	}

	Result<std::uint32_t> number(const Provenance& provenance, const char* key, const NumberRange& range) const
	{
		RT_TRY_ASSIGN(const std::string text, value(provenance, key));
		std::uint32_t number = 0;
		const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
		if (error != std::errc() || end != text.data() + text.size() || !range.contains(number))
			return unfit(fmt::format("the image says '{}' of its {}, which is not {}", text, key, range.describe()),
			             "the file was altered, or another rt wrote it");
		return number;
	}

	// One of a few words; the first, the default, where the image says nothing.
	template <class Choice, std::size_t count>
	Result<Choice> word(const Provenance& provenance, const char* key, const std::array<Choice, count>& all,
	                    const char* (*name)(Choice)) const
	{
		const std::string text = provenance_value(provenance, key);
		if (text.empty())
			return all.front();
		if (const std::optional<Choice> found = find_named(text, all, name))
			return *found;
		return unfit(fmt::format("the image says '{}' of its {}, which this rt does not have", text, key),
		             "reproduce it with the rt that made it: " + provenance_value(provenance, "Software"));
	}

	// Everything but the scene.
	Status read_recipe(const LoadedImage& image)
	{
		const Provenance& provenance = image.provenance;
		if (provenance.empty())
			return unfit("the image does not say how it was made",
			             "only an image that rt wrote and nobody stripped can be reproduced: a PNG, an EXR or a film");
		RT_TRY_ASSIGN(const std::string contract, value(provenance, "Contract"));
		RT_TRY_ASSIGN(const std::string precision, value(provenance, "Precision"));
		const std::string software = provenance_value(provenance, "Software");
		bool known = false;
		for (const Precision rung : {Precision::Exact, Precision::Fast, Precision::Double})
			if (precision == precision_name(rung)) {
				render_.precision = render_.device.precision = rung;
				known = true;
			}
		if (!known)
			return unfit(fmt::format("the image is of precision '{}', which this rt does not have", precision),
			             fmt::format("reproduce it with the rt that made it: {}", software));
		if (contract != contract_text(render_.precision))
			return unfit(fmt::format("the image is of numeric contract {}, this rt computes by {}", contract,
			                         contract_text(render_.precision)),
			             fmt::format("reproduce it with the rt that made it: {}", software));
		RT_TRY_ASSIGN(film_hash_, value(provenance, "FilmHash"));
		RT_TRY(read_samples(provenance));
		RT_TRY_ASSIGN(render_.width, number(provenance, "Width", range::image_size));
		RT_TRY_ASSIGN(render_.height, number(provenance, "Height", range::image_size));
		RT_TRY_ASSIGN(render_.seed, number(provenance, "Seed", range::seed));
		RT_TRY_ASSIGN(render_.max_depth, number(provenance, "MaxDepth", range::max_depth));
		RT_TRY_ASSIGN(render_.sampler, word(provenance, "Sampler", all_samplers, sampler_name));
		RT_TRY_ASSIGN(render_.estimator, word(provenance, "Estimator", all_estimators, estimator_name));
		render_.roulette = RenderSettings{}.roulette;
		if (!provenance_value(provenance, "Roulette").empty()) {
			RT_TRY_ASSIGN(render_.roulette, number(provenance, "Roulette", range::roulette));
		}
		RT_TRY_ASSIGN(render_.first_frame, number(provenance, "Frame", range::frame));
		render_.last_frame = render_.first_frame;
		RT_TRY_ASSIGN(const std::string window, value(provenance, "Window"));
		if (!image.knows_window || window != window_text(image.window) || image.image_width != *render_.width ||
		    image.image_height != *render_.height)
			return unfit(fmt::format("the image has {}x{} pixels and says that it is the window {} of {}x{}",
			                         image.window.width, image.window.height, window, *render_.width, *render_.height),
			             "it was scaled or cropped after it was rendered: take the original file");
		render_.window = image.window;
		render_.display = image.display;
		return success();
	}

	// How many samples a pixel has, or what decided that.
	Status read_samples(const Provenance& provenance)
	{
		const std::string error = provenance_value(provenance, "Error");
		if (!error.empty()) {
			double value = 0;
			const auto [end, fault] = std::from_chars(error.data(), error.data() + error.size(), value);
			if (fault != std::errc() || end != error.data() + error.size() || !(value > 0) || !std::isfinite(value))
				return unfit(fmt::format("the image says '{}' of its Error, which is not a positive number", error),
				             "the file was altered, or another rt wrote it");
			render_.error = value;
			RT_TRY_ASSIGN(render_.samples, number(provenance, "SampleLimit", range::samples));
			return success();
		}
		if (provenance_value(provenance, "Samples").find(" to ") != std::string::npos)
			return unfit("the render was stopped: its pixels have unequal numbers of samples, and which is not known",
			             "go on with it (--resume) and reproduce the whole image");
		RT_TRY_ASSIGN(render_.samples, number(provenance, "Samples", range::samples));
		return success();
	}

	// The scene as the image names it, or beside the image; its content must be the same.
	Status find_scene(const Provenance& provenance)
	{
		RT_TRY_ASSIGN(const std::string named, value(provenance, "Scene"));
		RT_TRY_ASSIGN(const std::string wanted, value(provenance, "SceneHash"));
		std::vector<std::string> places;
		if (!options_.scene.empty()) {
			places = {options_.scene};
		} else {
			const std::filesystem::path beside =
			    std::filesystem::path(options_.image).parent_path() / std::filesystem::path(named).filename();
			places = {named};
			if (beside != named)
				places.push_back(beside.string());
		}
		std::string seen;
		for (const std::string& place : places) {
			const Result<SceneFile> file = open_scene(place);
			if (!file) {
				seen += fmt::format("\n{}: {}", place, file.error().message);
				continue;
			}
			const Result<Scene> scene = file->at_frame(render_.first_frame);
			if (scene && scene->hash.hex() == wanted) {
				render_.scene = place;
				return success();
			}
			seen += scene ? fmt::format("\n{}: another scene, hash {}", place, scene->hash.hex())
			              : fmt::format("\n{}: {}", place, scene.error().message);
		}
		return Error{ErrorKind::InputOutput, fmt::format("the image's scene, of hash {}, was not found", wanted),
		             options_.image + seen,
		             "name the scene's file as it was when the image was made: --scene PATH. Its textures and sphere "
		             "sets count too, the order of keys and comments do not",
		             ""};
	}

	void warn_of_trust(const Provenance& provenance) const
	{
		const std::string self_test = provenance_value(provenance, "SelfTest");
		if (self_test != "passed")
			report_warning(fmt::format("the image is of a device that is not verified ({}): {}",
			                           provenance_value(provenance, "Device"),
			                           self_test.empty() ? "it does not say what the self-test said" : self_test));
	}

	Result<int> report(const LoadedImage& image, const LoadedImage& here, const Comparison& comparison) const
	{
		const std::string hash = here.film->hash().hex();
		const bool same_film = hash == film_hash_ && (!image.film || image.film->hash().hex() == hash);
		const bool same_pixels = comparison.verdict == Verdict::Identical;
		const bool reproduced = same_film && same_pixels;
		const char* const verdict = reproduced  ? "reproduced: the film and every pixel are the same to the last bit"
		                            : same_film ? "not reproduced: the film that the image tells is right, and its "
		                                          "pixels are not of it: the file was altered"
		                            : same_pixels
		                                ? "not reproduced: the pixels are the same, the film behind them is not"
		                                : "not reproduced";
		if (options_.json) {
			nlohmann::ordered_json json = {{"reproduced", reproduced},
			                               {"same_film", same_film},
			                               {"same_pixels", same_pixels},
			                               {"film_hash", hash}};
			json["comparison"] = comparison_json(image, here, comparison);
			print_result(to_text(json));
		} else if (options_.render.quiet) {
			print_result(fmt::format("{}\n", reproduced ? "reproduced" : "not reproduced"));
		} else if (reproduced) {
			print_result(fmt::format("{}\nmade on     {}\nhere on     {}\nfilm        {}\n", verdict,
			                         maker_of(image.provenance), maker_of(here.provenance), hash));
		} else {
			print_result(fmt::format("{}\nA is the image, B was rendered here\n\n{}", verdict,
			                         comparison_text(image, here, comparison)));
		}
		return reproduced ? 0 : 1;
	}

	static std::string maker_of(const Provenance& provenance)
	{
		return fmt::format("{} ({}), driver {}, by {}", provenance_value(provenance, "Device"),
		                   provenance_value(provenance, "Backend"), provenance_value(provenance, "Driver"),
		                   provenance_value(provenance, "Software"));
	}

	const ReproduceOptions& options_;
	RenderOptions render_;
	std::string film_hash_;
	ImageFormat output_format_ = ImageFormat::Png;
};

} // namespace

Result<int> run_reproduce(const ReproduceOptions& options) { return ReproduceCommand(options).run(); }

} // namespace rt
