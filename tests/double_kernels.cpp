#define RT_PRECISION 2
#include "tests/double_kernels.h"

namespace {
[[maybe_unused]] thread_local unsigned rt_host_global_id = 0;
} // namespace

#include "kernels/film.h"

namespace rt {

DoubleSincos double_sincos_turns(double u)
{
	DoubleSincos result{};
	rt_sincos_turns(u, &result.sine, &result.cosine);
	return result;
}

double double_atan2_turns(double y, double x) { return rt_atan2_turns(y, x); }

double double_sqrt(double x) { return rt_sqrt(x); }

double double_rcp(double x) { return rt_rcp(x); }

std::int64_t double_film_integer(double v)
{
	const rt_channel_sum sum = rt_channel_sample(v, 0x1p40f, 0x1p20f);
	return rt_channel_total(sum.high, sum.low, 1);
}

} // namespace rt
