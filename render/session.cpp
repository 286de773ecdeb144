#include "render/session.h"

#include "backends/kernel_text.h"
#include "backends/render_launch.h"
#include "common/rt_features.h"
#include "render/bvh.h"
#include "support/clock.h"
#include "support/hash.h"
#include "support/memory.h"
#include "support/thread_pool.h"

#include <algorithm>
#include <cmath>
#include <fmt/format.h>
#include <map>
#include <mutex>
#include <optional>
#include <thread>

namespace rt {
namespace {

// A launch aims at this long: short enough for a smooth bar, a quick Ctrl-C and every watchdog.
constexpr double target_launch_seconds = 0.1;
// What the first launch, whose speed nobody knows yet, may take of a processor or of each compute unit of a GPU: pixel
// samples, and spheres tried for their first segments. 0.1 s of a slow one. Each launch ends with some waiting for its
// longest paths, so a small image should not need several.
constexpr double first_samples = 0x1p16, first_tests = 0x1p27;
constexpr double gpu_first_samples = 0x1p18, gpu_first_tests = 0x1p22;
// A device holds the sums of this many bytes of pixels at once; larger windows are rendered page by page.
constexpr std::uint64_t page_bytes = std::uint64_t(1) << 28;
constexpr double progress_interval_seconds = 0.1;
// Of the film, that a thread adds at once.
constexpr std::uint64_t pixels_a_thread = std::uint64_t(1) << 13;
// A GPU's compute unit holds at most about this many threads; a launch should offer it some times as many, so that
// those that are through early find something left. Many more would leave each too few samples to go on with.
constexpr std::uint64_t threads_a_compute_unit = 2048, launch_fills = 2;
// A GPU takes the samples of large images in two parts, too: the last tiles, for which it waits, are half as long. Not
// where a part would be shorter than this.
constexpr std::uint32_t min_slice_samples = 8;
// What a program that walks a tree may take of a GPU's registers, a thread: its compiler, left to itself, takes fewer
// and fetches a node's rows one after the other (docs/performance.md, Steps).
constexpr std::uint32_t tree_registers = 96;
constexpr std::uint32_t max_slices = 32;
// Spheres and boxes that a ray tries in a tree, roughly.
constexpr std::size_t typical_visits = 64;
constexpr std::uint32_t widest_lanes = 16;
// Lanes of a program that walks a tree, at most: with 16 its nodes and leaves are as wide, and each ray tries more
// boxes and spheres than the wider shading gains (docs/performance.md, Steps).
constexpr std::uint32_t most_tree_lanes = 8;
// From so many spheres on a tree is faster than trying them all (docs/performance.md, tools/bench_crossover): 8 to 20
// with one lane on a processor, 20 to 32 with eight, 32 to 48 where they are tried with 16, 17 to 32 on a GPU. Programs
// with few spheres unrolled stay without one.
constexpr std::size_t min_bvh_spheres_one_lane = RT_MAX_FEW_SPHERES + 1;
constexpr std::size_t min_bvh_spheres_lanes = 24, min_bvh_spheres_16_lanes = 40;

// Bytes that a device's film may have; max_alloc_bytes: of its largest buffer, 0 if that is not known.
std::uint64_t film_room(std::uint64_t max_alloc_bytes)
{
	return max_alloc_bytes ? std::min(page_bytes, max_alloc_bytes) : page_bytes;
}

std::uint32_t page_rows(const PackedScene& packed, std::uint64_t max_alloc_bytes)
{
	const std::uint64_t row_bytes = std::uint64_t(packed.scene.window_width) * sizeof(rt_film_pixel);
	const std::uint64_t rows = std::max<std::uint64_t>(1, film_room(max_alloc_bytes) / row_bytes);
	return static_cast<std::uint32_t>(std::min<std::uint64_t>(rows, packed.scene.window_height));
}

// ---- the work of one page: parts of the window x samples, handed out in launches ----

// Pixels that lie together in a device's film, row after row. A launch sees them as the rows [first_row, first_row +
// height) of a window as wide as they are, which begins so far above that these rows are the part's: then the kernel
// puts each part where the one before it ends, and knows nothing of parts.
struct Part {
	Window window; // in the coordinates of the session's window
	std::uint32_t first_row = 0;
	std::size_t first_pixel() const { return std::size_t(first_row) * window.width; }
	std::size_t pixels() const { return std::size_t(window.width) * window.height; }
};

// What a device's film holds at once.
struct Page {
	std::vector<Part> parts;
	std::size_t pixels = 0;      // of the device's film: parts begin at whole rows of their own, which leaves gaps
	std::size_t part_pixels = 0; // of the parts alone
};

// Cuts the windows into parts and shares them out among pages of about so many pixels.
std::vector<Page> pages_of(const std::vector<Window>& windows, std::size_t page_pixels)
{
	std::vector<Page> pages;
	for (const Window& window : windows) {
		const std::size_t max_rows = std::max<std::size_t>(1, page_pixels / window.width);
		for (std::uint32_t row = 0; row < window.height;) {
			Part part;
			const std::size_t rows = std::min<std::size_t>(max_rows, window.height - row);
			part.window = {window.x, window.y + row, window.width, static_cast<std::uint32_t>(rows)};
			if (!pages.empty())
				part.first_row = static_cast<std::uint32_t>((pages.back().pixels + window.width - 1) / window.width);
			if (pages.empty() || part.first_pixel() + part.pixels() > page_pixels) {
				pages.emplace_back();
				part.first_row = 0;
			}
			Page& page = pages.back();
			page.pixels = part.first_pixel() + part.pixels();
			page.part_pixels += part.pixels();
			page.parts.push_back(part);
			row += part.window.height;
		}
	}
	return pages;
}

// One launch.
struct Work {
	std::size_t part = 0;                  // of the page
	std::uint32_t first_row = 0, rows = 0; // within the part
	std::uint32_t first_sample = 0, samples = 0;
};

// Hands out a page's work. A pass is a range of samples over all parts; a worker that finds an unfinished pass takes
// rows of it, otherwise it opens the next pass with as many samples as it manages at once.
class WorkQueue {
public:
	WorkQueue(const Page& page, std::uint32_t first_sample, std::uint32_t samples, std::uint32_t forced_rows,
	          std::uint32_t forced_samples)
	    : page_(page), next_sample_(first_sample), end_sample_(first_sample + samples), forced_rows_(forced_rows),
	      forced_samples_(forced_samples), next_part_(page.parts.size())
	{
	}

