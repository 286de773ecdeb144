// Rule 2's exception: the seed of our own root and reciprocal cannot reach the result. All mantissas, from the true
// value's float and from every float within four of it. Other exponents are these times powers of two: no step leaves
// the normal numbers (kernels/math.h).
#define RT_DEF_NATIVE_ROOTS 0
#include "common/rt_compat.h"
#undef RT_HARDWARE_SEEDS
#define RT_HARDWARE_SEEDS 1

namespace {

thread_local int seed_offset = 0; // floats

float rt_seed_rsqrt(float x)
{
	return rt_from_bits(rt_bits(static_cast<float>(1 / std::sqrt(static_cast<double>(x)))) +
	                    static_cast<rt_u32>(seed_offset));
}

float rt_seed_rcp(float x)
{
	return rt_from_bits(rt_bits(static_cast<float>(1 / static_cast<double>(x))) + static_cast<rt_u32>(seed_offset));
}

} // namespace

#include "kernels/math.h"

#include "verify/exhaustive_host.h"

#include <fmt/format.h>

namespace rt {

void advance_seeds(ExhaustiveResult& result)
{
	constexpr std::uint32_t mantissas = 3u << 23; // roots of [1, 4), reciprocals of [1, 2)
	advance_on_host(result, 1u << 14, [&result](std::uint64_t begin, std::uint64_t end) {
		HostFindings found;
		for (std::uint64_t i = begin; i < end; ++i) {
			const std::uint64_t input = (result.done + i) * result.stride;
			const auto mantissa = static_cast<std::uint32_t>(input % mantissas);
			seed_offset = static_cast<int>(input / mantissas) - 4;
			const bool is_root = mantissa < (2u << 23);
			const float x = rt_from_bits(0x3f800000u + (is_root ? mantissa : mantissa - (2u << 23)));
			const double exact = static_cast<double>(x);
			const float ours = is_root ? rt_root(x) : rt_rcp(x);
			const auto want = static_cast<float>(is_root ? std::sqrt(exact) : 1 / exact);
			if (rt_bits(ours) != rt_bits(want) && found.wrong++ == 0)
				found.first_failure =
				    fmt::format("the {} of {:08x} from a seed {} floats off gave {:08x}, the contract says {:08x}",
				                is_root ? "root" : "reciprocal", rt_bits(x), seed_offset, rt_bits(ours), rt_bits(want));
		}
		return found;
	});
}

} // namespace rt
