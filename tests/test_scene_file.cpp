// Reading scenes: every kind of bad input gives the documented kind, line, path and cure; keyframes; sphere sets.
#include "render/json_document.h"
#include "render/scene_file.h"
#include "render/scene_ranges.h"
#include "support/files.h"
#include "tests/catch.h"

#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <unistd.h>

using namespace rt;

namespace {

bool contains(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

std::string replaced(std::string text, const std::string& from, const std::string& to)
{
	const std::size_t at = text.find(from);
	REQUIRE(at != std::string::npos);
	return text.replace(at, from.size(), to);
}

// A good scene, each of whose lines the tables below break in turn.
const std::string good = R"({
"rt": 1,
"camera": {"from": [0, 0, -2], "at": [0, 0, 1], "up": [0, 1, 0], "vfov": 30, "aperture": 0.1, "focus": 3},
"sky": {"kind": "gradient", "bottom": [1, 1, 1], "top": [0.5, 0.7, 1]},
"textures": {"tiles": {"kind": "checker", "size": 0.1, "even": [0.7, 0.2, 0.2], "odd": [1, 1, 1]}},
"materials": {
"ground": {"kind": "lambertian", "albedo": [0.8, 0.8, 0]},
"floor": {"kind": "lambertian", "texture": "tiles"},
"steel": {"kind": "metal", "albedo": [0.7, 0.6, 0.5], "fuzz": 0.1},
"glass": {"kind": "dielectric", "ior": 1.5},
"lamp": {"kind": "light", "emission": [4, 4, 4]}},
"spheres": [
{"center": [0, -100.5, 1], "radius": 100, "material": "ground"},
{"center": [0, 0, 1], "radius": -0.5, "material": "glass"}],
"render": {"width": 32, "height": 16, "samples": 4, "max_depth": 5, "seed": 7}
})";

struct Bad {
	const char* from;    // in `good`
	const char* to;      // makes it bad
	const char* where;   // the whole of it, after the file's name
	const char* message; // a part of it
	const char* cure;    // a part of it
};

