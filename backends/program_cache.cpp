#include "backends/program_cache.h"

#include "support/files.h"
#include "support/hash.h"

#include <fmt/format.h>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <condition_variable>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <mutex>
#include <set>

extern char** environ;

namespace rt {

namespace {

// Raised whenever the file's layout or the meaning of a payload changes.
constexpr std::uint32_t cache_format = 1;
constexpr std::uint64_t max_payload_bytes = std::uint64_t(1) << 30;

struct FileHeader {
	char magic[8];
	std::uint32_t format;
	std::uint32_t reserved;
	std::uint64_t payload_bytes;
	std::uint64_t hash_high, hash_low; // of the payload
};
static_assert(sizeof(FileHeader) == 40, "the header is written as it lies in memory and must have no padding");

FileHeader make_header(const void* payload, std::size_t bytes)
{
	const Hash128 hash = hash_bytes(payload, bytes);
	return {{'r', 't', 'k', 'e', 'r', 'n', 'e', 'l'}, cache_format, 0, bytes, hash.high, hash.low};
}

// Empty when the cache is off: by RT_CACHE=off, or because no directory is known.
std::string cache_directory()
{
	const auto variable = [](const char* name) -> std::string {
		const char* value = std::getenv(name);
		return value ? value : "";
	};
	if (variable("RT_CACHE") == "off")
		return {};
	if (const std::string own = variable("RT_CACHE_DIR"); !own.empty())
		return own + "/kernels";
	// The XDG base directory specification: a relative path there is to be ignored.
	if (const std::string xdg = variable("XDG_CACHE_HOME"); !xdg.empty() && xdg[0] == '/')
		return xdg + "/rt/kernels";
	if (const std::string home = variable("HOME"); !home.empty())
		return home + "/.cache/rt/kernels";
	return {};
}

// Failures show when the file is opened.
void make_directories(const std::string& path)
{
	for (std::size_t end = 0; end != std::string::npos;) {
		end = path.find('/', end + 1);
		mkdir(path.substr(0, end).c_str(), 0700); // private to the user: what lies here is run as code
	}
}

std::string key_name(const CacheKey& key)
{
	Hasher hasher;
	hasher.add_u32(cache_format);
	for (const std::string* field :
	     {&key.backend, &key.platform, &key.device, &key.driver, &key.compiler, &key.options, &key.text}) {
		hasher.add_u64(field->size()); // so that text moved from one field to the next is another key
		hasher.add(field->data(), field->size());
	}
	return hasher.result().hex();
}

bool write_all(int file, const void* data, std::size_t bytes)
{
	const char* next = static_cast<const char*>(data);
	while (bytes > 0) {
		const ssize_t written = write(file, next, bytes);
		if (written < 0 && errno == EINTR)
			continue;
		if (written <= 0)
			return false;
		next += written;
		bytes -= static_cast<std::size_t>(written);
	}
	return true;
}

struct Turns {
	std::mutex mutex;
	std::condition_variable ended;
	std::set<std::string> taken; // the files that threads are making
};

Turns& turns()
{
	static Turns shared;
	return shared;
}

} // namespace

bool cache_is_on() { return !cache_directory().empty(); }

std::string cache_path(const CacheKey& key)
{
	const std::string directory = cache_directory();
	return directory.empty() ? directory : fmt::format("{}/{}.bin", directory, key_name(key));
}

std::optional<std::vector<std::uint8_t>> cache_load(const CacheKey& key)
{
	const std::string path = cache_path(key);
	if (path.empty())
		return std::nullopt;
	Result<std::vector<std::uint8_t>> file = read_file(path, max_payload_bytes + sizeof(FileHeader));
	if (!file || file->size() < sizeof(FileHeader))
		return std::nullopt;
	std::vector<std::uint8_t> bytes = std::move(*file);
	// The header of a sound file is a function of its payload: one comparison checks magic, format, size and hash.
	const FileHeader expected = make_header(bytes.data() + sizeof(FileHeader), bytes.size() - sizeof(FileHeader));
	if (std::memcmp(bytes.data(), &expected, sizeof expected) != 0)
		return std::nullopt;
	bytes.erase(bytes.begin(), bytes.begin() + sizeof(FileHeader));
	return bytes;
}

// Not write_file(): an entry lost in a power cut is only compiled again, so it is not worth waiting for the disk.
void cache_store(const CacheKey& key, const std::vector<std::uint8_t>& payload)
{
	const std::string path = cache_path(key);
	if (path.empty() || payload.size() > max_payload_bytes)
		return;
	make_directories(cache_directory());
	// The counter makes the name unique over threads, the process number over processes, and O_EXCL over machines
	// that share the directory, where a taken name only means another try.
	static std::atomic<unsigned> counter{0};
	std::string temporary;
	int file = -1;
	for (int attempt = 0; attempt < 8 && file < 0; ++attempt) {
		temporary = fmt::format("{}.{}.{}.tmp", path, getpid(), counter++);
		file = open(temporary.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
		if (file < 0 && errno != EEXIST)
			return;
	}
	if (file < 0)
		return;
	const FileHeader header = make_header(payload.data(), payload.size());
	bool done = write_all(file, &header, sizeof header) && write_all(file, payload.data(), payload.size());
	done = close(file) == 0 && done;
	if (!done || std::rename(temporary.c_str(), path.c_str()) != 0)
		unlink(temporary.c_str());
}

CacheTurn::CacheTurn(const CacheKey& key) : path_(cache_path(key))
{
	if (path_.empty())
		return;
	std::unique_lock<std::mutex> lock(turns().mutex);
	turns().ended.wait(lock, [this] { return turns().taken.insert(path_).second; });
}

CacheTurn::~CacheTurn()
{
	if (path_.empty())
		return;
	const std::lock_guard<std::mutex> lock(turns().mutex);
	turns().taken.erase(path_);
	turns().ended.notify_all();
}

bool changes_code(std::string_view name)
{
	for (const std::string_view prefix :
	     {"AMD_", "CL_CONFIG_", "CUDA_", "GALLIVM_", "IGC_", "LP_", "NV_", "POCL_", "RUSTICL_"})
		if (name.substr(0, prefix.size()) == prefix)
			return true;
	return false;
}

std::string cache_environment()
{
	std::vector<std::string> found;
	for (char** entry = environ; entry && *entry; ++entry)
		if (changes_code(*entry))
			found.emplace_back(*entry);
	std::sort(found.begin(), found.end());
	return fmt::format("{}", fmt::join(found, " "));
}

} // namespace rt
