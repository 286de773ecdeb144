#include "support/thread_pool.h"

#include "support/float_environment.h"

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <thread>
#include <vector>

#ifdef __linux__
#include <sched.h>
#endif

namespace rt {

unsigned thread_count()
{
	static const unsigned count = [] {
		if (const char* text = std::getenv("RT_THREADS")) {
			const long wanted = std::strtol(text, nullptr, 10);
			if (wanted >= 1 && wanted <= 4096)
				return static_cast<unsigned>(wanted);
		}
#ifdef __linux__
		cpu_set_t set;
		CPU_ZERO(&set);
		if (sched_getaffinity(0, sizeof set, &set) == 0)
			return static_cast<unsigned>(std::max(1, CPU_COUNT(&set)));
#endif
		return std::max(1u, std::thread::hardware_concurrency());
	}();
	return count;
}

void parallel_for(std::uint64_t count, std::uint64_t grain,
                  const std::function<void(std::uint64_t, std::uint64_t)>& body)
{
	grain = std::max<std::uint64_t>(grain, 1);
	std::atomic<std::uint64_t> next{0};
	const auto work = [&] {
		const ContractFloatEnvironment environment;
		for (;;) {
			const std::uint64_t begin = next.fetch_add(grain);
			if (begin >= count)
				return;
			body(begin, std::min(count, begin + grain));
		}
	};
	const std::uint64_t pieces = (count + grain - 1) / grain;
	const unsigned helpers =
	    static_cast<unsigned>(std::min<std::uint64_t>(thread_count(), pieces)) - (pieces ? 1u : 0u);
	std::vector<std::thread> threads;
	threads.reserve(helpers);
	for (unsigned i = 0; i < helpers; ++i)
		threads.emplace_back(work);
	work();
	for (std::thread& thread : threads)
		thread.join();
}

} // namespace rt
