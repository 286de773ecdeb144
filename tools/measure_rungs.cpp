// measure_rungs.cpp: what the rungs cost and how far they lie apart, on one device and scene.
//
// Renders the scene in each rung, and in the fast rung with each of its approximations alone, in turns so that a
// change of the machine's speed meets them all. The rungs take the same random numbers, so differences are taken pixel
// by pixel: the signed mean with its z-score tells a bias, the root mean square the size of the scatter. Most of the
// scatter is paths that a last bit sends another way. Error and FLIP are against a converged image in double of other
// random numbers, as `rt tradeoff` has them: they say whether the difference between the rungs is seen beside the
// noise.
#include "render/scene_file.h"
#include "render/session.h"
#include "render/tradeoff.h"
#include "support/clock.h"
#include "support/files.h"
#include "tools/measuring.h"
#include "tools/report.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <array>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace rt {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* usage = R"(usage: rt_measure_rungs [SCENE...] [options]

Tells what the rungs cost and how far they lie apart, on one device.

  SCENE           a file, a shipped scene (three-spheres), or a small scene that shows one feature:
                  {};
                  "features" stands for all of these
{}  --against X     the rung that differences are taken from: exact, double (exact)
)";

struct Rung {
	std::string name;
	Precision precision;
	std::uint32_t fast_parts;
	std::vector<double> seconds;
	Film film;
};

struct Wanted : MeasuringOptions {
	Wanted() : MeasuringOptions(320, 180, 16, 5) {}
	std::string against = "exact";
};

// ---- a scene for each feature ---------------------------------------------------------------------------------------

Material matte(const Vec3d& albedo)
{
	Material material;
	material.albedo = albedo;
	return material;
}

Material of_kind(Material::Kind kind, const Vec3d& albedo)
{
	Material material = matte(albedo);
	material.kind = kind;
	return material;
}

// One sphere of a material on a grey ground; the camera looks at it from the side. The sky changes with height: under
// an even one a sample's radiance tells only how often its path was scattered, and every small error stays unseen.
Scene still_life(const Material& material)
{
	Scene scene;
	scene.camera.from = {0, 1.2, -4};
	scene.camera.at = {0, 0.6, 0};
	scene.camera.focus = 4;
	scene.sky.kind = Sky::Kind::Gradient;
	scene.sky.bottom = {1, 1, 1};
	scene.sky.top = {0.3, 0.6, 1};
	scene.materials = {matte({0.5, 0.5, 0.5}), material};
	scene.spheres = {{{0, -100, 0}, 100, 0}, {{0, 1, 0}, 1, 1}};
	return scene;
}

// The scene of one feature, or nothing if there is no such feature.
std::optional<Scene> feature_scene(const std::string& name)
{
	Scene scene = still_life(matte({0.8, 0.4, 0.2}));
	if (name == "matte") {
	} else if (name == "metal") {
		scene = still_life(of_kind(Material::Kind::Metal, {0.9, 0.8, 0.6}));
		scene.materials[1].fuzz = 0.2;
	} else if (name == "glass") {
		scene = still_life(of_kind(Material::Kind::Dielectric, {1, 1, 1}));
	} else if (name == "texture") {
		Texture checker;
		checker.size = 0.0625;
		checker.even = {0.9, 0.1, 0.1};
		checker.odd = {0.1, 0.1, 0.9};
		scene.textures = {checker};
		scene.materials[1].texture = 0;
	} else if (name == "light") {
		scene.sky = Sky();
		Material lamp = of_kind(Material::Kind::Light, {0, 0, 0});
		lamp.emission = {20, 18, 15};
		scene.materials.push_back(lamp);
		scene.spheres.push_back({{-2, 3, -1}, 0.5, 2});
	} else if (name == "far-camera") {
		scene.camera.from = {0, 300, -1000};
		scene.camera.vfov = 0.15;
		scene.camera.focus = 1000;
	} else if (name == "huge-ground") {
		scene.spheres[0] = {{0, -6.4e6, 0}, 6.4e6, 0};
	} else if (name == "many-spheres") {
		for (int i = 0; i < 600; ++i) {
			const double angle = 2.399963229728653 * i, distance = 0.25 * std::sqrt(double(i) + 20);
			scene.spheres.push_back({{distance * std::cos(angle), 0.1, distance * std::sin(angle)},
			                         0.1,
			                         static_cast<std::uint32_t>(i % 2)});
		}
	} else
		return std::nullopt;
	scene.name = name;
	update_scene_hash(scene);
	return scene;
}

