// test_cli.cpp: the program as a user meets it: the real binary as a child process, its exit status, its two output
// streams and its files. Renders are tiny and on the reference backend, which every machine has.
#include "common/rt_contract.h"
#include "render/image_file.h"
#include "render/provenance.h"
#include "render/texture_file.h"
#include "support/files.h"
#include "tests/catch.h"

#include <nlohmann/json.hpp>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <random>
#include <regex>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include <fcntl.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

namespace {

namespace fs = std::filesystem;
using Arguments = std::vector<std::string>;
using Json = nlohmann::json;

std::string text_of(const fs::path& path)
{
	const auto bytes = rt::read_file(path.string());
	return bytes ? std::string(bytes->begin(), bytes->end()) : std::string();
}

// A new empty directory, removed with everything in it. Files of its own: the children's kernel cache and outputs.
class Directory {
public:
	Directory()
	{
		std::string pattern = (fs::temp_directory_path() / "rt-test-cli-XXXXXX").string();
		REQUIRE(mkdtemp(pattern.data()) != nullptr);
		path_ = pattern;
	}
	~Directory()
	{
		std::error_code ignored;
		fs::remove_all(path_, ignored);
	}
	Directory(const Directory&) = delete;
	Directory& operator=(const Directory&) = delete;
	fs::path operator/(const std::string& name) const { return path_ / name; }
	const fs::path& path() const { return path_; }
	std::size_t entries() const
	{
		return static_cast<std::size_t>(std::distance(fs::directory_iterator(path_), fs::directory_iterator()));
	}
	void write(const std::string& name, const std::string& text) const
	{
		REQUIRE(rt::write_file((path_ / name).string(), text));
	}

private:
	fs::path path_;
};

// One kernel cache for all children, so that the device is tested once.
const Directory& shared_cache()
{
	static const Directory cache;
	return cache;
}

// A running rt. Its streams go to files outside of its working directory.
class Child {
public:
	Child(const Directory& where, const Arguments& arguments, const std::string& standard_output = "")
	{
		const std::string out = standard_output.empty() ? (streams_ / "out").string() : standard_output;
		const std::string err = (streams_ / "err").string();
		const std::string cache = shared_cache().path().string();
		process_ = fork();
		REQUIRE(process_ >= 0);
		if (process_ == 0)
			become_rt(where.path().string(), arguments, out, err, cache);
	}
	~Child()
	{
		if (process_ > 0) {
			::kill(process_, SIGKILL);
			(void)waitpid(process_, nullptr, 0);
		}
	}
	Child(const Child&) = delete;
	Child& operator=(const Child&) = delete;

	void signal(int number) const { REQUIRE(::kill(process_, number) == 0); }
	std::string err() const { return text_of(streams_ / "err"); }
	std::string out() const { return text_of(streams_ / "out"); }

	// Waits until the condition holds; false if it does not within a minute or the process ends first.
	bool wait_for(const std::function<bool()>& condition)
	{
		for (int i = 0; i < 60000; i++) {
			if (condition())
				return true;
			if (ended())
				return condition();
			// Some conditions hold for some milliseconds only.
			std::this_thread::sleep_for(std::chrono::milliseconds(1));
		}
		return false;
	}

	// The exit status; 1000 + the signal that ended it; -1 if it does not end.
	int status()
	{
		for (int i = 0; i < 12000 && !ended(); i++)
			std::this_thread::sleep_for(std::chrono::milliseconds(5));
		return status_;
	}

private:
	[[noreturn]] static void become_rt(const std::string& where, const Arguments& arguments, const std::string& out,
	                                   const std::string& err, const std::string& cache)
	{
		std::vector<char*> argv;
		std::string program = RT_PROGRAM;
		argv.push_back(program.data());
		Arguments copies = arguments;
		for (std::string& argument : copies)
			argv.push_back(argument.data());
		argv.push_back(nullptr);
		const int out_file = open(out.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0666);
		const int err_file = open(err.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0666);
		const int null = open("/dev/null", O_RDONLY);
		if (out_file < 0 || err_file < 0 || null < 0 || chdir(where.c_str()) != 0 || dup2(null, 0) < 0 ||
		    dup2(out_file, 1) < 0 || dup2(err_file, 2) < 0 || setenv("RT_CACHE_DIR", cache.c_str(), 1) != 0)
			_exit(99);
		execv(program.c_str(), argv.data());
		_exit(98);
	}

	bool ended()
	{
		if (process_ < 0)
			return true;
		int status = 0;
		if (waitpid(process_, &status, WNOHANG) != process_)
			return false;
		process_ = -1;
		status_ = WIFEXITED(status) ? WEXITSTATUS(status) : 1000 + WTERMSIG(status);
		return true;
	}

	Directory streams_;
	pid_t process_ = -1;
	int status_ = -1;
};

struct Outcome {
	int status;
	std::string out, err;
};

Outcome run(const Directory& where, const Arguments& arguments, const std::string& standard_output = "")
{
	Child child(where, arguments, standard_output);
	const int status = child.status();
	return {status, child.out(), child.err()};
}

Arguments operator+(Arguments a, const Arguments& b)
{
	a.insert(a.end(), b.begin(), b.end());
	return a;
}

const std::string most_samples = std::to_string(RT_MAX_SAMPLES), too_many = std::to_string(RT_MAX_SAMPLES + 1);

// A render that takes milliseconds.
const Arguments small = {"--backend", "reference", "--size", "24x16", "--samples", "2"};

std::size_t count(const std::string& text, const std::string& part)
{
	std::size_t found = 0;
	for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1))
		found++;
	return found;
}

std::string last_line(std::string text)
{
	while (!text.empty() && text.back() == '\n')
		text.pop_back();
	return text.substr(text.rfind('\n') + 1);
}

// The film hash that a run ends with; fails if there is none.
std::string film_hash(const std::string& text)
{
	const std::string line = last_line(text);
	INFO(text);
	REQUIRE(std::regex_match(line, std::regex("film [0-9a-f]{32}")));
	return line.substr(5);
}

