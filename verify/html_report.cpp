#include "verify/verify_report.h"

#include "render/compare.h"
#include "render/image_file.h"
#include "render/image_read.h"
#include "verify/html_page.h"

#include <fmt/format.h>

#include <algorithm>

namespace rt {

namespace {

class HtmlReport {
public:
	explicit HtmlReport(const VerifyReport& report) : report_(report), tested_(report.verification) {}

	std::string text()
	{
		head();
		devices();
		odd();
		arithmetic();
		if (!report_.probe_only) {
			films();
			matrix();
			speed();
			pictures();
		}
		surroundings();
		out_ += html_end;
		return std::move(out_);
	}

private:
	const std::vector<VerifiedDevice>& list() const { return tested_.devices; }

	void cell(const std::string& html, const char* kind = "")
	{
		out_ += fmt::format("<td class=\"{}\">{}</td>", kind, html);
	}
	void row_of(const char* name, const std::string& value)
	{
		out_ += fmt::format("<tr><th>{}</th><td>{}</td></tr>\n", name, html_escape(value));
	}

	// A heading for each device.
	void device_heads(const char* first)
	{
		out_ += fmt::format("<div class=\"scroll\"><table><thead><tr><th>{}</th>", first);
		for (const VerifiedDevice& device : list())
			out_ += fmt::format("<th>{}: {} <small>({})</small></th>", device.index, html_escape(device.info.name),
			                    html_escape(device.info.backend));
		out_ += "</tr></thead><tbody>\n";
	}
	void end_table() { out_ += "</tbody></table></div>\n"; }

	void head()
	{
		const HostFacts& host = report_.host;
		const auto passed =
		    std::count_if(list().begin(), list().end(), [](const auto& device) { return device.passed(); });
		const bool all = tested_.passed();
		out_ += html_head(all ? "rt verify: passed" : "rt verify: FAILED");
		out_ += "<h1>rt verify</h1>\n";
		out_ += fmt::format("<p class=\"verdict {}\">{}: {} of {} devices keep the numeric contract</p>\n",
		                    all ? "good" : "bad", all ? "Passed" : "Failed", passed, list().size());
		out_ += "<table>\n";
		row_of("rt", fmt::format("{} (revision {})", host.version, host.revision));
		row_of("numeric contract", std::to_string(host.contract));
		row_of("kernels", host.kernels);
		row_of("system", fmt::format("{}; {}", host.system, host.kernel));
		row_of("host", fmt::format("{}, {} threads, built by {}", host.processor, host.threads, host.compiler));
		row_of("date", fmt::format("{}, {:.1f} s", host.date, tested_.seconds));
		out_ += "</table>\n";
	}

	void devices()
	{
		out_ += "<h2>Devices</h2>\n<div class=\"scroll\"><table><thead><tr><th></th><th>backend</th><th>name</th>"
		        "<th>platform</th><th>driver</th><th>compiler</th><th>verdict</th></tr></thead><tbody>\n";
		for (const VerifiedDevice& device : list()) {
			const DeviceInfo& info = device.info;
			out_ += "<tr>";
			cell(std::to_string(device.index), "number");
			for (const std::string& text : {info.backend, info.name, info.platform, info.driver, info.compiler})
				cell(html_escape(text));
			cell(device.passed() ? "passed" : "failed: " + html_escape(device.first_failure()),
			     device.passed() ? "good" : "bad");
			out_ += "</tr>\n";
		}
		end_table();
		out_ += "<ul>\n";
		for (std::size_t i = 0; i < report_.found.devices.size(); ++i)
			if (const DeviceInfo& info = report_.found.devices[i]; !info.usable)
				out_ += fmt::format("<li>{} ({}, {}): unusable, {}</li>\n", html_escape(info.name), i,
				                    html_escape(info.backend), html_escape(info.why_not));
		for (const Absence& absence : report_.found.absences)
			out_ +=
			    fmt::format("<li>missing: {}: {}</li>\n", html_escape(absence.backend), html_escape(absence.reason));
		out_ += "</ul>\n";
	}

	void odd()
	{
		if (report_.odd.empty())
			return;
		out_ += "<h2>Odd</h2>\n<ul>\n";
		for (const Oddity& oddity : report_.odd)
			out_ += fmt::format("<li><span class=\"odd\">{}</span><br>{}</li>\n", html_escape(oddity.headline()),
			                    html_escape(oddity.meaning));
		out_ += "</ul>\n";
	}

