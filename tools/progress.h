// progress.h: what a render shows while it runs, on standard error.
//
//   bar   one line that is redrawn in place and cleared at the end, never wider than the terminal
//   plain a line at every tenth of the work, and at least one every ten seconds
//   json  one object a line: {"event":"progress",...} or {"event":"status",...}
//   none  nothing
// `auto` is the bar on a terminal and nothing elsewhere.
#pragma once

#include "render/session.h"

#include <chrono>
#include <cstdint>
#include <mutex>
#include <string>

namespace rt {

enum class ProgressMode { Auto, Plain, Json, None };

class ProgressDisplay {
public:
	explicit ProgressDisplay(ProgressMode mode);
	~ProgressDisplay() { clear(); }
	ProgressDisplay(const ProgressDisplay&) = delete;
	ProgressDisplay& operator=(const ProgressDisplay&) = delete;

	void set_device(std::string device);
	// What is counted, where it is not samples of pixels: "inputs"; empty where it is time, which has no rate.
	void set_unit(std::string unit);
	// A film of `pixels` is about to be rendered. `title` may be empty ("frame 3 of 10").
	void begin(std::string title, std::uint64_t pixels);
	// Samples of the whole film; `before` of them came from a resumed film and say nothing about the rate.
	void update(const Progress& progress, std::uint64_t before);
	// Something that takes a while and has no measure: a compilation, a self-test.
	void status(const std::string& text);
	// Takes the bar away, so that something else can be printed; the next update draws it again.
	void clear();

private:
	enum class Style { Bar, Plain, Json, None };
	void draw(const std::string& line);

	Style style_ = Style::None;
	bool colour_ = false;
	bool drawn_ = false;
	std::string device_, title_;
	std::string unit_ = "samples";
	bool counts_pixels_ = true;
	std::uint64_t pixels_ = 1;
	int last_tenth_ = -1;
	std::chrono::steady_clock::time_point last_line_;
	std::mutex mutex_; // several devices may tell their status at once
};

} // namespace rt