std::string render_hash(const Directory& where, const Arguments& arguments)
{
	const Outcome outcome = run(where, arguments);
	INFO(outcome.err);
	REQUIRE(outcome.status == 0);
	return film_hash(outcome.out);
}

std::string joined(const Arguments& arguments)
{
	std::string text;
	for (const std::string& argument : arguments)
		text += argument + ' ';
	return text;
}

// One error of this status that contains all parts, nothing on standard output, and no file that was not there.
void check_refused(const Directory& where, const Arguments& arguments, int status, const Arguments& parts)
{
	const std::size_t before = where.entries();
	const Outcome outcome = run(where, arguments);
	INFO(joined(arguments) << "\n" << outcome.err);
	CHECK(outcome.status == status);
	CHECK(count(outcome.err, "rt: error: ") == 1);
	CHECK(count(outcome.err, "cure:") == 1);
	CHECK(outcome.out.empty());
	CHECK(where.entries() == before);
	for (const std::string& part : parts) {
		INFO("expected in the message: " << part);
		CHECK(outcome.err.find(part) != std::string::npos);
	}
}

// A scene with the given text in the place of one of its parts.
std::string scene_text(const std::string& replaced = "", const std::string& by = "")
{
	std::string text = R"({
	"rt": 1,
	"camera": {"from": [0, 0, -2], "at": [0, 0, 1], "vfov": 30},
	"sky": {"kind": "constant", "color": [1, 1, 1]},
	"textures": {"paint": {"kind": "checker", "size": 0.1, "even": [1, 0, 0], "odd": [0, 1, 0]}},
	"materials": {"ball": {"kind": "lambertian", "texture": "paint"}},
	"spheres": [{"center": [0, 0, 1], "radius": 0.5, "material": "ball"}],
	"render": {"width": 24, "height": 16, "samples": 2}
}
)";
	if (!replaced.empty()) {
		const std::size_t at = text.find(replaced);
		REQUIRE(at != std::string::npos);
		text.replace(at, replaced.size(), by);
	}
	return text;
}

const std::string png_signature("\x89PNG\r\n\x1a\n", 8);

// The first 33 bytes of a PNG file: signature and IHDR of 8-bit RGB, with a checksum that is right.
std::string png_header(unsigned width, unsigned height)
{
	std::string header = "IHDR";
	for (const unsigned side : {width, height})
		for (int shift = 24; shift >= 0; shift -= 8)
			header += static_cast<char>(side >> shift & 0xff);
	header += std::string("\x08\x02\x00\x00\x00", 5);
	unsigned crc = 0xffffffffu;
	for (const char c : header) {
		crc ^= static_cast<unsigned char>(c);
		for (int bit = 0; bit < 8; bit++)
			crc = crc >> 1 ^ (crc & 1u ? 0xedb88320u : 0u);
	}
	crc = ~crc;
	std::string file = png_signature + std::string("\0\0\0\x0d", 4) + header;
	for (int shift = 24; shift >= 0; shift -= 8)
		file += static_cast<char>(crc >> shift & 0xff);
	return file;
}

} // namespace

TEST_CASE("help and version go to standard output")
{
	const Directory where;
	for (const Arguments& arguments : std::vector<Arguments>{{"--help"},
	                                                         {"-h"},
	                                                         {"help"},
	                                                         {"render", "--help"},
	                                                         {"devices", "--help"},
	                                                         {"info", "--help"},
	                                                         {"--width", "12", "--help"}}) {
		const Outcome outcome = run(where, arguments);
		INFO(joined(arguments));
		CHECK(outcome.status == 0);
		CHECK(outcome.err.empty());
		CHECK(outcome.out.find("Usage: rt") != std::string::npos);
	}
	const std::string help = run(where, {"--help"}).out;
	for (const char* option :
	     {"--width",     "--height",   "--size",     "--samples", "--spp",     "--seed",
	      "--max-depth", "--frames",   "--output",   "--outfile", "--backend", "--device",
	      "--precision", "--transfer", "--exposure", "--pixel",   "--crop",    "--checkpoint",
	      "--resume",    "--progress", "--quiet",    "--verbose", "--stats",   "--force-unverified",
	      "--self-test", "--generic",  "--lanes",    "--help",    "--version", "Examples",
	      "devices",     "info"}) {
		INFO(option);
		CHECK(help.find(option) != std::string::npos);
	}
	const Outcome version = run(where, {"--version"});
	CHECK(version.status == 0);
	CHECK(std::regex_search(version.out, std::regex("^rt [0-9]+\\.[0-9]+\\.[0-9]+ \\(revision .+\\)\n")));
	CHECK(std::regex_search(version.out, std::regex("numeric contract [0-9]+\n")));
	CHECK(std::regex_search(version.out, std::regex("kernels [0-9a-f]{32}\n")));
	CHECK(where.entries() == 0);
}

