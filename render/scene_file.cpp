#include "render/scene_file.h"

#include "render/closest_match.h"
#include "render/json_reader.h"
#include "render/sphere_set.h"
#include "render/texture_file.h"
#include "support/files.h"

#include <fmt/format.h>

#include <filesystem>
#include <limits>
#include <new>
#include <unordered_map>

namespace rt {

namespace {

constexpr int format_version = 1;

// Things of a scene that others refer to by name.
struct Names {
	std::vector<std::string> list;
	std::unordered_map<std::string, std::uint32_t> index;

	void add(const std::string& name)
	{
		index.emplace(name, static_cast<std::uint32_t>(list.size()));
		list.push_back(name);
	}
};

// The grammar of a scene: one function a part, in the order of the format's description.
class SceneReader {
public:
	SceneReader(const JsonDocument& document, const std::string& path)
	    : json_(document), root_(document.root()), directory_(std::filesystem::path(path).parent_path())
	{
		file_.base.name = std::filesystem::path(path).stem().string();
	}

	Result<SceneFile> read()
	{
		read_root();
		if (json_.failed())
			return json_.error();
		// Frame 0 is never after the first keyframe, so the base, made of first keyframes, is frame 0.
		update_scene_hash(file_.base);
		return std::move(file_);
	}

private:
	void read_root()
	{
		if (!json_.object(root_, {"rt", "$schema", "name", "comment", "camera", "sky", "textures", "materials",
		                          "spheres", "sphere_sets", "render"}))
			return;
		const double version = json_.number(root_, "rt", {1, 1e9, false, false, false, true});
		if (!json_.failed() && version != format_version)
			json_.fail(*root_.find("rt"), fmt::format("the scene is written in version {} of the format", version),
			           fmt::format("this program reads version {}", format_version));
		for (const char* key : {"$schema", "name", "comment"})
			if (const auto remark = root_.find(key))
				json_.text(*remark);
		if (const auto camera = json_.member(root_, "camera"))
			read_cameras(*camera);
		if (const auto sky = json_.member(root_, "sky"))
			read_sky(*sky);
		if (const auto textures = root_.find("textures"); textures && json_.object_of_any(*textures))
			for (const JsonValue texture : textures->children())
				read_texture(texture);
		if (const auto materials = root_.find("materials"); materials && json_.object_of_any(*materials))
			for (const JsonValue material : materials->children())
				read_material(material);
		const auto spheres = root_.find("spheres");
		const auto sets = root_.find("sphere_sets");
		if (!spheres && !sets)
			json_.member(root_, "spheres");
		if (spheres && json_.array(*spheres, "a list of spheres"))
			for (const JsonValue sphere : spheres->children())
				read_spheres(sphere);
		if (sets && json_.array(*sets, "a list of sphere sets"))
			for (const JsonValue set : sets->children())
				read_sphere_set(set);
		if (const auto render = root_.find("render"))
			read_settings(*render);
	}

	// --- camera ---

	void read_cameras(JsonValue value)
	{
		if (!value.is_array()) {
			file_.base.camera = read_camera(value, false);
			return;
		}
		file_.camera_track = read_track<Camera>(value, [this](JsonValue key) { return read_camera(key, true); });
		if (!file_.camera_track.empty())
			file_.base.camera = file_.camera_track.front().value;
	}

	Camera read_camera(JsonValue value, bool keyframe)
	{
		Camera camera;
		if (!json_.object(value, keys({"from", "at", "up", "vfov", "aperture", "focus"}, keyframe)))
			return camera;
		camera.from = json_.vec3(value, "from", range::coordinate);
		camera.at = json_.vec3(value, "at", range::coordinate);
		camera.up = json_.vec3(value, "up", range::coordinate, camera.up);
		camera.vfov = json_.number(value, "vfov", range::vfov, camera.vfov);
		camera.aperture = json_.number(value, "aperture", range::aperture, camera.aperture);
		if (json_.failed())
			return camera;
		switch (camera_fault(camera)) {
		case CameraFault::None:
			break;
		case CameraFault::SamePoint:
			json_.fail(*value.find("at"), "the camera looks at the point where it stands",
			           "\"from\" and \"at\" must differ");
			break;
		case CameraFault::NoUp:
			json_.fail(*value.find("up"), "\"up\" has no direction", "write [0, 1, 0], or another upward direction");
			break;
		case CameraFault::UpAlongView:
			json_.fail(value.find("up").value_or(value), "\"up\" is parallel to the direction of view",
			           "choose an \"up\" across the line from \"from\" to \"at\", such as [0, 0, 1] for a camera that "
			           "looks straight down");
			break;
		}
		if (const auto focus = value.find("focus")) {
			camera.focus = json_.number(*focus, range::focus);
		} else {
			camera.focus = distance(camera.at, camera.from);
			if (!range::focus.contains(camera.focus))
				json_.fail(
				    value, fmt::format("the distance from \"from\" to \"at\", {}, is out of range", camera.focus),
				    fmt::format("it is also the distance in focus: give \"focus\", {}", range::focus.describe()));
		}
		return camera;
	}

