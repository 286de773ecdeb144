// Images that `rt compare` reads: PNG, EXR, PFM and films, recognised by their first bytes.
#include "tests/fuzz/fuzz.h"

#include "render/image_read.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size)
{
	const rt::Result<rt::LoadedImage> image = rt::decode_image(data, size, "fuzzed");
	if (!image)
		return 0;
	FUZZ_CHECK(image->values.size() == image->pixels() * image->channels);
	(void)image->pixel_hash();
	return 0;
}
