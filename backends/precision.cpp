#include "backends/precision.h"

#include <fmt/format.h>

namespace rt {
namespace {

// Is it a program of the fast rung with this part of it?
bool takes(const ProgramSpec& spec, std::uint32_t part)
{
	return integer_define(spec, "RT_PRECISION", RT_PRECISION_EXACT) == RT_PRECISION_FAST &&
	       (integer_define(spec, "RT_DEF_FAST", RT_FAST_ALL) & part) != 0;
}

} // namespace

const char* precision_name(Precision precision)
{
	switch (precision) {
	case Precision::Exact:
		return "exact";
	case Precision::Fast:
		return "fast";
	case Precision::Double:
		return "double";
	}
	return "";
}

std::uint32_t lanes_for(const DeviceInfo& device, Precision precision)
{
	return precision == Precision::Double ? 1 : device.native_lanes;
}

void set_precision(ProgramSpec& spec, Precision precision, std::uint32_t fast_parts)
{
	// An exact program's text does not mention rungs.
	if (precision != Precision::Exact)
		spec.defines.emplace_back("RT_PRECISION", fmt::to_string(static_cast<int>(precision)));
	if (precision == Precision::Fast && fast_parts != RT_FAST_ALL)
		spec.defines.emplace_back("RT_DEF_FAST", fmt::format("{:#x}u", fast_parts));
}

bool lets_compiler_fuse(const ProgramSpec& spec)
{
	return integer_define(spec, "RT_DEF_CONTRACT", 0) != 0 || takes(spec, RT_FAST_CONTRACT);
}

bool flushes_subnormals(const ProgramSpec& spec) { return takes(spec, RT_FAST_FLUSH); }

Status check_precision(const DeviceInfo& device, Precision precision)
{
	if (precision != Precision::Double || device.reports_fp64)
		return success();
	return Error{ErrorKind::NoDevice,
	             "the device has no double precision (fp64), which --precision double needs",
	             fmt::format("{} ({})", device.name, device.backend),
	             "choose another device (`rt devices -v` tells which have fp64); --backend reference always has it",
	             {}};
}

} // namespace rt
