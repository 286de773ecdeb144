// provenance.h: how an image was made, as key and value, in the order in which it is written.
//
// The keys are the same in PNG text chunks (prefixed "rt:"), EXR attributes ("rt:") and .rtfilm headers:
// Software, Contract, Scene, SceneHash, Frame, Width, Height, Window, Samples, Seed, MaxDepth, Precision,
// KernelHash, Backend, Device, Driver, Compiler, BuildOptions, SelfTest, Rejected, FilmHash, Transfer, Exposure.
#pragma once

#include <string>
#include <utility>
#include <vector>

namespace rt {

using Provenance = std::vector<std::pair<std::string, std::string>>;

// The value of a key; empty if absent.
inline std::string provenance_value(const Provenance& provenance, const std::string& key)
{
	for (const auto& [name, value] : provenance)
		if (name == key)
			return value;
	return {};
}

} // namespace rt
