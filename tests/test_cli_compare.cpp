// test_cli_compare.cpp: `rt compare` and `rt reproduce` as a user meets them: the real binary, its exit status, its
// output and its files. Renders are tiny and on the reference backend.
#include "render/image_file.h"
#include "render/image_read.h"
#include "support/files.h"
#include "tests/catch.h"
#include "tests/run_command.h"

#include <nlohmann/json.hpp>

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <string>

#include <sys/wait.h>
#include <unistd.h>

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

// A directory in which rt runs; its kernel cache is there too.
class Bench {
public:
	Bench()
	{
		std::string pattern = (fs::temp_directory_path() / "rt-test-compare-XXXXXX").string();
		REQUIRE(mkdtemp(pattern.data()) != nullptr);
		path_ = pattern;
	}
	~Bench()
	{
		std::error_code ignored;
		fs::remove_all(path_, ignored);
	}
	Bench(const Bench&) = delete;
	Bench& operator=(const Bench&) = delete;
	fs::path operator/(const std::string& name) const { return path_ / name; }

	Outcome rt(const std::string& arguments, const std::string& environment = "") const
	{
		const std::string command = "cd '" + path_.string() + "' && RT_CACHE_DIR='" + path_.string() + "/cache' " +
		                            environment + " '" RT_PROGRAM "' " + arguments + " 2>&1 </dev/null";
		return run_command(command);
	}
	Outcome render(const std::string& arguments) const
	{
		const Outcome outcome = rt("--backend reference --size 24x16 --samples 2 -q " + arguments);
		INFO(outcome.out);
		REQUIRE(outcome.status == 0);
		return outcome;
	}
	std::string text_of(const std::string& name) const
	{
		const auto bytes = rt::read_file((path_ / name).string());
		REQUIRE(bytes);
		return std::string(bytes->begin(), bytes->end());
	}
	rt::LoadedImage load(const std::string& name) const
	{
		auto image = rt::load_image((path_ / name).string());
		REQUIRE(image);
		return std::move(*image);
	}

private:
	fs::path path_;
};

bool has(const Outcome& outcome, const std::string& part) { return outcome.out.find(part) != std::string::npos; }

} // namespace

