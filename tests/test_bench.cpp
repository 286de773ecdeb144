// `rt bench` as a program sees it: the shape of its JSON, and that its figures hang together. No test of a speed.
#include "tests/catch.h"
#include "tests/run_command.h"

#include <nlohmann/json.hpp>

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include <sys/wait.h>

namespace {

using Json = nlohmann::json;

// Runs rt with a shell's line of arguments, on the reference backend, with nothing remembered from other runs.
Outcome run_rt(const std::string& arguments, const std::string& errors = "/dev/null")
{
	const std::string command = "RT_CACHE=off '" RT_PROGRAM "' " + arguments + " 2>" + errors;
	return run_command(command);
}

Json bench(const std::string& arguments)
{
	const Outcome outcome = run_rt("bench --backend reference --quiet --json - " + arguments);
	REQUIRE(outcome.status == 0);
	return Json::parse(outcome.out);
}

void check_spread(const Json& spread)
{
	REQUIRE(spread.size() == 3);
	const double min = spread.at("min"), median = spread.at("median"), max = spread.at("max");
	CHECK(min >= 0);
	CHECK(min <= median);
	CHECK(median <= max);
}

void check_measured(const Json& json)
{
	const Json& phases = json.at("phases");
	double parts = 0;
	for (const char* phase : {"bvh", "build", "upload", "launches", "read_back", "rest", "encode", "total"}) {
		check_spread(phases.at(phase));
		if (phase != std::string("total"))
			parts += phases.at(phase).at("min").get<double>();
		CHECK(json.at("first").at(phase).get<double>() >= 0);
	}
	CHECK(phases.size() == 8);
	CHECK(parts <= phases.at("total").at("max").get<double>());
	for (const char* rate : {"samples_per_second", "segments_per_second"}) {
		check_spread(json.at(rate));
		CHECK(json.at(rate).at("min").get<double>() > 0);
	}
	const double seconds = json.at("render_seconds").at("median");
	const double samples = json.at("samples_rendered");
	CHECK(json.at("samples_per_second").at("median").get<double>() * seconds == Approx(samples));
	CHECK(json.at("segments_rendered").get<double>() >= samples);
	CHECK(json.at("launches").get<int>() > 0);
	CHECK(json.at("film_hash").get<std::string>().size() == 32);
}

} // namespace

TEST_CASE("bench: one scene as JSON")
{
	const Json json = bench("three-spheres --size 40x30 --spp 3 --seed 7 --repeats 2");
	check_measured(json);
	CHECK(json.at("samples_rendered").get<int>() == 40 * 30 * 3);
	CHECK(json.at("width") == 40);
	CHECK(json.at("height") == 30);
	CHECK(json.at("samples") == 3);
	CHECK(json.at("seed") == 7);
	CHECK(json.at("spheres") == 4);
	CHECK(json.at("repeats") == 2);
	CHECK(json.at("device").at("backend") == "reference");
	CHECK(json.at("date").get<std::string>().size() == 20);
	CHECK(json.at("scene_hash").get<std::string>().size() == 32);
	CHECK(json.at("build").contains("kernels"));
	for (const char* rate : {"fma_per_second", "integer_per_second"})
		CHECK(json.at("peak").at(rate).get<double>() > 0);
	const Json& model = json.at("model");
	CHECK(model.at("operations_per_test") == 17);
	CHECK(model.at("tests_per_segment") == 4);
	CHECK(model.at("operations_per_second").get<double>() ==
	      Approx(17 * 4 * json.at("segments_rendered").get<double>() /
	             json.at("phases").at("launches").at("median").get<double>()));
	CHECK(model.at("share_of_fma_peak").get<double>() ==
	      Approx(model.at("operations_per_second").get<double>() / json.at("peak").at("fma_per_second").get<double>()));
}

TEST_CASE("bench: the model counts no tests that a tree spares")
{
	CHECK(bench("cloud-1000 --size 8x4 --spp 1 --repeats 1 --bvh always").at("model").is_null());
	const Json all = bench("cloud-1000 --size 8x4 --spp 1 --repeats 1 --bvh never");
	CHECK(all.at("model").at("tests_per_segment") == 1000);
	CHECK_FALSE(all.at("bvh").get<bool>());
}

TEST_CASE("bench: what is measured is what rt renders")
{
	const std::string scene = "planets --size 24x16 --spp 2 --seed 3";
	const std::string file = "/tmp/rt-test-bench-" + std::to_string(std::rand()) + ".png";
	const Outcome rendered = run_rt("--backend reference --quiet " + scene + " -o " + file);
	(void)std::remove(file.c_str());
	REQUIRE(rendered.status == 0);
	CHECK(rendered.out == "film " + bench(scene + " --repeats 1").at("film_hash").get<std::string>() + "\n");
}