TEST_CASE("a wrong command line is one usage error that names option, value and range")
{
	const Directory where;
	struct Case {
		Arguments arguments, parts;
	};
	const std::vector<Case> cases = {
	    {{"--samples", "0"}, {"--samples", "'0'", "from 1 to " + most_samples}},
	    {{"--spp", "-4"}, {"--samples", "'-4'"}},
	    {{"--samples", too_many}, {"--samples", "'" + too_many + "'"}},
	    {{"--samples", "12x"}, {"--samples", "'12x'"}},
	    {{"--samples", "1e3"}, {"--samples", "'1e3'"}},
	    {{"--samples", " 4"}, {"--samples", "' 4'"}},
	    {{"--samples", "99999999999999999999999"}, {"--samples", "'99999999999999999999999'"}},
	    {{"--samples", "nan"}, {"--samples", "'nan'"}},
	    {{"--samples"}, {"--samples"}},
	    {{"--samples="}, {"--samples"}},
	    {{"--samples", ""}, {"--samples", "empty"}},
	    {{"--width", "0"}, {"--width", "'0'", "from 1 to "}},
	    {{"--width", "-1"}, {"--width", "'-1'"}},
	    {{"--width", "4294967297"}, {"--width", "'4294967297'"}},
	    {{"--height", "18446744073709551617"}, {"--height", "'18446744073709551617'"}},
	    {{"--height", "0x10"}, {"--height", "'0x10'"}},
	    {{"--height", "10.5"}, {"--height", "'10.5'"}},
	    {{"--width", "3", "--width", "4"}, {"--width"}},
	    {{"--size", "640"}, {"--size", "'640'"}},
	    {{"--size", "640x"}, {"--size", "'640x'"}},
	    {{"--size", "0x480"}, {"--size", "'0x480'"}},
	    {{"--size", "640x480x3"}, {"--size", "'640x480x3'"}},
	    {{"--size", "100000x100000"}, {"--size", "'100000x100000'"}},
	    {{"--size", "6x4", "--width", "6"}, {"--size", "--width"}},
	    {{"--seed", "4294967296"}, {"--seed", "'4294967296'", "from 0 to 4294967295"}},
	    {{"--max-depth", "0"}, {"--max-depth", "'0'"}},
	    {{"--frames", "5:2"}, {"--frames", "'5:2'"}},
	    {{"--frames", "0:1000000000"}, {"--frames", "'0:1000000000'"}},
	    {{"--frames", "a:b"}, {"--frames", "'a:b'"}},
	    {{"--frames", "0:3", "-o", "-"}, {"standard output"}},
	    {{"--pixel", "3"}, {"--pixel", "'3'"}},
	    {{"--pixel", "640,0"}, {"--pixel", "640x480"}},
	    {{"--crop", "0,10,0"}, {"--crop", "'0,10,0'"}},
	    {{"--crop", "10,10,0,5"}, {"--crop", "'10,10,0,5'"}},
	    {{"--crop", "0,641,0,5"}, {"--crop", "640x480"}},
	    {{"--crop", "0,2,0,2", "--pixel", "1,1"}, {"--crop", "--pixel"}},
	    {{"--transfer", "gamma"}, {"--transfer", "'gamma'", "srgb, gamma2, linear"}},
	    {{"--exposure", "bright"}, {"--exposure", "'bright'"}},
	    {{"--exposure", "nan"}, {"--exposure", "'nan'"}},
	    {{"--exposure", "1e9"}, {"--exposure", "'1e9'"}},
	    {{"--precision", "half"}, {"--precision", "'half'", "exact, fast, double"}},
	    {{"--precision", "double", "--lanes", "4"}, {"--precision double", "one lane"}},
	    {{"--backend", "vulkan"}, {"vulkan", "cuda, opencl, reference"}},
	    {{"--lanes", "3"}, {"--lanes", "'3'", "1, 4, 8, 16"}},
	    {{"--progress", "loud"}, {"--progress", "'loud'"}},
	    {{"--smaples", "3"}, {"'--smaples'", "did you mean --samples?"}},
	    {{"--nonsense"}, {"'--nonsense'", "--help"}},
	    {{"-Z"}, {"'-Z'"}},
	    {{"three-spheres", "planets"}, {"'planets'"}},
	    {{"-q", "-v"}, {"--quiet", "--verbose"}},
	    {{"-o", "picture.gif"}, {"picture.gif", ".png", ".exr", ".pfm", ".rtfilm"}},
	    {{"-o", "folder/"}, {"folder/"}},
	    {{"-o", "-", "--stats", "-"}, {"standard output"}},
	    {{"--checkpoint", "-"}, {"--checkpoint"}},
	    {{"--frames", "0:3", "--checkpoint", "a.rtfilm"}, {"--checkpoint"}},
	    {{"info"}, {"info", "scene"}},
	    {{"info", "three-spheres", "--wrong"}, {"'--wrong'"}},
	    {{"devices", "--wrong"}, {"'--wrong'"}},
	    {{"devices", "extra"}, {"'extra'"}},
	};
	for (const Case& each : cases)
		check_refused(where, each.arguments, 2, each.parts);
}

TEST_CASE("a device that is not there or not clear is refused")
{
	const Directory where;
	check_refused(where, small + Arguments{"-d", "no such device"}, 3, {"no such device"});
	check_refused(where, {"-d", "999", "--size", "4x4"}, 3, {"999"});
	check_refused(where, {"-d", "pci:ffff:ff:1f.7", "--size", "4x4"}, 3, {"ffff:ff:1f.7"});
	check_refused(where, small + Arguments{"-d", "reference,,reference"}, 2, {"reference,,reference"});

	// A device is matched as BACKEND:NAME, so a colon means all of them.
	const Outcome list = run(where, {"devices", "--json"});
	REQUIRE(list.status == 0);
	std::vector<std::string> seen;
	const Json shown = Json::parse(list.out);
	for (const Json& device : shown.at("devices")) {
		const auto pci = device.at("pci").get<std::string>();
		if (device.at("usable").get<bool>() && (pci.empty() || std::count(seen.begin(), seen.end(), pci) == 0))
			seen.push_back(pci);
	}
	if (seen.size() > 1)
		check_refused(where, {"-d", ":", "--size", "4x4"}, 3, {"':' matches", "reference"});
}

