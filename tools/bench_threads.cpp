#include "tools/bench_threads.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <string_view>
#include <vector>

#include <fcntl.h>
#include <sched.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

extern char** environ;

namespace rt {

namespace {

Error failure(const std::string& message)
{
	return Error{ErrorKind::Failure, message, "--sweep threads", "look at the messages above", ""};
}

std::vector<char*> pointers(std::vector<std::string>& texts)
{
	std::vector<char*> result;
	for (std::string& text : texts)
		result.push_back(text.data());
	result.push_back(nullptr);
	return result;
}

// The environment with the number of threads as each driver is told it (PoCL renamed its variable with version 4).
std::vector<std::string> environment_with(unsigned threads)
{
	constexpr const char* names[] = {"RT_THREADS", "POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT"};
	std::vector<std::string> result;
	for (char** entry = environ; entry && *entry; ++entry) {
		const std::string_view text = *entry;
		if (std::none_of(std::begin(names), std::end(names),
		                 [&](const char* name) { return text.substr(0, text.find('=')) == name; }))
			result.emplace_back(text);
	}
	for (const char* name : names)
		result.push_back(fmt::format("{}={}", name, threads));
	return result;
}

// While it lives, this thread and the processes that it starts have only the first processors of those allowed.
class FewerProcessors {
public:
	explicit FewerProcessors(unsigned count)
	{
		CPU_ZERO(&all_);
		if (sched_getaffinity(0, sizeof all_, &all_) != 0)
			return;
		cpu_set_t few;
		CPU_ZERO(&few);
		for (int i = 0; i < CPU_SETSIZE && static_cast<unsigned>(CPU_COUNT(&few)) < count; ++i)
			if (CPU_ISSET(i, &all_))
				CPU_SET(i, &few);
		changed_ = sched_setaffinity(0, sizeof few, &few) == 0;
	}
	~FewerProcessors()
	{
		if (changed_)
			sched_setaffinity(0, sizeof all_, &all_);
	}
	FewerProcessors(const FewerProcessors&) = delete;
	FewerProcessors& operator=(const FewerProcessors&) = delete;

private:
	cpu_set_t all_;
	bool changed_ = false;
};

// What the program wrote to its standard output; Failure if it could not be run or did not end with status 0.
Result<std::string> output_of(std::vector<std::string> arguments, std::vector<std::string> environment)
{
	int ends[2];
	if (pipe2(ends, O_CLOEXEC) != 0)
		return failure(fmt::format("no pipe could be made: {}", std::strerror(errno)));
	posix_spawn_file_actions_t actions;
	posix_spawn_file_actions_init(&actions);
	posix_spawn_file_actions_adddup2(&actions, ends[1], STDOUT_FILENO);
	pid_t process = 0;
	const int code = posix_spawn(&process, "/proc/self/exe", &actions, nullptr, pointers(arguments).data(),
	                             pointers(environment).data());
	posix_spawn_file_actions_destroy(&actions);
	close(ends[1]);
	std::string text;
	if (code == 0) {
		char buffer[4096];
		for (ssize_t count; (count = read(ends[0], buffer, sizeof buffer)) != 0;) {
			if (count < 0 && errno == EINTR)
				continue;
			if (count < 0)
				break;
			text.append(buffer, static_cast<std::size_t>(count));
		}
	}
	close(ends[0]);
	if (code != 0)
		return failure(fmt::format("this program could not be started again: {}", std::strerror(code)));
	int status = 0;
	while (waitpid(process, &status, 0) < 0 && errno == EINTR) {
	}
	if (!WIFEXITED(status) || WEXITSTATUS(status) != 0)
		return failure("the benchmark with fewer threads failed");
	return text;
}

Result<BenchRun> run_of(const std::string& text)
{
	BenchRun run;
	try {
		const nlohmann::json json = nlohmann::json::parse(text);
		const auto spread = [](const nlohmann::json& value) {
			return Spread{value.at("min").get<double>(), value.at("median").get<double>(),
			              value.at("max").get<double>()};
		};
		run.scene = json.at("scene").get<std::string>();
		run.samples = json.at("samples_rendered").get<std::uint64_t>();
		run.segments = json.at("segments_rendered").get<std::uint64_t>();
		run.spheres = json.at("spheres").get<std::uint64_t>();
		run.settings.width = json.at("width").get<std::uint32_t>();
		run.settings.height = json.at("height").get<std::uint32_t>();
		run.settings.samples = json.at("samples").get<std::uint32_t>();
		run.settings.max_depth = json.at("max_depth").get<std::uint32_t>();
		run.settings.seed = json.at("seed").get<std::uint32_t>();
		run.settings.roulette = json.at("roulette").get<std::uint32_t>();
		run.film_hash = json.at("film_hash").get<std::string>();
		run.load_seconds = json.at("load_seconds").get<double>();
		run.pack_seconds = json.at("pack_seconds").get<double>();
		run.render_seconds = spread(json.at("render_seconds"));
		run.stats.bvh = json.at("bvh").get<bool>();
		run.stats.launches = json.at("launches").get<std::uint64_t>();
		for (std::size_t phase = 0; phase < bench_phase_names.size(); ++phase)
			run.phases[phase] = spread(json.at("phases").at(bench_phase_names[phase]));
	} catch (const nlohmann::json::exception& exception) {
		return failure(
		    fmt::format("the benchmark with fewer threads answered what is not its JSON: {}", exception.what()));
	}
	return run;
}

} // namespace

unsigned processors_allowed()
{
	cpu_set_t set;
	CPU_ZERO(&set);
	if (sched_getaffinity(0, sizeof set, &set) != 0)
		return 1;
	return static_cast<unsigned>(std::max(1, CPU_COUNT(&set)));
}

Result<BenchRun> bench_with_threads(const std::string& scene, const RenderOptions& options, std::uint32_t repeats,
                                    unsigned threads, const std::function<void(const std::string&)>& status)
{
	status(fmt::format("{} on {} {}", scene, threads, threads == 1 ? "thread" : "threads"));
	std::vector<std::string> arguments = {"rt",        "bench",
	                                      scene,       "--json",
	                                      "-",         "--quiet",
	                                      "--backend", options.device.backend,
	                                      "--repeats", fmt::to_string(repeats)};
	const auto add = [&arguments](const char* option, const auto& value) {
		if (value)
			arguments.insert(arguments.end(), {option, fmt::to_string(*value)});
	};
	add("--width", options.width);
	add("--height", options.height);
	add("--samples", options.samples);
	add("--seed", options.seed);
	add("--max-depth", options.max_depth);
	add("--roulette", options.roulette);
	if (options.sampler)
		arguments.insert(arguments.end(), {"--sampler", sampler_name(*options.sampler)});
	if (options.estimator)
		arguments.insert(arguments.end(), {"--estimator", estimator_name(*options.estimator)});
	if (!options.device.device.empty())
		arguments.insert(arguments.end(), {"--device", options.device.device});
	if (options.lanes)
		arguments.insert(arguments.end(), {"--lanes", fmt::to_string(options.lanes)});
	arguments.insert(arguments.end(), {"--precision", precision_name(options.precision)});
	if (options.bvh != Acceleration::Auto)
		arguments.insert(arguments.end(), {"--bvh", options.bvh == Acceleration::Always ? "always" : "never"});
	if (!options.specialise)
		arguments.emplace_back("--generic");
	if (options.force_unverified)
		arguments.emplace_back("--force-unverified");
	const FewerProcessors bound(threads);
	RT_TRY_ASSIGN(const std::string text, output_of(std::move(arguments), environment_with(threads)));
	return run_of(text);
}

} // namespace rt
