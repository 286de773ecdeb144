// rt: the command line. The only part of the project that prints or exits.
//
// Each command returns a Status; its error is printed once, here, and its kind is the exit status.
#include "support/float_environment.h"
#include "tools/command_bench.h"
#include "tools/command_compare.h"
#include "tools/command_devices.h"
#include "tools/command_info.h"
#include "tools/command_render.h"
#include "tools/command_reproduce.h"
#include "tools/command_trace.h"
#include "tools/command_tradeoff.h"
#include "tools/command_verify.h"
#include "tools/options.h"
#include "tools/report.h"

#include <exception>
#include <new>
#include <string>
#include <variant>

namespace {

rt::Status run_command(const rt::RenderOptions& options)
{
	if (!options.auto_precision)
		return rt::run_render(options);
	RT_TRY_ASSIGN(const rt::RenderOptions chosen, rt::with_auto_precision(options));
	return rt::run_render(chosen);
}

rt::Status run_command(const rt::DevicesOptions& options) { return rt::run_devices(options); }

rt::Status run_command(const rt::InfoOptions& options) { return rt::run_info(options); }

rt::Status run_command(const rt::BenchOptions& options) { return rt::run_bench(options); }
rt::Status run_command(const rt::VerifyOptions& options) { return rt::run_verify(options); }
rt::Status run_command(const rt::TraceOptions& options) { return rt::run_trace(options); }
rt::Status run_command(const rt::TradeoffOptions& options) { return rt::run_tradeoff(options); }

rt::Status run_command(const rt::TextRequest& request)
{
	rt::print_result(request.text);
	return rt::success();
}

// The exit status: a command has one of its own, or ends with 0.
template <class Options>
rt::Result<int> exit_status_of(const Options& options)
{
	RT_TRY(run_command(options));
	return 0;
}

rt::Result<int> exit_status_of(const rt::CompareOptions& options) { return rt::run_compare(options); }

rt::Result<int> exit_status_of(const rt::ReproduceOptions& options) { return rt::run_reproduce(options); }

rt::Result<int> run(int argc, const char* const* argv)
{
	RT_TRY_ASSIGN(const rt::CommandLine command_line, rt::parse_command_line(argc, argv));
	return std::visit([](const auto& options) { return exit_status_of(options); }, command_line);
}

rt::Error unexpected(const char* what)
{
	return rt::Error{rt::ErrorKind::Failure, std::string("an exception that nothing expected: ") + what, "",
	                 "this is a bug of rt; please report it with the command line and the output of `rt devices -v`",
	                 ""};
}

} // namespace

int main(int argc, char** argv)
{
	// Scenes are read and rounded in it too (contract rule 18).
	const rt::ContractFloatEnvironment environment;
	try {
		return rt::end_program(run(argc, argv));
	} catch (const std::bad_alloc&) {
		return rt::report_error({rt::ErrorKind::Memory, "the machine's memory does not suffice", "",
		                         "render a smaller image, a part of it with --crop, or a scene with fewer spheres",
		                         ""});
	} catch (const std::exception& exception) {
		return rt::report_error(unexpected(exception.what()));
	} catch (...) {
		return rt::report_error(unexpected("of no known type"));
	}
}
