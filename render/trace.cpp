#include "render/trace.h"

#include "backends/embedded_text.h"
#include "common/rt_features.h"

#include <algorithm>
#include <fmt/format.h>
#include <map>
#include <tuple>

namespace rt {
namespace {

// kernels/trace.h
constexpr std::size_t log_header_words = 4, log_note_words = 5;
// A tile of the render kernel; all but one of its pixels lie outside of a window of one.
constexpr std::uint32_t tile_pixels = 32;

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
	tracer.scene_values_ = packed.scene;
	tracer.lanes_ = options.lanes ? options.lanes : tracer.info().native_lanes;

	const ProgramSpec spec = render_program(packed, tracer.info(), options);
	tracer.expected_id_ = integer_define(spec, "RT_PROGRAM_ID", 0);
	RT_TRY_ASSIGN(tracer.ordinary_, tracer.device_->build(spec));

	// Generic, so that the notes of all devices are of one text; specialising changes no operation that remains.
	tracer.traced_spec_.root = "kernels/trace.cl";
	tracer.traced_spec_.traced = true;
	tracer.traced_spec_.entries = {"rt_render"};
	const bool own_roots = options.software_roots || tracer.info().hardware_seeds;
	tracer.traced_spec_.defines = {{"RT_LANES", "1"},
	                               {"RT_FEATURES", fmt::format("{:#x}u", unsigned(RT_FEATURE_ALL))},
	                               {"RT_DEF_NATIVE_ROOTS", own_roots ? "0" : "1"}};
	RT_TRY(tracer.upload(packed));
	return tracer;
}

Status Tracer::upload(const PackedScene& packed)
{
	const auto put = [this](BufferHandle& buffer, const auto& list) -> Status {
		// An empty list still needs memory that a kernel's argument can point to.
		using Item = typename std::decay_t<decltype(list)>::value_type;
		const Item nothing{};
		const std::size_t bytes = std::max<std::size_t>(1, list.size()) * sizeof(Item);
		RT_TRY_ASSIGN(buffer, device_->alloc(bytes));
		return device_->write(buffer, 0, list.empty() ? &nothing : list.data(), bytes);
	};
	RT_TRY_ASSIGN(scene_, device_->alloc(sizeof(rt_scene)));
	RT_TRY_ASSIGN(film_, device_->alloc(sizeof(rt_film_pixel)));
	RT_TRY(put(spheres_, packed.spheres));
	RT_TRY(put(wide_, packed.wide));
	RT_TRY(put(ids_, packed.sphere_ids));
	RT_TRY(put(sphere_materials_, packed.sphere_materials));
	RT_TRY(put(materials_, packed.materials));
	RT_TRY(put(textures_, packed.textures));
	return put(texels_, packed.texels);
}

Status Tracer::set_pixel(const PixelLaunch& launch, std::uint32_t max_depth)
{
	rt_scene scene = scene_values_;
	scene.window_x = launch.x;
	scene.window_y = launch.y;
	scene.window_width = scene.window_height = 1;
	if (max_depth)
		scene.max_depth = max_depth;
	RT_TRY(device_->write(scene_, 0, &scene, sizeof scene));
	return device_->write(film_, 0, &launch.before, sizeof launch.before);
}

std::vector<Argument> Tracer::arguments(const PixelLaunch& launch) const
{
	return {scene_,     spheres_, wide_,  ids_, sphere_materials_, materials_,          textures_,
	        texels_, film_,    0u,     1u,   launch.first_sample, launch.samples};
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
	RT_TRY(set_pixel(launch, max_depth));
	RT_TRY(device_->launch(ordinary_, "rt_render", tile_pixels / lanes_, arguments(launch)));
	return film();
}

Result<Trace> Tracer::trace(const PixelLaunch& launch, std::uint64_t first_note, std::uint64_t most_notes)
{
	if (!traced_) {
		RT_TRY_ASSIGN(traced_, device_->build(traced_spec_));
	}
	const std::size_t bytes = (log_header_words + most_notes * log_note_words) * sizeof(std::uint64_t);
	if (!log_ || log_->bytes() < bytes) {
		log_.reset();
		RT_TRY_ASSIGN(log_, device_->alloc(bytes));
	}
	const std::uint64_t header[log_header_words] = {0, first_note, most_notes, 0};
	RT_TRY(device_->write(log_, 0, header, sizeof header));
	RT_TRY(set_pixel(launch, 0));
	std::vector<Argument> with_log = arguments(launch);
	with_log.insert(with_log.begin(), log_);
	RT_TRY(device_->launch(traced_, "rt_render", 1, with_log));

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
