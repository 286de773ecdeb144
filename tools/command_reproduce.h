// command_reproduce.h: `rt reproduce`, an image rendered again from what it says about itself, and compared.
//
// What an image says is not trusted: numbers are checked as those of the command line are, the scene's hash decides
// whether a scene is the right one, and only the film's and the pixels' bits say whether the image was reproduced.
#pragma once

#include "support/result.h"
#include "tools/options.h"

namespace rt {

// The exit status: 0 if film and pixels are the same to the last bit, 1 if not.
Result<int> run_reproduce(const ReproduceOptions& options);

} // namespace rt
