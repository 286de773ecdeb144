// Compiled once for each variant, with RT_LANES, RT_FEATURES, RT_DEF_NATIVE_ROOTS, RT_DEF_CONTRACT, RT_PRECISION,
// RT_VARIANT (an identifier) and RT_VARIANT_SET (its instruction set); once more with RT_TRACED, whose kernels are a
// text that tools/make_traced.cpp wrote.
#include "backends/reference/reference_kernels.h"

namespace {
// The index of the work-item that this thread runs; what RT_GLOBAL_ID means on the host.
thread_local unsigned rt_host_global_id = 0;
} // namespace

#if RT_TRACED
#include "traced_kernels.inc"
#elif RT_PRECISION == 2 /* the probe asks about float32 */
#include "kernels/render.cl"
#else
#include "kernels/peak.cl"
#include "kernels/probe.cl" // includes kernels/render.cl
#endif

#include <tuple>
#include <utility>

namespace rt {
namespace {

// A kernel's argument from its place in memory: a pointer is the place, a scalar is read from it.
template <class T>
T argument_at(void* place)
{
	if constexpr (std::is_pointer_v<T>)
		return static_cast<T>(place);
	else
		return *static_cast<T*>(place);
}

template <auto kernel>
struct Adapter;

template <class... Arguments, void (*kernel)(Arguments...)>
struct Adapter<kernel> {
	static constexpr unsigned argument_count = sizeof...(Arguments);

	template <std::size_t... i>
	static void run_all(void* const* arguments, std::uint32_t begin, std::uint32_t end, std::index_sequence<i...>)
	{
		const std::tuple<Arguments...> values(argument_at<Arguments>(arguments[i])...);
		for (std::uint32_t item = begin; item < end; ++item) {
			rt_host_global_id = item;
			kernel(std::get<i>(values)...);
		}
	}
	static void run(void* const* arguments, std::uint32_t begin, std::uint32_t end)
	{
		run_all(arguments, begin, end, std::index_sequence_for<Arguments...>{});
	}
};

template <auto kernel>
constexpr ReferenceKernel entry(const char* name)
{
	return {name, Adapter<kernel>::argument_count, Adapter<kernel>::run};
}

constexpr ReferenceKernel kernels[] = {
    entry<rt_clear>("rt_clear"),       entry<rt_merge>("rt_merge"),
    entry<rt_render>("rt_render"),     entry<rt_identify>("rt_identify"),
#if RT_PRECISION != RT_PRECISION_DOUBLE && !RT_TRACED
    entry<rt_probe>("rt_probe"),       entry<rt_probe_layout>("rt_probe_layout"),
    entry<rt_peak_fma>("rt_peak_fma"), entry<rt_peak_integer>("rt_peak_integer"),
#endif
};

#define RT_QUOTE_(x) #x
#define RT_QUOTE(x) RT_QUOTE_(x)

} // namespace

extern const ReferenceVariant RT_VARIANT;
const ReferenceVariant RT_VARIANT = {RT_QUOTE(RT_VARIANT),
                                     RT_LANES,
                                     RT_FEATURES,
                                     RT_DEF_NATIVE_ROOTS != 0,
                                     RT_DEF_CONTRACT != 0,
                                     RT_TRACED != 0,
                                     RT_VARIANT_SET,
                                     RT_PRECISION,
                                     kernels,
                                     sizeof kernels / sizeof kernels[0]};

} // namespace rt