constexpr std::array<const char*, 8> feature_scenes = {"matte", "metal",      "glass",       "texture",
                                                       "light", "far-camera", "huge-ground", "many-spheres"};

Result<Scene> scene_named(const std::string& name)
{
	if (std::optional<Scene> scene = feature_scene(name))
		return std::move(*scene);
	RT_TRY_ASSIGN(const SceneFile file, open_scene(name));
	return file.at_frame(0);
}

// ---- the command line -----------------------------------------------------------------------------------------------

Result<Wanted> read_arguments(int argc, char** argv)
{
	Wanted wanted;
	const auto own = [&wanted](const std::string& name, const char* value) {
		wanted.against = value;
		return name == "--against" && (wanted.against == "exact" || wanted.against == "double");
	};
	RT_TRY(read_measuring_options(argc, argv, "rt_measure_rungs", own, wanted));
	std::vector<std::string> scenes;
	for (const std::string& name : wanted.scenes)
		if (name == "features")
			scenes.insert(scenes.end(), feature_scenes.begin(), feature_scenes.end());
		else
			scenes.push_back(name);
	wanted.scenes = std::move(scenes);
	return wanted;
}

std::vector<Rung> rungs_of(const DeviceInfo& info)
{
	std::vector<Rung> all = {{"exact", Precision::Exact, RT_FAST_ALL, {}, {}},
	                         {"fast", Precision::Fast, RT_FAST_ALL, {}, {}}};
	if (info.kind != DeviceKind::Host) // it has the fast rung as a whole
		for (const auto& [name, part] :
		     {std::pair("  roots alone", RT_FAST_ROOTS), std::pair("  reciprocals alone", RT_FAST_RECIPROCALS),
		      std::pair("  sincos alone", RT_FAST_SINCOS), std::pair("  contraction alone", RT_FAST_CONTRACT),
		      std::pair("  flushing alone", RT_FAST_FLUSH), std::pair("  none of them", 0u)})
			all.push_back({name, Precision::Fast, part, {}, {}});
	if (info.reports_fp64)
		all.push_back({"double", Precision::Double, RT_FAST_ALL, {}, {}});
	return all;
}

// Steps between neighbouring floats from a to b; both are radiances, so neither is negative.
std::uint32_t float_steps(float a, float b)
{
	std::uint32_t x, y;
	std::memcpy(&x, &a, sizeof x);
	std::memcpy(&y, &b, sizeof y);
	return x > y ? x - y : y - x;
}

// Where a histogram of float steps is cut: 0, 1, 2 to 3, 4 to 15, 16 to 255, more.
constexpr std::array<const char*, 6> bin_names = {"0", "1", "2-3", "4-15", "16-255", "more"};

struct Difference {
	std::array<double, 3> bias{}, z{}; // of the mean radiance
	double rmse = 0;
	std::array<double, bin_names.size()> percent{}; // of the values, by float steps
};