TEST_CASE("bench: sweeps go from small to large and fit an exponent")
{
	const auto points = [](const Json& json, const char* of) {
		const Json& sweep = json.at("sweep");
		CHECK(sweep.at("of") == of);
		CHECK(sweep.at("exponent").is_number());
		CHECK(sweep.at("upper_exponent").is_number());
		double last = 0;
		std::vector<double> xs;
		for (const Json& point : sweep.at("points")) {
			check_measured(point);
			CHECK(point.at("x").get<double>() > last);
			last = point.at("x");
			xs.push_back(last);
		}
		return xs;
	};
	CHECK(points(bench("--size 16x8 --spp 6 --repeats 1 --sweep samples"), "samples") ==
	      std::vector<double>{1, 2, 4, 6});
	CHECK(points(bench("--size 16x8 --spp 1 --max-depth 3 --repeats 1 --sweep depth"), "depth") ==
	      std::vector<double>{1, 2, 3});
	const std::vector<double> pixels = points(bench("--size 64x32 --spp 1 --repeats 1 --sweep pixels"), "pixels");
	REQUIRE(pixels.size() == 7);
	CHECK(pixels.back() == 64 * 32);
	CHECK(pixels.front() == 8 * 4);
}

// Not in a sanitized build: what --limit foretells of a render does not hold for the millions of spheres that are made
// before it, and their tree.
#if !RT_TEST_SANITIZED
TEST_CASE("bench: a sweep of spheres ends where a render would take too long")
{
	const Json json = bench("--size 8x4 --spp 1 --repeats 1 --sweep spheres --limit 1");
	const Json& points = json.at("sweep").at("points");
	REQUIRE(points.size() >= 3);
	CHECK(points[0].at("x") == 10);
	CHECK(points[2].at("x") == 1000);
}
#endif

TEST_CASE("bench: each number of threads is a process of its own, with the same film")
{
	const Json json = bench("--size 32x16 --spp 2 --repeats 1 --sweep threads");
	const Json& points = json.at("sweep").at("points");
	REQUIRE_FALSE(points.empty());
	CHECK(points.front().at("x") == 1);
	for (const Json& point : points)
		CHECK(point.at("film_hash") == points.front().at("film_hash"));
}

TEST_CASE("bench: the table, and errors")
{
	const Outcome table = run_rt("bench --backend reference --size 16x8 --spp 1 --repeats 1");
	CHECK(table.status == 0);
	for (const char* word : {"peak:", "launches", "read back", "samples/s", "rays/s", "of the fma peak", "film "})
		CHECK(table.out.find(word) != std::string::npos);
	CHECK(run_rt("bench --sweep weather").status == 2);
	CHECK(run_rt("bench --repeats 0").status == 2);
	CHECK(run_rt("bench no-such-scene").status == 7);
	CHECK(run_rt("bench --json /no/such/folder/bench.json --backend reference").status == 7);
}

TEST_CASE("info --spheres hands a scene to other programs")
{
	const std::string file = "/tmp/rt-test-bench-" + std::to_string(std::rand()) + ".f32";
	const Outcome told = run_rt("info three-spheres --json --spheres " + file);
	REQUIRE(told.status == 0);
	const Json json = Json::parse(told.out);
	REQUIRE(json.at("material_list").size() == 4);
	const auto read = [](const std::string& path) {
		std::ifstream stream(path, std::ios::binary);
		const std::string bytes((std::istreambuf_iterator<char>(stream)), std::istreambuf_iterator<char>());
		(void)std::remove(path.c_str());
		return bytes;
	};
	const std::string spheres = read(file), materials = read(file + ".materials");
	REQUIRE(spheres.size() == 4 * 16);
	REQUIRE(materials.size() == 4 * 4);
	// The third sphere: centre (1, 0, 1), radius -0.5, of glass.
	const float expected[4] = {1.0f, 0.0f, 1.0f, -0.5f};
	CHECK(std::memcmp(spheres.data() + 2 * 16, expected, sizeof expected) == 0);
	const auto index = static_cast<std::size_t>(static_cast<unsigned char>(materials[2 * 4]));
	CHECK(json.at("material_list").at(index).at("name") == "glass");
	CHECK(json.at("material_list").at(index).at("ior") == 0.7);
	CHECK(run_rt("info three-spheres --spheres /no/such/folder/x.f32").status == 7);
}
