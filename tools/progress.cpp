#include "tools/progress.h"

#include "tools/report.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <cstdio>
#include <utility>

#include <sys/ioctl.h>
#include <unistd.h>

namespace rt {

namespace {

std::size_t terminal_width()
{
	winsize size{};
	if (ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 0)
		return size.ws_col;
	return 80;
}

// What there is to say, from numbers to words.
struct Figures {
	double fraction = 0, rate = 0, left = -1; // share done, samples a second, seconds (negative: not known yet)
	std::uint64_t spp_done = 0, spp_total = 0;
};

Figures figures_of(const Progress& progress, std::uint64_t before, std::uint64_t pixels)
{
	Figures figures;
	const auto total = static_cast<double>(progress.samples_total);
	const auto done = static_cast<double>(progress.samples_done);
	figures.fraction = total > 0 ? std::clamp(done / total, 0.0, 1.0) : 1.0;
	figures.spp_done = progress.samples_done / pixels;
	figures.spp_total = progress.samples_total / pixels;
	const double here = done - static_cast<double>(before);
	if (progress.seconds > 0 && here > 0) {
		figures.rate = here / progress.seconds;
		figures.left = (total - done) / figures.rate;
	}
	return figures;
}

// Minutes and seconds that do not jump about in width.
std::string clock_text(double seconds)
{
	if (seconds < 0)
		return "-:--";
	const auto whole = static_cast<std::uint64_t>(std::min(seconds + 0.5, 1e9));
	if (whole < 3600)
		return fmt::format("{}:{:02}", whole / 60, whole % 60);
	return fmt::format("{}:{:02}:{:02}", whole / 3600, whole / 60 % 60, whole % 60);
}

constexpr std::size_t min_bar = 8, max_bar = 40;

// The line in at most `width` columns: parts that do not fit are left out, least important first.
std::string bar_line(const Figures& figures, const std::string& title, const std::string& device,
                     const std::string& unit, bool counts_pixels, std::size_t width, bool colour)
{
	const std::string percent = fmt::format("{:3}%", static_cast<int>(figures.fraction * 100));
	std::string tail = " " + percent;
	const std::string spp = counts_pixels ? fmt::format("  {}/{} spp", figures.spp_done, figures.spp_total) : "";
	const std::string left = fmt::format("  {} left", clock_text(figures.left));
	const std::string rate = unit.empty() ? "" : fmt::format("  {}{}/s", format_quantity(figures.rate), unit);
	const std::string head = title.empty() ? "" : title + "  ";
	const std::size_t frame = head.size() + 2; // the bar's brackets
	for (const std::string& part : {spp, left, rate, "  " + device})
		if (frame + min_bar + tail.size() + part.size() <= width)
			tail += part;
	if (frame + min_bar + tail.size() > width)
		return percent.substr(0, width);
	const std::size_t bar = std::min(width - frame - tail.size(), max_bar);
	const auto full = static_cast<std::size_t>(figures.fraction * static_cast<double>(bar));
	std::string filled(full, '=');
	std::string empty(bar - full, ' ');
	if (full < bar && full > 0)
		filled.back() = '>';
	if (colour)
		filled = "\033[32m" + filled + "\033[0m";
	return head + "[" + filled + empty + "]" + tail;
}

} // namespace

ProgressDisplay::ProgressDisplay(ProgressMode mode)
{
	if (mode == ProgressMode::Plain)
		style_ = Style::Plain;
	else if (mode == ProgressMode::Json)
		style_ = Style::Json;
	else if (mode == ProgressMode::Auto && has_terminal(stderr))
		style_ = Style::Bar;
	colour_ = has_colour(stderr);
}

void ProgressDisplay::set_device(std::string device)
{
	const std::lock_guard lock(mutex_);
	device_ = std::move(device);
}

void ProgressDisplay::set_unit(std::string unit)
{
	const std::lock_guard lock(mutex_);
	unit_ = std::move(unit);
	counts_pixels_ = false;
}

void ProgressDisplay::begin(std::string title, std::uint64_t pixels)
{
	const std::lock_guard lock(mutex_);
	title_ = std::move(title);
	pixels_ = std::max<std::uint64_t>(pixels, 1);
	last_tenth_ = -1;
	last_line_ = std::chrono::steady_clock::now();
}

void ProgressDisplay::update(const Progress& progress, std::uint64_t before)
{
	const std::lock_guard lock(mutex_);
	const Figures figures = figures_of(progress, before, pixels_);
	switch (style_) {
	case Style::None:
		return;
	case Style::Bar:
		// One column stays free: some terminals wrap when the last one is written.
		draw(bar_line(figures, title_, device_, unit_, counts_pixels_, terminal_width() - 1, colour_));
		return;
	case Style::Json: {
		nlohmann::ordered_json line = {{"event", "progress"},
		                               {"title", title_},
		                               {"samples_done", progress.samples_done},
		                               {"samples_total", progress.samples_total},
		                               {"spp_done", figures.spp_done},
		                               {"spp_total", figures.spp_total},
		                               {"fraction", figures.fraction},
		                               {"seconds", progress.seconds},
		                               {"samples_per_second", figures.rate},
		                               {"seconds_left", nullptr},
		                               {"device", device_}};
		if (figures.left >= 0)
			line["seconds_left"] = figures.left;
		print_message(fmt::format("{}\n", line.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace)));
		return;
	}
	case Style::Plain: {
		const auto now = std::chrono::steady_clock::now();
		const int tenth = static_cast<int>(figures.fraction * 10);
		if (tenth <= last_tenth_ && now - last_line_ < std::chrono::seconds(10))
			return;
		last_tenth_ = tenth;
		last_line_ = now;
		const std::string spp = counts_pixels_ ? fmt::format("{}/{} spp, ", figures.spp_done, figures.spp_total) : "";
		const std::string rate = unit_.empty() ? "" : fmt::format("{}{}/s, ", format_quantity(figures.rate), unit_);
		print_message(fmt::format("rt: {}{}{}%, {}{}{} left{}{}\n", title_, title_.empty() ? "" : ": ",
		                          static_cast<int>(figures.fraction * 100), spp, rate, clock_text(figures.left),
		                          device_.empty() ? "" : ", ", device_));
		return;
	}
	}
}

void ProgressDisplay::status(const std::string& text)
{
	const std::lock_guard lock(mutex_);
	if (style_ == Style::Bar)
		draw(text.substr(0, terminal_width() - 1));
	else if (style_ == Style::Plain)
		print_message("rt: " + text + "\n");
	else if (style_ == Style::Json) {
		const nlohmann::ordered_json line = {{"event", "status"}, {"text", text}};
		print_message(fmt::format("{}\n", line.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace)));
	}
}

void ProgressDisplay::clear()
{
	const std::lock_guard lock(mutex_);
	if (drawn_) {
		print_message("\r\033[K");
		drawn_ = false;
	}
}

// One write a line, so that it never flickers or mixes with others.
void ProgressDisplay::draw(const std::string& line)
{
	const std::string text = "\r" + line + "\033[K";
	print_message(text);
	drawn_ = true;
}

} // namespace rt
