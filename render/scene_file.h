// scene_file.h: reading a scene's JSON file.
//
// Strict: unknown and duplicate keys, wrong types, NaN, infinities, values outside their range, missing
// materials or textures and unreadable files are InputOutput errors whose `where` is "file:line, $.json.path" and
// whose `cure` says what would be right. Nothing is half-read.
#pragma once

#include "render/scene.h"
#include "support/result.h"

#include <string>
#include <string_view>
#include <vector>

namespace rt {

// Reads a scene from a file.
Result<SceneFile> load_scene_file(const std::string& path);

// Reads a scene from text; `path` is used in messages and to resolve files beside it. (Fuzzing and tests.)
Result<SceneFile> parse_scene(std::string_view text, const std::string& path);

// What a user types for a scene: a path, the name of a shipped scene ("weekend"), or "cloud-N" (N may be written
// 1000000 or 1e6). Shipped scenes are looked for in $RT_SCENES, ../share/rt/scenes beside the executable, and the
// source tree the program was built from.
Result<SceneFile> open_scene(const std::string& name);

// Names of the shipped scenes found there ("weekend", "extremes/grazing"), sorted.
std::vector<std::string> shipped_scenes();

} // namespace rt