const Bad bad_scenes[] = {
    // keys
    {R"("fuzz": 0.1)", R"("colour": 0.1)", ":9, $.materials.steel", "unknown key \"colour\"",
     "keys allowed here: kind, albedo, fuzz"},
    {R"("fuzz": 0.1)", R"("fuz": 0.1)", ":9, $.materials.steel", "unknown key \"fuz\"", "did you mean \"fuzz\"?"},
    {R"("rt": 1,)", R"("rt": 1, "camra": 1,)", ":2, $", "unknown key \"camra\"", "did you mean \"camera\"?"},
    {R"("fuzz": 0.1)", R"("albedo": [1, 1, 1])", ":9, $.materials.steel", "duplicate key \"albedo\"", "line 9"},
    {R"("rt": 1,)", "\"rt\": 1,\n\"sky\": 3,\n", ":6, $", "duplicate key \"sky\"", "line 3"},
    {R"("rt": 1,)", "", ":1, $", "\"rt\" is missing", "add \"rt\""},
    {R"("rt": 1,)", R"("rt": 2,)", ":2, $.rt", "version 2", "version 1"},
    {R"("radius": 100, )", "", ":13, $.spheres[0]", "\"radius\" is missing", "add \"radius\""},
    {R"("kind": "light", )", "", ":11, $.materials.lamp", "\"kind\" is missing", "add \"kind\""},
    {R"("albedo": [0.8, 0.8, 0])", R"("emission": [1, 1, 1])", ":7, $.materials.ground",
     "neither \"albedo\" nor \"texture\"", "add \"albedo\""},
    {R"("texture": "tiles")", R"("texture": "tiles", "albedo": [1, 1, 1])", ":8, $.materials.floor.texture",
     "both \"albedo\" and \"texture\"", "keep one"},
    {R"("spheres": [)", R"("sphere_sets": [)", ":13, $.sphere_sets[0]", "unknown key \"center\"", "materials_file"},
    // types
    {R"("radius": 100)", R"("radius": "100")", ":13, $.spheres[0].radius", "expected a number, found a string",
     "a number"},
    {R"("radius": 100)", R"("radius": null)", ":13, $.spheres[0].radius", "found null", "a number"},
    {R"([0, -100.5, 1])", R"([0, -100.5])", ":13, $.spheres[0].center", "expected a list of 3 numbers, found 2",
     "[x, y, z]"},
    {R"([0, -100.5, 1])", R"([0, true, 1])", ":13, $.spheres[0].center[1]", "found true or false", "a number"},
    {R"([0, -100.5, 1])", R"({"x": 0})", ":13, $.spheres[0].center", "found an object", "a list of 3 numbers"},
    {R"("camera": {)", R"("comment": 3, "camera": {)", ":3, $.comment", "expected a string", "a string"},
    {R"("kind": "light")", R"("kind": ["light"])", ":11, $.materials.lamp.kind", "expected a string, found a list",
     "a string"},
    {R"({"kind": "gradient", "bottom": [1, 1, 1], "top": [0.5, 0.7, 1]})", R"("blue")", ":4, $.sky",
     "expected an object", "an object"},
    // names
    {R"("kind": "light")", R"("kind": "lihgt")", ":11, $.materials.lamp.kind", "unknown kind \"lihgt\"",
     "did you mean \"light\"?"},
    {R"("gradient")", R"("hdri")", ":4, $.sky.kind", "unknown kind \"hdri\"", "choices: none, constant, gradient"},
    {R"("material": "ground")", R"("material": "grond")", ":13, $.spheres[0].material", "no material \"grond\"",
     "did you mean \"ground\"?"},
    {R"("texture": "tiles")", R"("texture": "earth")", ":8, $.materials.floor.texture", "no texture \"earth\"",
     "textures of this scene: tiles"},
    {R"({"kind": "checker", "size": 0.1, "even": [0.7, 0.2, 0.2], "odd": [1, 1, 1]})",
     R"({"kind": "image", "file": "no_such.png"})", ":5, $.textures.tiles.file", "no_such.png", ""},
    {R"({"kind": "checker", "size": 0.1, "even": [0.7, 0.2, 0.2], "odd": [1, 1, 1]})",
     R"({"kind": "image", "file": ""})", ":5, $.textures.tiles.file", "not a file's name", "relative"},
    // ranges
    {R"([0.8, 0.8, 0])", R"([0.8, 1.5, 0])", ":7, $.materials.ground.albedo[1]", "1.5 is out of range", "from 0 to 1"},
    {R"([0.8, 0.8, 0])", R"([0.8, -1e-40, 0])", ":7, $.materials.ground.albedo[1]", "-1e-40 is out of range",
     "from 0 to 1"},
    {R"("fuzz": 0.1)", R"("fuzz": 1.01)", ":9, $.materials.steel.fuzz", "1.01 is out of range", "from 0 to 1"},
    {R"("ior": 1.5)", R"("ior": 0)", ":10, $.materials.glass.ior", "0 is out of range", "from 0.001 to 1000"},
    {R"([4, 4, 4])", R"([4, 4, 1e30])", ":11, $.materials.lamp.emission[2]", "1e+30 is out of range",
     "1000000000, or 0"},
    {R"([4, 4, 4])", R"([4, 4, 1e-40])", ":11, $.materials.lamp.emission[2]", "1e-40 is out of range", "or 0"},
    {R"("radius": 100)", R"("radius": 0)", ":13, $.spheres[0].radius", "0 is out of range", "absolute value"},
    {R"("radius": 100)", R"("radius": 1e39)", ":13, $.spheres[0].radius", "1e+39 is out of range", "1073741824"},
    {R"("radius": 100)", R"("radius": 1e-42)", ":13, $.spheres[0].radius", "1e-42 is out of range", "9.313e-10"},
    {R"([0, -100.5, 1])", R"([1e-42, 0, 1])", ":13, $.spheres[0].center[0]", "1e-42 is out of range", "or 0"},
    {R"([0, -100.5, 1])", R"([0, 1e13, 1])", ":13, $.spheres[0].center[1]", "10000000000000 is out of range", "1e+12"},
    {R"([0, -100.5, 1])", R"([0, 1e999, 1])", ":13, $.spheres[0].center[1]", "1e999 is too large", "below"},
    {R"("size": 0.1)", R"("size": 0)", ":5, $.textures.tiles.size", "0 is out of range", "from 0.0009766 to 1024"},
    {R"("vfov": 30)", R"("vfov": 0)", ":3, $.camera.vfov", "0 is out of range", "between 0 and 180, the ends excluded"},
    {R"("vfov": 30)", R"("vfov": 180)", ":3, $.camera.vfov", "180 is out of range", "ends excluded"},
    {R"("aperture": 0.1)", R"("aperture": -1)", ":3, $.camera.aperture", "-1 is out of range", "or 0"},
    {R"("focus": 3)", R"("focus": 0)", ":3, $.camera.focus", "0 is out of range", "9.313e-10"},
    {R"("at": [0, 0, 1])", R"("at": [0, 0, -2])", ":3, $.camera.at", "where it stands", "must differ"},
    {R"("up": [0, 1, 0])", R"("up": [0, 0, -5])", ":3, $.camera.up", "parallel", "choose an \"up\""},
    {R"("up": [0, 1, 0])", R"("up": [0, 0, 0])", ":3, $.camera.up", "no direction", "[0, 1, 0]"},
    {R"("width": 32)", R"("width": 0)", ":15, $.render.width", "0 is out of range", "a whole number from 1 to 65535"},
    {R"("width": 32)", R"("width": 2.5)", ":15, $.render.width", "2.5 is out of range", "a whole number"},
    {R"("samples": 4)", R"("samples": 4194305)", ":15, $.render.samples", "4194305 is out of range", "4194304"},
    {R"("max_depth": 5)", R"("max_depth": 10001)", ":15, $.render.max_depth", "10001", "10000"},
    {R"("seed": 7)", R"("seed": -1)", ":15, $.render.seed", "-1 is out of range", "4294967295"},
    {R"("seed": 7)", R"("seed": 4294967296)", ":15, $.render.seed", "4294967296 is out of range", "4294967295"},
    {R"("seed": 7)", R"("sampler": "halton")", ":15, $.render.sampler", "halton", "sobol"},
    {R"("seed": 7)", R"("sampler": 2)", ":15, $.render.sampler", "", ""},
    {R"("seed": 7)", R"("estimator": "NEE")", ":15, $.render.estimator", "NEE", "nee"},
    {R"("seed": 7)", R"("roulette": -1)", ":15, $.render.roulette", "-1 is out of range", "10000"},
    // keyframes
    {R"({"center": [0, 0, 1], "radius": -0.5, "material": "glass"})", R"([])", ":14, $.spheres[1]",
     "list of keyframes is empty", "\"frame\""},
    {R"({"center": [0, 0, 1], "radius": -0.5, "material": "glass"})",
     R"([{"center": [0, 0, 1], "radius": -0.5, "material": "glass"}])", ":14, $.spheres[1][0]", "\"frame\" is missing",
     "add \"frame\""},
    {R"({"center": [0, 0, 1], "radius": -0.5, "material": "glass"})",
     "[{\"frame\": 3, \"center\": [0, 0, 1], \"radius\": 1, \"material\": \"glass\"},\n"
     "{\"frame\": 3, \"center\": [0, 0, 1], \"radius\": 1, \"material\": \"glass\"}]",
     ":15, $.spheres[1][1].frame", "frame 3 comes after frame 3", "ascend"},
    {R"({"center": [0, 0, 1], "radius": -0.5, "material": "glass"})",
     "[{\"frame\": 3, \"center\": [0, 0, 1], \"radius\": 1, \"material\": \"glass\"},\n"
     "{\"frame\": 4, \"center\": [0, 0, 1], \"radius\": 1, \"material\": \"lamp\"}]",
     ":15, $.spheres[1][1].material", "changes its material", "use \"glass\""},
    {R"({"center": [0, 0, 1], "radius": -0.5, "material": "glass"})",
     "[{\"frame\": 3, \"center\": [0, 0, 1], \"radius\": 1, \"material\": \"glass\"},\n"
     "{\"frame\": 4, \"center\": [0, 0, 1], \"radius\": -1, \"material\": \"glass\"}]",
     ":15, $.spheres[1][1].radius", "changes its sign", "keep its sign"},
    {R"("vfov": 30)", R"("frame": 3)", ":3, $.camera", "unknown key \"frame\"", "keys allowed here"},
    // syntax: file:line:column, and no path
    {R"("seed": 7})", R"("seed": 7,})", ":15:79", "not valid JSON", "remove the comma"},
    {R"("glass"}],)", R"("glass"},],)", ":14:60", "not valid JSON", "remove the comma"},
    {R"("rt": 1,)", "\"rt\": 1,\n// a remark", ":3:1", "not valid JSON", "no comments"},
    {R"("rt": 1,)", R"("rt": NaN,)", ":2:7", "not valid JSON", "no NaN"},
    {R"("rt": 1,)", R"("rt": -Infinity,)", ":2:8", "not valid JSON", "no NaN"},
    {R"("rt": 1,)", R"('rt': 1,)", ":2:1", "not valid JSON", "double quotes"},
    {R"("rt": 1,)", R"("rt": 1)", ":3:8", "not valid JSON", "missing before it"},
    {R"("seed": 7})", R"("seed": 7)", ":16:2", "not valid JSON", "ends too early"},
    {"7}\n}", "7}\n}}", ":16:2", "not valid JSON", ""},
    {R"("lamp")", "\"la\nmp\"", ":11", "not valid JSON", ""},
    {R"("lamp")", "\"la\xff\"", ":11", "not valid JSON", ""},
};

