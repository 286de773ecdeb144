// Scene files: any text is a scene or one error; a scene can be packed, or its frame refused, at any frame.
#include "tests/fuzz/fuzz.h"

#include "render/pack.h"
#include "render/scene_file.h"

#include <string_view>

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size)
{
	const std::string_view text(reinterpret_cast<const char*>(data), size);
	// No such folder: the files that a scene may name are the other targets' affair.
	const rt::Result<rt::SceneFile> file = rt::parse_scene(text, "/no such folder/scene.json");
	if (!file) {
		FUZZ_CHECK(!file.error().message.empty() && !file.error().where.empty());
		return 0;
	}
	for (const double frame : {0.0, 0.5, 7.0, 1e9}) {
		const rt::Result<rt::Scene> scene = file->at_frame(frame);
		if (!scene)
			continue;
		const rt::Window window{0, 0, scene->render.width, scene->render.height};
		const rt::Result<rt::PackedScene> packed = rt::pack_scene(*scene, scene->render, window);
		FUZZ_CHECK(!packed || packed->spheres.size() == scene->spheres.size());
	}
	return 0;
}