TEST_CASE("rt compare: verdict, hashes, metadata, pixels, histogram, metrics, and idiff's exit status")
{
	const Bench bench;
	for (const char* name : {"a.rtfilm", "a.exr", "a.pfm", "a.png"})
		bench.render(std::string("-o ") + name);
	bench.render("-o b.png --seed 1");
	bench.render("-o b.rtfilm --seed 1");

	for (const char* pair : {"a.rtfilm a.rtfilm", "a.rtfilm a.exr", "a.exr a.pfm", "a.png a.rtfilm", "a.png a.png"}) {
		const Outcome same = bench.rt(std::string("compare ") + pair);
		INFO(pair << "\n" << same.out);
		CHECK(same.status == 0);
		CHECK(same.out.rfind("identical", 0) == 0);
	}
	const Outcome other = bench.rt("compare a.rtfilm b.rtfilm -o difference.png");
	INFO(other.out);
	CHECK(other.status == 2);
	CHECK(other.out.rfind("failure: ", 0) == 0);
	std::size_t at = 0;
	for (const char* part :
	     {"a difference was to be expected: another Seed", "film hash", "metadata that differs", "Seed", "first",
	      "worst", "histogram", "MAE", "PSNR", "z ", "FLIP", "difference.png: |A - B| x"}) {
		INFO(part);
		const std::size_t found = other.out.find(part, at);
		CHECK(found != std::string::npos);
		at = found == std::string::npos ? at : found;
	}
	CHECK(bench.load("difference.png").pixels() == 24 * 16);

	CHECK(bench.rt("compare a.png b.png -fail 1 -warn 1").status == 0);
	CHECK(bench.rt("compare a.png b.png -fail 1").status == 1);
	CHECK(bench.rt("compare a.png b.png --fail 0.001 -failpercent 100 -warn=1").status == 0);
	CHECK(bench.rt("compare a.png b.png -failulp 255 -warnulp 255").status == 0);
	CHECK(bench.rt("compare a.png b.png -p -fail 1 -warn 1 -o flip.png").status == 0);
	CHECK(bench.rt("compare a.png b.png -p -fail 0.0001").status == 2);
	CHECK(bench.rt("--backend reference --size 16x24 --samples 1 -q -o c.png").status == 0);
	CHECK(bench.rt("compare a.png c.png").status == 3);
	const Outcome missing = bench.rt("compare a.png nix.png");
	CHECK(missing.status == 4);
	CHECK(has(missing, "nix.png"));
	REQUIRE(rt::write_file((bench / "text.png").string(), "not an image"));
	CHECK(bench.rt("compare text.png a.png").status == 4);
	CHECK(bench.rt("compare a.png b.png -o nowhere/x.png").status == 4);
	for (const char* wrong :
	     {"compare a.png", "compare a.png b.png -fail x", "compare a.png b.png -fail -1",
	      "compare a.png b.png -o x.exr", "compare a.png b.png c.png", "compare a.png b.png --nix"}) {
		INFO(wrong);
		CHECK(bench.rt(wrong).status == 2);
	}
	CHECK_FALSE(fs::exists(bench / "x.exr"));
	CHECK(bench.rt("compare a.png a.png -od -o none.png").status == 0);
	CHECK_FALSE(fs::exists(bench / "none.png"));

	// The page: the same text, and the pictures.
	CHECK(bench.rt("compare a.exr b.rtfilm --html page.html").status == 2);
	const std::string html = bench.text_of("page.html");
	for (const char* part : {"<!DOCTYPE html>", "failure: ", "another Seed", "A: a.exr", "B: b.rtfilm", "|A - B|",
	                         "FLIP", "histogram", "</html>"}) {
		INFO(part);
		CHECK(html.find(part) != std::string::npos);
	}
	std::size_t pictures = 0;
	for (std::size_t next = 0; (next = html.find("src=\"data:image/png;base64,", next)) != std::string::npos; ++next)
		++pictures;
	CHECK(pictures == 4);
	for (const char* remote : {"http://", "https://", "<script", "<link", "@import"})
		CHECK(html.find(remote) == std::string::npos);
	CHECK(bench.rt("compare a.png c.png --html sizes.html").status == 3); // the two pictures, no difference
	CHECK(bench.rt("compare a.png b.png --html -").status == 2);
	CHECK(bench.rt("compare a.png b.png --html nowhere/page.html").status == 4);

	const Outcome json = bench.rt("compare a.rtfilm b.rtfilm --json --hdr-flip");
	const Json parsed = Json::parse(json.out);
	CHECK(parsed["verdict"] == "failure");
	CHECK(parsed["exit_status"] == 2);
	CHECK(parsed["expected"]["difference"] == "different");
	CHECK(parsed["pixels"] == 24 * 16);
	CHECK(parsed["metrics"]["hdr_flip"].get<double>() > 0);
	CHECK(parsed["a"]["film_hash"] != parsed["b"]["film_hash"]);
	CHECK(Json::parse(bench.rt("compare a.png a.png --json").out)["verdict"] == "identical");
}

TEST_CASE("a pixel that nothing explains is called what it is")
{
	const Bench bench;
	bench.render("-o a.rtfilm");
	rt::LoadedImage image = bench.load("a.rtfilm");
	image.film->sums()[3 * (24 * 5 + 7) + 2] += 1;
	auto altered = rt::encode_rtfilm(*image.film, image.provenance);
	REQUIRE(rt::write_file((bench / "b.rtfilm").string(), altered.data(), altered.size()));
	const Outcome outcome = bench.rt("compare a.rtfilm b.rtfilm");
	INFO(outcome.out);
	CHECK(outcome.status == 2);
	CHECK(has(outcome, "NOT expected"));
	CHECK(has(outcome, "first  (7, 5) B: "));
	CHECK(has(outcome, "1 unit of the film"));
	CHECK(has(outcome, "b.rtfilm: the film's hash is not the one that its provenance tells"));
	CHECK(bench.rt("reproduce b.rtfilm --backend reference").status == 1);
}

