// embedded_text.h: the kernel sources inside the binary (made by cmake/EmbedText.cmake).
#pragma once

namespace rt {

struct EmbeddedText {
	const char* path; // "kernels/path.h"
	const char* text; // not terminated
	unsigned long bytes;
};

extern const EmbeddedText embedded_texts[];
extern const unsigned embedded_text_count;

} // namespace rt
