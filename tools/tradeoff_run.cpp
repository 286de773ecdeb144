#include "tools/tradeoff_run.h"

#include "backends/kernel_text.h"
#include "backends/program_cache.h"
#include "backends/self_test.h"
#include "common/rt_contract.h"
#include "render/image_file.h"
#include "render/pack.h"
#include "render/scene_file.h"
#include "support/clock.h"
#include "tools/tradeoff_json.h"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <cmath>
#include <ctime>
#include <utility>

namespace rt {

namespace {

// Wide enough to show the noise of every part of a scene, small enough for a processor.
constexpr std::uint32_t measured_width = 320;

// Seeds of the reference's halves; a user's own are small numbers.
constexpr std::uint32_t reference_seeds[] = {0xa511e9b3u, 0x63d83595u};
constexpr std::uint32_t first_reference_samples = 32; // of a half

// The grid's numbers of samples: 1, 4, 16, ... Beyond a fourth of the reference's there is little to tell.
constexpr std::uint32_t grid_factor = 4;
constexpr std::uint32_t reference_factor = 4;

// A render is repeated until it was timed for so long or so often.
constexpr double timed_seconds = 0.5;
constexpr std::uint32_t most_repeats = 5;

struct OpenDevice {
	DeviceHandle handle;
	bool software_roots = false;
};

// One cell of the grid while it is being measured.
struct Cell {
	std::size_t device = 0;
	Configuration configuration;
	std::vector<double> seconds, cores; // of the clock, and of all cores together
	double wall = 0;                    // seconds that one render of the last number of samples took, all in all
	double comparing = 0;               // seconds beside
	std::string film_hash;
	Film film;
	bool out = false; // its next number of samples takes too long

	// Seconds that so many times the last number of samples will take.
	double expected(double times) const
	{
		const double one = wall * times;
		return one * std::clamp(std::ceil(timed_seconds / std::max(one, 1e-6)), 1.0, double(most_repeats)) + comparing;
	}

	bool is_timed() const
	{
		double sum = 0;
		for (const double time : seconds)
			sum += time;
		return !seconds.empty() && (sum >= timed_seconds || seconds.size() >= most_repeats);
	}
};

CacheKey memory_key(const char* what, const DeviceInfo& device, std::string text)
{
	return {std::string("tradeoff ") + what,
	        device.platform,
	        device.name,
	        device.driver,
	        device.compiler,
	        fmt::format("{} {}", RT_CONTRACT_VERSION, kernel_hash()),
	        std::move(text)};
}

std::string settings_text(const Hash128& scene_hash, const RenderSettings& settings)
{
	return fmt::format("{} {}x{} depth {}", scene_hash.hex(), settings.width, settings.height, settings.max_depth);
}

CacheKey measurement_key(const Tradeoff& measured, const DeviceInfo& device, const RenderOptions& render)
{
	return memory_key("measurement", device,
	                  fmt::format("{} generic {} bvh {} lanes {} {}",
	                              settings_text(measured.scene_hash, measured.settings), !render.specialise,
	                              static_cast<int>(render.bvh), render.lanes, cache_environment()));
}

std::optional<Tradeoff> load_measurement(const CacheKey& key)
{
	const auto payload = cache_load(key);
	if (!payload)
		return std::nullopt;
	Result<Tradeoff> measured = tradeoff_of_json(std::string(payload->begin(), payload->end()));
	if (!measured)
		return std::nullopt;
	return std::move(*measured);
}

// Points that tell an error and not only a bound of it.
std::ptrdiff_t fullness(const Tradeoff& measured)
{
	return std::count_if(measured.points.begin(), measured.points.end(),
	                     [](const TradePoint& point) { return !point.error.is_bound; });
}

class TradeoffRun {
public:
	TradeoffRun(const TradeoffOptions& options, const TradeoffHooks& hooks) : options_(options), hooks_(hooks) {}