TEST_CASE("a wrong scene is one error with file and place, and no image")
{
	const Directory where;
	check_refused(where, small + Arguments{"missing.json"}, 7, {"missing.json"});
	check_refused(where, small + Arguments{"no-such-scene"}, 7, {"no-such-scene"});
	check_refused(where, small + Arguments{"cloud-0"}, 7, {"cloud"});
	check_refused(where, small + Arguments{where.path().string()}, 7, {});

	struct Case {
		std::string replaced, by;
		Arguments parts;
	};
	const std::vector<Case> cases = {
	    {"\"spheres\": [", "\"spheres\": ", {"scene.json:"}},
	    {"\"vfov\"", "\"vfow\"", {"scene.json:3", "vfow", "vfov"}},
	    {"\"vfov\": 30", "\"vfov\": \"wide\"", {"scene.json:3", "$.camera.vfov"}},
	    {"\"vfov\": 30", "\"vfov\": NaN", {"scene.json:3"}},
	    {"\"vfov\": 30", "\"vfov\": 1e999", {"scene.json:3"}},
	    {"\"vfov\": 30", "\"vfov\": 180", {"scene.json:3", "$.camera.vfov"}},
	    {"\"vfov\": 30", "\"vfov\": 30, \"vfov\": 31", {"scene.json:3", "vfov"}},
	    {"\"at\": [0, 0, 1]", "\"at\": [0, 0, -2]", {"scene.json:3", "$.camera"}},
	    {"\"radius\": 0.5", "\"radius\": 0", {"scene.json:7", "$.spheres[0].radius"}},
	    {"\"radius\": 0.5", "\"radius\": 1e30", {"scene.json:7", "$.spheres[0].radius"}},
	    {"\"material\": \"ball\"", "\"material\": \"bell\"", {"scene.json:7", "bell", "ball"}},
	    {"\"texture\": \"paint\"", "\"texture\": \"pant\"", {"scene.json:6", "pant", "paint"}},
	    {"\"even\": [1, 0, 0]", "\"even\": [1, 0]", {"scene.json:5", "$.textures.paint.even"}},
	    {"\"even\": [1, 0, 0]", "\"even\": [1, 0, 2]", {"scene.json:5", "$.textures.paint.even"}},
	    {"\"width\": 24", "\"width\": 0", {"scene.json:8", "$.render.width"}},
	    {"\"width\": 24", "\"width\": -24", {"scene.json:8", "$.render.width"}},
	    {"\"width\": 24", "\"width\": 4294967320", {"scene.json:8", "$.render.width"}},
	    {"\"samples\": 2", "\"samples\": 0", {"scene.json:8", "$.render.samples"}},
	    {"\"rt\": 1", "\"rt\": 2", {"scene.json:2", "rt"}},
	};
	for (const Case& each : cases) {
		where.write("scene.json", scene_text(each.replaced, each.by));
		check_refused(where, {"scene.json", "--backend", "reference"}, 7, each.parts);
		check_refused(where, {"info", "scene.json"}, 7, each.parts);
	}

	const std::string image = R"("paint": {"kind": "image", "file": "paint.png"})";
	const std::string checker = R"("paint": {"kind": "checker", "size": 0.1, "even": [1, 0, 0], "odd": [0, 1, 0]})";
	where.write("scene.json", scene_text(checker, image));
	check_refused(where, {"scene.json"}, 7, {"scene.json:5", "paint.png"});
	where.write("paint.png", png_signature + "nothing that a PNG file could hold");
	check_refused(where, {"scene.json"}, 7, {"paint.png"});
	where.write("paint.png", png_header(100000, 100000));
	check_refused(where, {"scene.json"}, 7, {"paint.png", "100000"});
	where.write("paint.png", png_header(8, 8));
	check_refused(where, {"scene.json"}, 7, {"paint.png"});
	where.write("paint.png", "");
	check_refused(where, {"scene.json"}, 7, {"paint.png"});
}

TEST_CASE("an output that cannot be written is refused before anything is rendered")
{
	const Directory where;
	// So many samples that a render would run into the test's own limit.
	const Arguments endless = {"--backend", "reference", "--samples", most_samples};
	check_refused(where, endless + Arguments{"-o", "nowhere/picture.png"}, 7, {"nowhere/picture.png"});
	check_refused(where, endless + Arguments{"--stats", "nowhere/stats.json"}, 7, {"nowhere/stats.json"});
	check_refused(where, endless + Arguments{"--checkpoint", "nowhere/a.rtfilm"}, 7, {"nowhere/a.rtfilm"});
	check_refused(where, endless + Arguments{"--resume", "missing.rtfilm"}, 7, {"missing.rtfilm"});
	where.write("broken.rtfilm", "RTFILM\r\n and then nothing of the kind");
	check_refused(where, endless + Arguments{"--resume", "broken.rtfilm"}, 7, {"broken.rtfilm"});
	fs::create_directory(where / "folder.png");
	check_refused(where, endless + Arguments{"-o", "folder.png"}, 7, {"folder.png"});
}

TEST_CASE("a full disk is an error")
{
	if (!fs::exists("/dev/full"))
		return;
	const Directory where;
	for (const Arguments& arguments : {small + Arguments{"-o", "-"}, small + Arguments{"-o", "picture.png"},
	                                   Arguments{"--help"}, Arguments{"devices"}}) {
		const Outcome outcome = run(where, arguments, "/dev/full");
		INFO(joined(arguments) << "\n" << outcome.err);
		CHECK(outcome.status == 7);
		CHECK(count(outcome.err, "rt: error: ") == 1);
		CHECK(outcome.err.find("standard output") != std::string::npos);
	}
	const Outcome stats = run(where, small + Arguments{"-o", "picture.png", "--stats", "/dev/full"});
	INFO(stats.err);
	CHECK(stats.status == 7);
	CHECK(stats.err.find("/dev/full") != std::string::npos);
	CHECK(fs::is_character_file("/dev/full"));
}

TEST_CASE("the seed's own command line writes a numbered PNG")
{
	const Directory where;
	const Outcome outcome = run(where, {"--width", "24", "--height", "16", "--samples", "1", "--output", "my_render"});
	INFO(outcome.err);
	REQUIRE(outcome.status == 0);
	CHECK(outcome.err.empty());
	(void)film_hash(outcome.out);
	const auto image = rt::load_texture((where / "my_render_000000000.png").string());
	REQUIRE(image);
	CHECK(image->width == 24);
	CHECK(image->height == 16);
	CHECK(where.entries() == 1);
}

