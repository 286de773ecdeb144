// kernels/exhaust.cl and kernels/probe_paths.cl compiled as C++, apart from the others, which every variant of a render
// would carry along.
// Compiled once for each variant, as reference_kernels.cpp is.
#include "backends/reference/reference_kernels.h"

namespace {
thread_local unsigned rt_host_global_id = 0; // what RT_GLOBAL_ID means on the host
} // namespace

#include "kernels/exhaust.cl"
#include "kernels/probe_paths.cl"

#include "backends/reference/reference_entries.h"

namespace rt {
namespace {

constexpr ReferenceKernel kernels[] = {entry<rt_exhaust>("rt_exhaust"), entry<rt_exhaust_rays>("rt_exhaust_rays"),
                                       entry<rt_probe_paths>("rt_probe_paths")};

} // namespace

extern const ReferenceVariant RT_VARIANT;
const ReferenceVariant RT_VARIANT = {
    RT_QUOTE(RT_VARIANT), RT_LANES,     RT_FEATURES, RT_DEF_NATIVE_ROOTS != 0,          RT_DEF_CONTRACT != 0, false,
    RT_VARIANT_SET,       RT_PRECISION, kernels,     sizeof kernels / sizeof kernels[0]};

} // namespace rt
