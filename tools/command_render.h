// command_render.h: `rt render`, from a scene's name to an image file and the film's hash.
#pragma once

#include "render/film.h"
#include "render/provenance.h"
#include "support/result.h"
#include "tools/options.h"

namespace rt {

// Renders every frame asked for. An Interrupted error says what was written before the stop.
Status run_render(const RenderOptions& options);

// The same for one frame, which is handed back instead of written; prints progress and warnings only. A stop is an
// Interrupted error.
struct RenderedFilm {
	Film film;
	Provenance provenance;
};
Result<RenderedFilm> render_film(const RenderOptions& options);

} // namespace rt
