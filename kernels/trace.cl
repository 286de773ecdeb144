/* trace.cl: the root of a traced program: the render's entry points, whose text gets notes when the program is built
 * (backends/traced_text.cpp). Its rt_render takes the log (kernels/trace.h) as one more argument, before the others.
 */
#ifndef RT_TRACED
#define RT_TRACED 1
#endif

#include "kernels/trace.h"

#include "kernels/render.cl"
