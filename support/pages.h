// pages.h: how the system gives memory.
//
// It makes and clears a page when it is first touched. A list of some millions of elements spends as long on that, page
// by page in the thread that fills it, as on all that is then done with it.
#pragma once

#include <cstddef>
#include <vector>

namespace rt {

// Has large pages put where a whole one fits, if the system knows any; nothing but speed depends on it.
void prefer_large_pages(void* memory, std::size_t bytes);

// Has the system make the pages now, by several threads, if it can: what they hold stays as it is. For a time at which
// the processor has nothing else to do.
void populate_pages(void* memory, std::size_t bytes);

// Room for so many elements, its pages made by several threads.
template <class T>
void reserve_pages(std::vector<T>& list, std::size_t size)
{
	list.reserve(size);
	populate_pages(list.data(), size * sizeof(T));
}

} // namespace rt
