// Speed against accuracy: errors from films whose errors are known, the front, the choice; and `rt tradeoff` itself,
// small, tampered with and stopped. No test of a speed.
#include "tests/catch.h"
#include "tests/run_command.h"

#include "render/scene_file.h"
#include "render/tradeoff.h"

#include <nlohmann/json.hpp>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include <sys/wait.h>
#include <unistd.h>

namespace {

using Json = nlohmann::json;

const rt::Configuration exact;
const rt::Configuration fast{rt::Precision::Fast, {}, {}, 0};

rt::TradePoint point(double seconds, double rel_rmse, std::uint32_t samples = 1, rt::Configuration configuration = {})
{
	rt::TradePoint made;
	made.seconds = seconds;
	made.error.noise.rel_mse = rel_rmse * rel_rmse;
	made.samples = samples;
	made.configuration = configuration;
	return made;
}

// What independent samples give: error 1 / sqrt(samples), a time for each and none beside.
void add_curve(std::vector<rt::TradePoint>& points, rt::Configuration configuration, double seconds_a_sample,
               double error_of_one = 1)
{
	for (const std::uint32_t samples : {1u, 4u, 16u, 64u, 256u})
		points.push_back(point(seconds_a_sample * samples, error_of_one / std::sqrt(samples), samples, configuration));
}

// A film of one colour and normal noise: what a renderer of a known error gives.
rt::Film noisy_film(double value, double deviation, std::uint32_t seed, std::uint32_t samples)
{
	constexpr std::int32_t exponent = 20;
	rt::Film film(80, 60, {0, 0, 80, 60}, exponent);
	std::mt19937 random(seed);
	std::normal_distribution<double> noise(value, deviation);
	for (std::int64_t& sum : film.sums())
		sum = std::llround(noise(random) * samples * (1 << exponent));
	std::fill(film.samples().begin(), film.samples().end(), samples);
	return film;
}

constexpr double value = 0.5;

rt::ConvergedFilm reference(double deviation)
{
	const auto made = rt::converged_film(noisy_film(value, deviation * std::sqrt(2.0), 11, 2048),
	                                     noisy_film(value, deviation * std::sqrt(2.0), 12, 2048));
	REQUIRE(made);
	return *made;
}

// A directory that is gone with the test.
class Directory {
public:
	Directory()
	{
		std::string name = "/tmp/rt-test-tradeoff-XXXXXX";
		REQUIRE(mkdtemp(name.data()) != nullptr);
		path_ = name;
	}
	~Directory() { std::filesystem::remove_all(path_); }
	Directory(const Directory&) = delete;
	Directory& operator=(const Directory&) = delete;
	std::string operator/(const std::string& name) const { return (path_ / name).string(); }

private:
	std::filesystem::path path_;
};

std::string file_text(const std::string& path)
{
	std::ifstream file(path, std::ios::binary);
	REQUIRE(file.good());
	return {std::istreambuf_iterator<char>(file), {}};
}

Outcome run_rt(const Directory& directory, const std::string& arguments)
{
	const std::string command = "RT_CACHE_DIR='" + (directory / "cache") + "' '" RT_PROGRAM "' " + arguments + " 2>'" +
	                            (directory / "errors") + "'";
	return run_command(command);
}

Json tradeoff(const Directory& directory, const std::string& more = "", int reference = 256)
{
	const Outcome outcome =
	    run_rt(directory, "tradeoff three-spheres --backend reference --size 24x18 --json - --reference " +
	                          std::to_string(reference) + " " + more);
	INFO(file_text(directory / "errors"));
	REQUIRE(outcome.status == 0);
	return Json::parse(outcome.out);
}

// The files of the cache that hold the halves of references.
std::vector<std::string> remembered_references(const Directory& directory)
{
	std::vector<std::string> found;
	const std::filesystem::path kernels = directory / "cache/kernels";
	if (!std::filesystem::exists(kernels))
		return found;
	for (const auto& entry : std::filesystem::directory_iterator(kernels))
		if (file_text(entry.path().string()).find("RTFILM") != std::string::npos)
			found.push_back(entry.path().string());
	return found;
}

// Runs rt until its progress has `sign` in it, then sends SIGINT; the exit status.
int run_until(const Directory& directory, std::vector<std::string> arguments, const std::string& sign)
{
	int ends[2];
	REQUIRE(pipe(ends) == 0);
	const std::string cache = "RT_CACHE_DIR=" + (directory / "cache");
	const pid_t child = fork();
	if (child == 0) {
		putenv(const_cast<char*>(cache.c_str()));
		dup2(ends[1], STDERR_FILENO);
		close(ends[0]);
		std::vector<char*> argv = {const_cast<char*>(RT_PROGRAM)};
		for (std::string& argument : arguments)
			argv.push_back(argument.data());
		argv.push_back(nullptr);
		execv(RT_PROGRAM, argv.data());
		_exit(126);
	}
	REQUIRE(child > 0);
	close(ends[1]);
	std::string errors;
	bool sent = false;
	char buffer[512];
	for (ssize_t count; (count = read(ends[0], buffer, sizeof buffer)) > 0;) {
		errors.append(buffer, static_cast<std::size_t>(count));
		if (!sent && errors.find(sign) != std::string::npos) {
			kill(child, SIGINT);
			sent = true;
		}
	}
	close(ends[0]);
	int status = 0;
	REQUIRE(waitpid(child, &status, 0) == child);
	INFO(errors);
	CHECK(sent);
	return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

} // namespace

TEST_CASE("tradeoff: the front is what nothing beats")
{
	std::vector<rt::TradePoint> points = {point(4, 0.1), point(1, 0.5), point(2, 0.6), point(2, 0.2),
	                                      point(3, 0.2), point(5, 0.1), point(1, 0.7)};
	rt::mark_front(points);
	std::vector<std::pair<double, bool>> found;
	for (const rt::TradePoint& each : points)
		found.emplace_back(each.seconds, each.on_front);
	const std::vector<std::pair<double, bool>> wanted = {{1, true},  {1, false}, {2, true}, {2, false},
	                                                     {3, false}, {4, true},  {5, false}};
	CHECK(found == wanted);
}

TEST_CASE("tradeoff: a digit far behind the point makes no place on the front")
{
	std::vector<rt::TradePoint> points = {point(1, 0.5), point(2, 0.499), point(3, 0.4)};
	rt::mark_front(points);
	CHECK(points[0].on_front);
	CHECK_FALSE(points[1].on_front);
	CHECK(points[2].on_front);
}

TEST_CASE("tradeoff: the front against its definition")
{
	std::mt19937 random(5);
	std::uniform_int_distribution<int> grid(1, 20);
	for (int round = 0; round < 50; ++round) {
		std::vector<rt::TradePoint> points;
		for (int i = 0; i < 40; ++i)
			points.push_back(point(grid(random), 0.01 * grid(random)));
		rt::mark_front(points);
		for (std::size_t i = 0; i < points.size(); ++i) {
			const auto mse = [](const rt::TradePoint& each) { return each.error.noise.rel_mse; };
			bool beaten = false, twin_before = false;
			for (std::size_t j = 0; j < points.size(); ++j) {
				const bool no_worse = points[j].seconds <= points[i].seconds && mse(points[j]) <= mse(points[i]);
				const bool better = points[j].seconds < points[i].seconds || mse(points[j]) < mse(points[i]);
				beaten = beaten || (no_worse && better);
				twin_before = twin_before || (no_worse && !better && j < i);
			}
			CHECK(points[i].on_front == !(beaten || twin_before));
		}
	}
}

TEST_CASE("tradeoff: errors are those that the films have")
{
	const rt::ConvergedFilm converged = reference(0.001);
	CHECK(converged.samples == 4096);
	CHECK(converged.noise.rmse() == Approx(0.001).epsilon(0.05));
	const auto error = rt::error_against(noisy_film(value, 0.02, 1, 16), converged);
	REQUIRE(error);
	CHECK(error->noise.rmse() == Approx(0.02).epsilon(0.03));
	CHECK(error->noise.rel_mse == Approx(0.02 * 0.02 / (value * value + 0.01)).epsilon(0.06));
	CHECK_FALSE(error->is_bound);
	CHECK(std::fabs(error->clearest_bias().z) < 4);
	CHECK(error->flip > 0);

	SECTION("the reference's own is taken off")
	{
		const rt::ConvergedFilm rough = reference(0.01);
		const auto same = rt::error_against(noisy_film(value, 0.02, 1, 16), rough);
		REQUIRE(same);
		CHECK(same->noise.rmse() == Approx(0.02).epsilon(0.05)); // and not sqrt(5) / 100 = 0.0224
	}
	SECTION("below the reference's own there is only a bound")
	{
		const rt::ConvergedFilm rough = reference(0.01);
		const auto near = rt::error_against(noisy_film(value, 0.001, 1, 16), rough);
		REQUIRE(near);
		CHECK(near->is_bound);
		CHECK(near->noise.rmse() == Approx(rough.noise.rmse()));
	}
	SECTION("a bias is told from noise")
	{
		const auto biased = rt::error_against(noisy_film(value * 1.01, 0.02, 1, 16), converged);
		REQUIRE(biased);
		CHECK(biased->clearest_bias().z > 8);
		for (const rt::ChannelBias& bias : biased->bias)
			CHECK(bias.relative == Approx(0.01).epsilon(0.2));
	}
	SECTION("films of other sizes are refused")
	{
		rt::Film other(40, 30, {0, 0, 40, 30}, 20);
		CHECK_FALSE(rt::error_against(other, converged));
	}
}

TEST_CASE("tradeoff: the quickest way to an error")
{
	std::vector<rt::TradePoint> points;
	add_curve(points, exact, 0.010);
	add_curve(points, fast, 0.005);
	rt::mark_front(points);

	auto way = rt::recommend(points, {0.1, {}});
	REQUIRE(way);
	CHECK(way->configuration == fast);
	CHECK(way->samples == 100);
	CHECK(way->rel_rmse == Approx(0.1));
	CHECK(way->seconds == Approx(0.5));
	CHECK_FALSE(way->extrapolated);

	way = rt::recommend(points, {0.1, {}}, 4); // four times the pixels
	REQUIRE(way);
	CHECK(way->samples == 100);
	CHECK(way->seconds == Approx(2.0));

	way = rt::recommend(points, {0.01, {}});
	REQUIRE(way);
	CHECK(way->samples == 10000);
	CHECK(way->extrapolated);
	CHECK_FALSE(rt::recommend(points, {1e-6, {}}));

	way = rt::recommend(points, {{}, 0.5});
	REQUIRE(way);
	CHECK(way->configuration == fast);
	CHECK(way->samples == 100);
	CHECK_FALSE(rt::recommend(points, {{}, 0.001}));
	CHECK_FALSE(rt::recommend({}, {0.1, {}}));
}

TEST_CASE("tradeoff: what a configuration is expected to give")
{
	std::vector<rt::TradePoint> points;
	add_curve(points, exact, 0.010);
	const auto between = rt::expectation(points, 0, exact, 100, 2);
	REQUIRE(between);
	CHECK(between->rel_rmse == Approx(0.1));
	CHECK(between->seconds == Approx(2.0));
	CHECK_FALSE(rt::expectation(points, 0, fast, 100));
	CHECK_FALSE(rt::expectation(points, 1, exact, 100));
}

TEST_CASE("tradeoff: identity is worth a tenth of the time and no more")
{
	for (const auto& [price, precision] :
	     {std::pair(1.08, rt::Precision::Exact), std::pair(1.2, rt::Precision::Fast)}) {
		std::vector<rt::TradePoint> points;
		add_curve(points, exact, 0.010 * price);
		add_curve(points, fast, 0.010);
		for (const rt::TradeGoal& goal : {rt::TradeGoal{0.1, {}}, rt::TradeGoal{{}, 1.0}}) {
			const auto way = rt::recommend(points, goal);
			REQUIRE(way);
			CHECK(way->configuration.precision == precision);
		}
	}
}

TEST_CASE("tradeoff: samples cure noise, not a bias")
{
	std::vector<rt::TradePoint> points;
	add_curve(points, fast, 0.001);
	CHECK(rt::recommend(points, {0.01, {}}));
	for (rt::TradePoint& each : points)
		each.error.bias[1] = {0.02, 50};
	CHECK_FALSE(rt::recommend(points, {0.01, {}}));
	CHECK(rt::recommend(points, {0.03, {}}));
}

TEST_CASE("tradeoff: a point that is only a bound promises nothing beyond it")
{
	std::vector<rt::TradePoint> points;
	add_curve(points, exact, 0.010);
	for (const std::uint32_t samples : {1024u, 4096u}) {
		points.push_back(point(0.010 * samples, 0.04, samples, exact));
		points.back().error.is_bound = true;
	}
	const auto way = rt::recommend(points, {0.02, {}});
	REQUIRE(way);
	CHECK(way->samples == 4096); // 1024 x (0.04 / 0.02)^2
	CHECK(way->extrapolated);
}

TEST_CASE("tradeoff: the grid leaves out what a scene or a device has no use for")
{
	const auto has = [](const std::vector<rt::Configuration>& all, auto is_it) {
		return std::any_of(all.begin(), all.end(), is_it);
	};
	const auto aims = [](const rt::Configuration& each) { return each.estimator != rt::Estimator::Path; };
	const auto is_double = [](const rt::Configuration& each) { return each.precision == rt::Precision::Double; };
	const auto sky = rt::open_scene("three-spheres"), box = rt::open_scene("cornell");
	REQUIRE(sky);
	REQUIRE(box);
	CHECK_FALSE(rt::aims_at_lamps(sky->base));
	CHECK(rt::aims_at_lamps(box->base));
	rt::DeviceInfo device;
	device.reports_fp64 = true;
	const auto plain = rt::configurations_for(sky->base, device);
	REQUIRE_FALSE(plain.empty());
	CHECK(plain[0] == exact);
	CHECK_FALSE(has(plain, aims));
	CHECK(has(plain, is_double));
	const auto lit = rt::configurations_for(box->base, device);
	CHECK(lit.size() >= plain.size());
	device.reports_fp64 = false;
	CHECK_FALSE(has(rt::configurations_for(sky->base, device), is_double));
}

TEST_CASE("tradeoff: a configuration is written as rt render reads it")
{
	rt::Configuration all{rt::Precision::Fast, rt::Sampler::Sobol, rt::Estimator::Mis, 5};
	CHECK(all.name() == "fast sobol mis roulette 5");
	CHECK(all.arguments() == "--precision fast --sampler sobol --estimator mis --roulette 5");
	CHECK(exact.name() == "exact");
	CHECK(exact.arguments() == "--precision exact");
	rt::RenderSettings settings;
	rt::SessionOptions session;
	all.apply(settings, session);
	CHECK(session.precision == rt::Precision::Fast);
	CHECK(settings.sampler == rt::Sampler::Sobol);
	CHECK(settings.estimator == rt::Estimator::Mis);
	CHECK(settings.roulette == 5);
}

TEST_CASE("tradeoff: one small run, as a program sees it")
{
	const Directory directory;
	const Json json = tradeoff(directory, "--csv '" + (directory / "table.csv") + "'");
	CHECK(json.at("complete") == true);
	CHECK(json.at("width") == 24);
	CHECK(json.at("reference").at("samples") == 256);
	CHECK(json.at("reference").at("remembered") == 0);
	CHECK(json.at("reference").at("precision") == "double");
	const Json& points = json.at("points");
	REQUIRE(points.size() >= 6);
	double best = 1e300, before = 0, exact_1 = 0, exact_64 = 0;
	for (const Json& each : points) {
		CHECK(each.at("seconds") >= before);
		before = each.at("seconds");
		const double error = each.at("rel_rmse");
		CHECK(each.at("on_front") == (error < best * (1 - rt::clearly_nearer)));
		if (each.at("on_front"))
			best = error;
		CHECK(each.at("film_hash").get<std::string>().size() == 32);
		CHECK(each.at("cpu_seconds").get<double>() > 0);
		if (each.at("precision") == "exact" && each.at("sampler") == "independent" && each.at("estimator") == "path")
			(each.at("samples") == 1 ? exact_1 : exact_64) = each.at("rel_rmse");
	}
	// The last of exact has 16 or 64 samples: an eighth or a fourth of the error of one.
	CHECK(exact_64 < 0.5 * exact_1);
	CHECK(exact_64 > 0.03 * exact_1);
	const std::string csv = file_text(directory / "table.csv");
	CHECK(std::count(csv.begin(), csv.end(), '\n') == std::ptrdiff_t(points.size()) + 1);

	SECTION("the recommended command line is one, and gives the film that was measured")
	{
		const Json& advice = json.at("advice").at("recommended");
		const std::string command = advice.at("command");
		REQUIRE(command.rfind("rt render three-spheres ", 0) == 0);
		const Outcome rendered =
		    run_rt(directory, command.substr(3) + " --size 24x18 -q -o '" + (directory / "image.png") + "'");
		CHECK(rendered.status == 0);
		const Outcome one = run_rt(directory, "render three-spheres --backend reference --size 24x18 --spp 1 -q -o '" +
		                                          (directory / "image.png") + "'");
		bool found = false;
		for (const Json& each : points)
			found = found || "film " + each.at("film_hash").get<std::string>() + "\n" == one.out;
		CHECK(found);
	}
	SECTION("the reference is remembered, unless a bit of it has changed")
	{
		CHECK(tradeoff(directory).at("reference").at("remembered") == 256);
		const std::vector<std::string> halves = remembered_references(directory);
		CHECK(halves.size() == 2);
		for (const std::string& path : halves) {
			const std::string bytes = file_text(path);
			std::fstream file(path, std::ios::in | std::ios::out | std::ios::binary);
			file.seekp(std::streamoff(bytes.size() / 2));
			file.put(static_cast<char>(bytes[bytes.size() / 2] ^ 1));
		}
		const Json again = tradeoff(directory);
		CHECK(again.at("reference").at("remembered") == 0);
		CHECK(again.at("reference").at("film_hash") == json.at("reference").at("film_hash"));
	}
	SECTION("a reference of more samples goes on from it, and is the same as one made at once")
	{
		const Json more = tradeoff(directory, "", 512);
		CHECK(more.at("reference").at("remembered") == 256);
		CHECK(more.at("reference").at("samples") == 512);
		const Directory other;
		CHECK(tradeoff(other, "", 512).at("reference").at("film_hash") == more.at("reference").at("film_hash"));
	}
	SECTION("--auto-precision takes what was measured")
	{
		const std::string render = "render three-spheres --backend reference --auto-precision -o '" +
		                           (directory / "image.png") + "' --target-error ";
		CHECK(run_rt(directory, render + "0.2 --size 24x18").status == 0);
		CHECK(file_text(directory / "errors").find("for an error of 20 %") != std::string::npos);
		CHECK(file_text(directory / "errors").find("was not measured") == std::string::npos);
		// An image of another size is measured itself, once.
		CHECK(run_rt(directory, render + "0.3 --size 12x9").status == 0);
		CHECK(file_text(directory / "errors").find("was not measured") != std::string::npos);
		CHECK(run_rt(directory, render + "0.3 --size 12x9").status == 0);
		CHECK(file_text(directory / "errors").find("was not measured") == std::string::npos);
		CHECK(run_rt(directory, render + "1e-9 --size 24x18").status == 1);
		CHECK(run_rt(directory, render + "0.2 --spp 3").status == 2);
		CHECK(run_rt(directory, render + "0.2 --error 0.1").status == 2);
		// What was measured with other options of the device says nothing of this.
		CHECK(run_rt(directory, render + "0.3 --size 12x9 --generic").status == 0);
		CHECK(file_text(directory / "errors").find("was not measured") != std::string::npos);
		CHECK(run_rt(directory, "render --auto-precision").status == 2);
		CHECK(run_rt(directory, "render --target-error 0.1").status == 2);
	}
}

TEST_CASE("tradeoff: the fuller of two measurements is remembered, whichever came first")
{
	const bool fuller_first = GENERATE(true, false);
	INFO(fuller_first);
	const Directory directory;
	Json fuller, shorter;
	for (const bool is_fuller : {fuller_first, !fuller_first}) {
		// Without its reference a run is as short as it is asked to be.
		for (const std::string& path : remembered_references(directory))
			std::filesystem::remove(path);
		const Json measured = tradeoff(directory, "", is_fuller ? 256 : 64);
		(is_fuller ? fuller : shorter) = measured;
		CHECK(measured.at("reference").at("samples") == (is_fuller ? 256 : 64));
	}
	// What is remembered is JSON behind a file's head of its own, in which any byte may stand.
	std::vector<Json> remembered;
	for (const auto& entry : std::filesystem::directory_iterator(directory / "cache/kernels")) {
		const std::string text = file_text(entry.path().string());
		if (text.find("\"points\":[") != std::string::npos)
			remembered.push_back(Json::parse(text.substr(text.find("{\""))));
	}
	REQUIRE(remembered.size() == 1);
	CHECK(remembered[0].at("reference").at("samples") == 256);
	CHECK(remembered[0].at("points").size() == fuller.at("points").size());
	CHECK(shorter.at("points").size() < fuller.at("points").size());
}

TEST_CASE("tradeoff: where the reference takes all the time it is told, and nothing is remembered")
{
	const Directory directory;
	// So many pixels that the least reference takes two seconds or so, and more than the one that it gets.
	const double side = (RT_TEST_SANITIZED ? 9 : 20) * std::sqrt(double(std::thread::hardware_concurrency()));
	const Outcome outcome =
	    run_rt(directory, "tradeoff weekend --backend reference --limit 1 --reference 65536 --size " +
	                          std::to_string(int(16 * side)) + "x" + std::to_string(int(9 * side)));
	CHECK(outcome.status == 1);
	CHECK(outcome.out.find("left out: ") != std::string::npos);
	CHECK(file_text(directory / "errors").find("--limit") != std::string::npos);
	// A measurement without a point would keep others from measuring.
	const std::filesystem::path cache = directory / "cache";
	std::size_t measurements = 0;
	for (const auto& file : std::filesystem::recursive_directory_iterator(cache))
		if (file.is_regular_file())
			measurements += file_text(file.path().string()).find("\"points\":[]") != std::string::npos;
	CHECK(measurements == 0);
}

TEST_CASE("tradeoff: Ctrl-C keeps what was measured")
{
	const Directory directory;
	const std::string file = directory / "stopped.json";
	const std::vector<std::string> arguments = {
	    "tradeoff", "three-spheres", "--backend", "reference", "--size", "32x24",      "--reference",
	    "65536",    "--limit",       "600",       "--json",    file,     "--progress", "json"};
	CHECK(run_until(directory, arguments, "reference, 1024 samples") == 130);
	Json json = Json::parse(file_text(file));
	CHECK(json.at("complete") == false);
	CHECK(json.at("points").empty());
	const std::uint32_t kept = json.at("reference").at("samples");
	CHECK(kept >= 64);

	std::vector<std::string> smaller = arguments;
	smaller[7] = "16384";
	CHECK(run_until(directory, smaller, "exact, 64 samples") == 130);
	json = Json::parse(file_text(file));
	CHECK(json.at("complete") == false);
	CHECK(json.at("reference").at("remembered").get<std::uint32_t>() >= kept);
	CHECK(json.at("reference").at("samples") == 16384);
	REQUIRE(json.at("points").size() >= 3);
	for (const Json& each : json.at("points"))
		CHECK(each.at("samples").get<std::uint32_t>() <= 64);
}

TEST_CASE("tradeoff: what is asked wrongly is told")
{
	const Directory directory;
	for (const char* arguments : {"tradeoff --budget 1 --target-error 0.1", "tradeoff --budget 0",
	                              "tradeoff --target-error x", "tradeoff --size 3", "tradeoff --json - --csv -",
	                              "tradeoff --limit 0", "tradeoff --precision fast", "tradeoff --frames 0:3"}) {
		INFO(arguments);
		CHECK(run_rt(directory, arguments).status == 2);
	}
	CHECK(run_rt(directory, "tradeoff no-such-scene").status == 7);
	CHECK(run_rt(directory, "tradeoff --json /no/such/directory/file.json").status == 7);
}
