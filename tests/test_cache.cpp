// The cache of compiled kernels: what is stored comes back whole or not at all.
#include "tests/catch.h"

#include "backends/program_cache.h"
#include "support/files.h"

#include <dirent.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <future>
#include <optional>
#include <string>
#include <thread>
#include <vector>

namespace {

using Bytes = std::vector<std::uint8_t>;

// Environment variables as a test wants them, put back at its end.
class Environment {
public:
	~Environment()
	{
		for (auto saved = saved_.rbegin(); saved != saved_.rend(); ++saved)
			if (saved->second)
				setenv(saved->first.c_str(), saved->second->c_str(), 1);
			else
				unsetenv(saved->first.c_str());
	}
	void set(const std::string& name, const std::string& value)
	{
		save(name);
		setenv(name.c_str(), value.c_str(), 1);
	}
	void unset(const std::string& name)
	{
		save(name);
		unsetenv(name.c_str());
	}

private:
	void save(const std::string& name)
	{
		const char* value = std::getenv(name.c_str());
		saved_.emplace_back(name, value ? std::optional<std::string>(value) : std::nullopt);
	}
	std::vector<std::pair<std::string, std::optional<std::string>>> saved_;
};

// An empty cache directory of the test's own, removed at its end.
class TemporaryCache {
public:
	TemporaryCache()
	{
		char pattern[] = "/tmp/rt_test_cache_XXXXXX";
		path_ = mkdtemp(pattern);
		environment_.unset("RT_CACHE");
		environment_.set("RT_CACHE_DIR", path_ + "/inner");
	}
	~TemporaryCache()
	{
		for (const std::string& name : files())
			unlink((kernels() + "/" + name).c_str());
		rmdir(kernels().c_str());
		rmdir((path_ + "/inner").c_str());
		rmdir(path_.c_str());
	}
	TemporaryCache(const TemporaryCache&) = delete;
	TemporaryCache& operator=(const TemporaryCache&) = delete;

	std::string kernels() const { return path_ + "/inner/kernels"; }
	std::vector<std::string> files() const
	{
		std::vector<std::string> names;
		if (DIR* directory = opendir(kernels().c_str())) {
			while (const dirent* entry = readdir(directory))
				if (entry->d_name[0] != '.')
					names.emplace_back(entry->d_name);
			closedir(directory);
		}
		return names;
	}
	Environment& environment() { return environment_; }

private:
	Environment environment_;
	std::string path_;
};

const rt::CacheKey key = {"opencl", "a platform", "a device", "1.0", "compiler 2", "-cl-std=CL1.2", "__kernel ..."};

Bytes payload_of(std::size_t bytes, unsigned seed = 1)
{
	Bytes payload(bytes);
	for (std::uint8_t& byte : payload) {
		seed = seed * 1664525u + 1013904223u;
		byte = static_cast<std::uint8_t>(seed >> 24);
	}
	return payload;
}

Bytes file_bytes()
{
	auto bytes = rt::read_file(rt::cache_path(key));
	REQUIRE(bytes);
	return *bytes;
}

void overwrite(const Bytes& bytes) { REQUIRE(rt::write_file(rt::cache_path(key), bytes.data(), bytes.size())); }

} // namespace

TEST_CASE("cold, warm, replaced")
{
	TemporaryCache cache;
	REQUIRE_FALSE(rt::cache_load(key));
	for (std::size_t bytes : {std::size_t(100000), std::size_t(1), std::size_t(0)}) {
		const Bytes payload = payload_of(bytes);
		rt::cache_store(key, payload);
		const auto loaded = rt::cache_load(key);
		REQUIRE(loaded);
		REQUIRE(*loaded == payload);
	}
	REQUIRE(cache.files().size() == 1); // no temporary file is left
	struct stat status;
	REQUIRE(stat(rt::cache_path(key).c_str(), &status) == 0);
	REQUIRE((status.st_mode & 0077) == 0); // code that is run later: nobody else may write it
}

