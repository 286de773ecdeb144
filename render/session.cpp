#include "render/session.h"

#include "backends/kernel_text.h"
#include "common/rt_features.h"
#include "render/bvh.h"
#include "support/hash.h"
#include "support/memory.h"
#include "support/thread_pool.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <fmt/format.h>
#include <map>
#include <mutex>
#include <optional>
#include <thread>

namespace rt {
namespace {

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start) { return std::chrono::duration<double>(Clock::now() - start).count(); }

// A launch aims at this long: short enough for a smooth bar, a quick Ctrl-C and every watchdog.
constexpr double target_launch_seconds = 0.1;
// A device holds the sums of this many bytes of pixels at once; larger windows are rendered page by page.
constexpr std::uint64_t page_bytes = std::uint64_t(1) << 28;
constexpr double progress_interval_seconds = 0.1;
// Of the film, that a thread adds at once.
constexpr std::uint64_t pixels_a_thread = std::uint64_t(1) << 13;
// A GPU's compute unit holds at most about this many threads; a launch should offer it as many. More would leave each
// too few samples to go on with when a path ends.
constexpr std::uint64_t threads_a_compute_unit = 2048, launch_fills = 1;
constexpr std::uint32_t max_slices = 32;
// Spheres and boxes that a ray tries in a tree, roughly.
constexpr std::size_t typical_visits = 64;
constexpr std::uint32_t widest_lanes = 16;
// From so many spheres on a tree is faster than trying them all (docs/performance.md, tools/bench_crossover): 8 to 20
// with one lane on a processor, 20 to 33 with eight. On a GPU it was not measured, so programs with few spheres
// unrolled stay without one.
constexpr std::size_t min_bvh_spheres_one_lane = RT_MAX_FEW_SPHERES + 1;
constexpr std::size_t min_bvh_spheres_lanes = 32;

std::uint32_t page_rows(const PackedScene& packed, std::uint64_t max_alloc_bytes)
{
	const std::uint64_t row_bytes = std::uint64_t(packed.scene.window_width) * sizeof(rt_film_pixel);
	std::uint64_t limit = page_bytes;
	if (max_alloc_bytes)
		limit = std::min(limit, max_alloc_bytes);
	const std::uint64_t rows = std::max<std::uint64_t>(1, limit / row_bytes);
	return static_cast<std::uint32_t>(std::min<std::uint64_t>(rows, packed.scene.window_height));
}

std::uint32_t lanes_of(const DeviceInfo& device, const SessionOptions& options)
{
	return options.lanes ? options.lanes : lanes_for(device, options.precision);
}

// ---- the work of one page: rows x samples, handed out in launches ----

struct Work {
	std::uint32_t first_row = 0, rows = 0; // within the page
	std::uint32_t first_sample = 0, samples = 0;
};

// Hands out a page's work. A pass is a range of samples over all rows; a worker that finds an unfinished pass takes
// rows of it, otherwise it opens the next pass with as many samples as it manages in one launch.
class WorkQueue {
public:
	WorkQueue(std::uint32_t width, std::uint32_t rows, std::uint32_t first_sample, std::uint32_t samples,
	          std::uint32_t forced_rows, std::uint32_t forced_samples)
	    : width_(width), rows_(rows), next_sample_(first_sample), end_sample_(first_sample + samples),
	      forced_rows_(forced_rows), forced_samples_(forced_samples)
	{
	}

	// `budget`: pixel samples that the worker wants to take at once.
	std::optional<Work> take(double budget)
	{
		if (next_row_ == rows_ || !open_) {
			if (next_sample_ == end_sample_)
				return std::nullopt;
			const double per_sample = double(width_) * rows_;
			double wanted = std::clamp(budget / per_sample, 1.0, double(RT_MAX_SAMPLES_PER_LAUNCH));
			if (forced_samples_)
				wanted = std::min(forced_samples_, RT_MAX_SAMPLES_PER_LAUNCH);
			pass_first_ = next_sample_;
			pass_samples_ = std::min(static_cast<std::uint32_t>(wanted), end_sample_ - next_sample_);
			next_sample_ += pass_samples_;
			next_row_ = 0;
			open_ = true;
		}
		Work work;
		work.first_row = next_row_;
		work.first_sample = pass_first_;
		work.samples = pass_samples_;
		const double rows = forced_rows_ ? forced_rows_ : budget / (double(width_) * pass_samples_);
		const std::uint32_t left = rows_ - next_row_;
		work.rows = rows >= left ? left : std::max(1u, static_cast<std::uint32_t>(rows));
		next_row_ += work.rows;
		return work;
	}

private:
	std::uint32_t width_, rows_;
	std::uint32_t next_sample_, end_sample_;
	std::uint32_t forced_rows_, forced_samples_;
	std::uint32_t next_row_ = 0, pass_first_ = 0, pass_samples_ = 0;
	bool open_ = false;
};

// ---- what the workers of a session share ----

struct Shared {
	const PackedScene& packed;
	const SessionOptions& options;

