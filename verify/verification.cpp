#include "verify/verification.h"

#include "render/peak.h"
#include "support/clock.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace rt {

namespace {

std::string one_line(const Error& error)
{
	return error.message + (error.where.empty() ? "" : " (" + error.where + ")");
}

// Where two films differ first, in words.
std::string difference_text(const Film& film, const Film& expected)
{
	const std::uint64_t different = differing_pixels(film, expected);
	std::size_t first = 0;
	if (different == 0 || film.sums().size() != expected.sums().size())
		return "the films differ in size, samples or scale";
	while (first < film.sums().size() && film.sums()[first] == expected.sums()[first])
		++first;
	const std::size_t pixel = first / 3, width = film.window().width;
	return fmt::format("{} of {} pixels differ; first ({}, {}) {}: sum {:#x}, the reference has {:#x}", different,
	                   film.pixels(), pixel % width, pixel / width, "RGB"[first % 3], film.sums()[first],
	                   expected.sums()[first]);
}

class Verifier {
public:
	Verifier(const Enumeration& found, const VerificationOptions& options) : found_(found), options_(options) {}

	Result<Verification> run(const std::vector<std::size_t>& indices)
	{
		const Clock::time_point start = Clock::now();
		if (!options_.probe_only)
			RT_TRY(prepare_scenes());
		for (std::size_t i = 0; i < indices.size(); ++i) {
			where_ = fmt::format("device {} ({} of {}): ", indices[i], i + 1, indices.size());
			result_.devices.push_back(verify_device(indices[i]));
		}
		where_.clear();
		if (options_.with_pictures)
			for (std::size_t scene = 0; scene < result_.scenes.size(); ++scene)
				(void)reference_film(scene);
		result_.seconds = seconds_since(start);
		return std::move(result_);
	}

private:
	Status prepare_scenes()
	{
		RT_TRY_ASSIGN(result_.scenes,
		              options_.depth == VerifyDepth::Full ? golden_and_shipped_scenes() : golden_scenes());
		result_.reference.resize(result_.scenes.size());
		for (const GoldenScene& scene : result_.scenes) {
			RT_TRY_ASSIGN(PackedScene packed, pack_golden_scene(scene));
			packed_.push_back(std::move(packed));
		}
		return success();
	}

	void tell(const std::string& what) const
	{
		if (options_.status)
			options_.status(where_ + what);
	}

	VerifiedDevice verify_device(std::size_t index)
	{
		const Clock::time_point start = Clock::now();
		VerifiedDevice verified;
		verified.index = index;
		verified.info = found_.devices[index];
		tell("opening " + verified.info.name);
		test(verified);
		verified.seconds = seconds_since(start);
		return verified;
	}

	void test(VerifiedDevice& verified)
	{
		const Result<DeviceHandle> device = open_device(verified.info);
		if (!device) {
			verified.error = device.error();
			return;
		}
		verified.info = (*device)->info();
		tell("arithmetic of " + verified.info.name);
		Result<SelfTestReport> probe = self_test(*device, false);
		if (!probe) {
			verified.error = probe.error();
			return;
		}
		verified.probe = std::move(*probe);
		if (options_.probe_only)
			return;
		check_films(*device, verified);
		measure_speed(*device, verified);
	}

	// ---- films ----

	std::vector<FilmVariant> variants_for(const VerifiedDevice& verified) const
	{
		std::vector<FilmVariant> variants = {FilmVariant::Generic};
		if (options_.depth != VerifyDepth::Quick)
			variants.push_back(FilmVariant::Specialised);
		// Where software roots are used anyway, both variants above had them.
		if (options_.depth == VerifyDepth::Full && !verified.probe.needs_software_roots)
			variants.push_back(FilmVariant::SoftwareRoots);
		if (options_.depth == VerifyDepth::Full)
			variants.push_back(FilmVariant::Tree);
		return variants;
	}

	static SessionOptions session_options(const GoldenScene& scene, FilmVariant variant, bool software_roots)
	{
		SessionOptions session;
		session.samples = scene.samples;
		session.specialise = variant == FilmVariant::Specialised;
		session.software_roots = software_roots || variant == FilmVariant::SoftwareRoots;
		session.bvh = variant == FilmVariant::Tree ? Acceleration::Always : Acceleration::Auto;
		return session;
	}