	Result<Tradeoff> run()
	{
		RT_TRY(read_scene());
		RT_TRY(open_devices());
		start_ = Clock::now();
		RT_TRY(make_reference());
		if (!stopped())
			RT_TRY(measure_grid());
		measured_.interrupted = stopped();
		measured_.seconds = seconds_since(start_);
		measured_.date = fmt::format("{:%Y-%m-%dT%H:%M:%SZ}", fmt::gmtime(std::time(nullptr)));
		mark_front(measured_.points);
		if (!measured_.interrupted)
			remember();
		return std::move(measured_);
	}

	// As far as it is known without opening a device.
	Result<Tradeoff> plan()
	{
		RT_TRY(read_scene());
		RT_TRY_ASSIGN(measured_.devices, find_devices(options_.render.device));
		return std::move(measured_);
	}

private:
	bool stopped() const { return hooks_.stop && hooks_.stop->load(); }

	// ---- what is measured -------------------------------------------------------------------------------------------

	Status read_scene()
	{
		RT_TRY_ASSIGN(const SceneFile file, open_scene(options_.render.scene));
		RT_TRY_ASSIGN(scene_, file.at_frame(options_.render.first_frame));
		measured_.scene = options_.render.scene;
		measured_.scene_hash = scene_.hash;
		const RenderSettings image = options_.render.settings_over(scene_.render);
		measured_.image_width = image.width;
		measured_.image_height = image.height;
		measured_.image_samples = image.samples;
		measured_.settings = image;
		measured_.settings.sampler = RenderSettings().sampler;
		measured_.settings.estimator = RenderSettings().estimator;
		measured_.settings.roulette = RenderSettings().roulette;
		measured_.settings.width = options_.width.value_or(std::min(measured_width, image.width));
		measured_.settings.height = options_.height.value_or(std::max(
		    1u,
		    static_cast<std::uint32_t>(std::lround(double(measured_.settings.width) * image.height / image.width))));
		return success();
	}

	Status open_devices()
	{
		const Enumeration found = enumerate_all();
		RT_TRY_ASSIGN(measured_.devices, select_devices(options_.render.device, found));
		for (const DeviceInfo& info : measured_.devices) {
			RT_TRY_ASSIGN(OpenDevice device, open_tested(info));
			devices_.push_back(std::move(device));
			measured_.device_arguments.push_back(arguments_for(info, found));
		}
		// The reference's: one of them if it has 64-bit numbers, else the host itself.
		for (const OpenDevice& device : devices_)
			if (!reference_device_.handle && serves_double(device.handle))
				reference_device_ = device;
		for (const DeviceInfo& info : found.devices)
			if (!reference_device_.handle && info.usable && info.kind == DeviceKind::Host) {
				RT_TRY_ASSIGN(reference_device_, open_tested(info));
			}
		if (!reference_device_.handle)
			return Error{ErrorKind::NoDevice, "no device here can render the reference, which is in double",
			             "rt tradeoff", "`rt devices -v` tells which have fp64", ""};
		return success();
	}

	Result<OpenDevice> open_tested(const DeviceInfo& info)
	{
		OpenDevice device;
		tell("testing " + describe(info));
		RT_TRY_ASSIGN(device.handle, open_device(info));
		RT_TRY_ASSIGN(const SelfTestReport report, self_test(device.handle, !options_.render.self_test_afresh));
		device.software_roots = report.needs_software_roots;
		if (!report.passed && !options_.render.force_unverified)
			return failed_self_test(info, report, "measures it all the same");
		return device;
	}

	static bool serves_double(const DeviceHandle& device)
	{
		if (!check_precision(device->info(), Precision::Double))
			return false;
		const Result<SelfTestReport> report = self_test(device, true, Precision::Double);
		return report && report->passed;
	}

