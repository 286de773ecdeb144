// exhaustive_host.h: functions that are tried on the host alone, by all its threads.
#pragma once

#include "support/thread_pool.h"
#include "verify/exhaustive.h"

#include <algorithm>
#include <cstdint>
#include <mutex>
#include <string>

namespace rt {

// What a piece of the inputs came to.
struct HostFindings {
	std::uint64_t wrong = 0;
	std::string first_failure; // of the piece; empty if there is none
};

// Tries the next 2^22 inputs at most, in pieces of so many. findings_of(begin, end) tries the inputs
// result.done + [begin, end), counted without the stride.
template <class FindingsOf>
void advance_on_host(ExhaustiveResult& result, std::uint64_t piece, const FindingsOf& findings_of)
{
	const std::uint64_t count = std::min<std::uint64_t>(1u << 22, result.total - result.done);
	std::mutex mutex;
	parallel_for(count, piece, [&](std::uint64_t begin, std::uint64_t end) {
		const HostFindings found = findings_of(begin, end);
		const std::lock_guard lock(mutex);
		result.failures += found.wrong;
		if (result.first_failure.empty())
			result.first_failure = found.first_failure;
	});
	result.done += count;
	result.tried += count;
}

} // namespace rt