	// Of `left` samples or rows, those that a launch takes which would like so many: all, if hardly more are left.
	static std::uint32_t most_of(double wanted, std::uint32_t left)
	{
		constexpr double hardly_more = 1.5; // a launch of its own for the rest would cost more waiting
		return wanted * hardly_more >= left ? left : std::max(1u, static_cast<std::uint32_t>(wanted));
	}

	// `budget`: pixel samples that the worker wants to take before it waits. Several launches where parts are small;
	// none where nothing is left.
	std::vector<Work> take(double budget)
	{
		std::vector<Work> works;
		if (next_part_ == page_.parts.size()) {
			if (next_sample_ == end_sample_)
				return works;
			const double per_sample = double(page_.part_pixels);
			const std::uint32_t left = end_sample_ - next_sample_;
			const std::uint32_t wanted =
			    forced_samples_ ? std::min(forced_samples_, left) : most_of(budget / per_sample, left);
			pass_first_ = next_sample_;
			pass_samples_ = std::min(wanted, RT_MAX_SAMPLES_PER_LAUNCH);
			next_sample_ += pass_samples_;
			next_part_ = 0;
		}
		do {
			const Window& window = page_.parts[next_part_].window;
			const double row_samples = double(window.width) * pass_samples_;
			const std::uint32_t left = window.height - next_row_;
			Work work;
			work.part = next_part_;
			work.first_row = next_row_;
			work.rows = forced_rows_ ? std::min(forced_rows_, left) : most_of(budget / row_samples, left);
			work.first_sample = pass_first_;
			work.samples = pass_samples_;
			works.push_back(work);
			budget = std::fma(-row_samples, double(work.rows), budget);
			next_row_ += work.rows;
			if (next_row_ == window.height) {
				next_row_ = 0;
				next_part_ += 1;
			}
		} while (!forced_rows_ && next_row_ == 0 && next_part_ < page_.parts.size() &&
		         budget >= double(page_.parts[next_part_].pixels()) * pass_samples_);
		return works;
	}

private:
	const Page& page_;
	std::uint32_t next_sample_, end_sample_;
	std::uint32_t forced_rows_, forced_samples_;
	std::size_t next_part_;
	std::uint32_t next_row_ = 0, pass_first_ = 0, pass_samples_ = 0;
};

// ---- what the workers of a session share ----

struct Shared {
	const PackedScene& packed;
	SessionOptions options;

