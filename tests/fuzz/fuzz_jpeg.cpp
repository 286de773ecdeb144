// JPEG textures.
#include "tests/fuzz/fuzz.h"

#include "render/texture_decoders.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size)
{
	const rt::Result<rt::TextureImage> image = rt::decode_jpeg(data, size, "fuzzed.jpg");
	FUZZ_CHECK(!image || image->texels.size() == std::size_t(image->width) * image->height);
	return 0;
}
