// double_kernels.h: functions of the kernels as the double rung has them, for tests whose own headers are of the exact
// one.
#pragma once

#include <cstdint>

namespace rt {

struct DoubleSincos {
	double sine, cosine;
};

DoubleSincos double_sincos_turns(double u);
double double_atan2_turns(double y, double x);
double double_sqrt(double x);
double double_rcp(double x);
// The film's integer of a radiance v, with 2^40 to one.
std::int64_t double_film_integer(double v);

} // namespace rt
