// program_cache.h: compiled kernels kept between runs.
//
// Where:  $RT_CACHE_DIR, else $XDG_CACHE_HOME/rt, else ~/.cache/rt; RT_CACHE=off turns it off.
// Key:    XXH3-128 over format number, backend, platform, device name, driver, compiler version, options and
//         the whole program text: anything that can change the code changes the key.
// File:   kernels/<key>.bin = magic, format, payload size, XXH3-128 of the payload, payload.
// Writes: to a temporary name in the same directory, then rename: two processes that start at once both write
//         the same bytes and neither reads half a file.
// Reads:  a wrong magic, size or checksum counts as absent; the entry is rebuilt and replaced. A cache that
//         cannot be written is no error: the next start compiles again.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace rt {

struct CacheKey {
	std::string backend, platform, device, driver, compiler, options, text;
};

// Whether a variable of this name may change the code that a driver makes.
bool changes_code(std::string_view name);

// The environment variables by which drivers let their code generation be changed, with their values: whoever keeps
// something that depends on a driver's code puts them into its key.
std::string cache_environment();

std::optional<std::vector<std::uint8_t>> cache_load(const CacheKey& key);
void cache_store(const CacheKey& key, const std::vector<std::uint8_t>& payload);

bool cache_is_on();

// Held from before an entry is looked up until it is stored: of this process's threads that want the same one, the
// first makes it and the others find it. Nobody waits for another key's, nor with the cache off.
class CacheTurn {
public:
	explicit CacheTurn(const CacheKey& key);
	CacheTurn(const CacheTurn&) = delete;
	CacheTurn& operator=(const CacheTurn&) = delete;
	~CacheTurn();

private:
	std::string path_;
};

// The file that holds a key's entry (whether or not it is there); empty when the cache is off.
std::string cache_path(const CacheKey& key);

} // namespace rt
