// Sphere sets. The first byte says how many materials there are (low bits) and whether a file of indices follows the
// spheres (top bit): the last fifth of the bytes, which is its share if both files fit together.
#include "tests/fuzz/fuzz.h"

#include "render/sphere_set.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size)
{
	if (size == 0)
		return 0;
	const bool indexed = data[0] & 0x80u;
	rt::SphereSet set{"spheres", indexed ? "indices" : "", {}};
	for (std::uint32_t i = 0; i < (data[0] & 0x0fu) || (!indexed && i == 0); ++i)
		set.materials.push_back(i);
	const std::uint8_t* records_end = data + size - (indexed ? (size - 1) / 5 : 0);
	const std::vector<std::uint8_t> records(data + 1, records_end), indices(records_end, data + size);
	std::vector<rt::Sphere> spheres(1);
	const rt::Status status = rt::append_sphere_records(set, records, indices, spheres);
	FUZZ_CHECK(!status || spheres.size() == 1 + records.size() / 16);
	for (std::size_t i = 1; i < spheres.size(); ++i)
		FUZZ_CHECK(spheres[i].material < set.materials.size());
	return 0;
}