TEST_CASE("every field is part of the key")
{
	TemporaryCache cache;
	rt::cache_store(key, payload_of(10));
	using Field = std::string rt::CacheKey::*;
	for (Field field : {&rt::CacheKey::backend, &rt::CacheKey::platform, &rt::CacheKey::device, &rt::CacheKey::driver,
	                    &rt::CacheKey::compiler, &rt::CacheKey::options, &rt::CacheKey::text}) {
		rt::CacheKey other = key;
		other.*field += "x";
		REQUIRE(rt::cache_path(other) != rt::cache_path(key));
		REQUIRE_FALSE(rt::cache_load(other));
	}
	// A character that moves over the border between two fields makes another key.
	rt::CacheKey moved = key;
	moved.driver = "1.0c";
	moved.compiler = "ompiler 2";
	REQUIRE(rt::cache_path(moved) != rt::cache_path(key));
}

TEST_CASE("a damaged entry counts as absent and is replaced")
{
	TemporaryCache cache;
	const Bytes payload = payload_of(1000);
	rt::cache_store(key, payload);
	const Bytes sound = file_bytes();

	SECTION("truncated anywhere")
	{
		for (std::size_t bytes = 0; bytes < sound.size(); bytes += bytes < 64 ? 1 : 97) {
			overwrite(Bytes(sound.begin(), sound.begin() + static_cast<std::ptrdiff_t>(bytes)));
			REQUIRE_FALSE(rt::cache_load(key));
		}
	}
	SECTION("a bit flipped anywhere: magic, format, size, checksum and payload")
	{
		for (std::size_t byte = 0; byte < sound.size(); byte += byte < 64 ? 1 : 97) {
			Bytes flipped = sound;
			flipped[byte] = static_cast<std::uint8_t>(flipped[byte] ^ (1u << byte % 8));
			overwrite(flipped);
			REQUIRE_FALSE(rt::cache_load(key));
		}
	}
	SECTION("of another format")
	{
		Bytes other = sound;
		std::uint32_t format;
		std::memcpy(&format, other.data() + 8, sizeof format);
		++format;
		std::memcpy(other.data() + 8, &format, sizeof format);
		overwrite(other);
		REQUIRE_FALSE(rt::cache_load(key));
	}
	SECTION("with bytes behind its end")
	{
		Bytes longer = sound;
		longer.push_back(0);
		overwrite(longer);
		REQUIRE_FALSE(rt::cache_load(key));
	}
	rt::cache_store(key, payload);
	const auto loaded = rt::cache_load(key);
	REQUIRE(loaded);
	REQUIRE(*loaded == payload);
}

TEST_CASE("of threads that want the same entry one makes it; nobody waits for another entry's")
{
	TemporaryCache cache;
	std::atomic<unsigned> made{0}, found{0};
	const auto build = [&](const rt::CacheKey& wanted) {
		const rt::CacheTurn turn(wanted);
		if (rt::cache_load(wanted)) {
			++found;
			return;
		}
		++made;
		rt::cache_store(wanted, payload_of(100));
	};
	{
		std::vector<std::thread> threads;
		for (unsigned i = 0; i < 8; ++i)
			threads.emplace_back(build, key);
		for (std::thread& thread : threads)
			thread.join();
	}
	REQUIRE(made == 1);
	REQUIRE(found == 7);

	rt::CacheKey other = key;
	other.options += " -DOTHER";
	std::future<void> waiting, free;
	{
		const rt::CacheTurn turn(key);
		waiting = std::async(std::launch::async, build, key);
		free = std::async(std::launch::async, build, other);
		CHECK(free.wait_for(std::chrono::minutes(1)) == std::future_status::ready);
		CHECK(found == 7); // the other thread that wants this one has not even looked
	}
	waiting.get();
	free.get();
	REQUIRE(made == 2);
	REQUIRE(found == 8);

	cache.environment().set("RT_CACHE", "off"); // there is nothing to be found: turns would only be slower
	const rt::CacheTurn turn(key);
	free = std::async(std::launch::async, build, key);
	CHECK(free.wait_for(std::chrono::minutes(1)) == std::future_status::ready);
}