	// The shortest that means this device alone.
	static std::string arguments_for(const DeviceInfo& info, const Enumeration& found)
	{
		const auto means_it = [&](const DeviceRequest& request) {
			const Result<std::vector<DeviceInfo>> chosen = select_devices(request, found);
			return chosen && chosen->size() == 1 && chosen->front().backend == info.backend &&
			       chosen->front().index_in_backend == info.index_in_backend;
		};
		DeviceRequest request;
		if (means_it(request))
			return {};
		request.backend = info.backend;
		if (means_it(request))
			return "--backend " + info.backend;
		for (std::size_t i = 0; i < found.devices.size(); ++i) {
			DeviceRequest by_index;
			by_index.device = std::to_string(i);
			if (means_it(by_index))
				return "--device " + by_index.device;
		}
		return {};
	}

	void tell(const std::string& text) const
	{
		if (hooks_.status)
			hooks_.status(text);
	}

	void show(const std::string& what, double all) const
	{
		if (hooks_.progress)
			hooks_.progress(what, seconds_since(start_), all);
	}

	Result<SessionResult> render(const OpenDevice& device, const Configuration& configuration, std::uint32_t seed,
	                             std::uint32_t first, std::uint32_t samples, const std::string& what, double all)
	{
		RenderSettings settings = measured_.settings;
		settings.seed = seed;
		settings.samples = first + samples;
		SessionOptions session;
		configuration.apply(settings, session);
		session.first_sample = first;
		session.samples = samples;
		session.specialise = options_.render.specialise;
		session.bvh = options_.render.bvh;
		session.lanes = configuration.precision == Precision::Double ? 0 : options_.render.lanes;
		session.software_roots = device.software_roots;
		session.stop = hooks_.stop;
		session.progress = [&](const Progress&) { show(what, all); };
		RT_TRY_ASSIGN(const PackedScene packed, pack_scene(scene_, settings, {0, 0, settings.width, settings.height}));
		return render_scene(packed, {device.handle}, session);
	}

	// ---- the reference ------------------------------------------------------------------------------------------

	std::uint32_t half_seed(std::size_t half) const
	{
		const std::uint32_t seed = reference_seeds[half];
		return seed == measured_.settings.seed ? seed + 1 : seed;
	}

	CacheKey half_key(std::size_t half) const
	{
		// A reference is the same on every device, but for the last bits of the double rung.
		return memory_key("reference", DeviceInfo{},
		                  fmt::format("{} seed {} {}", settings_text(measured_.scene_hash, measured_.settings),
		                              half_seed(half), measured_.reference.configuration.name()));
	}

	// A half as the cache has it: whole and even, or nothing.
	std::optional<Film> remembered_half(std::size_t half) const
	{
		const auto payload = cache_load(half_key(half));
		if (!payload)
			return std::nullopt;
		Result<LoadedFilm> loaded = decode_rtfilm(payload->data(), payload->size(), "the reference");
		if (!loaded || !loaded->film.is_even() || loaded->film.min_samples() < first_reference_samples ||
		    loaded->film.window().width != measured_.settings.width ||
		    loaded->film.window().height != measured_.settings.height)
			return std::nullopt;
		return std::move(loaded->film);
	}