// Differences of two films of the same paths.
Difference difference_of(const Film& film, const Film& base)
{
	const double count = static_cast<double>(film.pixels());
	std::array<double, 3> mean{}, deviation{}, brightness{};
	double square = 0;
	Difference difference;
	for (int pass = 0; pass < 2; ++pass)
		for (std::uint32_t y = 0; y < film.window().height; ++y)
			for (std::uint32_t x = 0; x < film.window().width; ++x)
				for (int channel = 0; channel < 3; ++channel) {
					const auto c = static_cast<std::size_t>(channel);
					const double apart = film.radiance(x, y, channel) - base.radiance(x, y, channel);
					if (pass == 1) {
						deviation[c] += (apart - mean[c]) * (apart - mean[c]) / count;
						continue;
					}
					mean[c] += apart / count;
					brightness[c] += base.radiance(x, y, channel) / count;
					square += apart * apart / (3 * count);
					const std::uint32_t steps =
					    float_steps(film.radiance_float(x, y, channel), base.radiance_float(x, y, channel));
					const std::size_t bin = steps < 2 ? steps : steps < 4 ? 2 : steps < 16 ? 3 : steps < 256 ? 4 : 5;
					difference.percent[bin] += 100 / (3 * count);
				}
	for (std::size_t c = 0; c < 3; ++c) {
		const double error = std::sqrt(deviation[c] / count);
		difference.bias[c] = brightness[c] > 0 ? mean[c] / brightness[c] : 0.0;
		difference.z[c] = error > 0 ? mean[c] / error : 0.0;
	}
	difference.rmse = std::sqrt(square);
	return difference;
}

class Measuring {
public:
	Measuring(const Wanted& wanted, DeviceHandle device, bool software_roots)
	    : wanted_(wanted), device_(std::move(device)), software_roots_(software_roots)
	{
	}

	Result<Json> run(const std::string& name)
	{
		RT_TRY_ASSIGN(const Scene scene, scene_named(name));
		settings_ = scene.render;
		settings_.width = wanted_.width;
		settings_.height = wanted_.height;
		settings_.samples = wanted_.samples;
		std::vector<Rung> all = rungs_of(device_->info());
		RT_TRY(measure(name, scene, all));
		ConvergedFilm converged;
		if (device_->info().reports_fp64) {
			std::array<Film, 2> halves;
			for (std::uint32_t half = 0; half < 2; ++half) {
				RT_TRY_ASSIGN(SessionResult result, render(scene, all.back(), 0x7ea5ed00u + half, 8 * wanted_.samples));
				halves[half] = std::move(result.film);
			}
			RT_TRY_ASSIGN(converged, converged_film(halves[0], halves[1]));
		}
		return report(name, all, converged);
	}

private:
	Result<SessionResult> render(const Scene& scene, const Rung& rung, std::uint32_t seed, std::uint32_t samples)
	{
		RenderSettings settings = settings_;
		settings.seed = seed;
		settings.samples = samples;
		RT_TRY_ASSIGN(const PackedScene packed, pack_scene(scene, settings, {0, 0, settings.width, settings.height}));
		SessionOptions options;
		options.samples = samples;
		options.precision = rung.precision;
		options.fast_parts = rung.fast_parts;
		options.software_roots = software_roots_;
		return render_scene(packed, {device_}, options);
	}

	// The first round compiles and warms up.
	Status measure(const std::string& name, const Scene& scene, std::vector<Rung>& all)
	{
		for (std::uint32_t round = 0; round <= wanted_.rounds; ++round)
			for (Rung& rung : all) {
				if (has_terminal(stderr))
					print_message(
					    fmt::format("\r\033[K{}, round {} of {}: {}", name, round, wanted_.rounds, rung.name));
				const double start = cpu_seconds();
				RT_TRY_ASSIGN(SessionResult result, render(scene, rung, settings_.seed, settings_.samples));
				if (round > 0)
					rung.seconds.push_back(device_->info().is_processor() ? cpu_seconds() - start
					                                                      : result.render_seconds);
				rung.film = std::move(result.film);
			}
		if (has_terminal(stderr))
			print_message("\r\033[K");
		return success();
	}