TEST_CASE("rule 17: an image carries its provenance, and its name follows the rules")
{
	const Directory where;
	const std::string hash = render_hash(where, small);
	const std::string png = text_of(where / "three-spheres.png");
	CHECK(png.substr(0, 8) == png_signature);
	CHECK(png.find("FilmHash") != std::string::npos);
	CHECK(png.find(hash) != std::string::npos);
	CHECK(png.find("passed") != std::string::npos);

	CHECK(render_hash(where, Arguments{"render", "three-spheres"} + small + Arguments{"-o", "a.rtfilm"}) == hash);
	const auto bytes = rt::read_file((where / "a.rtfilm").string());
	REQUIRE(bytes);
	const auto film = rt::decode_rtfilm(bytes->data(), bytes->size(), "a.rtfilm");
	REQUIRE(film);
	CHECK(film->film.hash().hex() == hash);
	CHECK(film->film.min_samples() == 2);
	for (const auto& [key, value] : rt::Provenance{{"FilmHash", hash},
	                                               {"Width", "24"},
	                                               {"Height", "16"},
	                                               {"Window", "0,24,0,16"},
	                                               {"Samples", "2"},
	                                               {"Seed", "0"},
	                                               {"Frame", "0"},
	                                               {"Precision", "exact"},
	                                               {"Backend", "reference"},
	                                               {"SelfTest", "passed"},
	                                               {"Rejected", "0"},
	                                               {"Transfer", "srgb"},
	                                               {"Exposure", "0"}}) {
		INFO(key);
		CHECK(rt::provenance_value(film->provenance, key) == value);
	}
	for (const char* name : {"b.PFM", "c.exr"})
		CHECK(render_hash(where, small + Arguments{"--outfile", name}) == hash);
	CHECK(text_of(where / "b.PFM").substr(0, 3) == "PF\n");
	CHECK(text_of(where / "c.exr").substr(0, 4) == "\x76\x2f\x31\x01");
	CHECK(where.entries() == 4);
}

TEST_CASE("what may not change a bit does not, and what should does")
{
	const Directory where;
	const std::string hash = render_hash(where, small + Arguments{"-o", "a.png"});
	CHECK(render_hash(where, small + Arguments{"-o", "b.png", "--generic"}) == hash);
	CHECK(render_hash(where, small + Arguments{"-o", "c.png", "--self-test"}) == hash);
	CHECK(render_hash(where, small + Arguments{"-o", "d.png", "--transfer", "gamma2", "--exposure", "+1.5"}) == hash);
	CHECK(text_of(where / "a.png") != text_of(where / "d.png"));
	CHECK(render_hash(where, small + Arguments{"-o", "e.png", "--seed", "1"}) != hash);
	CHECK(render_hash(where, small + Arguments{"-o", "f.png", "--max-depth", "1"}) != hash);
}

TEST_CASE("the rung of an image is in its summary, its file and its statistics, and rungs do not mix")
{
	const Directory where;
	const std::string exact = render_hash(where, small + Arguments{"-o", "exact.rtfilm"});
	for (const std::string rung : {"fast", "double"}) {
		INFO(rung);
		const Arguments precision = {"--precision", rung};
		const Outcome outcome = run(where, small + precision + Arguments{"-o", rung + ".rtfilm", "--stats", "s.json"});
		INFO(outcome.err);
		REQUIRE(outcome.status == 0);
		CHECK(film_hash(outcome.out) != exact);
		CHECK(outcome.out.find("2 samples a pixel, " + rung) != std::string::npos);
		CHECK((outcome.out.find("other bits") != std::string::npos) == (rung == "fast"));
		CHECK(Json::parse(text_of(where / "s.json")).at("precision") == rung);
		const auto bytes = rt::read_file((where / (rung + ".rtfilm")).string());
		REQUIRE(bytes);
		const auto film = rt::decode_rtfilm(bytes->data(), bytes->size(), rung);
		REQUIRE(film);
		CHECK(rt::provenance_value(film->provenance, "Precision") == rung);
		const std::string contract = rt::provenance_value(film->provenance, "Contract");
		CHECK((contract == std::to_string(RT_CONTRACT_VERSION)) == (rung == "double"));
		CHECK((contract.find("none") != std::string::npos) == (rung == "fast"));
		// The mark is in a picture too, and goes where it goes.
		CHECK(run(where, small + precision + Arguments{"-o", "picture.png"}).status == 0);
		CHECK(text_of(where / "picture.png").find("rt:Precision") != std::string::npos);
		CHECK((text_of(where / "picture.png").find("none: precision fast") != std::string::npos) == (rung == "fast"));
		// A film is gone on from in its own rung alone.
		const Arguments more = {"--backend", "reference", "--size", "24x16", "--samples", "3"};
		CHECK(run(where, more + precision + Arguments{"--resume", rung + ".rtfilm", "-o", "a.png"}).status == 0);
		check_refused(where, more + Arguments{"--resume", rung + ".rtfilm", "-o", "no.png"}, 2,
		              {rung + ".rtfilm", "Precision: the film has " + rung + ", this render exact"});
		check_refused(where, more + precision + Arguments{"--resume", "exact.rtfilm", "-o", "no.png"}, 2,
		              {"exact.rtfilm", "Precision: the film has exact, this render " + rung});
	}
	const Outcome unmarked = run(where, small + Arguments{"--precision", "fast", "-o", "a.pfm"});
	CHECK(unmarked.status == 0);
	CHECK(unmarked.err.find("no room for the mark") != std::string::npos);
}

TEST_CASE("the command line overrides the scene")
{
	const Directory where;
	where.write("scene.json", scene_text());
	const Outcome own = run(where, {"scene.json", "--backend", "reference"});
	INFO(own.err);
	REQUIRE(own.status == 0);
	CHECK(own.out.find("scene.png: 24x16, 2 samples") != std::string::npos);
	const Outcome other = run(where, {"scene.json", "--backend", "reference", "--width", "10", "--spp", "3"});
	REQUIRE(other.status == 0);
	CHECK(other.out.find("scene.png: 10x16, 3 samples") != std::string::npos);
}

