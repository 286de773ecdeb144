// naive_kernels.h: what textbooks write, in the places where rt's kernels write something else.
#pragma once

#include "backends/backend.h"

#include <string>
#include <vector>

namespace rt {

// One way of the textbook, with the edits that put it into the kernels.
struct NaiveHabit {
	std::string name;
	std::vector<TextEdit> edits;
	bool lets_compiler_fuse = false;
};

// All of them. The edits keep the number of lines, so that a trace names the lines of kernels/.
const std::vector<NaiveHabit>& naive_habits();

} // namespace rt
