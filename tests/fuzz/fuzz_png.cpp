// PNG textures, as they come and with the chunks' checksums put right: libpng drops a chunk whose checksum is wrong, so
// that a changed one would hardly ever be looked into.
#include "tests/fuzz/fuzz.h"

#include "render/texture_decoders.h"

#include <vector>

#include <zlib.h>

namespace {

std::uint32_t read_u32_be(const std::uint8_t* p)
{
	return std::uint32_t(p[0]) << 24 | std::uint32_t(p[1]) << 16 | std::uint32_t(p[2]) << 8 | std::uint32_t(p[3]);
}

void put_checksums_right(std::vector<std::uint8_t>& png)
{
	// A chunk is length, kind, data, checksum of kind and data.
	for (std::size_t at = 8; png.size() - at >= 12;) {
		const std::size_t length = read_u32_be(png.data() + at);
		if (length > png.size() - at - 12)
			return;
		const uLong sum = crc32(0, png.data() + at + 4, static_cast<uInt>(length + 4));
		for (std::size_t k = 0; k < 4; ++k)
			png[at + 8 + length + k] = static_cast<std::uint8_t>(sum >> (24 - 8 * k));
		at += length + 12;
	}
}

void decode(const std::uint8_t* data, std::size_t size)
{
	const rt::Result<rt::TextureImage> image = rt::decode_png(data, size, "fuzzed.png");
	FUZZ_CHECK(!image || image->texels.size() == std::size_t(image->width) * image->height);
}

} // namespace

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size)
{
	decode(data, size);
	if (size < 8)
		return 0;
	std::vector<std::uint8_t> mended(data, data + size);
	put_checksums_right(mended);
	decode(mended.data(), mended.size());
	return 0;
}
