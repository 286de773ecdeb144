// hash.h: XXH3-128, the one hash of the project, as a value and as 32 hex digits.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

namespace rt {

struct Hash128 {
	std::uint64_t high = 0, low = 0;
	// 32 lower-case hex digits, high half first: XXH128's canonical form.
	std::string hex() const;
	friend bool operator==(const Hash128& a, const Hash128& b) { return a.high == b.high && a.low == b.low; }
	friend bool operator!=(const Hash128& a, const Hash128& b) { return !(a == b); }
};

Hash128 hash_bytes(const void* data, std::size_t bytes);
inline Hash128 hash_text(std::string_view text) { return hash_bytes(text.data(), text.size()); }

// Hashes data that comes in pieces; the result is that of the pieces joined.
class Hasher {
public:
	Hasher();
	~Hasher();
	Hasher(const Hasher&) = delete;
	Hasher& operator=(const Hasher&) = delete;
	void add(const void* data, std::size_t bytes);
	void add_u32(std::uint32_t value); // little-endian on every machine
	void add_u64(std::uint64_t value);
	Hash128 result() const;

private:
	void* state_;
};

} // namespace rt