	// --- sky, textures, materials ---

	void read_sky(JsonValue value)
	{
		Sky& sky = file_.base.sky;
		switch (read_kind(value, {"none", "constant", "gradient"}, {{}, {"color"}, {"bottom", "top"}})) {
		case 0:
			sky.kind = Sky::Kind::None;
			break;
		case 1:
			sky.kind = Sky::Kind::Constant;
			sky.bottom = sky.top = json_.vec3(value, "color", range::emission);
			break;
		case 2:
			sky.kind = Sky::Kind::Gradient;
			sky.bottom = json_.vec3(value, "bottom", range::emission);
			sky.top = json_.vec3(value, "top", range::emission);
			break;
		}
	}

	void read_texture(JsonValue value)
	{
		Texture texture;
		texture.name = value.key();
		switch (read_kind(value, {"checker", "image"}, {{"size", "even", "odd"}, {"file"}})) {
		case 0:
			texture.kind = Texture::Kind::Checker;
			texture.size = json_.number(value, "size", range::checker_size);
			texture.even = json_.vec3(value, "even", range::albedo);
			texture.odd = json_.vec3(value, "odd", range::albedo);
			break;
		case 1:
			texture.kind = Texture::Kind::Image;
			read_image(value, texture);
			break;
		}
		textures_.add(texture.name);
		file_.base.textures.push_back(std::move(texture));
	}

	void read_image(JsonValue value, Texture& texture)
	{
		texture.file = read_file_name(value, "file");
		if (json_.failed())
			return;
		Result<TextureImage> image = load_texture(texture.file);
		if (!image) {
			fail_in_file(*value.find("file"), image.error());
			return;
		}
		texture.width = image->width;
		texture.height = image->height;
		texture.texels = std::move(image->texels);
	}

	void read_material(JsonValue value)
	{
		Material material;
		material.name = value.key();
		switch (read_kind(value, {"lambertian", "metal", "dielectric", "light"},
		                  {{"albedo", "texture", "emission"}, {"albedo", "fuzz"}, {"ior"}, {"emission"}})) {
		case 0:
			material.kind = Material::Kind::Lambertian;
			read_reflectance(value, material);
			material.emission = json_.vec3(value, "emission", range::emission, material.emission);
			break;
		case 1:
			material.kind = Material::Kind::Metal;
			material.albedo = json_.vec3(value, "albedo", range::albedo);
			material.fuzz = json_.number(value, "fuzz", range::fuzz, material.fuzz);
			break;
		case 2:
			material.kind = Material::Kind::Dielectric;
			material.ior = json_.number(value, "ior", range::ior);
			break;
		case 3:
			material.kind = Material::Kind::Light;
			material.emission = json_.vec3(value, "emission", range::emission);
			break;
		}
		materials_.add(material.name);
		file_.base.materials.push_back(std::move(material));
	}

	// A lambertian surface has one colour, or one texture.
	void read_reflectance(JsonValue value, Material& material)
	{
		const auto texture = value.find("texture");
		if (texture && value.find("albedo")) {
			json_.fail(*texture, "both \"albedo\" and \"texture\" are given", "keep one of them");
		} else if (texture) {
			material.texture = static_cast<int>(find_name(*texture, textures_, "texture"));
		} else if (value.find("albedo") || json_.failed()) {
			material.albedo = json_.vec3(value, "albedo", range::albedo);
		} else {
			json_.fail(value, "neither \"albedo\" nor \"texture\" is given",
			           "add \"albedo\": [r, g, b] or \"texture\": \"name\"");
		}
	}

	// --- spheres ---