Result<SceneFile> parsed(const std::string& text) { return parse_scene(text, "dir/x.json"); }

std::string little_endian(const std::vector<float>& values)
{
	std::string bytes;
	for (const float value : values) {
		std::uint32_t bits;
		std::memcpy(&bits, &value, 4);
		for (int k = 0; k < 4; ++k)
			bytes += static_cast<char>(bits >> 8 * k & 255);
	}
	return bytes;
}

std::string little_endian(const std::vector<std::uint32_t>& values)
{
	std::string bytes;
	for (const std::uint32_t value : values)
		for (int k = 0; k < 4; ++k)
			bytes += static_cast<char>(value >> 8 * k & 255);
	return bytes;
}

// A directory of the test's own, removed at its end.
struct Directory {
	Directory()
	{
		std::string name = (std::filesystem::temp_directory_path() / "rt-scene-XXXXXX").string();
		REQUIRE(mkdtemp(name.data()));
		path = name;
	}
	~Directory() { std::filesystem::remove_all(path); }
	Directory(const Directory&) = delete;
	Directory& operator=(const Directory&) = delete;
	void put(const std::string& name, const std::string& bytes) const
	{
		std::ofstream(path / name, std::ios::binary) << bytes;
	}
	std::filesystem::path path;
};

} // namespace