	void arithmetic()
	{
		out_ += "<h2>Arithmetic by operation</h2>\n";
		device_heads("operation");
		// All devices are asked the same; one that could not be asked has no items.
		const auto longest = std::max_element(list().begin(), list().end(), [](const auto& a, const auto& b) {
			return a.probe.items.size() < b.probe.items.size();
		});
		const std::size_t items = longest == list().end() ? 0 : longest->probe.items.size();
		for (std::size_t i = 0; i < items; ++i) {
			out_ += fmt::format("<tr><th>{}</th>", html_escape(longest->probe.items[i].name));
			for (const VerifiedDevice& device : list()) {
				if (i >= device.probe.items.size()) {
					cell("not tested", "bad");
					continue;
				}
				const SelfTestItem& item = device.probe.items[i];
				if (item.passed)
					cell("right", "good");
				else
					cell(fmt::format("{}: {}", item.required ? "WRONG" : "differs, which is allowed",
					                 html_escape(item.detail)),
					     item.required ? "bad" : "odd");
			}
			out_ += "</tr>\n";
		}
		out_ += "<tr><th>square root, reciprocal: whose</th>";
		for (const VerifiedDevice& device : list())
			cell(device.probe.needs_software_roots
			         ? "ours, because the device's is wrong: " + html_escape(device.probe.native_roots_failure)
			         : "the device's own",
			     device.probe.needs_software_roots ? "odd" : "");
		out_ += "</tr>\n";
		end_table();
		out_ += fmt::format("<p>Atomic operations: {}.</p>\n", atomics_text);
		for (const VerifiedDevice& device : list())
			if (device.error)
				log(device.info.name, device.error->message, device.error->log);
	}

	void log(const std::string& name, const std::string& message, const std::string& text)
	{
		out_ += fmt::format("<p class=\"bad\">{}: {}</p>\n", html_escape(name), html_escape(message));
		if (!text.empty())
			out_ += fmt::format("<pre>{}</pre>\n", html_escape(text));
	}

	void films()
	{
		out_ += "<h2>Films by hash</h2>\n";
		device_heads("scene");
		for (std::size_t scene = 0; scene < tested_.scenes.size(); ++scene) {
			out_ += fmt::format("<tr><th>{}<br><small>{}</small><br><span class=\"hash\">{}</span></th>",
			                    html_escape(tested_.scenes[scene].name), settings_text(tested_.scenes[scene]),
			                    tested_.scenes[scene].film);
			for (const VerifiedDevice& device : list())
				film_cell(device, scene);
			out_ += "</tr>\n";
		}
		end_table();
	}

	void film_cell(const VerifiedDevice& device, std::size_t scene)
	{
		std::string text;
		bool good = true;
		for (const FilmCheck& film : device.films) {
			if (film.scene != scene)
				continue;
			good = good && film.passed;
			text += fmt::format("{}{}: {}", text.empty() ? "" : "<br>", variant_name(film.variant),
			                    film.passed ? "same"
			                                : "<span class=\"hash\">" + film.film + "</span> " + html_escape(film.why));
		}
		cell(text.empty() ? "not rendered" : text, text.empty() || !good ? "bad" : "good");
	}

	void matrix()
	{
		out_ += fmt::format("<h2>Device by device</h2>\n<p>Pixels that differ by any bit, of {} in all scenes.</p>\n",
		                    tested_.compared_pixels());
		device_heads("");
		for (std::size_t a = 0; a < list().size(); ++a) {
			out_ += fmt::format("<tr><th>{}</th>", list()[a].index);
			for (std::size_t b = 0; b < list().size(); ++b) {
				const auto pixels = tested_.differing_pixels(a, b);
				if (a == b)
					cell("");
				else
					cell(pixels ? std::to_string(*pixels) : "?", pixels == 0u ? "number good" : "number bad");
			}
			out_ += "</tr>\n";
		}
		end_table();
	}

