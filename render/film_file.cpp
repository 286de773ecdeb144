#include "render/image_file.h"
#include "support/hash.h"

#include <fmt/format.h>

#include <cstddef>
#include <cstring>
#include <utility>

namespace rt {

namespace {

// docs/formats.md describes the layout.
const char magic[] = "RTFILM\r\n";
constexpr std::size_t magic_bytes = 8;
constexpr std::uint32_t format_version = 1;
constexpr std::size_t header_bytes = 64;
constexpr std::size_t bytes_per_pixel = 4 + 3 * 8;
constexpr std::size_t checksum_bytes = 16;
constexpr std::int32_t max_exponent = 256; // far beyond what a scene in the contract's range needs

class Writer {
public:
	explicit Writer(std::size_t bytes) { bytes_.reserve(bytes); }
	void raw(const void* data, std::size_t count)
	{
		const auto* first = static_cast<const std::uint8_t*>(data);
		bytes_.insert(bytes_.end(), first, first + count);
	}
	void u32(std::uint32_t value) { little_endian(value, 4); }
	void u64(std::uint64_t value) { little_endian(value, 8); }
	void text(const std::string& value)
	{
		u32(static_cast<std::uint32_t>(value.size()));
		raw(value.data(), value.size());
	}
	std::vector<std::uint8_t>& bytes() { return bytes_; }

private:
	void little_endian(std::uint64_t value, std::size_t count)
	{
		std::uint8_t field[8];
		for (std::size_t i = 0; i < 8; ++i)
			field[i] = static_cast<std::uint8_t>(value >> (8 * i));
		raw(field, count);
	}

	std::vector<std::uint8_t> bytes_;
};

// Reads what the caller knows to be there; only text() must look.
class Reader {
public:
	Reader(const std::uint8_t* data, std::size_t bytes) : next_(data), end_(data + bytes) {}
	std::size_t left() const { return static_cast<std::size_t>(end_ - next_); }
	std::uint32_t u32() { return static_cast<std::uint32_t>(little_endian(4)); }
	std::uint64_t u64() { return little_endian(8); }
	bool text(std::string& value)
	{
		if (left() < 4)
			return false;
		const std::uint32_t length = u32();
		if (left() < length)
			return false;
		value.assign(next_, next_ + length);
		next_ += length;
		return true;
	}

private:
	std::uint64_t little_endian(int count)
	{
		std::uint64_t value = 0;
		for (int i = 0; i < count; ++i)
			value |= static_cast<std::uint64_t>(*next_++) << (8 * i);
		return value;
	}