TEST_CASE("a good scene is read as it stands")
{
	const Result<SceneFile> file = parsed(good);
	REQUIRE(file);
	const Scene& scene = file->base;
	CHECK(scene.name == "x");
	CHECK(scene.camera.from == Vec3d{0, 0, -2});
	CHECK(scene.camera.at == Vec3d{0, 0, 1});
	CHECK(scene.camera.vfov == 30);
	CHECK(scene.camera.aperture == 0.1);
	CHECK(scene.camera.focus == 3);
	CHECK(scene.sky.kind == Sky::Kind::Gradient);
	CHECK(scene.sky.top == Vec3d{0.5, 0.7, 1});
	REQUIRE(scene.materials.size() == 5);
	CHECK(scene.materials[0].name == "ground");
	CHECK(scene.materials[1].texture == 0);
	CHECK(scene.materials[2].kind == Material::Kind::Metal);
	CHECK(scene.materials[2].fuzz == 0.1);
	CHECK(scene.materials[3].ior == 1.5);
	CHECK(scene.materials[4].emission == Vec3d{4, 4, 4});
	REQUIRE(scene.spheres.size() == 2);
	CHECK(scene.spheres[0].center == Vec3d{0, -100.5, 1});
	CHECK(scene.spheres[1].radius == -0.5);
	CHECK(scene.spheres[1].material == 3);
	CHECK(scene.render.width == 32);
	CHECK(scene.render.height == 16);
	CHECK(scene.render.samples == 4);
	CHECK(scene.render.max_depth == 5);
	CHECK(scene.render.seed == 7);
	CHECK(scene.render.sampler == Sampler::Independent);
	CHECK(scene.render.estimator == Estimator::Path);
	CHECK(scene.render.roulette == 0);
	CHECK(file->camera_track.empty());
	CHECK(file->sphere_tracks.empty());
	const Result<Scene> frame = file->at_frame(5);
	REQUIRE(frame);
	CHECK(frame->hash == scene.hash);
}