	void check_films(const DeviceHandle& device, VerifiedDevice& verified)
	{
		verified.kept.resize(result_.scenes.size());
		const std::vector<FilmVariant> variants = variants_for(verified);
		const std::size_t total = result_.scenes.size() * variants.size();
		for (std::size_t scene = 0; scene < result_.scenes.size(); ++scene)
			for (const FilmVariant variant : variants) {
				tell(fmt::format("film {} of {}: {}, {}", verified.films.size() + 1, total, result_.scenes[scene].name,
				                 variant_name(variant)));
				verified.films.push_back(check_film(device, verified, scene, variant));
				// A kernel that does not build, or a driver that fails: the other scenes would say the same again.
				if (verified.films.back().film.empty())
					return;
			}
	}

	FilmCheck check_film(const DeviceHandle& device, VerifiedDevice& verified, std::size_t index, FilmVariant variant)
	{
		const Clock::time_point start = Clock::now();
		FilmCheck check;
		check.scene = index;
		check.variant = variant;
		Result<SessionResult> rendered =
		    render_scene(packed_[index], {device},
		                 session_options(result_.scenes[index], variant, verified.probe.needs_software_roots));
		check.seconds = seconds_since(start);
		if (!rendered) {
			check.why = one_line(rendered.error());
			check.log = rendered.error().log;
			return check;
		}
		check.lanes = rendered->devices.front().lanes;
		Film& film = rendered->film;
		check.film = film.hash().hex();
		// A scene without a stored hash is held against the reference's film.
		if (result_.scenes[index].film.empty() && reference_film(index))
			result_.scenes[index].film = reference_film(index)->hash().hex();
		check.passed = check.film == result_.scenes[index].film;
		if (!check.passed) {
			const Film* reference = reference_film(index);
			if (reference && reference->hash().hex() != check.film)
				check.why = difference_text(film, *reference);
			else
				check.why = fmt::format("film {}, and it should be {}", check.film, result_.scenes[index].film);
		}
		std::optional<Film>& kept = verified.kept[index];
		if (!kept || (!check.passed && kept->hash().hex() == result_.scenes[index].film))
			kept = std::move(film);
		return check;
	}

	// The film of the reference backend, rendered when it is first asked for; null if that is not possible.
	const Film* reference_film(std::size_t index)
	{
		std::optional<Film>& film = result_.reference[index];
		if (film)
			return &*film;
		if (!reference_)
			for (const DeviceInfo& info : found_.devices)
				if (info.backend == "reference")
					if (Result<DeviceHandle> device = open_device(info))
						reference_ = *device;
		if (!reference_)
			return nullptr;
		Result<SessionResult> rendered = render_scene(
		    packed_[index], {reference_}, session_options(result_.scenes[index], FilmVariant::Generic, false));
		if (!rendered)
			return nullptr;
		film = std::move(rendered->film);
		return &*film;
	}

	// ---- speed ----

	double speed_budget() const { return options_.depth == VerifyDepth::Quick ? 0.3 : 1.0; }

