#include "tools/signals.h"

#include <csignal>
#include <initializer_list>

namespace rt {

namespace {

std::atomic<bool> stop{false};
std::atomic<bool> snapshot{false};
static_assert(std::atomic<bool>::is_always_lock_free, "a signal handler may touch it");

extern "C" void on_stop(int) { stop = true; }

extern "C" void on_snapshot(int) { snapshot = true; }

void set_handler(int signal_number, void (*handler)(int), int flags)
{
	struct sigaction action {};
	action.sa_handler = handler;
	sigemptyset(&action.sa_mask);
	action.sa_flags = flags;
	(void)sigaction(signal_number, &action, nullptr);
}

} // namespace

void catch_snapshot_signal() { set_handler(SIGUSR1, on_snapshot, SA_RESTART); }

void catch_stop_signals()
{
	if (stop)
		return; // the next signal must end the process
	for (const int signal_number : {SIGINT, SIGTERM})
		set_handler(signal_number, on_stop, static_cast<int>(SA_RESTART | SA_RESETHAND));
}

const std::atomic<bool>& stop_requested() { return stop; }

bool take_snapshot_request() { return snapshot.exchange(false); }

} // namespace rt