TEST_CASE("a scene file chooses sampler, estimator and roulette; the scene's hash does not know of it")
{
	for (const Sampler sampler : all_samplers)
		for (const Estimator estimator : all_estimators) {
			const Result<SceneFile> file =
			    parsed(replaced(good, R"("seed": 7)",
			                    std::string(R"("seed": 7, "sampler": ")") + sampler_name(sampler) +
			                        R"(", "estimator": ")" + estimator_name(estimator) + R"(", "roulette": 4)"));
			REQUIRE(file);
			CHECK(file->base.render.sampler == sampler);
			CHECK(file->base.render.estimator == estimator);
			CHECK(file->base.render.roulette == 4);
			CHECK(file->base.hash == parsed(good)->base.hash);
		}
}

TEST_CASE("every kind of bad scene has its line, path and cure")
{
	for (const Bad& bad : bad_scenes) {
		INFO(bad.from << "  ->  " << bad.to);
		const Result<SceneFile> file = parsed(replaced(good, bad.from, bad.to));
		REQUIRE_FALSE(file);
		const Error& error = file.error();
		INFO(error.message << " | " << error.where << " | " << error.cure);
		CHECK(error.kind == ErrorKind::InputOutput);
		const std::string where = std::string("dir/x.json") + bad.where;
		// Errors in a file that the scene names go on with the place there; syntax errors with a column.
		CHECK(error.where.compare(0, where.size(), where) == 0);
		CHECK((error.where.size() == where.size() || contains(error.where, "no_such.png") ||
		       contains(error.message, "not valid JSON")));
		CHECK(contains(error.message + " " + error.where, bad.message));
		CHECK(contains(error.cure, bad.cure));
		CHECK(error.message.back() != '.');
	}
}

TEST_CASE("optional parts have defaults")
{
	const Result<SceneFile> file = parsed(R"({"rt": 1, "camera": {"from": [0, 3, 4], "at": [0, 0, 0]},
		"sky": {"kind": "none"}, "spheres": []})");
	REQUIRE(file);
	CHECK(file->base.spheres.empty());
	CHECK(file->base.camera.focus == 5);
	CHECK(file->base.camera.up == Vec3d{0, 1, 0});
	CHECK(file->base.camera.aperture == 0);
	CHECK(file->base.render.width == 640);
	CHECK(file->base.render.samples == 128);
}

TEST_CASE("numbers are the nearest doubles")
{
	const std::string number = "0.1000000000000000055511151231257827021181583404541015625000000000000000001";
	const Result<SceneFile> file = parsed(replaced(good, "\"fuzz\": 0.1", "\"fuzz\": " + number));
	REQUIRE(file);
	CHECK(file->base.materials[2].fuzz == 0.1);
	const Result<SceneFile> minus = parsed(replaced(good, "[0, 0, 1], \"radius\"", "[-0.0, -0, 1], \"radius\""));
	REQUIRE(minus);
	CHECK_FALSE(std::signbit(minus->base.spheres[1].center[0]));
	CHECK_FALSE(std::signbit(minus->base.spheres[1].center[1]));
	CHECK(minus->base.hash == parsed(good)->base.hash);
}

TEST_CASE("the scene's hash is of what can reach a pixel")
{
	const Hash128 hash = parsed(good)->base.hash;
	CHECK(parsed(replaced(good, "\"seed\": 7", "\"seed\": 8"))->base.hash == hash);
	CHECK(parsed(replaced(replaced(good, "\"glass\"", "\"ice\""), "\"glass\"", "\"ice\""))->base.hash == hash);
	CHECK(parsed(replaced(good, "100.5", "100.50000000000001"))->base.hash != hash);
	CHECK(parsed(replaced(good, "\"ior\": 1.5", "\"ior\": 1.6"))->base.hash != hash);
	CHECK(parsed(replaced(good, "0.7, 1]", "0.6, 1]"))->base.hash != hash);
	CHECK(parsed(replaced(good, "\"size\": 0.1", "\"size\": 0.2"))->base.hash != hash);
}

TEST_CASE("hostile text meets limits, not the end of the stack")
{
	const Result<SceneFile> deep = parsed(std::string(1000000, '['));
	REQUIRE_FALSE(deep);
	CHECK(contains(deep.error().message, "nested more than 64 deep"));

	std::string wide = "{\"rt\": 1";
	for (int i = 0; i < 200000; ++i)
		wide += ", \"k" + std::to_string(i) + "\": 0";
	const Result<SceneFile> keys = parsed(wide + "}");
	REQUIRE_FALSE(keys);
	CHECK(contains(keys.error().message, "unknown key \"k0\""));

	const Result<SceneFile> long_key = parsed("{\"" + std::string(1000000, 'x') + "\": 1}");
	REQUIRE_FALSE(long_key);
	CHECK(long_key.error().message.size() < 200);

	for (const char* text : {"", " \n\n ", "\xef\xbb\xbf", "null", "3", "[]", "\"rt\"", "{", "}", "{}"}) {
		INFO(text);
		const Result<SceneFile> file = parsed(text);
		REQUIRE_FALSE(file);
		CHECK(file.error().kind == ErrorKind::InputOutput);
		CHECK(contains(file.error().where, "dir/x.json:"));
	}
}

