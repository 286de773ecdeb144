// kernel_text.h: the kernel sources embedded in the binary, and one text made of them.
#pragma once

#include "backends/backend.h"
#include "backends/embedded_text.h"
#include "support/result.h"

#include <string>

namespace rt {

// The text a device's compiler gets: the spec's defines, then its root file with every #include of an embedded
// file replaced by that file (once), and #line directives so that logs point at kernels/...:line.
// The spec's edits are made in the files first.
// Includes are named from the project's root, as the host's compiler finds them; <system> includes stay as they are.
// Tests give files of their own.
Result<std::string> flatten_program(const ProgramSpec& spec, const EmbeddedText* files = embedded_texts,
                                    unsigned file_count = embedded_text_count);

// A compiler's log with its places in `text` put as kernels/...:line. For compilers that heed no #line and write
// `name`:line:column instead, as NVIDIA's OpenCL compiler does with "<kernel>"; other logs stay as they are.
std::string place_in_files(const std::string& log, const std::string& name, const std::string& text);

// XXH3-128 of all embedded kernel files, 32 hex digits: which kernels made an image.
std::string kernel_hash(const EmbeddedText* files = embedded_texts, unsigned file_count = embedded_text_count);

} // namespace rt