	Status make_reference()
	{
		TradeoffReference& reference = measured_.reference;
		reference.configuration = reference_configuration(scene_);
		reference.device = describe(reference_device_.handle->info());
		std::array<Film, 2> halves;
		std::uint32_t done = 0; // samples of a half
		auto a = remembered_half(0), b = remembered_half(1);
		if (a && b && a->min_samples() == b->min_samples()) {
			done = a->min_samples();
			halves = {std::move(*a), std::move(*b)};
			reference.remembered = 2 * done;
		}
		const std::uint32_t wanted = std::max(options_.reference_samples / 2, first_reference_samples);
		const double limit = options_.limit_seconds * 0.5;
		double each = 0; // seconds a sample of both halves
		while (done < wanted && !stopped()) {
			const std::uint32_t more = done == 0 ? first_reference_samples : std::min(done, wanted - done);
			const double gone = seconds_since(start_);
			if (each > 0 && gone + each * more > limit) {
				measured_.left_out.push_back(fmt::format("the reference beyond {} samples: about {:.0f} s more",
				                                         2 * done, each * (wanted - done)));
				break;
			}
			const double all = each > 0 ? std::min(limit, gone + each * (wanted - done)) : limit;
			RT_TRY_ASSIGN(const bool whole, extend(halves, done, more, all));
			if (!whole)
				break;
			each = (seconds_since(start_) - gone) / more;
			done += more;
		}
		reference.seconds = seconds_since(start_);
		if (done == 0)
			return success(); // stopped
		RT_TRY_ASSIGN(reference_, converged_film(halves[0], halves[1]));
		reference.samples = reference_.samples;
		reference.noise = reference_.noise;
		reference.film_hash = reference_.film.hash().hex();
		return success();
	}

	// Adds samples [done, done + more) to both halves, or to neither if it was stopped.
	Result<bool> extend(std::array<Film, 2>& halves, std::uint32_t done, std::uint32_t more, double all)
	{
		const std::string what = fmt::format("reference, {} samples", 2 * (done + more));
		std::array<Film, 2> parts;
		for (std::size_t half = 0; half < 2; ++half) {
			RT_TRY_ASSIGN(SessionResult result, render(reference_device_, measured_.reference.configuration,
			                                           half_seed(half), done, more, what, all));
			if (result.interrupted)
				return false;
			parts[half] = std::move(result.film);
		}
		for (std::size_t half = 0; half < 2; ++half) {
			if (done > 0)
				RT_TRY(parts[half].add(halves[half]));
			halves[half] = std::move(parts[half]);
			cache_store(half_key(half), encode_rtfilm(halves[half], {}));
		}
		return true;
	}

	// ---- the grid -------------------------------------------------------------------------------------------------

	Status measure_grid()
	{
		std::vector<Cell> cells;
		for (std::size_t device = 0; device < devices_.size(); ++device)
			for (const Configuration& configuration : configurations_for(scene_, devices_[device].handle->info())) {
				Cell cell;
				cell.device = device;
				cell.configuration = configuration;
				RT_TRY_ASSIGN(const bool warm, warm_up(cell));
				if (stopped())
					return success();
				if (warm)
					cells.push_back(std::move(cell));
			}
		const std::uint32_t most = std::max(1u, measured_.reference.samples / reference_factor);
		std::uint32_t rounds = 1;
		for (std::uint32_t samples = 1; samples <= most / grid_factor; samples *= grid_factor)
			++rounds;
		std::uint32_t samples = 1;
		for (std::uint32_t round = 0; round < rounds && !stopped(); ++round, samples *= grid_factor)
			RT_TRY(measure_round(cells, samples, rounds - round - 1));
		return success();
	}

	// Compiles and touches everything once. False if this device has no such program, which is told.
	Result<bool> warm_up(const Cell& cell)
	{
		const OpenDevice& device = devices_[cell.device];
		tell(fmt::format("preparing {} on {}", cell.configuration.name(), describe(device.handle->info())));
		const Result<SessionResult> result =
		    render(device, cell.configuration, measured_.settings.seed, 0, 1, "preparing", options_.limit_seconds);
		if (result)
			return true;
		if (cell.configuration.precision == Precision::Exact)
			return result.error();
		measured_.left_out.push_back(fmt::format("{} on {}: {}", cell.configuration.name(),
		                                         describe(device.handle->info()), result.error().message));
		return false;
	}

	// Seconds that the cells will take for a number of samples and for `more` larger ones, as far as they fit.
	static double expected(const std::vector<Cell>& cells, std::uint32_t more)
	{
		double sum = 0, times = grid_factor;
		for (std::uint32_t round = 0; round <= more; ++round, times *= grid_factor)
			for (const Cell& cell : cells)
				if (!cell.out)
					sum += cell.expected(times);
		return sum;
	}