TEST_CASE("no cut or changed byte of a scene is more than an error")
{
	for (std::size_t length = 0; length < good.size(); ++length)
		CHECK_FALSE(parsed(good.substr(0, length)));
	unsigned random = 1;
	int accepted = 0;
	for (int round = 0; round < 20000; ++round) {
		std::string text = good;
		for (int k = 0; k < 3; ++k) {
			random = random * 1664525 + 1013904223;
			const char likely = "0123456789-.,[]{}\"eE "[random % 21];
			text[(random >> 8) % text.size()] = round % 2 ? static_cast<char>(random >> 24) : likely;
		}
		const Result<SceneFile> file = parsed(text);
		if (file)
			++accepted;
		else
			REQUIRE(contains(file.error().where, "dir/x.json:"));
	}
	CHECK(accepted > 0); // a changed digit is a good scene too
}

TEST_CASE("lines are counted right in every position")
{
	const Result<JsonDocument> document =
	    JsonDocument::parse("\n[1,\n 2\n,\"a\"\n\n,{\n\"k\"\n:\n-3.5e0\n}\r\n,true]\n", "x");
	REQUIRE(document);
	const std::vector<JsonValue> values = document->root().children();
	REQUIRE(values.size() == 5);
	CHECK(document->root().line() == 2);
	CHECK(values[0].line() == 2);
	CHECK(values[1].line() == 3);
	CHECK(values[2].line() == 4);
	CHECK(values[3].line() == 6);
	CHECK(values[3].children()[0].key_line() == 7);
	CHECK(values[3].children()[0].line() == 9);
	CHECK(values[3].children()[0].number() == -3.5);
	CHECK(values[3].children()[0].path() == "$[3].k");
	CHECK(values[4].line() == 11);
}

TEST_CASE("keyframes are interpolated, and held outside their frames")
{
	std::string text = replaced(good, R"({"center": [0, 0, 1], "radius": -0.5, "material": "glass"})", R"([
		{"frame": 2, "center": [0.1, 0, 1], "radius": 1, "material": "glass"},
		{"frame": 6, "center": [0.3, 4, -1], "radius": 3, "material": "glass"},
		{"frame": 9, "center": [0, 4, -1], "radius": 3, "material": "glass"}])");
	text = replaced(
	    text,
	    R"("camera": {"from": [0, 0, -2], "at": [0, 0, 1], "up": [0, 1, 0], "vfov": 30, "aperture": 0.1, "focus": 3})",
	    R"("camera": [{"frame": 0, "from": [0, 0, -2], "at": [0, 0, 1]}, {"frame": 10, "from": [0, 0, -4], "at": [0, 0, 1], "vfov": 50}])");
	const Result<SceneFile> file = parsed(text);
	REQUIRE(file);
	REQUIRE(file->sphere_tracks.size() == 1);
	CHECK(file->sphere_tracks[0].sphere == 1);
	CHECK(file->base.hash == file->at_frame(0)->hash);
	CHECK(file->at_frame(0)->spheres[1].center == Vec3d{0.1, 0, 1});
	CHECK(file->at_frame(2)->spheres[1].center == Vec3d{0.1, 0, 1});
	CHECK(file->at_frame(6)->spheres[1].center == Vec3d{0.3, 4, -1}); // exactly
	CHECK(file->at_frame(100)->spheres[1].center == Vec3d{0, 4, -1});
	const Scene middle = file->at_frame(4).value();
	CHECK(middle.spheres[1].center[0] == Approx(0.2));
	CHECK(middle.spheres[1].center[1] == 2);
	CHECK(middle.spheres[1].center[2] == 0);
	CHECK(middle.spheres[1].radius == 2);
	CHECK(middle.spheres[0].radius == 100);
	CHECK(middle.hash != file->base.hash);
	// The camera moves too; focus follows when it is not given.
	CHECK(file->at_frame(5)->camera.from == Vec3d{0, 0, -3});
	CHECK(file->at_frame(5)->camera.focus == 4);
	CHECK(file->at_frame(5)->camera.vfov == 40);
	for (const double bad : {-1.0, HUGE_VAL, std::nan("")}) {
		REQUIRE_FALSE(file->at_frame(bad));
		CHECK(file->at_frame(bad).error().kind == ErrorKind::Usage);
	}
}