TEST_CASE("a crop and a pixel have the bits of the whole")
{
	const Directory where;
	(void)render_hash(where, small + Arguments{"-o", "whole.png"});
	(void)render_hash(where, small + Arguments{"-o", "crop.png", "--crop", "5,17,3,9"});
	(void)render_hash(where, small + Arguments{"-o", "pixel.png", "--pixel", "11,8"});
	const auto whole = rt::load_texture((where / "whole.png").string());
	const auto crop = rt::load_texture((where / "crop.png").string());
	const auto pixel = rt::load_texture((where / "pixel.png").string());
	REQUIRE(whole);
	REQUIRE(crop);
	REQUIRE(pixel);
	REQUIRE(crop->width == 12);
	REQUIRE(crop->height == 6);
	for (unsigned y = 0; y < 6; y++)
		for (unsigned x = 0; x < 12; x++)
			CHECK(crop->texels[y * 12 + x] == whole->texels[(y + 3) * 24 + x + 5]);
	REQUIRE(pixel->texels.size() == 1);
	CHECK(pixel->texels[0] == whole->texels[8 * 24 + 11]);
}

TEST_CASE("frames are numbered, one film each")
{
	const Directory where;
	const Outcome outcome = run(where, Arguments{"orbit"} + small + Arguments{"--frames", "7:9", "-o", "moon.png"});
	INFO(outcome.err);
	REQUIRE(outcome.status == 0);
	(void)film_hash(outcome.out);
	CHECK(count(outcome.out, "\nfilm ") == 3);
	CHECK(where.entries() == 3);
	for (const char* name : {"moon_000000007.png", "moon_000000008.png", "moon_000000009.png"})
		CHECK(fs::exists(where / name));
	CHECK(render_hash(where, Arguments{"orbit"} + small + Arguments{"--frames", "9", "-o", "one.png"}) ==
	      film_hash(outcome.out));
	CHECK(fs::exists(where / "one.png"));
	const Outcome quiet = run(where, Arguments{"orbit"} + small + Arguments{"--frames", "0:1", "-o", "x", "-q"});
	CHECK(quiet.status == 0);
	CHECK(std::regex_match(quiet.out, std::regex("(film [0-9a-f]{32}\n){2}")));
	CHECK(fs::exists(where / "x_000000001.png"));
}

TEST_CASE("standard output takes a PNG")
{
	const Directory where;
	const std::string hash = render_hash(where, small);
	const Outcome outcome = run(where, small + Arguments{"-o", "-"});
	REQUIRE(outcome.status == 0);
	CHECK(film_hash(outcome.err) == hash);
	CHECK(count(outcome.out, "film ") == 0);
	const auto* bytes = reinterpret_cast<const std::uint8_t*>(outcome.out.data());
	const auto image = rt::decode_texture(bytes, outcome.out.size(), "standard output");
	REQUIRE(image);
	CHECK(image->width == 24);
	CHECK(image->texels == rt::load_texture((where / "three-spheres.png").string())->texels);
}

TEST_CASE("statistics are JSON")
{
	const Directory where;
	const std::string hash = render_hash(where, small + Arguments{"--stats", "stats.json"});
	const Json stats = Json::parse(text_of(where / "stats.json"));
	CHECK(stats.at("film_hash") == hash);
	CHECK(stats.at("width") == 24);
	CHECK(stats.at("samples_rendered") == 24 * 16 * 2);
	CHECK(stats.at("segments_rendered").get<int>() >= 24 * 16 * 2);
	CHECK(stats.at("samples_per_second").get<double>() > 0);
	CHECK(stats.at("seconds").at("total").get<double>() >= stats.at("seconds").at("render").get<double>());
	CHECK(stats.at("devices").at(0).at("backend") == "reference");
	CHECK(stats.at("work").at(0).at("launches").get<int>() >= 1);
	CHECK(stats.at("features").is_array());
	CHECK(stats.at("self_test") == "passed");
	CHECK(stats.at("interrupted") == false);

	const Outcome outcome = run(where, small + Arguments{"--stats", "-"});
	CHECK(Json::parse(outcome.out).at("film_hash") == hash);
	CHECK(film_hash(outcome.err) == hash);
	const Outcome frames = run(where, small + Arguments{"--stats", "-", "--frames", "0:1"});
	REQUIRE(Json::parse(frames.out).at("frames").size() == 2);
	CHECK(Json::parse(frames.out).at("frames").at(1).at("film_hash") == hash);
}

TEST_CASE("progress goes to standard error in the form asked for")
{
	const Directory where;
	CHECK(run(where, small).err.empty()); // no terminal
	const Outcome plain = run(where, small + Arguments{"--progress", "plain"});
	CHECK(plain.err.find("100%, 2/2 spp") != std::string::npos);
	const Outcome json = run(where, small + Arguments{"--progress", "json"});
	Json last;
	std::istringstream lines(json.err);
	for (std::string line; std::getline(lines, line);)
		last = Json::parse(line);
	CHECK(last.at("event") == "progress");
	CHECK(last.at("samples_done") == 24 * 16 * 2);
	CHECK(last.at("fraction") == 1.0);
	const Outcome verbose = run(where, small + Arguments{"-v"});
	CHECK(verbose.err.find("self-test passed") != std::string::npos);
	CHECK(film_hash(verbose.out) == film_hash(plain.out));
}

