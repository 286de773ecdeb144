// clock.h: how long something took.
#pragma once

#include <chrono>
#include <ctime>

namespace rt {

using Clock = std::chrono::steady_clock;

inline double seconds_since(Clock::time_point start)
{
	return std::chrono::duration<double>(Clock::now() - start).count();
}

// Seconds that cores have spent on this program, on all its threads together: others on the machine do not lengthen
// them as they do the wall clock's.
inline double cpu_seconds() { return static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

} // namespace rt