	Shared(const PackedScene& scene, const SessionOptions& wanted) : packed(scene), options(wanted) {}

	std::mutex mutex;
	Film film;
	Clock::time_point start = Clock::now();
	Clock::time_point last_progress = start;
	std::uint64_t samples_done = 0, samples_total = 0;
	std::optional<Error> error;   // of the first worker that failed; the others stop
	bool page_is_fresh = false;   // nothing of this page is in the film yet
	std::size_t page_workers = 0; // that began it
	// A snapshot is wanted: every worker adds what its device holds to the film; the last one hands it out.
	unsigned snapshot_round = 0, drained = 0, workers = 0;
	bool snapshot_open = false;

	bool must_stop()
	{
		const std::lock_guard<std::mutex> lock(mutex);
		return error.has_value() || (options.stop && options.stop->load());
	}

	void report_progress(bool last)
	{
		if (!options.progress || (!last && seconds_since(last_progress) < progress_interval_seconds))
			return;
		last_progress = Clock::now();
		options.progress({samples_done, samples_total, seconds_since(start)});
	}

	// Call with the mutex held, after a worker drained or ended.
	void close_snapshot_if_complete()
	{
		if (snapshot_open && drained >= workers) {
			snapshot_open = false;
			options.snapshot(film);
		}
	}
};

// ---- one device ----

class Worker {
public:
	// packed: the shared scene with its spheres stored as this device wants them.
	// spare: the same if nobody needs its lists once they are uploaded.
	Worker(DeviceHandle device, const PackedScene& packed, PackedScene* spare, Shared& shared)
	    : device_(std::move(device)), packed_(packed), spare_(spare), shared_(shared)
	{
		stats_.device = device_->info().name;
	}

	const DeviceStats& stats() const { return stats_; }
	bool served_snapshot(unsigned round) const { return snapshot_round_ == round; }

	Status prepare()
	{
		const PackedScene& packed = packed_;
		const SessionOptions& options = shared_.options;
		RT_TRY(check_precision(device_->info(), options.precision));
		const ProgramSpec spec = render_program(packed, device_->info(), options);
		if (options.status)
			options.status("compiling the kernel for " + device_->info().name);
		RT_TRY_ASSIGN(program_, device_->build(spec));
		stats_.build = program_->report();
		stats_.lanes = lanes_of(device_->info(), options);
		stats_.native_roots =
		    options.precision != Precision::Exact || (!options.software_roots && !device_->info().hardware_seeds);

		if (packed.spheres.size() <= RT_MAX_FEW_SPHERES) {
			std::copy(packed.spheres.begin(), packed.spheres.end(), few_.spheres);
			std::copy(packed.wide.begin(), packed.wide.end(), few_.wide);
		}
		stats_.bvh = !packed.bvh.empty();
		// A guess to begin with, corrected by every launch: brute force costs in proportion to the spheres.
		const std::size_t tried = packed.bvh.empty() ? packed.spheres.size() : packed.wide.size() + typical_visits;
		budget_ = std::min(65536.0, 0x1p27 / (8.0 + double(tried)));

		const Clock::time_point start = Clock::now();
		RT_TRY(upload_list(spheres_, &PackedScene::spheres));
		RT_TRY(upload_list(wide_, &PackedScene::wide));
		RT_TRY(upload_list(ids_, &PackedScene::sphere_ids));
		RT_TRY(upload_list(sphere_materials_, &PackedScene::sphere_materials));
		RT_TRY(upload_list(bvh_, &PackedScene::bvh));
		RT_TRY(upload_list(materials_, &PackedScene::materials));
		RT_TRY(upload_list(textures_, &PackedScene::textures));
		RT_TRY(upload_list(texels_, &PackedScene::texels));
		RT_TRY(upload_list(lights_, &PackedScene::lights));
		stats_.upload_seconds = seconds_since(start);
		return success();
	}

