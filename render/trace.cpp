#include "render/trace.h"

#include "backends/embedded_text.h"
#include "common/rt_features.h"
#include "render/bvh.h"

#include <algorithm>
#include <fmt/format.h>
#include <map>
#include <tuple>

namespace rt {
namespace {

// kernels/trace.h
constexpr std::size_t log_header_words = 4, log_note_words = 5, log_items = 256;

using Place = std::tuple<std::uint32_t, std::uint32_t, std::uint32_t>;

std::map<Place, TraceSite> read_sites()
{
	const std::vector<EmbeddedText> files(embedded_texts, embedded_texts + embedded_text_count);
	std::map<Place, TraceSite> sites;
	for (TraceSite& site : trace_kernels(files).sites) {
		const Place place{site.code.file, site.code.line, site.code.number};
		sites.emplace(place, std::move(site));
	}
	return sites;
}

// One row of one pixel.
RenderRange range_of(const PixelLaunch& launch)
{
	RenderRange range;
	range.rows = range.slice_pixels = 1;
	range.first_sample = launch.first_sample;
	range.samples = launch.samples;
	return range;
}

} // namespace

bool same_sums(const rt_film_pixel& a, const rt_film_pixel& b)
{
	return a.r == b.r && a.g == b.g && a.b == b.b && a.tally == b.tally;
}

const TraceSite* trace_site(const TraceCode& code)
{
	static const std::map<Place, TraceSite> sites = read_sites();
	const auto found = sites.find({code.file, code.line, code.number});
	return found == sites.end() ? nullptr : &found->second;
}

Result<Tracer> Tracer::make(DeviceHandle device, const PackedScene& packed, const SessionOptions& options)
{
	Tracer tracer;
	tracer.device_ = std::move(device);
	tracer.lanes_ = render_lanes(packed, tracer.info(), options);

	const auto stored_for = [&packed, &options](std::uint32_t lanes) -> Result<PackedScene> {
		if (wants_bvh(packed, lanes, options.bvh))
			return with_bvh(packed, lanes);
		return packed;
	};
	RT_TRY_ASSIGN(const PackedScene ordinary, stored_for(tracer.lanes_));
	RT_TRY_ASSIGN(tracer.ordinary_scene_, tracer.upload(ordinary));
	RT_TRY_ASSIGN(const PackedScene traced, stored_for(1));
	RT_TRY_ASSIGN(tracer.traced_scene_, tracer.upload(traced));
	RT_TRY_ASSIGN(tracer.film_, tracer.device_->alloc(sizeof(rt_film_pixel)));

	const ProgramSpec spec = render_program(ordinary, tracer.info(), options);
	tracer.expected_id_ = integer_define(spec, "RT_PROGRAM_ID", 0);
	RT_TRY_ASSIGN(tracer.ordinary_, tracer.device_->build(spec));

	// Generic, so that the notes of all devices are of one text; specialising changes no operation that remains.
	tracer.traced_spec_.root = "kernels/trace.cl";
	tracer.traced_spec_.traced = true;
	tracer.traced_spec_.entries = {"rt_render"};
	tracer.traced_spec_.defines = {{"RT_LANES", "1"},
	                               {"RT_FEATURES", fmt::format("{:#x}u", unsigned(RT_FEATURE_ALL))},
	                               {"RT_DEF_NATIVE_ROOTS", options.software_roots ? "0" : "1"}};
	return tracer;
}

Result<Tracer::Resident> Tracer::upload(const PackedScene& packed) const
{
	Resident resident;
	resident.scene = packed.scene;
	if (packed.spheres.size() <= RT_MAX_FEW_SPHERES) {
		std::copy(packed.spheres.begin(), packed.spheres.end(), resident.few.spheres);
		std::copy(packed.wide.begin(), packed.wide.end(), resident.few.wide);
	}
	const auto put = [this](BufferHandle& buffer, const auto& list) -> Status {
		// An empty list still needs memory that a kernel's argument can point to.
		using Item = typename std::decay_t<decltype(list)>::value_type;
		const Item nothing{};
		const std::size_t bytes = std::max<std::size_t>(1, list.size()) * sizeof(Item);
		RT_TRY_ASSIGN(buffer, device_->alloc(bytes));
		return device_->write(buffer, 0, list.empty() ? &nothing : list.data(), bytes);
	};
	RT_TRY(put(resident.lists.spheres, packed.spheres));
	RT_TRY(put(resident.lists.wide, packed.wide));
	RT_TRY(put(resident.lists.ids, packed.sphere_ids));
	RT_TRY(put(resident.lists.sphere_materials, packed.sphere_materials));
	RT_TRY(put(resident.lists.bvh, packed.bvh));
	RT_TRY(put(resident.lists.materials, packed.materials));
	RT_TRY(put(resident.lists.textures, packed.textures));
	RT_TRY(put(resident.lists.texels, packed.texels));
	RT_TRY(put(resident.lists.lights, packed.lights));
	return resident;
}

Result<std::vector<Argument>> Tracer::arguments(const Resident& resident, const PixelLaunch& launch,
                                                std::uint32_t max_depth)
{
	rt_scene scene = resident.scene;
	scene.window_x = launch.x;
	scene.window_y = launch.y;
	scene.window_width = scene.window_height = 1;
	if (max_depth)
		scene.max_depth = max_depth;
	RT_TRY(device_->write(film_, 0, &launch.before, sizeof launch.before));
	return render_arguments(scene, resident.few, resident.lists, film_, range_of(launch));
}

Result<rt_film_pixel> Tracer::film()
{
	RT_TRY(device_->wait());
	rt_film_pixel pixel{};
	RT_TRY(device_->read(film_, 0, &pixel, sizeof pixel));
	return pixel;
}

Result<rt_film_pixel> Tracer::render(const PixelLaunch& launch, std::uint32_t max_depth)
{
	RT_TRY_ASSIGN(const std::vector<Argument> values, arguments(ordinary_scene_, launch, max_depth));
	// All pixels of the tile but one lie outside of the window.
	RT_TRY(device_->launch(ordinary_, "rt_render", render_items(1, range_of(launch), lanes_), values,
	                       render_group(lanes_)));
	return film();
}

Result<Trace> Tracer::trace(const PixelLaunch& launch, std::uint64_t first_note, std::uint64_t most_notes)
{
	if (!traced_) {
		RT_TRY_ASSIGN(traced_, device_->build(traced_spec_));
	}
	// Behind the notes, room for one that does not fit, and a log of that size for each other work-item.
	const std::size_t other_words = (log_items + 1) * (log_header_words + log_note_words);
	const std::size_t bytes = (other_words + most_notes * log_note_words) * sizeof(std::uint64_t);
	if (!log_ || log_->bytes() < bytes) {
		log_.reset();
		RT_TRY_ASSIGN(log_, device_->alloc(bytes));
	}
	const std::vector<std::uint64_t> nothing(other_words);
	RT_TRY(
	    device_->write(log_, bytes - other_words * sizeof nothing[0], nothing.data(), other_words * sizeof nothing[0]));
	const std::uint64_t header[log_header_words] = {0, first_note, most_notes, 0};
	RT_TRY(device_->write(log_, 0, header, sizeof header));
	RT_TRY_ASSIGN(std::vector<Argument> with_log, arguments(traced_scene_, launch, 0));
	with_log.insert(with_log.begin(), log_);
	RT_TRY(device_->launch(traced_, "rt_render", 1, with_log, 1));

	Trace trace;
	trace.launch = launch;
	trace.first_note = first_note;
	RT_TRY_ASSIGN(trace.after, film());
	RT_TRY(device_->read(log_, 0, &trace.note_count, sizeof trace.note_count));
	const std::uint64_t left = trace.note_count > first_note ? trace.note_count - first_note : 0;
	std::vector<std::uint64_t> words(std::min(left, most_notes) * log_note_words);
	if (!words.empty())
		RT_TRY(device_->read(log_, sizeof header, words.data(), words.size() * sizeof words[0]));
	trace.notes.reserve(words.size() / log_note_words);
	for (std::size_t i = 0; i < words.size(); i += log_note_words)
		trace.notes.push_back(
		    {TraceCode::from(static_cast<std::uint32_t>(words[i] >> 32), static_cast<std::uint32_t>(words[i])),
		     {words[i + 1], words[i + 2], words[i + 3]},
		     words[i + 4]});
	return trace;
}

Result<std::uint32_t> Tracer::program_id()
{
	RT_TRY_ASSIGN(const BufferHandle out, device_->alloc(sizeof(std::uint32_t)));
	std::uint32_t id = 0;
	RT_TRY(device_->write(out, 0, &id, sizeof id));
	RT_TRY(device_->launch(ordinary_, "rt_identify", 1, {out}));
	RT_TRY(device_->wait());
	RT_TRY(device_->read(out, 0, &id, sizeof id));
	return id;
}

} // namespace rt
