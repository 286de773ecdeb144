// zeroed.h: an array of integers that begin as zeros, without anyone writing them.
//
// The system hands out pages of zeros when they are first touched, so an array costs nothing until it is used, and then
// its pages are cleared by whichever threads use it: std::vector has them all cleared by the one that makes it. Large
// arrays ask for large pages, of which there are 512 times fewer to be touched. Its size stays as it was made.
#pragma once

#include "support/pages.h"

#include <algorithm>
#include <cstddef>
#include <cstdlib>
#include <initializer_list>
#include <limits>
#include <memory>
#include <new>
#include <type_traits>

namespace rt {

template <class T>
class Zeroed {
	static_assert(std::is_integral_v<T>, "bytes of zero must be a T of 0");

public:
	Zeroed() = default;
	// Throws std::bad_alloc as a vector does.
	explicit Zeroed(std::size_t size) : data_(allocate(size)), size_(size) {}
	Zeroed(std::initializer_list<T> values) : Zeroed(values.size())
	{
		std::copy(values.begin(), values.end(), begin());
	}
	Zeroed(const Zeroed& other) : Zeroed(other.size_) { std::copy(other.begin(), other.end(), begin()); }
	Zeroed(Zeroed&& other) noexcept { swap(other); }
	Zeroed& operator=(Zeroed other) noexcept
	{
		swap(other);
		return *this;
	}
	~Zeroed() = default;

	std::size_t size() const { return size_; }
	bool empty() const { return size_ == 0; }
	T* data() { return data_.get(); }
	const T* data() const { return data_.get(); }
	void populate() { populate_pages(data_.get(), size_ * sizeof(T)); }
	T* begin() { return data_.get(); }
	T* end() { return data_.get() + size_; }
	const T* begin() const { return data_.get(); }
	const T* end() const { return data_.get() + size_; }
	T& operator[](std::size_t i) { return data_[i]; }
	const T& operator[](std::size_t i) const { return data_[i]; }

	friend bool operator==(const Zeroed& a, const Zeroed& b)
	{
		return std::equal(a.begin(), a.end(), b.begin(), b.end());
	}
	friend bool operator!=(const Zeroed& a, const Zeroed& b) { return !(a == b); }

private:
	struct Free {
		void operator()(T* memory) const { std::free(memory); }
	};

	static T* allocate(std::size_t size)
	{
		if (size == 0)
			return nullptr;
		void* const memory =
		    size > std::numeric_limits<std::size_t>::max() / sizeof(T) ? nullptr : std::calloc(size, sizeof(T));
		if (!memory)
			throw std::bad_alloc();
		prefer_large_pages(memory, size * sizeof(T));
		return static_cast<T*>(memory);
	}

	void swap(Zeroed& other) noexcept
	{
		std::swap(data_, other.data_);
		std::swap(size_, other.size_);
	}

	std::unique_ptr<T[], Free> data_;
	std::size_t size_ = 0;
};

} // namespace rt