	Status begin_page(std::uint32_t first_row, std::uint32_t rows)
	{
		page_row_ = first_row;
		page_pixels_ = std::size_t(rows) * shared_.packed.scene.window_width;
		scene_ = packed_.scene;
		scene_.window_y += first_row;
		scene_.window_height = rows;
		slices_ = slices_for(page_pixels_);
		const std::size_t bytes = page_pixels_ * slices_ * sizeof(rt_film_pixel);
		if (!film_ || film_->bytes() < bytes) {
			film_.reset();
			RT_TRY_ASSIGN(film_, device_->alloc(bytes));
		}
		film_is_clear_ = false;
		return success();
	}

	Status run_page(WorkQueue& queue)
	{
		while (!shared_.must_stop()) {
			std::optional<Work> work;
			{
				const std::lock_guard<std::mutex> lock(shared_.mutex);
				work = queue.take(budget_);
			}
			if (!work)
				break;
			RT_TRY(run(*work));
			RT_TRY(serve_snapshot());
		}
		return drain();
	}

	// Adds what the device holds to the shared film and clears it there.
	Status drain()
	{
		if (done_.empty())
			return success();
		const Clock::time_point start = Clock::now();
		if (slices_ > 1) {
			const auto pixels = static_cast<std::uint32_t>(page_pixels_);
			RT_TRY(device_->launch(program_, "rt_merge", pixels, {film_, pixels, slices_}));
		}
		// Memory of the film that nobody has read or written is cheaper to store in than to add to: one page fault for
		// each page, not two. With other workers beside this one, another could have added to some of it.
		bool store = false;
		{
			const std::lock_guard<std::mutex> lock(shared_.mutex);
			store = shared_.page_is_fresh && shared_.page_workers == 1;
			shared_.page_is_fresh = false;
		}
		const std::size_t offset = std::size_t(page_row_) * shared_.packed.scene.window_width;
		RT_TRY(device_->read_pieces(film_, 0, page_pixels_ * sizeof(rt_film_pixel),
		                            [&](const void* data, std::size_t first, std::size_t bytes) {
			                            const std::lock_guard<std::mutex> lock(shared_.mutex);
			                            add_pixels(static_cast<const rt_film_pixel*>(data),
			                                       offset + first / sizeof(rt_film_pixel),
			                                       bytes / sizeof(rt_film_pixel), store);
		                            }));
		{
			const std::lock_guard<std::mutex> lock(shared_.mutex);
			add_samples(offset, store);
		}
		done_.clear();
		film_is_clear_ = false;
		stats_.read_seconds += seconds_since(start);
		return success();
	}

private:
	Status upload(BufferHandle& buffer, const void* data, std::size_t bytes)
	{
		RT_TRY_ASSIGN(buffer, device_->alloc(bytes));
		return device_->write(buffer, 0, data, bytes);
	}

	// How many parts a pixel's samples are taken in, so that a GPU has enough to do.
	std::uint32_t slices_for(std::size_t pixels) const
	{
		const SessionOptions& options = shared_.options;
		if (options.slices)
			return options.slices;
		if (device_->info().kind != DeviceKind::Gpu)
			return 1;
		const std::uint64_t wanted = device_->info().compute_units * threads_a_compute_unit * launch_fills / pixels;
		const std::uint64_t room = page_bytes / (pixels * sizeof(rt_film_pixel));
		return static_cast<std::uint32_t>(std::max<std::uint64_t>(
		    1, std::min({wanted, room, std::uint64_t(max_slices), std::uint64_t(options.samples)})));
	}

	// An empty list still needs memory that a kernel's argument can point to.
	template <class T>
	Status upload_list(BufferHandle& buffer, std::vector<T> PackedScene::*member)
	{
		const std::vector<T>& list = packed_.*member;
		const T nothing{};
		RT_TRY(list.empty() ? upload(buffer, &nothing, sizeof nothing)
		                    : upload(buffer, list.data(), list.size() * sizeof(T)));
		if (spare_)
			std::vector<T>().swap(spare_->*member);
		return success();
	}