	Result<Json> report(const std::string& name, const std::vector<Rung>& all, const ConvergedFilm& converged)
	{
		const Rung& exact = all.front();
		const Rung& base = wanted_.against == "double" ? all.back() : exact;
		std::vector<std::vector<std::string>> rows = {
		    {"rung", device_->info().is_processor() ? ">CPU seconds" : ">seconds", ">of exact", ">R bias (z)",
		     ">G bias (z)", ">B bias (z)", ">RMSE"}};
		for (const char* bin : bin_names)
			rows[0].push_back(fmt::format(">{}{}", bin, bin == bin_names[0] ? " ulp %" : ""));
		rows[0].insert(rows[0].end(), {">error %", ">FLIP"});
		Json rungs = Json::array();
		for (const Rung& rung : all) {
			std::vector<double> ratios;
			for (std::size_t i = 0; i < rung.seconds.size(); ++i)
				ratios.push_back(rung.seconds[i] / exact.seconds[i]);
			const Difference difference = difference_of(rung.film, base.film);
			std::vector<std::string> row = {rung.name, fmt::format("{:.3f}", median(rung.seconds)),
			                                fmt::format("{:.3f}", median(ratios))};
			for (std::size_t c = 0; c < 3; ++c)
				row.push_back(fmt::format("{:+.1e} ({:+.1f})", difference.bias[c], difference.z[c]));
			row.push_back(fmt::format("{:.1e}", difference.rmse));
			for (const double share : difference.percent)
				row.push_back(fmt::format("{:.1f}", share));
			Json json = {{"rung", rung.name.substr(rung.name.find_first_not_of(' '))},
			             {"is_part", rung.fast_parts != RT_FAST_ALL},
			             {"seconds", median(rung.seconds)},
			             {"of_exact", median(ratios)},
			             {"bias", difference.bias},
			             {"z", difference.z},
			             {"rmse", difference.rmse},
			             {"ulp_percent", difference.percent}};
			if (converged.samples > 0) {
				RT_TRY_ASSIGN(const ImageError error, error_against(rung.film, converged));
				row.push_back(fmt::format("{:.4f}", 100 * error.noise.rel_rmse()));
				row.push_back(fmt::format("{:.5f}", error.flip));
				json.update({{"rel_rmse", error.noise.rel_rmse()},
				             {"rel_mse", error.noise.rel_mse},
				             {"rmse_to_double", error.noise.rmse()},
				             {"flip", error.flip}});
			}
			rows.push_back(std::move(row));
			rungs.push_back(std::move(json));
		}
		print_result(fmt::format("{}, {}x{}, {} samples a pixel, {} ({}), {} rounds, differences from {}\n", name,
		                         settings_.width, settings_.height, settings_.samples, device_->info().name,
		                         device_->info().backend, wanted_.rounds, base.name));
		print_result(format_table(rows, "") + '\n');
		RT_TRY(flush_results());
		return Json{
		    {"scene", name}, {"against", base.name}, {"reference_samples", converged.samples}, {"rungs", rungs}};
	}

	const Wanted& wanted_;
	DeviceHandle device_;
	bool software_roots_;
	RenderSettings settings_;
};

Result<int> run(int argc, char** argv)
{
	RT_TRY_ASSIGN(const Wanted wanted, read_arguments(argc, argv));
	if (wanted.help) {
		print_result(fmt::format(usage, fmt::join(feature_scenes, ", "), measuring_usage(Wanted())));
		return 0;
	}
	RT_TRY_ASSIGN(const MeasuredDevice device, open_measured_device(wanted.device));
	if (wanted.against == "double" && !device.handle->info().reports_fp64)
		return Error{ErrorKind::Usage, "the device has no double precision", "--against double", "take another one",
		             ""};
	Measuring measuring(wanted, device.handle, device.software_roots);
	Json all = measuring_head(wanted, device.handle->info());
	all["ulp_bins"] = bin_names;
	Json& scenes = all["rung_scenes"] = Json::array();
	for (const std::string& scene : wanted.scenes) {
		RT_TRY_ASSIGN(Json json, measuring.run(scene));
		scenes.push_back(std::move(json));
		// After each scene: a run that somebody ends keeps what it has.
		if (!wanted.json.empty())
			RT_TRY(write_file(wanted.json, to_text(all)));
	}
	return 0;
}

} // namespace
} // namespace rt

int main(int argc, char** argv) { return rt::end_program(rt::run(argc, argv)); }
