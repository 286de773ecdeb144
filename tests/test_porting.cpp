// The worked example of docs/porting.md: what is said of a candidate backend that computes as textbooks do, of one that
// has only one of its habits, and of one that has none.
#include "tests/catch.h"

#include "support/files.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <cstdlib>
#include <filesystem>
#include <set>
#include <string>

#include <sys/wait.h>
#include <unistd.h>

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

bool contains(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

struct Outcome {
	int status = -1;
	std::string text; // both streams
};

// Runs a program of this build with these habits left.
Outcome run(const std::string& habits, const std::string& program, const std::string& arguments)
{
	std::string pattern = (fs::temp_directory_path() / "rt-test-porting-XXXXXX").string();
	const int file = mkstemp(pattern.data());
	REQUIRE(file >= 0);
	close(file);
	const int code = std::system(
	    fmt::format("env RT_NAIVE={} '{}' {} >{} 2>&1 </dev/null", habits, program, arguments, pattern).c_str());
	const auto bytes = rt::read_file(pattern);
	std::error_code ignored;
	fs::remove(pattern, ignored);
	REQUIRE(bytes);
	return {WIFEXITED(code) ? WEXITSTATUS(code) : -1, std::string(bytes->begin(), bytes->end())};
}

Outcome naive(const std::string& habits, const std::string& arguments)
{
	return run(habits, RT_NAIVE_PROGRAM, arguments);
}

const char* const all = "dot,native,quadratic,sums";

// Is there an OpenCL device for the port to run on?
bool has_patient()
{
	if (contains(naive("none", "devices").text, "  naive "))
		return true;
	const char* const required = std::getenv("RT_REQUIRE");
	if (required && contains(required, "opencl"))
		FAIL("RT_REQUIRE asks for opencl and the naive port has no device");
	WARN("skipped: no OpenCL device for the naive port");
	return false;
}

// What the arithmetic probe of the port's first device finds wrong.
std::set<std::string> wrong_operations(const std::string& habits, int status)
{
	const Outcome outcome = naive(habits, "verify --probe-only --backend naive --progress none --json - 2>/dev/null");
	INFO(habits << ": " << outcome.text);
	CHECK(outcome.status == status);
	const std::size_t begin = outcome.text.find('{'), end = outcome.text.rfind('}');
	REQUIRE(begin < end);
	const Json json = Json::parse(outcome.text.substr(begin, end - begin + 1), nullptr, false);
	REQUIRE(json.is_object());
	std::set<std::string> wrong;
	for (const Json& item : json["devices"][0]["self_test"]["items"])
		if (!item["passed"] && item["required"])
			wrong.insert(item["name"]);
	return wrong;
}

} // namespace

TEST_CASE("without its habits the naive port is a backend like the others", "[porting]")
{
	if (!has_patient())
		return;
	const Outcome outcome = naive("none", "verify --quick --backend naive --progress none");
	INFO(outcome.text);
	CHECK(outcome.status == 0);
	CHECK(wrong_operations("none", 0).empty());
}

TEST_CASE("verify names what each habit makes wrong", "[porting]")
{
	if (!has_patient())
		return;
	const std::set<std::string> images = {"stress tile", "stress tile through a tree"};
	CHECK(wrong_operations("dot", 4) == images);
	CHECK(wrong_operations("quadratic", 4) == images);
	CHECK(wrong_operations("sums", 4).count("radiance to integer") == 1);
	CHECK(wrong_operations("native", 4).count("sine and cosine") == 1);
	const std::set<std::string> wrong = wrong_operations(all, 4);
	for (const char* operation : {"sine and cosine", "radiance to integer", "stress tile"})
		CHECK(wrong.count(operation) == 1);
}

TEST_CASE("trace names the place where the port leaves the contract", "[porting]")
{
	if (!has_patient())
		return;
	const auto check_place = [](const char* habits, const char* function) {
		const Outcome outcome =
		    naive(habits, "trace weekend --size 64x36 --samples 8 --backend naive --against reference");
		INFO(habits << ": " << outcome.text);
		CHECK(outcome.status == 1);
		const std::size_t first = outcome.text.find("first different operation: ");
		REQUIRE(first != std::string::npos);
		// "... fma in v3_dot, kernels/vec.h:39", and the calls that led there.
		CHECK(contains(outcome.text.substr(first), function));
	};
	check_place("dot", " in v3_dot, kernels/vec.h:");
	check_place("quadratic", "rt_sphere_foot in rt_wide_distance, kernels/sphere.h:");
	check_place("sums", " in rt_channel_sample, kernels/film.h:");
}

TEST_CASE("the suite runs over one backend more", "[porting]")
{
	if (!has_patient())
		return;
	const char* const test = "'rule 1: every device*'";
	const Outcome well = run("none", RT_NAIVE_CONTRACT_TEST, test);
	INFO(well.text);
	CHECK(well.status == 0);
	CHECK(contains(well.text, "All tests passed"));
	const Outcome ill = run(all, RT_NAIVE_CONTRACT_TEST, test);
	INFO(ill.text);
	CHECK(ill.status != 0);
	CHECK(contains(ill.text, "naive: "));
	CHECK(contains(ill.text, "sine and cosine"));
}

TEST_CASE("a habit that does not exist is told", "[porting]")
{
	const Outcome outcome = naive("spheres", "devices");
	INFO(outcome.text);
	CHECK(contains(outcome.text, "RT_NAIVE names 'spheres'"));
}
