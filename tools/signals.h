// signals.h: how the outside asks a render to stop or to show what it has.
//
// SIGINT and SIGTERM ask for a stop after the launch in flight; the same signal a second time ends the process at
// once, because the handler is taken away by the first. SIGUSR1 asks for the image so far. Handlers only set atomics.
//
// Drivers put handlers of their own in place of ours: LLVM, which OpenCL drivers on CPUs load, takes SIGUSR1 and SIGINT
// when it first compiles. So both functions are called again from time to time; that is cheap and harmless.
#pragma once

#include <atomic>

namespace rt {

// SIGUSR1, from the start of a command on: its default would end the process.
void catch_snapshot_signal();
// SIGINT and SIGTERM, once there is something to save. Does nothing after a stop was asked for.
void catch_stop_signals();

const std::atomic<bool>& stop_requested();
// True once for each request.
bool take_snapshot_request();

} // namespace rt