TEST_CASE("rule 21: a resumed render equals a straight one")
{
	const Directory where;
	const Arguments five = {"--backend", "reference", "--size", "24x16", "--samples", "5"};
	const std::string straight = render_hash(where, five + Arguments{"-o", "five.png"});
	(void)render_hash(where, small + Arguments{"-o", "two.png", "--checkpoint", "film.rtfilm"});
	CHECK(render_hash(where, five + Arguments{"--resume", "film.rtfilm", "-o", "a.png"}) == straight);
	CHECK(render_hash(where, five + Arguments{"--resume", "film.rtfilm", "-o", "film.rtfilm"}) == straight);
	// Nothing is left to do.
	CHECK(render_hash(where, five + Arguments{"--resume", "film.rtfilm", "-o", "b.png"}) == straight);
	CHECK(rt::load_texture((where / "b.png").string())->texels ==
	      rt::load_texture((where / "five.png").string())->texels);

	const Arguments resume = {"--resume", "film.rtfilm", "-o", "no.png"};
	check_refused(where, small + resume, 2, {"film.rtfilm", "5 samples", "more than the 2"});
	check_refused(where, five + resume + Arguments{"--seed", "3"}, 2, {"film.rtfilm", "Seed: the film has 0", "3"});
	check_refused(where, five + resume + Arguments{"--max-depth", "3"}, 2, {"film.rtfilm", "MaxDepth"});
	check_refused(where, five + resume + Arguments{"--crop", "0,4,0,4"}, 2, {"film.rtfilm", "Window", "window"});
	check_refused(where, five + resume + Arguments{"one-sphere"}, 2, {"film.rtfilm", "SceneHash"});
	check_refused(where, Arguments{"--backend", "reference", "--size", "16x24"} + resume, 2,
	              {"film.rtfilm", "Width", "image size"});
	std::string altered = text_of(where / "film.rtfilm");
	altered[altered.size() / 2] = static_cast<char>(altered[altered.size() / 2] ^ 1);
	where.write("film.rtfilm", altered);
	check_refused(where, five + resume, 7, {"film.rtfilm"});
}

TEST_CASE("rule 21: a stop leaves a valid image, a film to go on from, and status 130")
{
	const int number = GENERATE(SIGINT, SIGTERM);
	const Directory where;
	const Arguments image = {"--backend", "reference", "--size", "32x24"};
	Child child(where, image + Arguments{"--samples", most_samples, "-o", "a.png", "--checkpoint", "a.rtfilm",
	                                     "--checkpoint-every", "1", "--progress", "json"});
	REQUIRE(child.wait_for([&where] { return fs::exists(where / "a.rtfilm"); }));
	child.signal(number);
	CHECK(child.status() == 130);
	INFO(child.err());
	CHECK(child.err().find("rt: interrupted: ") != std::string::npos);
	CHECK(child.err().find("--resume a.rtfilm") != std::string::npos);
	(void)film_hash(child.out());
	const auto picture = rt::load_texture((where / "a.png").string());
	REQUIRE(picture);
	CHECK(picture->width == 32);
	CHECK(where.entries() == 2);

	const auto bytes = rt::read_file((where / "a.rtfilm").string());
	REQUIRE(bytes);
	const auto film = rt::decode_rtfilm(bytes->data(), bytes->size(), "a.rtfilm");
	REQUIRE(film);
	CHECK(film->film.is_even());
	const std::uint32_t done = film->film.min_samples();
	REQUIRE(done > 0);
	const Arguments samples = {"--samples", std::to_string(done + 3)};
	CHECK(render_hash(where, image + samples + Arguments{"--resume", "a.rtfilm", "-o", "b.png"}) ==
	      render_hash(where, image + samples + Arguments{"-o", "c.png"}));
}

TEST_CASE("rule 21: a render killed at any moment goes on from its last checkpoint to the same film")
{
	const Directory where;
	// Large enough that writing a checkpoint takes a while, half a megabyte.
	const Arguments image = {"--backend", "reference", "--size", "160x120", "--checkpoint-every", "1"};
	const std::string file = (where / "a.rtfilm").string();
	// A checkpoint is a new file each time; a kill may leave temporary files beside it.
	const auto inode = [&file] {
		struct stat info {};
		return ::stat(file.c_str(), &info) == 0 ? info.st_ino : 0;
	};
	std::mt19937 engine(21);
	std::uint32_t done = 0;
	for (int kill = 0; kill < 6; kill++) {
		const ino_t before = inode();
		const std::size_t files = where.entries();
		Child child(where, image + (before ? Arguments{"--resume", "a.rtfilm"} : Arguments{}) +
		                       Arguments{"--samples", most_samples, "-o", "a.png", "--checkpoint", "a.rtfilm"});
		// At once, at any time after the first new checkpoint, or when the next one is just being written.
		if (kill > 0)
			REQUIRE(child.wait_for([&] { return inode() != before; }));
		const auto pause = std::chrono::milliseconds(engine() % 1500);
		if (kill % 2 == 0)
			std::this_thread::sleep_for(pause);
		else
			REQUIRE(child.wait_for([&] { return where.entries() > std::max<std::size_t>(files, 1); }));
		INFO("kill " << kill << ", pause " << pause.count() << " ms");
		child.signal(SIGKILL);
		CHECK(child.status() == 1000 + SIGKILL);
		if (kill == 0 && !inode())
			continue;
		const auto bytes = rt::read_file(file);
		REQUIRE(bytes);
		const auto film = rt::decode_rtfilm(bytes->data(), bytes->size(), "a.rtfilm");
		REQUIRE(film);
		CHECK(film->film.is_even());
		CHECK(film->film.min_samples() > done);
		done = film->film.min_samples();
	}
	const Arguments samples = {"--samples", std::to_string(done + 3)};
	CHECK(render_hash(where, image + samples + Arguments{"--resume", "a.rtfilm", "-o", "b.png"}) ==
	      render_hash(where, image + samples + Arguments{"-o", "c.png"}));
}

TEST_CASE("SIGUSR1 writes the image so far and goes on")
{
	const Directory where;
	Child child(where, {"--backend", "reference", "--size", "32x24", "--samples", most_samples, "-o", "a.png",
	                    "--progress", "json"});
	REQUIRE(child.wait_for([&child] { return child.err().find("\"progress\"") != std::string::npos; }));
	child.signal(SIGUSR1);
	REQUIRE(child.wait_for([&where] { return fs::exists(where / "a.png"); }));
	CHECK(rt::load_texture((where / "a.png").string()));
	const std::size_t told = child.err().size();
	CHECK(child.wait_for([&child, told] { return child.err().size() > told + 400; }));
	child.signal(SIGINT);
	CHECK(child.status() == 130);
	CHECK(child.err().find("holds the image so far") != std::string::npos);
}

