// testu01: rt's random numbers under L'Ecuyer and Simard's batteries (TestU01, ACM TOMS 33(4), 2007).
//
// One statistic a call of the battery, each on numbers of its own (seed = 1000 n + test), and one line for each
// p-value: so a run may be stopped and continued with --tests, and split over processes. docs/random.md has the log.
#include "tools/testu01/streams.h"

// TestU01's headers are C and do not say so.
extern "C" {
#include <bbattery.h>
#include <swrite.h>
#include <unif01.h>
}

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include <chrono>
#include <cstdio>
#include <string>
#include <vector>

#include <unistd.h>

namespace {

constexpr double clear_failure = 1e-10, suspicious = 1e-3; // TestU01's own limits

unsigned long next_bits(void*, void* state) { return static_cast<rt::Stream*>(state)->next(); }
double next_number(void*, void* state) { return static_cast<rt::Stream*>(state)->next() * 0x1p-32; }
void write_nothing(void*) {}

const rt::Order* order_named(const std::string& name)
{
	for (const rt::Order& order : rt::orders)
		if (name == order.name)
			return &order;
	return nullptr;
}

struct Settings {
	std::string battery, order, bits;
	std::uint32_t seed = 1;
	int first = 1, last = 0;
};

struct Tally {
	int statistics = 0, suspects = 0, failures = 0;
};

void run_test(const Settings& settings, int test, bool crush, std::FILE* report, Tally& tally)
{
	rt::Stream stream(*order_named(settings.order), settings.bits == "raw" ? rt::Bits::Raw : rt::Bits::Used,
	                  1000 * settings.seed + static_cast<std::uint32_t>(test));
	std::string name = settings.order + " " + settings.bits;
	unif01_Gen generator{&stream, nullptr, name.data(), next_number, next_bits, write_nothing};
	std::vector<int> repetitions(128, 0);
	repetitions[static_cast<std::size_t>(test)] = 1;
	const auto begin = std::chrono::steady_clock::now();
	crush ? bbattery_RepeatCrush(&generator, repetitions.data())
	      : bbattery_RepeatSmallCrush(&generator, repetitions.data());
	const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
	for (int i = 0; i < bbattery_NTests; ++i) {
		const double p = bbattery_pVal[i];
		const double tail = p < 0.5 ? p : 1 - p;
		const char* verdict = tail < clear_failure ? "FAILED" : tail < suspicious ? "suspicious" : "";
		++tally.statistics;
		tally.failures += tail < clear_failure;
		tally.suspects += tail >= clear_failure && tail < suspicious;
		fmt::print(report, "{:3} {:<32} p {:<11.4g} {}\n", test, bbattery_TestNames[i], p, verdict);
	}
	fmt::print(report, "{:3} took {:.1f} s\n", test, seconds);
	std::fflush(report);
}

} // namespace

int main(int argc, char** argv)
{
	Settings settings;
	std::string tests;
	std::vector<std::string> names;
	std::string footer = "Orders:\n";
	for (const rt::Order& order : rt::orders) {
		names.emplace_back(order.name);
		footer += fmt::format("  {:<11} {}\n", order.name, order.what);
	}
	CLI::App app("Runs a battery of TestU01 over rt's random numbers");
	app.footer(footer);
	app.add_option("BATTERY", settings.battery, "smallcrush (15 statistics, seconds) or crush (144, about an hour)")
	    ->required()
	    ->check(CLI::IsMember({"smallcrush", "crush"}));
	app.add_option("--order", settings.order, "which numbers follow each other")
	    ->required()
	    ->check(CLI::IsMember(names));
	app.add_option("--bits", settings.bits, "used: the 24 bits of each number, packed; raw: all 32 of the hash")
	    ->default_val("used")
	    ->check(CLI::IsMember({"used", "raw"}));
	app.add_option("--seed", settings.seed, "other numbers, for repeating a suspicious test")->default_val(1);
	app.add_option("--first", settings.first, "the first test of the battery to run")->check(CLI::Range(1, 96));
	app.add_option("--last", settings.last, "the last test of the battery to run")->check(CLI::Range(1, 96));
	CLI11_PARSE(app, argc, argv);

	const bool crush = settings.battery == "crush";
	const int available = crush ? 96 : 10;
	if (settings.last == 0 || settings.last > available)
		settings.last = available;
	swrite_Basic = FALSE; // pages a test; the p-values are what matters
	swrite_Host = FALSE;
	// TestU01 prints a page a call on stdout that no switch suppresses.
	std::FILE* report = fdopen(dup(STDOUT_FILENO), "w");
	if (!report || !std::freopen("/dev/null", "w", stdout))
		return 1;
	fmt::print(report, "{} order {} bits {} seed {} tests {} to {}\n", settings.battery, settings.order, settings.bits,
	           settings.seed, settings.first, settings.last);
	Tally tally;
	for (int test = settings.first; test <= settings.last; ++test)
		run_test(settings, test, crush, report, tally);
	fmt::print(report, "{} statistics: {} failed, {} suspicious\n", tally.statistics, tally.failures, tally.suspects);
	return tally.failures == 0 ? 0 : 1;
}