	Shared(const PackedScene& scene, const SessionOptions& wanted) : packed(scene), options(wanted) {}

	std::mutex mutex;
	Film film;
	Clock::time_point start = Clock::now();
	Clock::time_point last_progress = start;
	std::uint64_t samples_done = 0, samples_total = 0;
	std::optional<Error> error; // of the first worker that failed; the others stop
	bool film_is_populated = false;
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
	// spare: the same if nobody needs its lists once they are uploaded. A GPU's are given back during its first launch,
	// a processor's at once: its buffers are in the same memory.
	Worker(DeviceHandle device, const PackedScene& packed, PackedScene* spare, Shared& shared)
	    : device_(std::move(device)), packed_(packed), spare_(spare), shared_(shared)
	{
		stats_.device = device_->info().name;
	}

	const DeviceStats& stats() const { return stats_; }
	bool served_snapshot(unsigned round) const { return snapshot_round_ == round; }

	Status build()
	{
		const SessionOptions& options = shared_.options;
		RT_TRY(check_precision(device_->info(), options.precision));
		// Of the shared scene: the lists of packed_ may be gone, and a tree makes no other program.
		const ProgramSpec spec = render_program(shared_.packed, device_->info(), options);
		if (options.status)
			options.status("compiling the kernel for " + device_->info().name);
		RT_TRY_ASSIGN(program_, device_->build(spec));
		stats_.build = program_->report();
		stats_.lanes = render_lanes(shared_.packed, device_->info(), options);
		stats_.native_roots = options.precision != Precision::Exact || !options.software_roots;
		return success();
	}

	Status prepare()
	{
		RT_TRY(build());
		const PackedScene& packed = packed_;
		if (packed.spheres.size() <= RT_MAX_FEW_SPHERES) {
			std::copy(packed.spheres.begin(), packed.spheres.end(), few_.spheres);
			std::copy(packed.wide.begin(), packed.wide.end(), few_.wide);
		}
		stats_.bvh = !packed.bvh.empty();
		// A guess to begin with, corrected by every launch: brute force costs in proportion to the spheres.
		const std::size_t tried = packed.bvh.empty() ? packed.spheres.size() : packed.wide.size() + typical_visits;
		const double per_sample = 8 + double(tried);
		budget_ = is_gpu() ? std::max(1u, device_->info().compute_units) *
		                         std::min(gpu_first_samples, gpu_first_tests / per_sample)
		                   : std::min(first_samples, first_tests / per_sample);

		const Clock::time_point start = Clock::now();
		RT_TRY(upload_list(lists_.spheres, &PackedScene::spheres));
		RT_TRY(upload_list(lists_.wide, &PackedScene::wide));
		RT_TRY(upload_list(lists_.ids, &PackedScene::sphere_ids));
		RT_TRY(upload_list(lists_.sphere_materials, &PackedScene::sphere_materials));
		RT_TRY(upload_list(lists_.bvh, &PackedScene::bvh));
		RT_TRY(upload_list(lists_.materials, &PackedScene::materials));
		RT_TRY(upload_list(lists_.textures, &PackedScene::textures));
		RT_TRY(upload_list(lists_.texels, &PackedScene::texels));
		RT_TRY(upload_list(lists_.lights, &PackedScene::lights));
		stats_.upload_seconds = seconds_since(start);
		return success();
	}