TEST_CASE("rule 20: an image rendered to an error or to a time is reproduced")
{
	const Directory where;
	const Arguments image = {"--backend", "reference", "--size", "96x54", "--seed", "3"};
	const auto provenance = [&where](const std::string& file) {
		const auto bytes = rt::read_file((where / file).string());
		REQUIRE(bytes);
		const auto film = rt::decode_rtfilm(bytes->data(), bytes->size(), file);
		REQUIRE(film);
		return film->provenance;
	};
	const auto check_reproduced = [&where](const std::string& file, const std::string& hash) {
		const Outcome again = run(where, {"reproduce", file, "--backend", "reference", "--lanes", "1"});
		INFO(again.out << again.err);
		CHECK(again.status == 0);
		CHECK(last_line(again.out).find(hash) != std::string::npos);
	};

	// To an error: the counts are the film's, and another lane count decides the same.
	const Outcome to_error = run(
	    where, image + Arguments{"--error", "0.12", "--samples", "200", "-o", "error.rtfilm", "--stats", "error.json"});
	REQUIRE(to_error.status == 0);
	CHECK(to_error.out.find("relative error below 0.12 in ") != std::string::npos);
	const rt::Provenance adaptive = provenance("error.rtfilm");
	CHECK(rt::provenance_value(adaptive, "Error") == "0.12");
	CHECK(rt::provenance_value(adaptive, "SampleLimit") == "200");
	CHECK(rt::provenance_value(adaptive, "Samples").find(" to ") != std::string::npos);
	const Json stats = Json::parse(text_of(where / "error.json"))["adaptive"];
	CHECK(stats["tiles"] == 24);
	std::size_t tiles = 0;
	for (const Json& row : stats["tiles_by_samples"])
		tiles += row["tiles"].get<std::size_t>();
	CHECK(tiles == 24);
	check_reproduced("error.rtfilm", film_hash(to_error.out));
	CHECK(render_hash(where, image + Arguments{"--error", "0.11", "--samples", "200", "-o", "b.png"}) !=
	      film_hash(to_error.out));

	// To a time, with an error and without: the summary tells the options that make the same film.
	for (const Arguments& error : {Arguments{}, Arguments{"--error", "0.0001"}}) {
		const Outcome timed = run(where, image + error + Arguments{"--time-limit", "0.3", "-o", "time.rtfilm"});
		INFO(timed.out << timed.err);
		REQUIRE(timed.status == 0);
		CHECK(rt::provenance_value(provenance("time.rtfilm"), "TimeLimit") == "0.3");
		const std::string told = "the same film again: ";
		const std::size_t at = timed.out.find(told);
		REQUIRE(at != std::string::npos);
		std::istringstream words(timed.out.substr(at + told.size(), timed.out.find('\n', at) - at - told.size()));
		Arguments same;
		for (std::string word; words >> word;)
			same.push_back(word);
		CHECK(same.size() == error.size() + 2);
		CHECK(render_hash(where, image + same + Arguments{"-o", "same.png"}) == film_hash(timed.out));
		check_reproduced("time.rtfilm", film_hash(timed.out));
	}

	// A number of samples that comes first is no timeout.
	const Outcome short_of_time =
	    run(where, image + Arguments{"--samples", "3", "--time-limit", "1000", "-o", "c.png"});
	CHECK(short_of_time.out.find("time limit") == std::string::npos);
	CHECK(film_hash(short_of_time.out) == render_hash(where, image + Arguments{"--samples", "3", "-o", "d.png"}));

	// A stop leaves an image that does not say that it was rendered to an error.
	Child child(where, image + Arguments{"--error", "0.00001", "--samples", most_samples, "-o", "stopped.rtfilm",
	                                     "--progress", "json"});
	REQUIRE(child.wait_for([&child] { return child.err().find("\"progress\"") != std::string::npos; }));
	child.signal(SIGINT);
	CHECK(child.status() == 130);
	CHECK(rt::provenance_value(provenance("stopped.rtfilm"), "Error").empty());

	check_refused(where, image + Arguments{"--error", "0.1", "--crop", "0,10,0,10"}, 2, {"--error", "--crop"});
	check_refused(where, image + Arguments{"--error", "0.1", "--checkpoint", "a.rtfilm"}, 2,
	              {"--error", "--checkpoint"});
	check_refused(where, image + Arguments{"--error", "0"}, 2, {"--error", "'0'", "from 1e-05 to 1"});
	check_refused(where, image + Arguments{"--time-limit", "soon"}, 2, {"--time-limit", "'soon'"});
}

TEST_CASE("devices and info tell what there is")
{
	const Directory where;
	const Outcome devices = run(where, {"devices"});
	CHECK(devices.status == 0);
	CHECK(devices.out.find("reference") != std::string::npos);
	const Outcome verbose = run(where, {"devices", "-v"});
	CHECK(verbose.status == 0);
	CHECK(verbose.out.find("self-test") != std::string::npos);
	CHECK(verbose.out.find("RT_CACHE_DIR=") != std::string::npos);
	const Json list = Json::parse(run(where, {"devices", "-v", "--json"}).out);
	REQUIRE(!list.at("devices").empty());
	const Json& last = list.at("devices").back();
	CHECK(last.at("backend") == "reference");
	CHECK(last.at("self_test").at("passed") == true);
	CHECK(list.at("environment").contains("RT_CACHE_DIR"));
	CHECK(list.at("auto").is_number());

	const Outcome info = run(where, {"info", "weekend"});
	CHECK(info.status == 0);
	CHECK(info.out.find("dielectric") != std::string::npos);
	const Json planets = Json::parse(run(where, {"info", "planets", "--json"}).out);
	CHECK(planets.at("spheres").at("count") == 6);
	CHECK(planets.at("textures").size() == 5);
	CHECK(planets.at("textures").at(0).at("width").get<int>() > 0);
	CHECK(planets.at("animation").is_null());
	const Json orbit = Json::parse(run(where, {"info", "orbit", "--json"}).out);
	CHECK(orbit.at("animation").at("last_frame") == 48);
	CHECK(where.entries() == 0);
}
