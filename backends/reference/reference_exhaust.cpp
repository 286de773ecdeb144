// kernels/exhaust.cl compiled as C++, apart from the others, which every variant of a render would carry along.
// Compiled once for each variant, as reference_kernels.cpp is.
#include "backends/reference/reference_kernels.h"

namespace {
thread_local unsigned rt_host_global_id = 0; // what RT_GLOBAL_ID means on the host
} // namespace

#include "kernels/exhaust.cl"

namespace rt {
namespace {

std::uint32_t scalar(void* place) { return *static_cast<std::uint32_t*>(place); }

void run_exhaust(void* const* a, std::uint32_t begin, std::uint32_t end)
{
	for (rt_host_global_id = begin; rt_host_global_id < end; ++rt_host_global_id)
		rt_exhaust(static_cast<rt_u32*>(a[0]), scalar(a[1]), scalar(a[2]), scalar(a[3]), scalar(a[4]), scalar(a[5]));
}

void run_rays(void* const* a, std::uint32_t begin, std::uint32_t end)
{
	for (rt_host_global_id = begin; rt_host_global_id < end; ++rt_host_global_id)
		rt_exhaust_rays(static_cast<const rt_sphere*>(a[0]), static_cast<const rt_u32*>(a[1]),
		                static_cast<rt_u32*>(a[2]), scalar(a[3]), scalar(a[4]), scalar(a[5]), scalar(a[6]));
}

constexpr ReferenceKernel kernels[] = {{"rt_exhaust", 6, run_exhaust}, {"rt_exhaust_rays", 7, run_rays}};

#define RT_QUOTE_(x) #x
#define RT_QUOTE(x) RT_QUOTE_(x)

} // namespace

extern const ReferenceVariant RT_VARIANT;
const ReferenceVariant RT_VARIANT = {
    RT_QUOTE(RT_VARIANT), RT_LANES,     RT_FEATURES, RT_DEF_NATIVE_ROOTS != 0,          RT_DEF_CONTRACT != 0, false,
    RT_VARIANT_SET,       RT_PRECISION, kernels,     sizeof kernels / sizeof kernels[0]};

} // namespace rt