	// All cells at one number of samples, in turns, so that a change of the machine's speed meets them all.
	Status measure_round(std::vector<Cell>& cells, std::uint32_t samples, std::uint32_t more)
	{
		std::stable_sort(cells.begin(), cells.end(), [](const Cell& a, const Cell& b) { return a.wall < b.wall; });
		leave_out(cells, samples);
		// Of the first round nothing is known yet.
		const double all = measured_.points.empty() ? options_.limit_seconds
		                                            : std::min(double(options_.limit_seconds),
		                                                       seconds_since(start_) + expected(cells, more));
		std::vector<double> walls(cells.size(), 0.0);
		for (Cell& cell : cells) {
			cell.seconds.clear();
			cell.cores.clear();
		}
		for (bool again = true; again;) {
			again = false;
			for (std::size_t i = 0; i < cells.size(); ++i) {
				Cell& cell = cells[i];
				if (cell.out || cell.is_timed())
					continue;
				const Clock::time_point begin = Clock::now();
				RT_TRY(measure(cell, samples, all));
				if (stopped())
					return finish_stopped(cells, samples);
				walls[i] += seconds_since(begin);
				again = again || !cell.is_timed();
			}
		}
		for (std::size_t i = 0; i < cells.size(); ++i)
			if (!cells[i].out) {
				const Clock::time_point begin = Clock::now();
				RT_TRY(add_point(cells[i], samples));
				cells[i].comparing = seconds_since(begin);
				cells[i].wall = walls[i] / double(cells[i].seconds.size());
				show(title(cells[i], samples), all);
			}
		return success();
	}

	// Those that no longer fit into the time that is left, slowest first.
	void leave_out(std::vector<Cell>& cells, std::uint32_t samples)
	{
		double left = options_.limit_seconds - seconds_since(start_);
		for (Cell& cell : cells) {
			if (cell.out)
				continue;
			const double takes = cell.expected(grid_factor);
			if (takes <= left) {
				left -= takes;
				continue;
			}
			cell.out = true;
			measured_.left_out.push_back(title(cell, samples) +
			                             (takes > 0 ? fmt::format(": about {:.0f} s", takes) : ""));
		}
	}

	std::string title(const Cell& cell, std::uint32_t samples) const
	{
		std::string text =
		    fmt::format("{}, {} {}", cell.configuration.name(), samples, samples == 1 ? "sample" : "samples");
		if (devices_.size() > 1)
			text += ", " + describe(measured_.devices[cell.device]);
		return text;
	}

	Status measure(Cell& cell, std::uint32_t samples, double all)
	{
		const double before = cpu_seconds();
		RT_TRY_ASSIGN(SessionResult result, render(devices_[cell.device], cell.configuration, measured_.settings.seed,
		                                           0, samples, title(cell, samples), all));
		const double cores = cpu_seconds() - before;
		if (result.interrupted)
			return success();
		const std::string hash = result.film.hash().hex();
		if (!cell.seconds.empty() && hash != cell.film_hash)
			return Error{ErrorKind::Failure,
			             fmt::format("{} gave film {}, and before {}", title(cell, samples), hash, cell.film_hash),
			             describe(measured_.devices[cell.device]),
			             "a device must give the same bits each time: look at its memory and cooling, or report a bug",
			             ""};
		cell.film_hash = hash;
		cell.film = std::move(result.film);
		cell.seconds.push_back(result.render_seconds);
		cell.cores.push_back(cores);
		return success();
	}

