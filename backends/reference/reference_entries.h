// reference_entries.h: an entry of a variant's table for each kernel that is compiled into it. To be included where
// rt_host_global_id and the kernels are defined.
#pragma once

#include "backends/reference/reference_kernels.h"

#include <tuple>
#include <type_traits>
#include <utility>

namespace rt {
namespace {

// A kernel's argument from its place in memory: a pointer is the place, a scalar or struct is read from it.
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

#define RT_QUOTE_(x) #x
#define RT_QUOTE(x) RT_QUOTE_(x)

} // namespace
} // namespace rt
