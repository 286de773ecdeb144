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

#include "backends/reference/reference_entries.h"

namespace rt {
namespace {

constexpr ReferenceKernel kernels[] = {
    entry<rt_clear>("rt_clear"),       entry<rt_merge>("rt_merge"),
    entry<rt_render>("rt_render"),     entry<rt_identify>("rt_identify"),
#if RT_PRECISION != RT_PRECISION_DOUBLE && !RT_TRACED
    entry<rt_probe>("rt_probe"),       entry<rt_probe_layout>("rt_probe_layout"),
    entry<rt_peak_fma>("rt_peak_fma"), entry<rt_peak_integer>("rt_peak_integer"),
#endif
};

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
