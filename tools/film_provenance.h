// film_provenance.h: what rt writes into a file about how its film was made, and whether a film may be gone on from.
#pragma once

#include "backends/backend.h"
#include "backends/precision.h"
#include "render/display.h"
#include "render/film.h"
#include "render/image_file.h"
#include "render/provenance.h"
#include "render/scene.h"
#include "render/session.h"
#include "support/result.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace rt {

// Everything about a film that is not in it.
struct FilmOrigin {
	std::string scene; // as the user named it
	Hash128 scene_hash;
	std::uint32_t frame = 0;
	RenderSettings settings;
	Window window;
	DisplaySettings display;
	Precision precision = Precision::Exact;
	std::vector<DeviceHandle> devices;
	std::string self_test; // "passed" or "failed: ..."
	// Of a render that came to its own end: where it was to stop, and the samples a pixel that it was held to.
	std::optional<double> error, time_limit;
	std::uint32_t sample_limit = 0;
	Provenance resumed; // of the film that was gone on from; empty if there was none
};

// The value of the key Contract: the contract by which a rung's bits are one on all devices, or why there is none.
std::string contract_text(Precision precision);

// In the order and with the keys of provenance.h. `stats` may be empty while a render is under way.
Provenance provenance_of(const FilmOrigin& origin, const Film& film, const std::vector<DeviceStats>& stats);

// "rt 0.1.0 (1234abc)"
std::string software_text();
// "0,640,0,480": a window as --crop takes it.
std::string window_text(const Window& window);
// "128", or "12 to 14" of an uneven film.
std::string samples_text(const Film& film);

// Reads the film to go on from. Usage error that names every difference if it is not a film of the same image, made by
// the same kernels, or if it is uneven or has more than the samples wanted.
Result<LoadedFilm> load_film_to_resume(const std::string& path, const FilmOrigin& origin, std::int32_t exponent);

} // namespace rt