	Status run(const Work& work)
	{
		const std::uint32_t width = shared_.packed.scene.window_width;
		// Tiles of 8x4 pixels, 32 / lanes work-items each (kernels/render.cl).
		const std::uint64_t tiles = std::uint64_t((width + 7) / 8) * ((work.rows + 3) / 4);
		const Clock::time_point start = Clock::now();
		if (!film_is_clear_) {
			const auto pixels = static_cast<std::uint32_t>(page_pixels_ * slices_);
			RT_TRY(device_->launch(program_, "rt_clear", pixels, {film_, pixels}));
			film_is_clear_ = true;
		}
		RT_TRY(device_->launch(program_, "rt_render", tiles * slices_ * 32 / stats_.lanes,
		                       {by_value(scene_), by_value(few_), spheres_, wide_, ids_, sphere_materials_, bvh_,
		                        materials_, textures_, texels_, lights_, film_, work.first_row, work.rows,
		                        work.first_sample, work.samples, slices_, static_cast<std::uint32_t>(page_pixels_)},
		                       shared_.options.group_size));
		RT_TRY(device_->wait());
		const double seconds = seconds_since(start);
		const std::uint64_t samples = std::uint64_t(width) * work.rows * work.samples;
		done_.push_back(work);
		stats_.launches += 1;
		stats_.samples += samples;
		stats_.launch_seconds += seconds;
		// Follow the measured speed, but not blindly: the first launch is dominated by its overhead.
		const double wanted = double(samples) * target_launch_seconds / std::max(seconds, 1e-6);
		budget_ = std::clamp(wanted, budget_ / 8, budget_ * 8);

		const std::lock_guard<std::mutex> lock(shared_.mutex);
		shared_.samples_done += samples;
		shared_.report_progress(false);
		return success();
	}

	Status serve_snapshot()
	{
		const SessionOptions& options = shared_.options;
		if (!options.snapshot)
			return success();
		{
			const std::lock_guard<std::mutex> lock(shared_.mutex);
			if (!shared_.snapshot_open && options.snapshot_wanted && options.snapshot_wanted()) {
				shared_.snapshot_open = true;
				shared_.snapshot_round += 1;
				shared_.drained = 0;
			}
			if (!shared_.snapshot_open || snapshot_round_ == shared_.snapshot_round)
				return success();
			snapshot_round_ = shared_.snapshot_round;
		}
		RT_TRY(drain());
		const std::lock_guard<std::mutex> lock(shared_.mutex);
		shared_.drained += 1;
		shared_.close_snapshot_if_complete();
		return success();
	}

	// The film's pixels from `first` on; `store`: they are still zero.
	void add_pixels(const rt_film_pixel* pixels, std::size_t first, std::size_t count, bool store)
	{
		constexpr std::uint64_t segments_mask = (std::uint64_t(1) << RT_TALLY_REJECTED_SHIFT) - 1;
		std::atomic<std::uint64_t> segments{0}, rejected{0};
		parallel_for(count, pixels_a_thread, [&](std::uint64_t begin, std::uint64_t end) {
			std::int64_t* sums = shared_.film.sums().data() + (first + begin) * 3;
			std::uint64_t piece_segments = 0, piece_rejected = 0;
			for (std::uint64_t i = begin; i < end; ++i, sums += 3) {
				if (store) {
					sums[0] = pixels[i].r;
					sums[1] = pixels[i].g;
					sums[2] = pixels[i].b;
				} else {
					sums[0] += pixels[i].r;
					sums[1] += pixels[i].g;
					sums[2] += pixels[i].b;
				}
				const auto tally = static_cast<std::uint64_t>(pixels[i].tally);
				piece_segments += tally & segments_mask;
				piece_rejected += tally >> RT_TALLY_REJECTED_SHIFT;
			}
			segments += piece_segments;
			rejected += piece_rejected;
		});
		shared_.film.segments += segments;
		shared_.film.rejected += rejected;
	}

	// What done_ took of each pixel, as above.
	void add_samples(std::size_t first, bool store)
	{
		// All launches of a row together: most took whole pages.
		const std::size_t width = shared_.packed.scene.window_width, rows = page_pixels_ / width;
		std::vector<std::uint32_t> row_samples(rows, 0);
		for (const Work& work : done_)
			for (std::uint32_t row = work.first_row; row < work.first_row + work.rows; ++row)
				row_samples[row] += work.samples;
		parallel_for(rows, 4 * pixels_a_thread / width + 1, [&](std::uint64_t begin, std::uint64_t end) {
			std::uint32_t* samples = shared_.film.samples().data() + first + begin * width;
			for (std::uint64_t row = begin; row < end; ++row, samples += width) {
				if (store)
					std::fill(samples, samples + width, row_samples[row]);
				else
					std::for_each(samples, samples + width, [&](std::uint32_t& taken) { taken += row_samples[row]; });
			}
		});
	}