TEST_CASE("a coordinate that passes through zero leaves no rounding residue")
{
	// No length of the contract is below 2^-30 but 0 itself.
	const Result<SceneFile> file =
	    parsed(replaced(good, R"({"center": [0, 0, 1], "radius": -0.5, "material": "glass"})",
	                    R"([{"frame": 0, "center": [0.1, 0, 1], "radius": 1, "material": "glass"},
							{"frame": 3, "center": [-0.2, 0, 1], "radius": 1, "material": "glass"}])"));
	REQUIRE(file);
	const double residue = std::fma(1.0 / 3.0, -0.2 - 0.1, 0.1);
	CHECK(residue != 0);
	CHECK(std::abs(residue) < 0x1p-30);
	CHECK(file->at_frame(1)->spheres[1].center[0] == 0);
}

TEST_CASE("a camera that keyframes lead through its target is refused in that frame")
{
	const Result<SceneFile> file = parsed(R"({"rt": 1, "sky": {"kind": "none"}, "spheres": [], "camera": [
		{"frame": 0, "from": [0, 0, -1], "at": [0, 0, 0]}, {"frame": 2, "from": [0, 0, 1], "at": [0, 0, 0]}]})");
	REQUIRE(file);
	CHECK(file->at_frame(0.5));
	const Result<Scene> scene = file->at_frame(1);
	REQUIRE_FALSE(scene);
	CHECK(scene.error().kind == ErrorKind::Usage);
	CHECK(contains(scene.error().message, "frame 1"));
}

TEST_CASE("sphere sets")
{
	const Directory directory;
	const std::string scene = (directory.path / "set.json").string();
	const auto with = [&](const std::string& set) {
		return parse_scene(R"({"rt": 1, "camera": {"from": [0, 0, -2], "at": [0, 0, 1]}, "sky": {"kind": "none"},
			"materials": {"a": {"kind": "dielectric", "ior": 1.5}, "b": {"kind": "metal", "albedo": [1, 1, 1]}},
			"spheres": [{"center": [9, 9, 9], "radius": 1, "material": "a"}],
			"sphere_sets": [)" +
		                       set + "]}",
		                   scene);
	};
	const auto error_of = [&](const std::string& set) {
		const Result<SceneFile> file = with(set);
		REQUIRE_FALSE(file);
		CHECK(file.error().kind == ErrorKind::InputOutput);
		return file.error().message + " | " + file.error().where + " | " + file.error().cure;
	};
	directory.put("two", little_endian(std::vector<float>{1, 2, 3, 0.1f, -4, -0.0f, 6, -7}));
	directory.put("index", little_endian(std::vector<std::uint32_t>{1, 0}));

	const Result<SceneFile> one = with(R"({"file": "two", "format": "f32le-xyzr", "material": "b"})");
	REQUIRE(one);
	REQUIRE(one->base.spheres.size() == 3);
	CHECK(one->base.spheres[1].center == Vec3d{1, 2, 3});
	CHECK(one->base.spheres[1].radius == static_cast<double>(0.1f));
	CHECK(one->base.spheres[2].radius == -7);
	CHECK_FALSE(std::signbit(one->base.spheres[2].center[1]));
	CHECK(one->base.spheres[2].material == 1);

	const std::string indexed =
	    R"({"file": "two", "format": "f32le-xyzr", "materials_file": "index", "materials": ["b", "a"]})";
	const Result<SceneFile> several = with(indexed);
	REQUIRE(several);
	CHECK(several->base.spheres[1].material == 0);
	CHECK(several->base.spheres[2].material == 1);

	directory.put("index", little_endian(std::vector<std::uint32_t>{1, 2}));
	CHECK(contains(error_of(indexed), "no material 2 | "));
	CHECK(contains(error_of(indexed), "record 1 at byte 4"));
	directory.put("index", "abc");
	CHECK(contains(error_of(indexed), "3 bytes do not match the 2 spheres"));

	directory.put("odd", "0123456789abcdef0");
	CHECK(contains(error_of(R"({"file": "odd", "format": "f32le-xyzr", "material": "b"})"),
	               "17 bytes are not a whole number"));
	directory.put("nan", little_endian(std::vector<float>{1, 2, 3, 1, 1, std::nanf(""), 3, 1}));
	const std::string nan = error_of(R"({"file": "nan", "format": "f32le-xyzr", "material": "b"})");
	CHECK(contains(nan, "nan is out of range for a centre's coordinate"));
	CHECK(contains(nan, "set.json:4, $.sphere_sets[0].file; "));
	CHECK(contains(nan, "record 1 at byte 20"));
	directory.put("zero", little_endian(std::vector<float>{1, 2, 3, 0}));
	CHECK(contains(error_of(R"({"file": "zero", "format": "f32le-xyzr", "material": "b"})"),
	               "0 is out of range for a radius"));
	directory.put("infinite", little_endian(std::vector<float>{1, 2, 3, HUGE_VALF}));
	CHECK(
	    contains(error_of(R"({"file": "infinite", "format": "f32le-xyzr", "material": "b"})"), "inf is out of range"));

	CHECK(contains(error_of(R"({"file": "missing", "format": "f32le-xyzr", "material": "b"})"), "missing"));
	CHECK(contains(error_of(R"({"file": "two", "format": "f32be", "material": "b"})"), "choices: f32le-xyzr"));
	CHECK(contains(error_of(R"({"file": "two", "format": "f32le-xyzr"})"), "\"material\" is missing"));
	CHECK(contains(error_of(R"({"file": "two", "format": "f32le-xyzr", "material": "c"})"), "no material \"c\""));
	CHECK(contains(error_of(R"({"file": "two", "format": "f32le-xyzr", "materials": ["a"]})"),
	               "without \"materials_file\""));
	CHECK(contains(error_of(R"({"file": "two", "format": "f32le-xyzr", "material": "a", "materials_file": "index"})"),
	               "keep one"));
}

