// What a library built with -ffast-math does to the process that loads it: subnormals are flushed from then on.
#if defined(__x86_64__)
#include <xmmintrin.h>
__attribute__((constructor)) static void flush() { _mm_setcsr(_mm_getcsr() | 0x8040u); }
#endif