	DeviceHandle device_;
	const PackedScene& packed_;
	PackedScene* spare_;
	Shared& shared_;
	DeviceStats stats_;
	ProgramHandle program_;
	rt_scene scene_{}; // of the page
	rt_few_spheres few_{};
	BufferHandle spheres_, wide_, ids_, sphere_materials_, bvh_, materials_, textures_, texels_, lights_, film_;
	std::uint32_t page_row_ = 0;
	std::size_t page_pixels_ = 0;
	std::uint32_t slices_ = 1;
	bool film_is_clear_ = false; // empty, or holding only the sums of done_
	std::vector<Work> done_;     // launches whose sums are on the device and not yet in the film
	double budget_ = 0;          // pixel samples for the next launch
	unsigned snapshot_round_ = 0;
};

Status check_memory(const PackedScene& packed, const std::vector<DeviceHandle>& devices)
{
	constexpr double mebibyte = 1024.0 * 1024.0;
	const std::uint64_t host = host_bytes_needed(packed), free_host = available_host_bytes();
	if (free_host && host > free_host)
		return Error{ErrorKind::Memory,
		             fmt::format("the render needs {:.0f} MiB of host memory and {:.0f} MiB are free",
		                         double(host) / mebibyte, double(free_host) / mebibyte),
		             {},
		             "render a smaller image, parts of it with --crop, or a smaller scene",
		             {}};
	const std::uint64_t needed = device_bytes_needed(packed);
	for (const DeviceHandle& device : devices)
		if (device->info().memory_bytes && needed > device->info().memory_bytes)
			return Error{ErrorKind::Memory,
			             fmt::format("the render needs {:.0f} MiB of device memory and the device has {:.0f} MiB",
			                         double(needed) / mebibyte, double(device->info().memory_bytes) / mebibyte),
			             device->info().name,
			             "choose a device with more memory, or a smaller scene",
			             {}};
	return success();
}

// Of the kernels' text and what was defined so far; never 0.
std::uint32_t program_id(const ProgramSpec& spec)
{
	std::string text = kernel_hash();
	for (const auto& [name, value] : spec.defines)
		text += " " + name + "=" + value;
	return static_cast<std::uint32_t>(hash_bytes(text.data(), text.size()).low) | 1u;
}

} // namespace

ProgramSpec render_program(const PackedScene& packed, const DeviceInfo& device, const SessionOptions& options)
{
	ProgramSpec spec;
	spec.root = "kernels/render.cl";
	spec.entries = {"rt_clear", "rt_merge", "rt_render", "rt_identify"};
	const bool permuted = (packed.features & RT_FEATURE_PERMUTED) != 0;
	const std::uint32_t features = options.specialise ? packed.features : std::uint32_t(RT_FEATURE_ALL);
	spec.defines.emplace_back("RT_LANES", fmt::format("{}", lanes_of(device, options)));
	spec.defines.emplace_back("RT_FEATURES", fmt::format("{:#x}u", features));
	spec.defines.emplace_back("RT_DEF_NATIVE_ROOTS", options.software_roots || device.hardware_seeds ? "0" : "1");
	set_precision(spec, options.precision, options.fast_parts);
	if (options.allow_contraction)
		spec.defines.emplace_back("RT_DEF_CONTRACT", "1");
	if (options.specialise && !permuted && device.indexes_parameters && packed.spheres.size() <= RT_MAX_FEW_SPHERES) {
		spec.defines.emplace_back("RT_DEF_SPHERE_COUNT", fmt::format("{}", packed.spheres.size()));
		spec.defines.emplace_back("RT_DEF_WIDE_COUNT", fmt::format("{}", packed.wide.size()));
	}
	spec.defines.emplace_back("RT_PROGRAM_ID", fmt::format("{:#x}u", program_id(spec)));
	return spec;
}

bool wants_bvh(const PackedScene& packed, std::uint32_t lanes, Acceleration bvh)
{
	if (bvh != Acceleration::Auto || !packed.bvh.empty())
		return bvh == Acceleration::Always && packed.bvh.empty() && packed.spheres.size() > packed.wide.size();
	const std::size_t listed = packed.spheres.size() - packed.wide.size();
	return listed >= (lanes == 1 ? min_bvh_spheres_one_lane : min_bvh_spheres_lanes);
}

std::uint64_t device_bytes_needed(const PackedScene& packed)
{
	std::uint64_t bytes = packed.bytes();
	if (wants_bvh(packed, 1, Acceleration::Auto))
		bytes += bvh_bytes_needed(packed.spheres.size() - packed.wide.size(), 1);
	return bytes + std::uint64_t(page_rows(packed, 0)) * packed.scene.window_width * sizeof(rt_film_pixel);
}

