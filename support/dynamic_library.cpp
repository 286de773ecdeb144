#include "support/dynamic_library.h"

#include <dlfcn.h>

namespace rt {

Result<std::shared_ptr<DynamicLibrary>> DynamicLibrary::open(const std::vector<std::string>& names)
{
	Error error{ErrorKind::NoDevice, "no shared library of this name could be loaded", {}, {}, {}};
	for (const std::string& name : names) {
		if (void* handle = dlopen(name.c_str(), RTLD_NOW | RTLD_LOCAL)) {
			std::string path = name;
			return std::shared_ptr<DynamicLibrary>(new DynamicLibrary(handle, std::move(path)));
		}
		const char* reason = dlerror();
		error.where += (error.where.empty() ? "" : ", ") + name;
		error.log += std::string(reason ? reason : "unknown reason") + "\n";
	}
	return error;
}

DynamicLibrary::~DynamicLibrary() { dlclose(handle_); }

void* DynamicLibrary::symbol(const char* name) const { return dlsym(handle_, name); }

} // namespace rt
