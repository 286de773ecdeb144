#include "render/trace_file.h"

#include "backends/embedded_text.h"
#include "backends/kernel_text.h"
#include "common/rt_contract.h"
#include "support/hash.h"

#include <fmt/format.h>
#include <map>
#include <nlohmann/json.hpp>
#include <tuple>

namespace rt {
namespace {

using Json = nlohmann::ordered_json;

constexpr int trace_format = 1;

std::string hex(std::uint64_t value) { return fmt::format("{:08x}", value); }

std::uint64_t from_hex(const Json& text) { return std::stoull(text.get<std::string>(), nullptr, 16); }

Json film_json(const rt_film_pixel& pixel) { return {pixel.r, pixel.g, pixel.b, pixel.tally}; }

rt_film_pixel film_from(const Json& json)
{
	rt_film_pixel pixel{};
	pixel.r = json.at(0).get<std::int64_t>();
	pixel.g = json.at(1).get<std::int64_t>();
	pixel.b = json.at(2).get<std::int64_t>();
	pixel.tally = json.at(3).get<std::int64_t>();
	return pixel;
}

Json site_json(const TraceCode& code)
{
	Json json = {{"file", code.file < embedded_text_count ? embedded_texts[code.file].path : ""},
	             {"line", code.line},
	             {"number", code.number},
	             {"operation", name_of(code.kind)},
	             {"code", code.what() & 0xffffu}};
	if (const TraceSite* site = trace_site(code)) {
		json["function"] = site->function;
		json["source"] = site->source;
		if (!site->target.empty())
			json["target"] = site->target;
	}
	return json;
}

TraceCode code_from(const Json& json)
{
	TraceCode code = TraceCode::from(json.at("code").get<std::uint32_t>(), 0);
	code.line = json.at("line").get<std::uint32_t>();
	code.number = json.at("number").get<std::uint32_t>();
	const auto file = json.at("file").get<std::string>();
	while (code.file < embedded_text_count && file != embedded_texts[code.file].path)
		++code.file;
	return code;
}

template <class T>
void add_list(Hasher& hasher, const std::vector<T>& list)
{
	hasher.add_u64(list.size());
	hasher.add(list.data(), list.size() * sizeof(T));
}

Error other_kernels(const std::string& path, const std::string& message)
{
	return Error{ErrorKind::Usage,
	             message,
	             path,
	             "both sides must run the same version of rt: `rt --version` names its kernels",
	             {}};
}

SavedTrace parse(const Json& json)
{
	SavedTrace saved;
	saved.kernels = json.at("kernels").get<std::string>();
	saved.contract = json.at("contract").get<std::uint32_t>();
	const Json& device = json.at("device");
	saved.backend = device.at("backend").get<std::string>();
	saved.device = device.at("name").get<std::string>();
	saved.driver = device.at("driver").get<std::string>();
	const Json& scene = json.at("scene");
	saved.scene = scene.at("name").get<std::string>();
	saved.inputs = scene.at("inputs").get<std::string>();
	saved.width = scene.at("width").get<std::uint32_t>();
	saved.height = scene.at("height").get<std::uint32_t>();
	const Json& launch = json.at("launch");
	saved.trace.launch.x = launch.at("x").get<std::uint32_t>();
	saved.trace.launch.y = launch.at("y").get<std::uint32_t>();
	saved.trace.launch.first_sample = launch.at("first_sample").get<std::uint32_t>();
	saved.trace.launch.samples = launch.at("samples").get<std::uint32_t>();
	saved.trace.launch.before = film_from(launch.at("film_before"));
	saved.trace.after = film_from(json.at("film_traced"));
	saved.ordinary = film_from(json.at("film"));
	return saved;
}

void parse_notes(const Json& json, Trace& trace)
{
	std::vector<TraceCode> sites;
	for (const Json& site : json.at("sites"))
		sites.push_back(code_from(site));
	for (const Json& row : json.at("notes"))
		trace.notes.push_back({sites.at(row.at(0).get<std::size_t>()),
		                       {from_hex(row.at(1)), from_hex(row.at(2)), from_hex(row.at(3))},
		                       from_hex(row.at(4))});
	trace.note_count = trace.notes.size();
}

} // namespace

std::string inputs_hash(const PackedScene& packed)
{
	Hasher hasher;
	rt_scene scene = packed.scene;
	scene.window_x = scene.window_y = scene.window_width = scene.window_height = 0;
	hasher.add(&scene, sizeof scene);
	add_list(hasher, packed.spheres);
	add_list(hasher, packed.wide);
	add_list(hasher, packed.sphere_ids);
	add_list(hasher, packed.sphere_materials);
	add_list(hasher, packed.materials);
	add_list(hasher, packed.textures);
	add_list(hasher, packed.texels);
	add_list(hasher, packed.lights);
	return hasher.result().hex();
}

std::string write_trace(const SavedTrace& saved)
{
	std::map<std::tuple<std::uint32_t, std::uint32_t>, std::size_t> known;
	Json sites = Json::array(), notes = Json::array();
	for (const TraceNote& note : saved.trace.notes) {
		const auto [place, is_new] = known.emplace(std::make_tuple(note.code.what(), note.code.where()), sites.size());
		if (is_new)
			sites.push_back(site_json(note.code));
		notes.push_back(
		    {place->second, hex(note.operands[0]), hex(note.operands[1]), hex(note.operands[2]), hex(note.result)});
	}
	const PixelLaunch& launch = saved.trace.launch;
	const Json head = {
	    {"rt_trace", trace_format},
	    {"kernels", saved.kernels},
	    {"contract", saved.contract},
	    {"device", {{"backend", saved.backend}, {"name", saved.device}, {"driver", saved.driver}}},
	    {"scene", {{"name", saved.scene}, {"inputs", saved.inputs}, {"width", saved.width}, {"height", saved.height}}},
	    {"launch",
	     {{"x", launch.x},
	      {"y", launch.y},
	      {"first_sample", launch.first_sample},
	      {"samples", launch.samples},
	      {"film_before", film_json(launch.before)}}},
	    {"film", film_json(saved.ordinary)},
	    {"film_traced", film_json(saved.trace.after)}};
	// One line a site and a note: such files are read and compared by people too.
	const auto replace = Json::error_handler_t::replace;
	std::string text = head.dump(1, '\t', false, replace);
	text.resize(text.size() - 2); // its line feed and brace
	const auto add_rows = [&](const char* name, const Json& rows) {
		text += fmt::format(",\n\t\"{}\": [", name);
		for (std::size_t i = 0; i < rows.size(); ++i)
			text += (i == 0 ? "\n\t\t" : ",\n\t\t") + rows[i].dump(-1, ' ', false, replace);
		text += "\n\t]";
	};
	add_rows("sites", sites);
	add_rows("notes", notes);
	return text + "\n}\n";
}

Result<SavedTrace> read_trace(const std::string& text, const std::string& path)
{
	// The library throws at whatever is not as expected; it goes no further than this.
	try {
		const Json json = Json::parse(text);
		if (!json.is_object() || !json.contains("rt_trace") || json.at("rt_trace") != trace_format)
			return Error{ErrorKind::InputOutput,
			             "this is no trace of this version of rt",
			             path,
			             "make one with rt trace SCENE --pixel X,Y --json FILE",
			             {}};
		SavedTrace saved = parse(json);
		if (saved.contract != RT_CONTRACT_VERSION)
			return other_kernels(path, fmt::format("the trace is of contract {}, this rt of contract {}",
			                                       saved.contract, RT_CONTRACT_VERSION));
		if (saved.kernels != kernel_hash())
			return other_kernels(
			    path, fmt::format("the trace is of kernels {}, this rt has {}", saved.kernels, kernel_hash()));
		parse_notes(json, saved.trace);
		return saved;
	} catch (const std::exception& exception) {
		return Error{ErrorKind::InputOutput,
		             std::string("the trace cannot be read: ") + exception.what(),
		             path,
		             "make it anew with rt trace SCENE --pixel X,Y --json FILE",
		             {}};
	}
}

} // namespace rt