TEST_CASE("coordinates that their file rounds too coarsely are counted")
{
	// 1e6 in steps of 2^-33 (a double) or 2^-4 (a float).
	CHECK_FALSE(is_coarse({{1e6, 0, 0}, 1, 0}, 53));
	CHECK(is_coarse({{0, -1e6, 0}, 1, 0}, 24));
	CHECK_FALSE(is_coarse({{800, 0, 0}, 1, 0}, 24));
	CHECK(is_coarse({{0, 0, 1100}, -1, 0}, 24));
	CHECK_FALSE(is_coarse({{0, 0, 0}, 1e-9, 0}, 24));

	const Directory directory;
	directory.put("far", little_endian(std::vector<float>{1e6f, 0, 0, 1, 1, 2, 3, 1}));
	const Result<SceneFile> file = parse_scene(
	    R"({"rt": 1, "camera": {"from": [0, 0, -2], "at": [0, 0, 1]}, "sky": {"kind": "none"},
		"materials": {"a": {"kind": "dielectric", "ior": 1.5}},
		"spheres": [{"center": [1e12, 0, 0], "radius": 1, "material": "a"},
		            {"center": [1e6, 0, 0], "radius": 1, "material": "a"}],
		"sphere_sets": [{"file": "far", "format": "f32le-xyzr", "material": "a"}]})",
	    (directory.path / "set.json").string());
	REQUIRE(file);
	CHECK(file->coarse_spheres == 2);
}

TEST_CASE("bad scene files on disk")
{
	// Each file's expected place and message stand in its own first key or in its name's line here.
	const struct {
		const char* file;
		const char* where;
		const char* message;
	} expected[] = {
	    {"unknown_key.json", ":6, $.materials.steel", "unknown key \"colour\""},
	    {"duplicate_key.json", ":5, $", "duplicate key \"camera\""},
	    {"trailing_comma.json", ":6:", "not valid JSON"},
	    {"not_a_number.json", ":5:", "not valid JSON"},
	    {"missing_material.json", ":7, $.spheres[0].material", "there is no material \"grond\""},
	    {"missing_texture_file.json", ":6, $.textures.globe.file", "no_such_texture.png"},
	    {"out_of_range.json", ":7, $.spheres[0].radius", "is out of range"},
	    {"camera_at_target.json", ":3, $.camera.at", "the camera looks at the point where it stands"},
	    {"empty.json", ":1:1", "not valid JSON"},
	};
	std::size_t files = 0;
	for (const auto& entry : std::filesystem::directory_iterator(RT_TEST_DATA "/bad_scenes"))
		files += entry.path().extension() == ".json";
	CHECK(files == sizeof expected / sizeof expected[0]);
	for (const auto& bad : expected) {
		const std::string path = std::string(RT_TEST_DATA "/bad_scenes/") + bad.file;
		const Result<SceneFile> file = load_scene_file(path);
		REQUIRE_FALSE(file);
		INFO(file.error().message << " | " << file.error().where);
		CHECK(file.error().kind == ErrorKind::InputOutput);
		CHECK(contains(file.error().where, path + bad.where));
		CHECK(contains(file.error().message + file.error().where, bad.message));
	}
	CHECK(load_scene_file(RT_TEST_DATA "/bad_scenes/no_such_file.json").error().kind == ErrorKind::InputOutput);
}