	// `samples`: that will be taken of each pixel. The page must live until the next one begins.
	Status begin_page(const Page& page, std::uint32_t samples)
	{
		page_ = &page;
		slices_ = slices_for(page, samples);
		const std::size_t bytes = page.pixels * slices_ * sizeof(rt_film_pixel);
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
			std::vector<Work> works;
			{
				const std::lock_guard<std::mutex> lock(shared_.mutex);
				works = queue.take(budget_);
			}
			if (works.empty())
				break;
			RT_TRY(run(works));
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
			const auto pixels = static_cast<std::uint32_t>(page_->pixels);
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
		RT_TRY(device_->read_pieces(film_, 0, page_->pixels * sizeof(rt_film_pixel),
		                            [&](const void* data, std::size_t first, std::size_t bytes) {
			                            const std::lock_guard<std::mutex> lock(shared_.mutex);
			                            add_piece(static_cast<const rt_film_pixel*>(data),
			                                      first / sizeof(rt_film_pixel), bytes / sizeof(rt_film_pixel), store);
		                            }));
		{
			const std::lock_guard<std::mutex> lock(shared_.mutex);
			add_samples(store);
		}
		done_.clear();
		film_is_clear_ = false;
		stats_.read_seconds += seconds_since(start);
		return success();
	}

private:
	bool is_gpu() const { return device_->info().kind == DeviceKind::Gpu; }

	Status upload(BufferHandle& buffer, const void* data, std::size_t bytes)
	{
		RT_TRY_ASSIGN(buffer, device_->alloc(bytes));
		return device_->write(buffer, 0, data, bytes);
	}

	// How many parts a pixel's samples are taken in, so that a GPU has enough to do. A power of two: samples are mostly
	// so many that these are of one size.
	std::uint32_t slices_for(const Page& page, std::uint32_t samples) const
	{
		const SessionOptions& options = shared_.options;
		if (options.slices)
			return options.slices;
		if (!is_gpu())
			return 1;
		// Launches of one device run one after the other, so each should fill it.
		const std::uint64_t to_fill = device_->info().compute_units * threads_a_compute_unit * launch_fills /
		                              (page.part_pixels / page.parts.size());
		const std::uint64_t wanted = std::max<std::uint64_t>(to_fill, samples >= 2 * min_slice_samples ? 2 : 1);
		const std::uint64_t room = film_room(device_->info().max_alloc_bytes) / (page.pixels * sizeof(rt_film_pixel));
		const std::uint64_t most = std::min({wanted, room, std::uint64_t(max_slices), std::uint64_t(samples)});
		std::uint32_t slices = 1;
		while (2 * slices <= most)
			slices *= 2;
		return slices;
	}

	// An empty list still needs memory that a kernel's argument can point to.
	template <class T>
	Status upload_list(BufferHandle& buffer, std::vector<T> PackedScene::*member)
	{
		const std::vector<T>& list = packed_.*member;
		const T nothing{};
		RT_TRY(list.empty() ? upload(buffer, &nothing, sizeof nothing)
		                    : upload(buffer, list.data(), list.size() * sizeof(T)));
		if (spare_ && !is_gpu())
			std::vector<T>().swap(spare_->*member);
		return success();
	}