TEST_CASE("a cache that cannot be written is no error")
{
	TemporaryCache cache;
	cache.environment().set("RT_CACHE_DIR", "/proc/rt_test_cache"); // not even root can write there
	rt::cache_store(key, payload_of(10));
	REQUIRE_FALSE(rt::cache_load(key));
	// A directory stands where the entry should be: the rename fails, and its temporary file goes.
	TemporaryCache blocked;
	rt::cache_store(key, payload_of(10));
	REQUIRE(unlink(rt::cache_path(key).c_str()) == 0);
	REQUIRE(mkdir(rt::cache_path(key).c_str(), 0700) == 0);
	rt::cache_store(key, payload_of(10));
	REQUIRE_FALSE(rt::cache_load(key));
	REQUIRE(blocked.files().size() == 1);
	REQUIRE(rmdir(rt::cache_path(key).c_str()) == 0);
}

TEST_CASE("where the cache lies")
{
	Environment environment;
	environment.unset("RT_CACHE");
	environment.set("RT_CACHE_DIR", "/one");
	environment.set("XDG_CACHE_HOME", "/two");
	environment.set("HOME", "/three");
	const auto starts_with = [](const std::string& start) {
		return rt::cache_path(key).compare(0, start.size(), start) == 0;
	};
	REQUIRE(starts_with("/one/kernels/"));
	environment.unset("RT_CACHE_DIR");
	REQUIRE(starts_with("/two/rt/kernels/"));
	environment.set("XDG_CACHE_HOME", "relative");
	REQUIRE(starts_with("/three/.cache/rt/kernels/"));
	environment.set("RT_CACHE", "off");
	REQUIRE(rt::cache_path(key).empty());
	environment.unset("RT_CACHE");
	environment.unset("XDG_CACHE_HOME");
	environment.unset("HOME");
	REQUIRE(rt::cache_path(key).empty());
	rt::cache_store(key, payload_of(10)); // goes nowhere
	REQUIRE_FALSE(rt::cache_load(key));
}

TEST_CASE("processes and threads that store and load one key never see half an entry")
{
	TemporaryCache cache;
	// Payloads of different sizes: a mixture of two would fail its checksum and load as absent.
	const std::vector<Bytes> payloads = {payload_of(30000, 1), payload_of(70000, 2), payload_of(5, 3)};
	rt::cache_store(key, payloads[0]);
	const auto work = [&payloads](std::size_t first) {
		bool sound = true;
		for (std::size_t i = 0; i < 150; ++i) {
			rt::cache_store(key, payloads[(first + i) % payloads.size()]);
			const auto loaded = rt::cache_load(key);
			sound = sound && loaded && (*loaded == payloads[0] || *loaded == payloads[1] || *loaded == payloads[2]);
		}
		return sound;
	};
	std::vector<pid_t> children;
	for (std::size_t child = 0; child < 2; ++child) {
		const pid_t pid = fork();
		REQUIRE(pid >= 0);
		if (pid == 0) {
			bool sound[2] = {false, false};
			std::thread other([&] { sound[1] = work(child + 1); });
			sound[0] = work(child);
			other.join();
			_exit(sound[0] && sound[1] ? 0 : 1);
		}
		children.push_back(pid);
	}
	for (pid_t pid : children) {
		int status = 0;
		REQUIRE(waitpid(pid, &status, 0) == pid);
		REQUIRE(WIFEXITED(status));
		REQUIRE(WEXITSTATUS(status) == 0);
	}
	REQUIRE(cache.files().size() == 1);
}
