// bench_threads.h: a benchmark on fewer processors than there are.
//
// Drivers decide at their start how many threads they take, so each count is a process of its own, bound to as many
// processors, with RT_THREADS and PoCL's variables set.
#pragma once

#include "support/result.h"
#include "tools/bench_run.h"

#include <functional>
#include <string>

namespace rt {

// Processors that this process may use.
unsigned processors_allowed();

// Runs this program again as `rt bench`; the result holds times, counts and the film's hash.
Result<BenchRun> bench_with_threads(const std::string& scene, const RenderOptions& options, std::uint32_t repeats,
                                    unsigned threads, const std::function<void(const std::string&)>& status);

} // namespace rt
