#include "support/float_environment.h"

#include <cfenv>
#if defined(__x86_64__) || defined(__i386__)
#include <xmmintrin.h>
#elif defined(__aarch64__)
#include <cstdint>
#endif

namespace rt {
namespace {

#if defined(__x86_64__) || defined(__i386__)
constexpr unsigned flush_bits = 0x8040; // MXCSR: flush to zero, denormals are zero
unsigned read_control() { return _mm_getcsr(); }
void write_control(unsigned control) { _mm_setcsr(control); }
#elif defined(__aarch64__)
constexpr unsigned flush_bits = 1u << 24; // FPCR.FZ
unsigned read_control()
{
	std::uint64_t control;
	__asm__ volatile("mrs %0, fpcr" : "=r"(control));
	return static_cast<unsigned>(control);
}
void write_control(unsigned control)
{
	const std::uint64_t wide = control;
	__asm__ volatile("msr fpcr, %0" : : "r"(wide));
}
#else
constexpr unsigned flush_bits = 0;
unsigned read_control() { return 0; }
void write_control(unsigned) {}
#endif

// Libraries that the program is linked with or that are preloaded are initialised before this.
const FloatEnvironment environment_before_main = current_float_environment();

} // namespace

FloatEnvironment current_float_environment()
{
	return {std::fegetround() == FE_TONEAREST, (read_control() & flush_bits) != 0};
}

FloatEnvironment inherited_float_environment() { return environment_before_main; }

ContractFloatEnvironment::ContractFloatEnvironment() : saved_rounding_(std::fegetround())
{
	std::fesetround(FE_TONEAREST);
	saved_control_ = read_control();
	write_control(saved_control_ & ~flush_bits);
}

ContractFloatEnvironment::~ContractFloatEnvironment()
{
	write_control(saved_control_);
	std::fesetround(saved_rounding_);
}

FlushingFloatEnvironment::FlushingFloatEnvironment() : saved_control_(read_control())
{
	write_control(saved_control_ | flush_bits);
}

FlushingFloatEnvironment::~FlushingFloatEnvironment() { write_control(saved_control_); }

} // namespace rt
