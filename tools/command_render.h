// command_render.h: `rt render`, from a scene's name to an image file and the film's hash.
#pragma once

#include "support/result.h"
#include "tools/options.h"

namespace rt {

// Renders every frame asked for. An Interrupted error says what was written before the stop.
Status run_render(const RenderOptions& options);

} // namespace rt
