#include "render/trace_path.h"

#include <algorithm>
#include <fmt/format.h>

namespace rt {
namespace {

// A variable of a kernel worth telling, and its name for people. The longer of two that fit comes first.
struct Told {
	const char* function;
	const char* variable;
	const char* name;
};

constexpr Told told[] = {
    {"rt_path_start", "u", "random numbers"},
    {"rt_path_start", "path.ray.base", "ray base"},
    {"rt_path_start", "path.ray.arm", "ray arm"},
    {"rt_path_start", "path.ray.reach", "ray reach"},
    {"rt_path_start", "path.ray.dir", "ray direction"},
    {"rt_path_step", "hit.t", "t"},
    {"rt_path_step", "hit.index", "sphere, as stored"},
    {"rt_path_step", "hit.id", "sphere id"},
    {"rt_path_step", "sky", "sky"},
    {"rt_path_step", "path->radiance", "radiance so far"},
    {"rt_path_scatter", "surface.normal", "normal"},
    {"rt_path_scatter", "material", "material"},
    {"rt_path_scatter", "kind", "its kind"},
    {"rt_path_scatter", "emission", "emission"},
    {"rt_path_scatter", "c", "cosine of incidence"},
    {"rt_path_scatter", "u", "random numbers"},
    {"rt_path_scatter", "albedo", "albedo"},
    {"rt_path_scatter", "throughput", "throughput"},
    {"rt_path_scatter", "path->ray.base", "ray base"},
    {"rt_path_scatter", "path->ray.arm", "ray arm"},
    {"rt_path_scatter", "path->ray.reach", "ray reach"},
    {"rt_path_scatter", "path->ray.dir", "ray direction"},
    {"rt_path_scatter", "path->ray.chord", "chord"},
    {"rt_film_sample", "radiance", "radiance"},
};

const char* name_told(const TraceSite& site)
{
	for (const Told& candidate : told) {
		const std::string variable = candidate.variable;
		if (site.function == candidate.function &&
		    (site.target == variable || site.target.rfind(variable + ".", 0) == 0))
			return candidate.name;
	}
	return nullptr;
}

class Reader {
public:
	void see(const TraceNote& note)
	{
		const TraceSite* site = trace_site(note.code);
		if (!site)
			return;
		if (note.code.kind == TraceKind::Call)
			return called(site->target);
		const char* name = name_told(*site);
		if (!name || steps_.empty())
			return;
		std::vector<PathValue>& values = steps_.back().values;
		auto value = std::find_if(values.begin(), values.end(), [&](const PathValue& v) { return v.name == name; });
		if (value == values.end())
			value = values.insert(values.end(), {name, note.code.result, {}});
		// A variable that is set again: the last value is told.
		if (last_site_ == nullptr || site->code.line != last_site_->code.line || name != last_name_)
			value->bits.clear();
		value->bits.push_back(note.result);
		last_site_ = site;
		last_name_ = name;
	}

	std::vector<PathStep> take() && { return std::move(steps_); }

private:
	void called(const std::string& function)
	{
		last_site_ = nullptr;
		if (function == "rt_path_start") {
			steps_.push_back({"camera", {}});
			segments_ = 0;
		} else if (function == "rt_closest_hit") {
			steps_.push_back({fmt::format("segment {}", segments_++), {}});
		} else if (function == "rt_path_scatter") {
			steps_.push_back({fmt::format("scattering {}", segments_), {}});
		} else if (function == "rt_film_sample") {
			steps_.push_back({"film", {}});
		}
	}

	std::vector<PathStep> steps_;
	unsigned segments_ = 0;
	const TraceSite* last_site_ = nullptr;
	const char* last_name_ = nullptr;
};

} // namespace

std::vector<PathStep> path_of(const Trace& trace)
{
	Reader reader;
	for (const TraceNote& note : trace.notes)
		reader.see(note);
	std::vector<PathStep> steps = std::move(reader).take();
	// The loop starts a next sample, which the launch does not take.
	if (!steps.empty() && steps.back().title == "camera")
		steps.pop_back();
	return steps;
}

} // namespace rt
