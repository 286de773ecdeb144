#include "support/hash.h"

#include <xxhash.h>

#include <array>
#include <new>

namespace rt {

namespace {

Hash128 from_xxhash(XXH128_hash_t hash) { return {hash.high64, hash.low64}; }

template <std::size_t Bytes>
std::array<unsigned char, Bytes> little_endian(std::uint64_t value)
{
	std::array<unsigned char, Bytes> bytes{};
	for (std::size_t i = 0; i < Bytes; ++i)
		bytes[i] = static_cast<unsigned char>(value >> (8 * i));
	return bytes;
}

} // namespace

std::string Hash128::hex() const
{
	static const char digits[] = "0123456789abcdef";
	std::string text(32, '0');
	for (unsigned i = 0; i < 16; ++i) {
		text[i] = digits[(high >> (60 - 4 * i)) & 15];
		text[16 + i] = digits[(low >> (60 - 4 * i)) & 15];
	}
	return text;
}

Hash128 hash_bytes(const void* data, std::size_t bytes) { return from_xxhash(XXH3_128bits(data, bytes)); }

Hasher::Hasher() : state_(XXH3_createState())
{
	if (!state_)
		throw std::bad_alloc(); // as `new` would: 576 bytes are missing
	XXH3_128bits_reset(static_cast<XXH3_state_t*>(state_));
}

Hasher::~Hasher() { XXH3_freeState(static_cast<XXH3_state_t*>(state_)); }

void Hasher::add(const void* data, std::size_t bytes)
{
	// An empty vector's data() may be null, which the library takes for an error.
	if (bytes != 0)
		XXH3_128bits_update(static_cast<XXH3_state_t*>(state_), data, bytes);
}

void Hasher::add_u32(std::uint32_t value)
{
	const auto bytes = little_endian<4>(value);
	add(bytes.data(), bytes.size());
}

void Hasher::add_u64(std::uint64_t value)
{
	const auto bytes = little_endian<8>(value);
	add(bytes.data(), bytes.size());
}

Hash128 Hasher::result() const { return from_xxhash(XXH3_128bits_digest(static_cast<XXH3_state_t*>(state_))); }

} // namespace rt
