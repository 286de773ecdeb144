// .rtfilm files, as they come and with the checksum put right, which is what a malicious writer would do. A film that
// is taken goes the way that films go: added, hashed, encoded, and read back as the same.
#include "tests/fuzz/fuzz.h"

#include "render/image_file.h"
#include "support/hash.h"

#include <vector>

namespace {

void decode(const std::uint8_t* data, std::size_t size)
{
	rt::Result<rt::LoadedFilm> loaded = rt::decode_rtfilm(data, size, "fuzzed.rtfilm");
	if (!loaded)
		return;
	const rt::Film& film = loaded->film;
	FUZZ_CHECK(film.sums().size() == 3 * film.pixels() && film.samples().size() == film.pixels());
	const std::vector<std::uint8_t> again = rt::encode_rtfilm(film, loaded->provenance);
	FUZZ_CHECK(again == std::vector<std::uint8_t>(data, data + size));
	for (const rt::ImageFormat format : {rt::ImageFormat::Png, rt::ImageFormat::Exr, rt::ImageFormat::Pfm})
		(void)rt::encode_image(film, format, {}, loaded->provenance);
	rt::Film sum = film;
	const rt::Status added = sum.add(film);
	FUZZ_CHECK(added || sum.hash() == film.hash());
}

} // namespace

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size)
{
	decode(data, size);
	constexpr std::size_t checksum_bytes = 16;
	if (size < checksum_bytes)
		return 0;
	std::vector<std::uint8_t> mended(data, data + size);
	const rt::Hash128 sum = rt::hash_bytes(data, size - checksum_bytes);
	for (std::size_t k = 0; k < 8; ++k) {
		mended[size - 16 + k] = static_cast<std::uint8_t>(sum.high >> (56 - 8 * k));
		mended[size - 8 + k] = static_cast<std::uint8_t>(sum.low >> (56 - 8 * k));
	}
	decode(mended.data(), mended.size());
	return 0;
}