	Status run(const std::vector<Work>& works)
	{
		const Clock::time_point start = Clock::now();
		if (!film_is_clear_) {
			const auto pixels = static_cast<std::uint32_t>(page_->pixels * slices_);
			RT_TRY(device_->launch(program_, "rt_clear", pixels, {film_, pixels}));
			film_is_clear_ = true;
		}
		const std::uint32_t group_size = shared_.options.group_size;
		std::uint64_t samples = 0;
		for (const Work& work : works) {
			const Part& part = page_->parts[work.part];
			const std::uint32_t width = part.window.width;
			rt_scene scene = packed_.scene;
			scene.window_x += part.window.x;
			scene.window_y += part.window.y - part.first_row; // may wrap: the kernel's sum wraps back
			scene.window_width = width;
			scene.window_height = part.window.height;
			const RenderRange range{
			    part.first_row + work.first_row,          work.rows, work.first_sample, work.samples, slices_,
			    static_cast<std::uint32_t>(page_->pixels)};
			RT_TRY(device_->launch(program_, "rt_render", render_items(width, range, stats_.lanes),
			                       render_arguments(scene, few_, lists_, film_, range),
			                       group_size ? group_size : render_group(stats_.lanes)));
			samples += std::uint64_t(width) * work.rows * work.samples;
		}
		if (is_gpu()) {
			populate_film();
			free_spare();
		}
		RT_TRY(device_->wait());
		const double seconds = seconds_since(start);
		done_.insert(done_.end(), works.begin(), works.end());
		stats_.launches += works.size();
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

	// While a GPU works the processor waits: it makes the film's pages, which otherwise come one by one when the first
	// sums are added, in half the time that all the launches of a short render take.
	void populate_film()
	{
		{
			const std::lock_guard<std::mutex> lock(shared_.mutex);
			if (shared_.film_is_populated)
				return;
			shared_.film_is_populated = true;
		}
		shared_.film.sums().populate();
		shared_.film.samples().populate();
	}

	// Another part of that wait: giving back a million spheres' lists takes as long as sending them.
	void free_spare()
	{
		if (spare_)
			spare_->free_lists();
		spare_ = nullptr;
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

	// Pixels [first, first + count) of the device's film: some of each part that lies there.
	void add_piece(const rt_film_pixel* pixels, std::size_t first, std::size_t count, bool store)
	{
		for (const Part& part : page_->parts) {
			const std::size_t begin = std::max(first, part.first_pixel());
			const std::size_t end = std::min(first + count, part.first_pixel() + part.pixels());
			if (begin < end)
				add_pixels(part, begin - part.first_pixel(), end - begin, pixels + (begin - first), store);
		}
	}

	// Where a row of a part begins in the shared film.
	std::size_t film_pixel(const Part& part, std::size_t row) const
	{
		return (part.window.y + row) * shared_.packed.scene.window_width + part.window.x;
	}

	// The part's pixels from `first` on; `store`: they are still zero in the shared film.
	void add_pixels(const Part& part, std::size_t first, std::size_t count, const rt_film_pixel* pixels, bool store)
	{
		constexpr std::uint64_t segments_mask = (std::uint64_t(1) << RT_TALLY_REJECTED_SHIFT) - 1;
		const std::size_t width = part.window.width;
		std::atomic<std::uint64_t> segments{0}, rejected{0};
		parallel_for(count, pixels_a_thread, [&](std::uint64_t begin, std::uint64_t end) {
			std::uint64_t piece_segments = 0, piece_rejected = 0;
			for (std::uint64_t i = begin; i < end;) {
				const std::size_t row = (first + i) / width, column = (first + i) % width;
				std::int64_t* sums = shared_.film.sums().data() + (film_pixel(part, row) + column) * 3;
				for (const std::uint64_t row_end = std::min(end, i + (width - column)); i < row_end; ++i, sums += 3) {
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
			}
			segments += piece_segments;
			rejected += piece_rejected;
		});
		shared_.film.segments += segments;
		shared_.film.rejected += rejected;
	}

	// What done_ took of each pixel of the page, as above.
	void add_samples(bool store)
	{
		// All launches of a row together: most took whole pages. The rows of all parts, one part after the other.
		std::vector<std::size_t> first_rows;
		std::size_t rows = 0;
		for (const Part& part : page_->parts) {
			first_rows.push_back(rows);
			rows += part.window.height;
		}
		std::vector<std::uint32_t> row_samples(rows, 0);
		for (const Work& work : done_)
			for (std::uint32_t row = 0; row < work.rows; ++row)
				row_samples[first_rows[work.part] + work.first_row + row] += work.samples;
		for (std::size_t index = 0; index < page_->parts.size(); ++index)
			add_samples(page_->parts[index], row_samples.data() + first_rows[index], store);
	}

	void add_samples(const Part& part, const std::uint32_t* row_samples, bool store)
	{
		const std::size_t width = part.window.width;
		parallel_for(part.window.height, 4 * pixels_a_thread / width + 1, [&](std::uint64_t begin, std::uint64_t end) {
			for (std::uint64_t row = begin; row < end; ++row) {
				std::uint32_t* samples = shared_.film.samples().data() + film_pixel(part, row);
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
	rt_few_spheres few_{};
	SceneBuffers lists_;
	BufferHandle film_;
	const Page* page_ = nullptr;
	std::uint32_t slices_ = 1;
	bool film_is_clear_ = false; // empty, or holding only the sums of done_
	std::vector<Work> done_;     // launches whose sums are on the device and not yet in the film
	double budget_ = 0;          // pixel samples for the next launch
	unsigned snapshot_round_ = 0;
};

// `beside`: bytes of host memory that the caller takes beside the film.
Status check_memory(const PackedScene& packed, const std::vector<DeviceHandle>& devices, std::uint64_t beside)
{
	constexpr double mebibyte = 1024.0 * 1024.0;
	const std::uint64_t host = host_bytes_needed(packed) + beside, free_host = available_host_bytes();
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
	const std::uint32_t lanes = render_lanes(packed, device, options);
	const std::uint32_t own = packed.features | (wants_bvh(packed, lanes, options.bvh) ? bvh_features : 0u);
	const std::uint32_t features = options.specialise ? own : std::uint32_t(RT_FEATURE_ALL);
	const bool permuted = (own & RT_FEATURE_PERMUTED) != 0;
	spec.defines.emplace_back("RT_LANES", fmt::format("{}", lanes));
	spec.defines.emplace_back("RT_FEATURES", fmt::format("{:#x}u", features));
	spec.defines.emplace_back("RT_DEF_NATIVE_ROOTS", options.software_roots ? "0" : "1");
	set_precision(spec, options.precision, options.fast_parts);
	if (options.allow_contraction)
		spec.defines.emplace_back("RT_DEF_CONTRACT", "1");
	if (options.specialise && !permuted && device.indexes_parameters && packed.spheres.size() <= RT_MAX_FEW_SPHERES) {
		spec.defines.emplace_back("RT_DEF_SPHERE_COUNT", fmt::format("{}", packed.spheres.size()));
		spec.defines.emplace_back("RT_DEF_WIDE_COUNT", fmt::format("{}", packed.wide.size()));
	}
	if ((features & RT_FEATURE_BVH) != 0)
		spec.registers = tree_registers;
	spec.defines.emplace_back("RT_PROGRAM_ID", fmt::format("{:#x}u", program_id(spec)));
	return spec;
}

bool wants_bvh(const PackedScene& packed, std::uint32_t lanes, Acceleration bvh)
{
	if (bvh != Acceleration::Auto || !packed.bvh.empty())
		return bvh == Acceleration::Always && packed.bvh.empty() && packed.spheres.size() > packed.wide.size();
	const std::size_t listed = packed.spheres.size() - packed.wide.size();
	return listed >= (lanes == 1                 ? min_bvh_spheres_one_lane
	                  : lanes <= most_tree_lanes ? min_bvh_spheres_lanes
	                                             : min_bvh_spheres_16_lanes);
}

std::uint32_t render_lanes(const PackedScene& packed, const DeviceInfo& device, const SessionOptions& options)
{
	if (options.lanes)
		return options.lanes;
	const std::uint32_t own = lanes_for(device, options.precision);
	const bool through_tree = !packed.bvh.empty() || wants_bvh(packed, own, options.bvh);
	return through_tree ? std::min(own, most_tree_lanes) : own;
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

struct Session::State {
	State(const PackedScene& packed, const SessionOptions& options) : shared(packed, options) {}

	Shared shared;
	std::map<std::uint32_t, PackedScene> trees; // one for each width of lanes among the devices
	std::vector<Worker> workers;
	std::size_t page_pixels = 0;
	bool interrupted = false, begun = false;
	bool film_is_fresh = true; // nothing is in it
	double bvh_seconds = 0, render_seconds = 0;

	// `fresh`: nothing has been rendered into the film yet but other pages.
	void render_page(const Page& page, std::uint32_t first_sample, std::uint32_t samples, bool fresh)
	{
		const SessionOptions& options = shared.options;
		WorkQueue queue(page, first_sample, samples, options.rows_per_launch, options.samples_per_launch);
		shared.workers = static_cast<unsigned>(workers.size());
		shared.page_workers = workers.size();
		shared.page_is_fresh = fresh;
		const auto work = [&](Worker& worker) {
			Status status = worker.begin_page(page, samples);
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
};

Session::Session(std::unique_ptr<State> state) : state_(std::move(state)) {}
Session::Session(Session&&) noexcept = default;
Session& Session::operator=(Session&&) noexcept = default;
Session::~Session() = default;

Result<Session> Session::open(const PackedScene& packed, const std::vector<DeviceHandle>& devices,
                              const SessionOptions& options)
{
	RT_TRY(check_memory(packed, devices, options.host_bytes_beside));
	const rt_scene& scene = packed.scene;
	auto state = std::make_unique<State>(packed, options);
	state->shared.film =
	    Film(scene.width, scene.height, {scene.window_x, scene.window_y, scene.window_width, scene.window_height},
	         packed.film_exponent);
	if (options.start) {
		RT_TRY(state->shared.film.add(*options.start));
		state->film_is_fresh = false;
	}

	std::map<std::uint32_t, PackedScene>& trees = state->trees;
	std::vector<Worker>& workers = state->workers;
	workers.reserve(devices.size());
	std::uint64_t max_alloc = 0;
	for (const DeviceHandle& device : devices) {
		const std::uint32_t lanes = render_lanes(packed, device->info(), options);
		if (wants_bvh(packed, lanes, options.bvh) && !trees.count(lanes)) {
			if (options.status)
				options.status(fmt::format("building a tree of {} spheres", packed.spheres.size()));
			const Clock::time_point start = Clock::now();
			RT_TRY_ASSIGN(trees[lanes], with_bvh(packed, lanes));
			state->bvh_seconds += seconds_since(start);
		}
		const auto tree = trees.find(lanes);
		const bool last = std::none_of(
		    devices.begin() + static_cast<std::ptrdiff_t>(workers.size()) + 1, devices.end(),
		    [&](const DeviceHandle& later) { return render_lanes(packed, later->info(), options) == lanes; });
		workers.emplace_back(device, tree == trees.end() ? packed : tree->second,
		                     tree == trees.end() || !last ? nullptr : &tree->second, state->shared);
		RT_TRY(workers.back().prepare());
		const std::uint64_t bytes = device->info().max_alloc_bytes;
		max_alloc = max_alloc && bytes ? std::min(max_alloc, bytes) : std::max(max_alloc, bytes);
	}
	state->page_pixels = std::size_t(page_rows(packed, max_alloc)) * scene.window_width;
	if (options.late_software_roots) {
		RT_TRY_ASSIGN(const bool needed, options.late_software_roots());
		if (needed && !std::exchange(state->shared.options.software_roots, true))
			for (Worker& worker : workers)
				RT_TRY(worker.build());
	}
	return Session(std::move(state));
}

Result<bool> Session::take(std::uint32_t first_sample, std::uint32_t samples, const std::vector<Window>& windows)
{
	Shared& shared = state_->shared;
	const Clock::time_point start = Clock::now();
	if (!std::exchange(state_->begun, true))
		shared.start = shared.last_progress = start;
	const bool fresh = std::exchange(state_->film_is_fresh, false);
	std::uint64_t wanted = shared.samples_done;
	for (const Page& page : pages_of(windows, state_->page_pixels)) {
		wanted += std::uint64_t(page.part_pixels) * samples;
		if (!shared.must_stop())
			state_->render_page(page, first_sample, samples, fresh);
	}
	state_->render_seconds += seconds_since(start);
	if (shared.error)
		return *shared.error;
	state_->interrupted = shared.samples_done < wanted;
	return !state_->interrupted;
}

void Session::expect_samples(std::uint64_t total) { state_->shared.samples_total = total; }
const Film& Session::film() const { return state_->shared.film; }

SessionResult Session::finish() &&
{
	Shared& shared = state_->shared;
	shared.report_progress(true);
	SessionResult result;
	result.interrupted = state_->interrupted;
	result.bvh_seconds = state_->bvh_seconds;
	result.render_seconds = state_->render_seconds;
	for (const Worker& worker : state_->workers)
		result.devices.push_back(worker.stats());
	result.film = std::move(shared.film);
	return result;
}

Result<SessionResult> render_scene(const PackedScene& packed, const std::vector<DeviceHandle>& devices,
                                   const SessionOptions& options)
{
	RT_TRY_ASSIGN(Session session, Session::open(packed, devices, options));
	session.expect_samples(session.film().pixels() * options.samples);
	const rt_scene& scene = packed.scene;
	RT_TRY(session.take(options.first_sample, options.samples, {{0, 0, scene.window_width, scene.window_height}}));
	return std::move(session).finish();
}

} // namespace rt
