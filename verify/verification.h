// verification.h: the acceptance test of devices: arithmetic by operation, golden films by hash, devices against each
// other, speed.
//
// A device is judged by what it computes, never by what it says. Whatever goes wrong with one device (it cannot be
// opened, a kernel does not build, a film is another one) is part of the result; only what concerns rt itself, as a
// missing table of golden films, is an Error.
#pragma once

#include "backends/registry.h"
#include "backends/self_test.h"
#include "render/golden_scenes.h"
#include "render/session.h"
#include "support/result.h"

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

namespace rt {

enum class VerifyDepth {
	Quick,    // golden scenes with the generic program
	Standard, // and with programs specialised to them
	Full,     // all shipped scenes; software roots and trees too
};

struct VerificationOptions {
	VerifyDepth depth = VerifyDepth::Standard;
	bool probe_only = false;    // the self-test alone: the driver, not the renderer
	bool with_pictures = false; // render the reference's films even where no device differs from them
	std::function<void(const std::string&)> status;
};

// How a scene's program was made.
enum class FilmVariant { Generic, Specialised, SoftwareRoots, Tree };
const char* variant_name(FilmVariant variant);

struct FilmCheck {
	std::size_t scene = 0; // into Verification::scenes
	FilmVariant variant = FilmVariant::Generic;
	bool passed = false;
	std::string film; // its hash; empty if it could not be rendered
	std::string why;  // it did not pass
	std::string log;  // a compiler's own words
	std::uint32_t lanes = 1;
	double seconds = 0; // build included
};

struct DeviceSpeed {
	std::string scene;
	std::uint32_t width = 0, height = 0, samples = 0;
	double seconds = 0;
	double rays_per_second = 0, samples_per_second = 0; // a ray is a segment of a path
	std::optional<double> share_of_peak;                // of the device's measured float peak (render/peak.h)
};

struct VerifiedDevice {
	std::size_t index = 0; // as `rt devices` numbers it
	DeviceInfo info;
	std::optional<Error> error; // it could not be opened or tested, and no more was asked of it
	SelfTestReport probe;
	std::vector<FilmCheck> films;
	std::vector<std::optional<Film>> kept; // a film of each scene: the first that is wrong, else a right one
	std::optional<DeviceSpeed> speed;
	std::string speed_error;
	double seconds = 0;

	bool passed() const;
	std::size_t films_passed() const;
	std::string first_failure() const; // empty if it passed
};

struct Verification {
	std::vector<GoldenScene>
	    scenes; // those that were rendered; films filled in by the reference where the table has none
	std::vector<std::optional<Film>> reference; // the reference backend's films, as far as something needed them
	std::vector<VerifiedDevice> devices;
	double seconds = 0;

	bool passed() const;
	// Pixels that differ between the kept films of two devices, all scenes together; nothing where no scene was
	// rendered by both.
	std::optional<std::uint64_t> differing_pixels(std::size_t a, std::size_t b) const;
	std::uint64_t compared_pixels() const; // of all scenes
};

// Tests the devices of `found` with these indices, one after the other.
Result<Verification> verify_devices(const Enumeration& found, const std::vector<std::size_t>& indices,
                                    const VerificationOptions& options);

// Pixels in which two films of one size differ by any bit.
std::uint64_t differing_pixels(const Film& a, const Film& b);

} // namespace rt