TEST_CASE("what a file says cannot reach the terminal as it stands")
{
	const Bench bench;
	bench.render("-o a.rtfilm");
	rt::LoadedImage image = bench.load("a.rtfilm");
	image.provenance.emplace_back("Evil\x1b[2J", "\x1b]0;title\x07 and\nlines");
	const auto bytes = rt::encode_rtfilm(*image.film, image.provenance);
	REQUIRE(rt::write_file((bench / "b.rtfilm").string(), bytes.data(), bytes.size()));
	const Outcome outcome = bench.rt("compare a.rtfilm b.rtfilm");
	CHECK(has(outcome, "Evil [2J"));
	CHECK_FALSE(has(outcome, "\x1b"));
	CHECK_FALSE(has(outcome, "\x07"));
}

TEST_CASE("rt reproduce renders an image again from what it says, and finds what was altered")
{
	const Bench bench;
	bench.render("-o a.png --seed 7 --max-depth 9 --transfer gamma2 --exposure 0.5");
	bench.render("-o a.exr --crop 3,20,2,11");
	bench.render("weekend -o a.rtfilm");
	for (const char* name : {"a.png", "a.exr", "a.rtfilm"}) {
		const Outcome outcome = bench.rt(std::string("reproduce --backend reference -o again.rtfilm ") + name);
		INFO(outcome.out);
		CHECK(outcome.status == 0);
		CHECK(outcome.out.rfind("reproduced", 0) == 0);
		CHECK(bench.rt(std::string("compare again.rtfilm ") + name).status == 0);
	}
	// With the provenance kept, one code changed: the film that the image tells is right, its pixels are not of it.
	rt::LoadedImage png = bench.load("a.png");
	std::vector<std::uint8_t> codes(png.values.begin(), png.values.end());
	codes[100] = static_cast<std::uint8_t>(codes[100] ^ 1);
	const auto altered = rt::encode_png(24, 16, codes, rt::Transfer::Gamma2, png.provenance);
	REQUIRE(altered);
	REQUIRE(rt::write_file((bench / "altered.png").string(), altered->data(), altered->size()));
	const Outcome outcome = bench.rt("reproduce altered.png --backend reference");
	INFO(outcome.out);
	CHECK(outcome.status == 1);
	CHECK(has(outcome, "the file was altered"));
	CHECK(has(outcome, "1 of 384 pixels differ"));
	CHECK(Json::parse(bench.rt("reproduce altered.png --backend reference --json").out)["reproduced"] == false);

	// What cannot be reproduced is said before anything is rendered.
	const auto with = [&](const std::string& key, const std::string& value) {
		rt::Provenance provenance = png.provenance;
		for (auto& entry : provenance)
			if (entry.first == key)
				entry.second = value;
		const auto bytes = rt::encode_png(24, 16, codes, rt::Transfer::Gamma2, provenance);
		REQUIRE(bytes);
		REQUIRE(rt::write_file((bench / "x.png").string(), bytes->data(), bytes->size()));
		return bench.rt("reproduce x.png --backend reference");
	};
	CHECK(has(with("Contract", "999"), "numeric contract 999"));
	CHECK(has(with("Precision", "quadruple"), "precision 'quadruple'"));
	CHECK(has(with("Samples", "1 to 2"), "was stopped"));
	CHECK(has(with("Samples", "1e9"), "which is not"));
	CHECK(has(with("Samples", "99999999999"), "which is not"));
	CHECK(has(with("Seed", ""), "does not say its Seed"));
	CHECK(has(with("Width", "20"), "scaled or cropped"));
	CHECK(has(with("Window", "0,24,0,17"), "scaled or cropped"));
	CHECK(with("Scene", "--help").status == 7);
	CHECK(with("SceneHash", "00").status == 7);
	bench.render("-o a.pfm");
	const Outcome silent = bench.rt("reproduce a.pfm");
	CHECK(silent.status == 2);
	CHECK(has(silent, "does not say how it was made"));
	CHECK(bench.rt("reproduce").status == 2);
	CHECK(bench.rt("reproduce nix.png").status == 7);
}

