// dynamic_library.h: shared libraries loaded at run time, so that one binary starts where a driver is absent.
#pragma once

#include "support/result.h"

#include <memory>
#include <string>
#include <vector>

namespace rt {

class DynamicLibrary {
public:
	// Opens the first of `names` that loads. Error kind NoDevice; its log holds the loader's reason for each name.
	static Result<std::shared_ptr<DynamicLibrary>> open(const std::vector<std::string>& names);
	~DynamicLibrary();
	DynamicLibrary(const DynamicLibrary&) = delete;
	DynamicLibrary& operator=(const DynamicLibrary&) = delete;

	// nullptr if the symbol is absent.
	void* symbol(const char* name) const;
	template <class Function>
	bool load(Function*& function, const char* name) const
	{
		function = reinterpret_cast<Function*>(symbol(name));
		return function != nullptr;
	}
	const std::string& path() const { return path_; } // the file that was loaded, or the name it was found by

private:
	DynamicLibrary(void* handle, std::string path) : handle_(handle), path_(std::move(path)) {}
	void* handle_;
	std::string path_;
};

} // namespace rt