	// Rays a second over about the budgeted time. An image that would take an interpreter hours is made smaller.
	void measure_speed(const DeviceHandle& device, VerifiedDevice& verified)
	{
		if (verified.films.empty() || verified.films.back().film.empty())
			return;
		const FilmCheck& known = verified.films.front();
		const GoldenScene& small = result_.scenes[known.scene];
		const double slowest = double(small.width) * small.height * small.samples / std::max(known.seconds, 1e-9);
		DeviceSpeed speed;
		speed.scene = small.name;
		GoldenScene scene = small;
		scene.width = 640;
		scene.height = 360;
		scene.samples = 1;
		while (double(scene.width) * scene.height > slowest * 4 * speed_budget() && scene.width > 40) {
			scene.width /= 2;
			scene.height /= 2;
		}
		tell(fmt::format("speed, {} {}x{}", scene.name, scene.width, scene.height));
		const Result<PackedScene> packed = pack_golden_scene(scene);
		if (!packed) {
			verified.speed_error = one_line(packed.error());
			return;
		}
		SessionOptions session = session_options(scene, FilmVariant::Specialised, verified.probe.needs_software_roots);
		// The first render may compile at its first launch, so it is never the one that counts.
		for (int round = 0; round < 8; ++round) {
			session.samples = scene.samples;
			const Result<SessionResult> rendered = render_scene(*packed, {device}, session);
			if (!rendered) {
				verified.speed_error = one_line(rendered.error());
				return;
			}
			const double seconds = std::max(rendered->render_seconds, 1e-9);
			if (round > 0 && (seconds > speed_budget() / 2 || scene.samples >= max_speed_samples)) {
				speed.width = scene.width;
				speed.height = scene.height;
				speed.samples = scene.samples;
				speed.seconds = seconds;
				speed.rays_per_second = double(rendered->film.segments) / seconds;
				speed.samples_per_second = double(rendered->film.pixels()) * scene.samples / seconds;
				// An interpreter would take minutes for the probe, and nobody asks how near it comes.
				if (!verified.info.only_if_named) {
					tell("peak of " + verified.info.name);
					const Result<DevicePeak> peak = measure_peak(*device);
					if (!peak)
						verified.speed_error = one_line(peak.error());
					else
						speed.share_of_peak =
						    peak_share(rendered->film.segments, packed->spheres.size(), rendered->devices.front().bvh,
						               rendered->devices.front().launch_seconds, *peak)
						        .share;
				}
				verified.speed = speed;
				return;
			}
			const double factor = std::clamp(speed_budget() / seconds, 1.0, round == 0 ? 4.0 : 32.0);
			scene.samples =
			    std::min(static_cast<std::uint32_t>(std::lround(scene.samples * factor)), max_speed_samples);
		}
	}

	static constexpr std::uint32_t max_speed_samples = 1u << 14;

	const Enumeration& found_;
	const VerificationOptions& options_;
	Verification result_;
	std::vector<PackedScene> packed_;
	DeviceHandle reference_;
	std::string where_;
};

} // namespace

const char* variant_name(FilmVariant variant)
{
	switch (variant) {
	case FilmVariant::Generic:
		return "generic";
	case FilmVariant::Specialised:
		return "specialised";
	case FilmVariant::SoftwareRoots:
		return "software roots";
	case FilmVariant::Tree:
		return "through a tree";
	}
	return "";
}

bool VerifiedDevice::passed() const { return !error && probe.passed && films_passed() == films.size(); }

std::size_t VerifiedDevice::films_passed() const
{
	return static_cast<std::size_t>(
	    std::count_if(films.begin(), films.end(), [](const FilmCheck& film) { return film.passed; }));
}

std::string VerifiedDevice::first_failure() const
{
	if (error)
		return error->message;
	if (!probe.passed)
		return probe.first_failure();
	for (const FilmCheck& film : films)
		if (!film.passed)
			return film.why;
	return {};
}

bool Verification::passed() const
{
	return std::all_of(devices.begin(), devices.end(), [](const VerifiedDevice& device) { return device.passed(); });
}

std::optional<std::uint64_t> Verification::differing_pixels(std::size_t a, std::size_t b) const
{
	std::optional<std::uint64_t> sum;
	for (std::size_t scene = 0; scene < scenes.size(); ++scene) {
		if (scene >= devices[a].kept.size() || scene >= devices[b].kept.size())
			break;
		const std::optional<Film>&film_a = devices[a].kept[scene], &film_b = devices[b].kept[scene];
		if (film_a && film_b)
			sum = sum.value_or(0) + rt::differing_pixels(*film_a, *film_b);
	}
	return sum;
}

std::uint64_t Verification::compared_pixels() const
{
	std::uint64_t sum = 0;
	for (const GoldenScene& scene : scenes)
		sum += std::uint64_t(scene.width) * scene.height;
	return sum;
}

std::uint64_t differing_pixels(const Film& a, const Film& b)
{
	if (a.sums().size() != b.sums().size())
		return std::max(a.pixels(), b.pixels());
	std::uint64_t count = 0;
	for (std::size_t i = 0; i < a.sums().size(); i += 3)
		count += std::equal(a.sums().begin() + static_cast<std::ptrdiff_t>(i),
		                    a.sums().begin() + static_cast<std::ptrdiff_t>(i + 3),
		                    b.sums().begin() + static_cast<std::ptrdiff_t>(i))
		             ? 0
		             : 1;
	return count;
}

Result<Verification> verify_devices(const Enumeration& found, const std::vector<std::size_t>& indices,
                                    const VerificationOptions& options)
{
	return Verifier(found, options).run(indices);
}

} // namespace rt
