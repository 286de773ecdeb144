#include "tools/command_info.h"

#include "render/pack.h"
#include "render/scene_file.h"
#include "render/session.h"
#include "support/files.h"
#include "tools/report.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <cstdint>
#include <cstring>
#include <limits>
#include <string>
#include <utility>
#include <vector>

namespace rt {

namespace {

using Json = nlohmann::ordered_json;

const char* name_of(Material::Kind kind)
{
	switch (kind) {
	case Material::Kind::Lambertian:
		return "lambertian";
	case Material::Kind::Metal:
		return "metal";
	case Material::Kind::Dielectric:
		return "dielectric";
	case Material::Kind::Light:
		return "light";
	}
	return "";
}

const char* name_of(Sky::Kind kind)
{
	switch (kind) {
	case Sky::Kind::None:
		return "none";
	case Sky::Kind::Constant:
		return "constant";
	case Sky::Kind::Gradient:
		return "gradient";
	}
	return "";
}

// Materials by kind, and spheres by their material's kind, in the order of Material::Kind.
struct KindCounts {
	std::uint64_t materials[4] = {}, spheres[4] = {};
	std::uint64_t hollow = 0; // spheres of negative radius
};

KindCounts count_kinds(const Scene& scene)
{
	KindCounts counts;
	for (const Material& material : scene.materials)
		counts.materials[static_cast<int>(material.kind)]++;
	for (const Sphere& sphere : scene.spheres) {
		counts.spheres[static_cast<int>(scene.materials[sphere.material].kind)]++;
		counts.hollow += sphere.radius < 0 ? 1 : 0;
	}
	return counts;
}

// First and last keyframe of all tracks.
std::pair<double, double> keyframe_range(const SceneFile& file)
{
	double first = std::numeric_limits<double>::max(), last = 0;
	const auto see = [&](const auto& keys) {
		for (const auto& key : keys) {
			first = std::min(first, key.frame);
			last = std::max(last, key.frame);
		}
	};
	see(file.camera_track);
	for (const SceneFile::SphereTrack& track : file.sphere_tracks)
		see(track.keys);
	return {first, last};
}

bool is_animated(const SceneFile& file) { return !file.camera_track.empty() || !file.sphere_tracks.empty(); }

std::string text_of(const Vec3d& v) { return fmt::format("({}, {}, {})", v[0], v[1], v[2]); }

std::string texture_text(const Texture& texture)
{
	if (texture.kind == Texture::Kind::Checker)
		return fmt::format("{}: checker of size {}", texture.name, texture.size);
	return fmt::format("{}: image {}x{}, {}", texture.name, texture.width, texture.height, texture.file);
}

std::string sky_text(const Sky& sky)
{
	if (sky.kind == Sky::Kind::None)
		return "none (black)";
	if (sky.kind == Sky::Kind::Constant)
		return "constant " + text_of(sky.bottom);
	return fmt::format("gradient from {} to {}", text_of(sky.bottom), text_of(sky.top));
}

std::string text(const SceneFile& file, const PackedScene& packed)
{
	const Scene& scene = file.base;
	const KindCounts counts = count_kinds(scene);
	std::vector<std::vector<std::string>> rows;
	const auto add = [&rows](const char* name, std::string value) { rows.push_back({name, std::move(value)}); };
	add("scene", scene.name);
	add("hash", scene.hash.hex());
	add("image", fmt::format("{}x{}, {} samples a pixel, depth {}, seed {}", scene.render.width, scene.render.height,
	                         scene.render.samples, scene.render.max_depth, scene.render.seed));
	add("camera", fmt::format("from {} at {} up {}, vfov {}, {}", text_of(scene.camera.from), text_of(scene.camera.at),
	                          text_of(scene.camera.up), scene.camera.vfov,
	                          scene.camera.aperture > 0
	                              ? fmt::format("aperture {}, focus {}", scene.camera.aperture, scene.camera.focus)
	                              : "pinhole"));
	add("sky", sky_text(scene.sky));
	add("spheres",
	    fmt::format("{}, of them {} wide, {} hollow", scene.spheres.size(), packed.wide.size(), counts.hollow));
	for (const auto kind :
	     {Material::Kind::Lambertian, Material::Kind::Metal, Material::Kind::Dielectric, Material::Kind::Light}) {
		const auto index = static_cast<int>(kind);
		if (counts.materials[index] > 0)
			add("", fmt::format("{} of {} {} {}", plural(counts.spheres[index], "sphere"), counts.materials[index],
			                    name_of(kind), counts.materials[index] == 1 ? "material" : "materials"));
	}
	for (std::size_t i = 0; i < scene.textures.size(); i++)
		add(i == 0 ? "textures" : "", texture_text(scene.textures[i]));
	if (is_animated(file)) {
		const auto [first, last] = keyframe_range(file);
		add("animation", fmt::format("frames {} to {}: {}{}", first, last,
		                             file.camera_track.empty() ? "the camera stands still" : "the camera moves",
		                             file.sphere_tracks.empty()
		                                 ? ""
		                                 : ", " + plural(file.sphere_tracks.size(), "sphere") + " in motion"));
	} else {
		add("animation", "none");
	}
	add("features", fmt::format("{}", fmt::join(feature_names(packed.features), " ")));
	add("film", fmt::format("fixed point, 2^-{}", packed.film_exponent));
	add("memory", fmt::format("{} on the device, {} on the host (scene {})", format_bytes(device_bytes_needed(packed)),
	                          format_bytes(host_bytes_needed(packed)), format_bytes(packed.bytes())));
	return format_table(rows);
}

Json materials_json(const Scene& scene)
{
	Json list = Json::array();
	for (const Material& material : scene.materials)
		list.push_back(
		    {{"name", material.name},
		     {"kind", name_of(material.kind)},
		     {"albedo", material.albedo},
		     {"emission", material.emission},
		     {"fuzz", material.fuzz},
		     {"ior", material.ior},
		     {"texture",
		      material.texture < 0 ? Json() : Json(scene.textures[static_cast<std::size_t>(material.texture)].name)}});
	return list;
}

void append_le32(std::vector<std::uint8_t>& bytes, std::uint32_t word)
{
	for (int shift = 0; shift < 32; shift += 8)
		bytes.push_back(static_cast<std::uint8_t>(word >> shift));
}

// As sphere_set.h reads them: records of four floats, and an index a sphere into the list of materials.
Status write_spheres(const Scene& scene, const std::string& path)
{
	std::vector<std::uint8_t> records, materials;
	records.reserve(scene.spheres.size() * 16);
	materials.reserve(scene.spheres.size() * 4);
	for (const Sphere& sphere : scene.spheres) {
		for (const double value : {sphere.center[0], sphere.center[1], sphere.center[2], sphere.radius}) {
			const auto rounded = static_cast<float>(value);
			std::uint32_t bits;
			std::memcpy(&bits, &rounded, sizeof bits);
			append_le32(records, bits);
		}
		append_le32(materials, sphere.material);
	}
	RT_TRY(write_file(path, records.data(), records.size()));
	return write_file(path + ".materials", materials.data(), materials.size());
}

Json json(const SceneFile& file, const PackedScene& packed)
{
	const Scene& scene = file.base;
	const KindCounts counts = count_kinds(scene);
	Json kinds = Json::object();
	for (const auto kind :
	     {Material::Kind::Lambertian, Material::Kind::Metal, Material::Kind::Dielectric, Material::Kind::Light})
		kinds[name_of(kind)] = {{"materials", counts.materials[static_cast<int>(kind)]},
		                        {"spheres", counts.spheres[static_cast<int>(kind)]}};
	Json textures = Json::array();
	for (const Texture& texture : scene.textures) {
		Json entry = {{"name", texture.name}};
		if (texture.kind == Texture::Kind::Checker)
			entry.update(Json{{"kind", "checker"}, {"size", texture.size}});
		else
			entry.update(
			    Json{{"kind", "image"}, {"width", texture.width}, {"height", texture.height}, {"file", texture.file}});
		textures.push_back(std::move(entry));
	}
	Json animation = nullptr;
	if (is_animated(file)) {
		const auto [first, last] = keyframe_range(file);
		animation = {{"first_frame", first},
		             {"last_frame", last},
		             {"camera", !file.camera_track.empty()},
		             {"spheres", file.sphere_tracks.size()}};
	}
	return {
	    {"name", scene.name},
	    {"hash", scene.hash.hex()},
	    {"render",
	     {{"width", scene.render.width},
	      {"height", scene.render.height},
	      {"samples", scene.render.samples},
	      {"max_depth", scene.render.max_depth},
	      {"seed", scene.render.seed}}},
	    {"camera",
	     {{"from", scene.camera.from},
	      {"at", scene.camera.at},
	      {"up", scene.camera.up},
	      {"vfov", scene.camera.vfov},
	      {"aperture", scene.camera.aperture},
	      {"focus", scene.camera.focus}}},
	    {"sky", {{"kind", name_of(scene.sky.kind)}, {"bottom", scene.sky.bottom}, {"top", scene.sky.top}}},
	    {"spheres", {{"count", scene.spheres.size()}, {"wide", packed.wide.size()}, {"hollow", counts.hollow}}},
	    {"materials", kinds},
	    {"material_list", materials_json(scene)},
	    {"textures", textures},
	    {"animation", animation},
	    {"features", feature_names(packed.features)},
	    {"film_exponent", packed.film_exponent},
	    {"memory",
	     {{"device", device_bytes_needed(packed)}, {"host", host_bytes_needed(packed)}, {"scene", packed.bytes()}}}};
}

} // namespace

Status run_info(const InfoOptions& options)
{
	RT_TRY_ASSIGN(const SceneFile file, open_scene(options.scene));
	const RenderSettings& settings = file.base.render;
	RT_TRY_ASSIGN(const PackedScene packed, pack_scene(file.base, settings, {0, 0, settings.width, settings.height}));
	if (!options.spheres.empty())
		RT_TRY(write_spheres(file.base, options.spheres));
	print_result(options.json ? to_text(json(file, packed)) : text(file, packed));
	return success();
}

} // namespace rt
