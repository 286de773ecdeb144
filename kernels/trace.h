/* trace.h: how a traced program writes down what it computes.
 *
 * A traced program is rt_render compiled from a text in which backends/traced_text.cpp has put a note behind every
 * operation. The kernels themselves know nothing of it, so that tracing cannot change them.
 *
 * The log is a row of 64-bit words: how many notes there were, how many of them to leave out, how many fit, nothing,
 * and then five words a note: place and kind, three operands, the result; behind them a place for notes that do not
 * fit. Work-items other than the first, which a group may have, write into small logs of their own behind it.
 *
 * There is no branch in a note: thousands of them are inlined into one kernel, which compilers must get through.
 */
#ifndef RT_TRACE_H
#define RT_TRACE_H

#include "common/rt_compat.h"

#define RT_LOG_HEADER_WORDS 4u
#define RT_LOG_NOTE_WORDS 5u

/* Work-items beyond share the last log. */
#define RT_LOG_ITEMS 256u

RT_FN RT_GLOBAL rt_u64* rt_own_log(RT_GLOBAL rt_u64* log)
{
	rt_u32 item = RT_GLOBAL_ID < RT_LOG_ITEMS ? RT_GLOBAL_ID : RT_LOG_ITEMS;
	rt_u64 one_note = RT_LOG_HEADER_WORDS + RT_LOG_NOTE_WORDS;
	return item == 0u ? log : log + (one_note * item + log[2] * RT_LOG_NOTE_WORDS);
}

RT_FN void rt_note(RT_GLOBAL rt_u64* log, rt_u32 what, rt_u32 where, rt_u64 a, rt_u64 b, rt_u64 c, rt_u64 result)
{
	rt_u64 n = log[0];
	rt_u64 slot = n - log[1] < log[2] ? n - log[1] : log[2];
	RT_GLOBAL rt_u64* note = log + (RT_LOG_HEADER_WORDS + slot * RT_LOG_NOTE_WORDS);
	note[0] = ((rt_u64)what << 32) | where;
	note[1] = a;
	note[2] = b;
	note[3] = c;
	note[4] = result;
	log[0] = n + 1u;
}

#endif