std::uint64_t host_bytes_needed(const PackedScene& packed)
{
	const std::uint64_t pixels = std::uint64_t(packed.scene.window_width) * packed.scene.window_height;
	// Three sums and a count in the film, and about as much again while it is encoded.
	std::uint64_t bytes = pixels * (3 * sizeof(std::int64_t) + sizeof(std::uint32_t)) * 2;
	// A second copy of the scene, with the tree; what is being sorted is smaller than the copy that follows it.
	if (wants_bvh(packed, 1, Acceleration::Auto)) {
		const std::size_t listed = packed.spheres.size() - packed.wide.size();
		bytes += packed.bytes() + std::max(bvh_bytes_needed(listed, 1), bvh_bytes_needed(listed, widest_lanes));
	}
	return bytes;
}

Result<SessionResult> render_scene(const PackedScene& packed, const std::vector<DeviceHandle>& devices,
                                   const SessionOptions& options)
{
	RT_TRY(check_memory(packed, devices));
	const rt_scene& scene = packed.scene;
	Shared shared(packed, options);
	shared.film = Film(scene.width, scene.height,
	                   {scene.window_x, scene.window_y, scene.window_width, scene.window_height}, packed.film_exponent);
	shared.samples_total = shared.film.pixels() * options.samples;

	// One tree for each width of lanes among the devices.
	SessionResult result;
	std::map<std::uint32_t, PackedScene> trees;
	std::vector<Worker> workers;
	workers.reserve(devices.size());
	std::uint64_t max_alloc = 0;
	for (const DeviceHandle& device : devices) {
		const std::uint32_t lanes = lanes_of(device->info(), options);
		if (wants_bvh(packed, lanes, options.bvh) && !trees.count(lanes)) {
			if (options.status)
				options.status(fmt::format("building a tree of {} spheres", packed.spheres.size()));
			const Clock::time_point start = Clock::now();
			RT_TRY_ASSIGN(trees[lanes], with_bvh(packed, lanes));
			result.bvh_seconds += seconds_since(start);
		}
		const auto tree = trees.find(lanes);
		const bool last =
		    std::none_of(devices.begin() + static_cast<std::ptrdiff_t>(workers.size()) + 1, devices.end(),
		                 [&](const DeviceHandle& later) { return lanes_of(later->info(), options) == lanes; });
		workers.emplace_back(device, tree == trees.end() ? packed : tree->second,
		                     tree == trees.end() || !last ? nullptr : &tree->second, shared);
		RT_TRY(workers.back().prepare());
		const std::uint64_t bytes = device->info().max_alloc_bytes;
		max_alloc = max_alloc && bytes ? std::min(max_alloc, bytes) : std::max(max_alloc, bytes);
	}

	shared.start = shared.last_progress = Clock::now();
	const std::uint32_t rows_per_page = page_rows(packed, max_alloc);
	for (std::uint32_t row = 0; row < scene.window_height && !shared.must_stop(); row += rows_per_page) {
		const std::uint32_t rows = std::min(rows_per_page, scene.window_height - row);
		WorkQueue queue(scene.window_width, rows, options.first_sample, options.samples, options.rows_per_launch,
		                options.samples_per_launch);
		shared.workers = static_cast<unsigned>(workers.size());
		shared.page_workers = workers.size();
		shared.page_is_fresh = true;
		const auto work = [&](Worker& worker) {
			Status status = worker.begin_page(row, rows);
			if (status)
				status = worker.run_page(queue);
			const std::lock_guard<std::mutex> lock(shared.mutex);
			if (!status && !shared.error)
				shared.error = status.error();
			shared.workers -= 1;
			if (shared.snapshot_open && worker.served_snapshot(shared.snapshot_round))
				shared.drained -= 1;
			shared.close_snapshot_if_complete();
		};
		std::vector<std::thread> threads;
		for (std::size_t i = 1; i < workers.size(); ++i)
			threads.emplace_back(work, std::ref(workers[i]));
		work(workers[0]);
		for (std::thread& thread : threads)
			thread.join();
	}
	if (shared.error)
		return *shared.error;
	shared.report_progress(true);

	result.render_seconds = seconds_since(shared.start);
	result.interrupted = shared.samples_done < shared.samples_total;
	for (const Worker& worker : workers)
		result.devices.push_back(worker.stats());
	result.film = std::move(shared.film);
	return result;
}

} // namespace rt