	void read_spheres(JsonValue value)
	{
		if (json_.failed())
			return;
		std::vector<Sphere>& spheres = file_.base.spheres;
		if (!value.is_array()) {
			spheres.push_back(read_sphere(value, false));
			return;
		}
		SceneFile::SphereTrack track;
		track.sphere = static_cast<std::uint32_t>(spheres.size());
		track.keys = read_track<Sphere>(value, [this](JsonValue key) { return read_sphere(key, true); });
		if (json_.failed())
			return;
		const Sphere& first = track.keys.front().value;
		const std::vector<JsonValue> keyframes = value.children();
		for (std::size_t i = 1; i < keyframes.size(); ++i) {
			const Sphere& sphere = track.keys[i].value;
			if (sphere.material != first.material)
				json_.fail(*keyframes[i].find("material"), "a sphere changes its material",
				           fmt::format("use {} in all its keyframes", in_quotes(materials_.list[first.material])));
			if ((sphere.radius < 0) != (first.radius < 0))
				json_.fail(*keyframes[i].find("radius"), "a radius changes its sign between keyframes",
				           "a radius cannot pass through 0: keep its sign");
		}
		spheres.push_back(first);
		file_.sphere_tracks.push_back(std::move(track));
	}

	Sphere read_sphere(JsonValue value, bool keyframe)
	{
		Sphere sphere;
		if (!json_.object(value, keys({"center", "radius", "material"}, keyframe)))
			return sphere;
		sphere.center = json_.vec3(value, "center", range::coordinate);
		sphere.radius = json_.number(value, "radius", range::radius);
		if (const auto material = json_.member(value, "material"))
			sphere.material = find_name(*material, materials_, "material");
		file_.coarse_spheres += is_coarse(sphere, std::numeric_limits<double>::digits);
		return sphere;
	}

	void read_sphere_set(JsonValue value)
	{
		if (!json_.object(value, {"file", "format", "material", "materials_file", "materials"}))
			return;
		json_.choice(value, "format", {"f32le-xyzr"});
		SphereSet set;
		set.spheres_file = read_file_name(value, "file");
		const auto one = value.find("material");
		const auto several = value.find("materials_file");
		if (one && several) {
			json_.fail(*several, "both \"material\" and \"materials_file\" are given", "keep one of them");
		} else if (several) {
			set.materials_file = read_file_name(value, "materials_file");
			if (const auto names = json_.member(value, "materials");
			    names && json_.array(*names, "a list of names of materials"))
				for (const JsonValue name : names->children())
					set.materials.push_back(find_name(name, materials_, "material"));
		} else if (const auto unused = value.find("materials")) {
			json_.fail(*unused, "\"materials\" is given without \"materials_file\"",
			           "name one \"material\" for the set, or add \"materials_file\"");
		} else if (const auto material = json_.member(value, "material")) {
			set.materials.push_back(find_name(*material, materials_, "material"));
		}
		if (json_.failed())
			return;
		std::vector<Sphere>& spheres = file_.base.spheres;
		const std::size_t before = spheres.size();
		if (const Status status = append_sphere_set(set, spheres); !status)
			fail_in_file(*value.find("file"), status.error());
		for (std::size_t i = before; i < spheres.size(); ++i)
			file_.coarse_spheres += is_coarse(spheres[i], std::numeric_limits<float>::digits);
	}

	// --- render settings ---

	void read_settings(JsonValue value)
	{
		if (!json_.object(value,
		                  {"width", "height", "samples", "max_depth", "seed", "sampler", "estimator", "roulette"}))
			return;
		RenderSettings& settings = file_.base.render;
		settings.width = json_.integer(value, "width", range::image_size, settings.width);
		settings.height = json_.integer(value, "height", range::image_size, settings.height);
		settings.samples = json_.integer(value, "samples", range::samples, settings.samples);
		settings.max_depth = json_.integer(value, "max_depth", range::max_depth, settings.max_depth);
		settings.seed = json_.integer(value, "seed", range::seed, settings.seed);
		settings.roulette = json_.integer(value, "roulette", range::roulette, settings.roulette);
		settings.sampler = named(value, "sampler", all_samplers, sampler_name, settings.sampler);
		settings.estimator = named(value, "estimator", all_estimators, estimator_name, settings.estimator);
	}