	void speed()
	{
		out_ += "<h2>Speed</h2>\n<div class=\"scroll\"><table><thead><tr><th></th><th>device</th><th>scene</th>"
		        "<th>path segments/s</th><th>samples/s</th><th>of its measured peak</th></tr></thead><tbody>\n";
		for (const VerifiedDevice& device : list()) {
			out_ += "<tr>";
			cell(std::to_string(device.index), "number");
			cell(html_escape(device.info.name));
			if (const auto& speed = device.speed) {
				cell(fmt::format("{} {}x{}, {} samples, {:.2f} s", html_escape(speed->scene), speed->width,
				                 speed->height, speed->samples, speed->seconds));
				cell(fmt::format("{:.3g} M", speed->rays_per_second / 1e6), "number");
				cell(fmt::format("{:.3g} M", speed->samples_per_second / 1e6), "number");
				cell(speed->share_of_peak ? fmt::format("{:.1f} %", *speed->share_of_peak * 100) : "not measured",
				     "number");
			} else
				cell(html_escape(device.speed_error.empty() ? "not measured" : device.speed_error));
			out_ += "</tr>\n";
		}
		end_table();
	}

	// ---- pictures ----

	void picture(const std::string& caption, const Result<std::vector<std::uint8_t>>& png)
	{
		out_ += html_picture(caption, png);
	}

	void film_picture(const std::string& caption, const Film& film)
	{
		picture(caption, encode_image(film, ImageFormat::Png, {}, {}));
	}

	// |A - B|, the largest difference white; a pixel that differs at all is never darker than a quarter.
	void difference(const std::string& caption, const Film& film, const Film& expected)
	{
		Result<DifferencePicture> picture_of =
		    difference_picture(image_of(film, {}, "device"), image_of(expected, {}, "reference"), {});
		if (!picture_of) {
			picture(caption, picture_of.error());
			return;
		}
		std::vector<std::uint8_t>& rgb = picture_of->rgb;
		for (std::size_t pixel = 0; pixel * 3 < rgb.size(); ++pixel) {
			const auto begin = static_cast<std::ptrdiff_t>(pixel * 3);
			if (!std::equal(film.sums().begin() + begin, film.sums().begin() + begin + 3,
			                expected.sums().begin() + begin))
				for (std::size_t channel = 0; channel < 3; ++channel)
					rgb[pixel * 3 + channel] = std::max<std::uint8_t>(rgb[pixel * 3 + channel], 64);
		}
		picture(caption, encode_png(picture_of->width, picture_of->height, rgb, Transfer::Srgb, {}));
	}

	void pictures()
	{
		out_ += "<h2>Pictures</h2>\n<p>Of each scene the reference backend's film, and each film that differs from it, "
		        "with "
		        "the difference: black where all bits are the same, the largest difference white.</p>\n";
		for (std::size_t scene = 0; scene < tested_.scenes.size(); ++scene) {
			const std::optional<Film>& expected = tested_.reference[scene];
			const std::string& name = tested_.scenes[scene].name;
			out_ += "<div>\n";
			if (expected)
				film_picture(name + ": reference", *expected);
			for (const VerifiedDevice& device : list()) {
				if (scene >= device.kept.size() || !device.kept[scene])
					continue;
				const Film& film = *device.kept[scene];
				if (expected && film.hash() == expected->hash())
					continue;
				film_picture(fmt::format("{}: device {}, {}", name, device.index, device.info.name), film);
				if (expected && film.sums().size() == expected->sums().size())
					difference(fmt::format("{}: device {} - reference: {} of {} pixels differ", name, device.index,
					                       differing_pixels(film, *expected), film.pixels()),
					           film, *expected);
			}
			out_ += "</div>\n";
		}
	}

	void surroundings()
	{
		out_ += "<h2>Environment</h2>\n<p>Variables that change devices, arithmetic or rt's files:</p>\n<ul>\n";
		for (const auto& [name, value] : report_.environment)
			out_ += fmt::format("<li><code>{}={}</code></li>\n", html_escape(name), html_escape(value));
		if (report_.environment.empty())
			out_ += "<li>none is set</li>\n";
		out_ += "</ul>\n";
	}

	const VerifyReport& report_;
	const Verification& tested_;
	std::string out_;
};

} // namespace

std::vector<ProbeGroup> probe_groups(const SelfTestReport& probe)
{
	std::vector<ProbeGroup> groups;
	for (const SelfTestItem& item : probe.items) {
		auto group = std::find_if(groups.begin(), groups.end(),
		                          [&item](const ProbeGroup& known) { return known.name == item.group; });
		if (group == groups.end())
			group = groups.insert(groups.end(), {item.group, 0, 0, false});
		group->items += 1;
		group->passed += item.passed ? 1 : 0;
		group->refused = group->refused || (item.required && !item.passed);
	}
	return groups;
}

std::string html_report(const VerifyReport& report) { return HtmlReport(report).text(); }

} // namespace rt
