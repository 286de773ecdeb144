// thread_pool.h: a loop shared by all cores.
#pragma once

#include <cstdint>
#include <functional>

namespace rt {

// Calls body(begin, end) on pieces of [0, count), on as many threads as the process may use (its CPU affinity, or
// RT_THREADS), until all are done. Pieces have `grain` items at most and are handed out one by one, so uneven work
// balances. Every thread checks its floating-point environment first (contract rule 18): round to nearest, subnormals
// kept. What a body throws ends the loop and comes out here. Bodies may call parallel_for; so may several threads.
void parallel_for(std::uint64_t count, std::uint64_t grain,
                  const std::function<void(std::uint64_t, std::uint64_t)>& body);

// Threads that parallel_for uses.
unsigned thread_count();

} // namespace rt