	template <class Choice, std::size_t count>
	Choice named(JsonValue value, const char* key, const std::array<Choice, count>& all, const char* (*name)(Choice),
	             Choice otherwise)
	{
		if (!value.find(key))
			return otherwise;
		std::vector<std::string> names;
		for (const Choice choice : all)
			names.emplace_back(name(choice));
		const std::size_t index = json_.choice(value, key, names);
		return index < count ? all[index] : otherwise;
	}

	// --- parts of the grammar that recur ---

	static std::vector<std::string> keys(std::vector<std::string> plain, bool keyframe)
	{
		if (keyframe)
			plain.insert(plain.begin(), "frame");
		return plain;
	}

	// An object whose other keys depend on its "kind": the kind's index.
	std::size_t read_kind(JsonValue value, const std::vector<std::string>& kinds,
	                      const std::vector<std::vector<std::string>>& keys_of_kind)
	{
		if (!json_.object_of_any(value))
			return kinds.size();
		const std::size_t kind = json_.choice(value, "kind", kinds);
		if (json_.failed())
			return kinds.size();
		std::vector<std::string> allowed = keys_of_kind[kind];
		allowed.insert(allowed.begin(), "kind");
		return json_.object(value, allowed) ? kind : kinds.size();
	}

	// A list of keyframes, strictly ascending.
	template <class T, class ReadOne>
	std::vector<Keyframe<T>> read_track(JsonValue value, ReadOne read_one)
	{
		std::vector<Keyframe<T>> track;
		if (value.size() == 0)
			json_.fail(value, "the list of keyframes is empty", "give one object, or a list of objects with \"frame\"");
		for (const JsonValue key : value.children()) {
			Keyframe<T> keyframe;
			keyframe.value = read_one(key);
			if (json_.failed())
				return track;
			keyframe.frame = json_.number(key, "frame", range::frame);
			if (!json_.failed() && !track.empty() && keyframe.frame <= track.back().frame)
				json_.fail(*key.find("frame"),
				           fmt::format("frame {} comes after frame {}", keyframe.frame, track.back().frame),
				           "keyframes must ascend, each frame once");
			track.push_back(std::move(keyframe));
		}
		return track;
	}

	std::uint32_t find_name(JsonValue value, const Names& names, const char* what)
	{
		const std::string name = json_.text(value);
		if (json_.failed())
			return 0;
		if (const auto found = names.index.find(name); found != names.index.end())
			return found->second;
		json_.fail(value, fmt::format("there is no {} {}", what, in_quotes(name)),
		           names.list.empty() ? fmt::format("the scene has no {}s: add \"{}s\" with this one", what, what)
		                              : name_cure(name, fmt::format("{}s of this scene", what), names.list));
		return 0;
	}

	// Files are named relative to the scene's own directory.
	std::string read_file_name(JsonValue object, const char* key)
	{
		const auto value = json_.member(object, key);
		if (!value)
			return {};
		const std::string name = json_.text(*value);
		if (!json_.failed() && (name.empty() || name.find('\0') != std::string::npos))
			json_.fail(*value, "this is not a file's name", "name a file, relative to the scene's own directory");
		return json_.failed() ? std::string() : (directory_ / name).string();
	}

	// An error in a file that the scene names: where the scene names it, then where in that file.
	void fail_in_file(JsonValue at, Error error)
	{
		error.where = json_.where(at) + (error.where.empty() ? "" : "; " + error.where);
		json_.fail(std::move(error));
	}

	JsonReader json_;
	JsonValue root_;
	std::filesystem::path directory_;
	SceneFile file_;
	Names textures_, materials_;
};

} // namespace

Result<SceneFile> parse_scene(std::string_view text, const std::string& path)
{
	try {
		RT_TRY_ASSIGN(const JsonDocument document, JsonDocument::parse(text, path));
		return SceneReader(document, path).read();
	} catch (const std::bad_alloc&) {
		return Error{ErrorKind::Memory, "no memory for the scene", path, "use a smaller scene", {}};
	} catch (const std::exception& exception) {
		return Error{ErrorKind::InputOutput, "the scene could not be read", path, "report this as a bug",
		             exception.what()};
	}
}

Result<SceneFile> load_scene_file(const std::string& path)
{
	RT_TRY_ASSIGN(const std::vector<std::uint8_t> bytes, read_file(path, max_json_bytes));
	return parse_scene(std::string_view(reinterpret_cast<const char*>(bytes.data()), bytes.size()), path);
}

} // namespace rt