	Status add_point(const Cell& cell, std::uint32_t samples)
	{
		TradePoint point;
		point.device = cell.device;
		point.configuration = cell.configuration;
		point.samples = samples;
		const auto [least, most] = std::minmax_element(cell.seconds.begin(), cell.seconds.end());
		point.seconds = *least;
		point.most_seconds = *most;
		point.repeats = static_cast<std::uint32_t>(cell.seconds.size());
		if (measured_.devices[cell.device].is_processor())
			point.cpu_seconds = *std::min_element(cell.cores.begin(), cell.cores.end());
		point.film_hash = cell.film_hash;
		RT_TRY_ASSIGN(point.error, error_against(cell.film, reference_));
		measured_.points.push_back(std::move(point));
		return success();
	}

	// Renders of the round under way that were finished before the stop count, if timed once only.
	Status finish_stopped(const std::vector<Cell>& cells, std::uint32_t samples)
	{
		for (const Cell& cell : cells)
			if (!cell.out && !cell.seconds.empty())
				RT_TRY(add_point(cell, samples));
		return success();
	}

	// A measurement for each device, as if it had been the only one. One that got less far than an older one leaves
	// that: points of both are not mixed, because times of different hours do not compare.
	void remember() const
	{
		for (std::size_t device = 0; device < measured_.devices.size(); ++device) {
			Tradeoff alone = measured_;
			alone.devices = {measured_.devices[device]};
			alone.device_arguments = {measured_.device_arguments[device]};
			alone.points.clear();
			for (TradePoint point : measured_.points)
				if (point.device == device) {
					point.device = 0;
					alone.points.push_back(std::move(point));
				}
			if (alone.points.empty())
				continue; // it would keep others from measuring
			mark_front(alone.points);
			const CacheKey key = measurement_key(alone, alone.devices[0], options_.render);
			if (const auto older = load_measurement(key); older && fullness(*older) > fullness(alone))
				continue;
			const std::string text = tradeoff_json(alone).dump();
			cache_store(key, {text.begin(), text.end()});
		}
	}

	const TradeoffOptions& options_;
	const TradeoffHooks& hooks_;
	Scene scene_;
	Tradeoff measured_;
	std::vector<OpenDevice> devices_;
	OpenDevice reference_device_;
	ConvergedFilm reference_;
	Clock::time_point start_;
};

} // namespace

double Tradeoff::scale() const
{
	return double(image_width) * image_height / (double(settings.width) * settings.height);
}

Result<Tradeoff> measure_tradeoff(const TradeoffOptions& options, const TradeoffHooks& hooks)
{
	return TradeoffRun(options, hooks).run();
}

std::optional<Tradeoff> remembered_tradeoff(const TradeoffOptions& options)
{
	Result<Tradeoff> plan = TradeoffRun(options, {}).plan();
	if (!plan || plan->devices.size() != 1)
		return std::nullopt;
	std::optional<Tradeoff> measured = load_measurement(measurement_key(*plan, plan->devices[0], options.render));
	if (!measured)
		return std::nullopt;
	// The image may be another.
	measured->scene = plan->scene;
	measured->image_width = plan->image_width;
	measured->image_height = plan->image_height;
	measured->image_samples = plan->image_samples;
	measured->devices = plan->devices;
	return measured;
}

TradeoffAdvice advice_for(const Tradeoff& measured, const TradeoffOptions& options)
{
	TradeoffAdvice advice;
	advice.as_it_is = expectation(measured.points, 0, Configuration(), measured.image_samples, measured.scale());
	advice.goal = {options.target_error, options.budget};
	if (!advice.goal.rel_rmse && !advice.goal.seconds && advice.as_it_is)
		advice.goal.rel_rmse = advice.as_it_is->rel_rmse;
	advice.way = recommend(measured.points, advice.goal, measured.scale());
	return advice;
}

std::string command_line(const Tradeoff& measured, const Recommendation& way)
{
	std::string text = fmt::format("rt render {}", measured.scene);
	if (!measured.device_arguments[way.device].empty())
		text += ' ' + measured.device_arguments[way.device];
	return text + fmt::format(" {} --spp {}", way.configuration.arguments(), way.samples);
}

} // namespace rt