	const std::uint8_t* next_;
	const std::uint8_t* end_;
};

// The bytes in the order of the hash's hex digits.
void checksum(const std::uint8_t* data, std::size_t bytes, std::uint8_t (&out)[checksum_bytes])
{
	const Hash128 hash = hash_bytes(data, bytes);
	for (int i = 0; i < 8; ++i) {
		out[i] = static_cast<std::uint8_t>(hash.high >> (56 - 8 * i));
		out[8 + i] = static_cast<std::uint8_t>(hash.low >> (56 - 8 * i));
	}
}

Error refused(const std::string& name, std::string message, std::string cure)
{
	return {ErrorKind::InputOutput, std::move(message), name, std::move(cure), {}};
}

Error damaged(const std::string& name, const char* how)
{
	return refused(name, fmt::format("the film is damaged: {}", how), "copy the file again or render it again");
}

} // namespace

std::vector<std::uint8_t> encode_rtfilm(const Film& film, const Provenance& provenance)
{
	std::size_t provenance_bytes = 0;
	for (const auto& [key, value] : provenance)
		provenance_bytes += 8 + key.size() + value.size();

	Writer out(header_bytes + provenance_bytes + bytes_per_pixel * film.samples().size() + checksum_bytes);
	out.raw(magic, magic_bytes);
	out.u32(format_version);
	out.u32(film.image_width());
	out.u32(film.image_height());
	out.u32(film.window().x);
	out.u32(film.window().y);
	out.u32(film.window().width);
	out.u32(film.window().height);
	out.u32(static_cast<std::uint32_t>(film.exponent()));
	out.u64(film.segments);
	out.u64(film.rejected);
	out.u32(static_cast<std::uint32_t>(provenance.size()));
	out.u32(static_cast<std::uint32_t>(provenance_bytes));
	for (const auto& [key, value] : provenance) {
		out.text(key);
		out.text(value);
	}
	for (const std::uint32_t count : film.samples())
		out.u32(count);
	for (const std::int64_t sum : film.sums())
		out.u64(static_cast<std::uint64_t>(sum));
	std::uint8_t sum_of_all[checksum_bytes];
	checksum(out.bytes().data(), out.bytes().size(), sum_of_all);
	out.raw(sum_of_all, checksum_bytes);
	return std::move(out.bytes());
}

Result<LoadedFilm> decode_rtfilm(const std::uint8_t* data, std::size_t bytes, const std::string& name)
{
	if (bytes < magic_bytes || std::memcmp(data, magic, magic_bytes) != 0)
		return refused(name, "this is not an .rtfilm file",
		               "name a film that rt wrote; rt render -o NAME.rtfilm writes one");
	if (bytes < magic_bytes + 4)
		return damaged(name, "it ends within its header");
	Reader in(data + magic_bytes, bytes - magic_bytes);
	const std::uint32_t version = in.u32();
	if (version > format_version)
		return refused(
		    name,
		    fmt::format("the film has format version {}, this rt reads up to version {}", version, format_version),
		    "use a newer rt");
	if (version != format_version)
		return refused(name, fmt::format("the film has format version {}, which does not exist", version),
		               "copy the file again or render it again");
	if (bytes < header_bytes + checksum_bytes)
		return damaged(name, "it ends within its header");

	const std::uint32_t image_width = in.u32(), image_height = in.u32();
	Window window;
	window.x = in.u32();
	window.y = in.u32();
	window.width = in.u32();
	window.height = in.u32();
	const std::int32_t exponent = static_cast<std::int32_t>(in.u32());
	const std::uint64_t segments = in.u64(), rejected = in.u64();
	const std::uint32_t entries = in.u32(), provenance_bytes = in.u32();

	// Nothing is allocated before the sizes are known to be those of the bytes at hand. A pixel count is below 2^64 and
	// is compared before it is multiplied.
	const std::uint64_t pixels = std::uint64_t(window.width) * window.height;
	const std::uint64_t payload = bytes - header_bytes - checksum_bytes;
	if (pixels > payload / bytes_per_pixel || payload - pixels * bytes_per_pixel != provenance_bytes)
		return damaged(name, "its length is not what its header says");
	std::uint8_t expected[checksum_bytes];
	checksum(data, bytes - checksum_bytes, expected);
	if (std::memcmp(expected, data + bytes - checksum_bytes, checksum_bytes) != 0)
		return damaged(name, "its checksum does not match");

	// The checksum is right, so from here on only a faulty or malicious writer is refused.
	if (pixels == 0 || std::uint64_t(window.x) + window.width > image_width ||
	    std::uint64_t(window.y) + window.height > image_height)
		return damaged(name, "its window is empty or not within the image");
	if (exponent < -max_exponent || exponent > max_exponent)
		return damaged(name, "its fixed-point exponent is out of range");

	LoadedFilm loaded;
	Reader text(data + header_bytes, provenance_bytes);
	for (std::uint32_t i = 0; i < entries; ++i) {
		std::string key, value;
		if (!text.text(key) || !text.text(value))
			return damaged(name, "its provenance does not fit");
		loaded.provenance.emplace_back(std::move(key), std::move(value));
	}
	if (text.left() != 0)
		return damaged(name, "its provenance does not fit");

	loaded.film = Film(image_width, image_height, window, exponent);
	loaded.film.segments = segments;
	loaded.film.rejected = rejected;
	Reader pixel_data(data + header_bytes + provenance_bytes, static_cast<std::size_t>(pixels) * bytes_per_pixel);
	for (std::uint32_t& count : loaded.film.samples())
		count = pixel_data.u32();
	for (std::int64_t& sum : loaded.film.sums())
		sum = static_cast<std::int64_t>(pixel_data.u64());
	return loaded;
}

} // namespace rt