TEST_CASE("rt reproduce says when the scene is not the one of the image")
{
	const Bench bench;
	const std::string scene = R"({"rt": 1, "camera": {"from": [0, 0, 5], "at": [0, 0, 0]},
	  "sky": {"kind": "constant", "color": [1, 1, 1]},
	  "materials": {"m": {"kind": "lambertian", "albedo": [0.5, 0.5, 0.5]}},
	  "spheres": [{"center": [0, 0, 0], "radius": RADIUS, "material": "m"}]})";
	const auto save = [&](const std::string& name, const std::string& radius) {
		std::string text = scene;
		text.replace(text.find("RADIUS"), 6, radius);
		REQUIRE(rt::write_file((bench / name).string(), text));
	};
	save("my.json", "1");
	bench.render("my.json -o my.png");
	CHECK(bench.rt("reproduce my.png --backend reference").status == 0);
	save("my.json", "1.5");
	const Outcome changed = bench.rt("reproduce my.png --backend reference");
	INFO(changed.out);
	CHECK(changed.status == 7);
	CHECK(has(changed, "another scene"));
	CHECK(has(changed, "--scene"));
	save("as-it-was.json", "1");
	CHECK(bench.rt("reproduce my.png --backend reference --scene as-it-was.json").status == 0);
	fs::remove(bench / "my.json");
	CHECK(has(bench.rt("reproduce my.png --backend reference"), "there is no scene"));
	// Beside the image, wherever the command is run.
	fs::create_directory(bench / "sub");
	fs::rename(bench / "as-it-was.json", bench / "sub/my.json");
	fs::rename(bench / "my.png", bench / "sub/my.png");
	CHECK(bench.rt("reproduce sub/my.png --backend reference").status == 0);
}

TEST_CASE("an image of a device that is not verified says so in its name, its metadata and when it is read")
{
	const Bench bench;
	const std::string fast = "POCL_EXTRA_BUILD_FLAGS=-cl-fast-relaxed-math";
	const std::string arguments = "--backend opencl --size 24x16 --samples 2 -q --force-unverified";
	const Outcome outcome = bench.rt(arguments, fast);
	if (!has(outcome, "is not verified")) {
		WARN("no PoCL, whose arithmetic a variable spoils: not tested\n" << outcome.out);
		return;
	}
	CHECK(outcome.status == 0);
	REQUIRE(fs::exists(bench / "three-spheres-unverified.png"));
	CHECK_FALSE(fs::exists(bench / "three-spheres.png"));
	CHECK(bench.rt(arguments + " -o u.exr", fast).status == 0);
	const auto png = rt::read_file((bench / "three-spheres-unverified.png").string());
	REQUIRE(png);
	const std::string bytes(png->begin(), png->end());
	CHECK(bytes.find(std::string("tEXtWarning\0NOT VERIFIED", 24)) != std::string::npos);
	bench.render("-o a.exr");
	const Outcome comparison = bench.rt("compare u.exr a.exr");
	INFO(comparison.out);
	CHECK(has(comparison, "A is of a device that is not verified"));
	const Outcome again = bench.rt("reproduce u.exr --backend reference");
	CHECK(again.status == 1);
	CHECK(has(again, "is of a device that is not verified"));
	bench.render("-o a.png");
	const auto good = rt::read_file((bench / "a.png").string());
	REQUIRE(good);
	CHECK(std::string(good->begin(), good->end()).find("Warning") == std::string::npos);
}
