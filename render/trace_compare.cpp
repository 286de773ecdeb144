#include "render/trace_compare.h"

#include "common/rt_contract.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fmt/format.h>

namespace rt {
namespace {

using Type = KernelType::Kind;

float as_float(std::uint64_t bits)
{
	const auto low = static_cast<std::uint32_t>(bits);
	float value;
	std::memcpy(&value, &low, sizeof value);
	return value;
}

std::uint64_t bits_of(float value)
{
	std::uint32_t bits;
	std::memcpy(&bits, &value, sizeof bits);
	return bits;
}

bool is_nan(std::uint64_t bits) { return bits <= 0xffffffffu && std::isnan(as_float(bits)); }

std::optional<std::uint64_t> compared(TraceKind kind, bool less, bool equal, bool greater)
{
	switch (kind) {
	case TraceKind::Less:
		return less;
	case TraceKind::LessEqual:
		return less || equal;
	case TraceKind::Greater:
		return greater;
	case TraceKind::GreaterEqual:
		return greater || equal;
	case TraceKind::Equal:
		return equal;
	case TraceKind::NotEqual:
		return !equal;
	default:
		return std::nullopt;
	}
}

std::optional<std::uint64_t> real_result(const TraceNote& note)
{
	const float a = as_float(note.operands[0]), b = as_float(note.operands[1]), c = as_float(note.operands[2]);
	switch (note.code.kind) {
	case TraceKind::Add:
		return bits_of(a + b);
	case TraceKind::Subtract:
		return bits_of(a - b);
	case TraceKind::Multiply:
		return bits_of(a * b);
	case TraceKind::Divide:
		return bits_of(a / b);
	case TraceKind::Fma:
		return bits_of(std::fma(a, b, c));
	case TraceKind::Root:
		return bits_of(std::sqrt(a));
	case TraceKind::Reciprocal:
		return bits_of(1.0f / a);
	case TraceKind::Convert:
		if (note.code.result == Type::Int && std::fabs(a) < 0x1p31f)
			return static_cast<std::uint32_t>(static_cast<std::int32_t>(a));
		if (note.code.result == Type::Uint && a >= 0 && a < 0x1p32f)
			return static_cast<std::uint32_t>(a);
		return std::nullopt;
	default:
		return compared(note.code.kind, a<b, a == b, a> b);
	}
}

// Modulo 2^bits, as the kernels' unsigned and (by rule 16 never overflowing) signed integers.
std::optional<std::uint64_t> integer_result(const TraceNote& note)
{
	const bool wide = note.code.operand == Type::Long || note.code.operand == Type::Ulong;
	const bool is_signed = note.code.operand == Type::Int || note.code.operand == Type::Long;
	const std::uint64_t mask = wide ? ~std::uint64_t(0) : 0xffffffffu;
	const std::uint64_t a = note.operands[0] & mask, b = note.operands[1] & mask;
	const auto widened = [&](std::uint64_t x) {
		return wide ? static_cast<std::int64_t>(x)
		            : static_cast<std::int64_t>(static_cast<std::int32_t>(static_cast<std::uint32_t>(x)));
	};
	const std::uint64_t shift = b & (wide ? 63u : 31u);
	switch (note.code.kind) {
	case TraceKind::Add:
		return (a + b) & mask;
	case TraceKind::Subtract:
		return (a - b) & mask;
	case TraceKind::Multiply:
		return (a * b) & mask;
	case TraceKind::Divide:
	case TraceKind::Remainder:
		if (b == 0 || is_signed)
			return std::nullopt;
		return note.code.kind == TraceKind::Divide ? a / b : a % b;
	case TraceKind::ShiftLeft:
		return (a << shift) & mask;
	case TraceKind::ShiftRight:
		return is_signed ? static_cast<std::uint64_t>(widened(a) >> shift) & mask : a >> shift;
	case TraceKind::And:
		return a & b;
	case TraceKind::Or:
		return a | b;
	case TraceKind::Xor:
		return a ^ b;
	case TraceKind::Convert:
		if (note.code.result == Type::Real)
			return note.code.operand == Type::Int ? bits_of(static_cast<float>(widened(a)))
			                                      : bits_of(static_cast<float>(a));
		if (note.code.result == Type::Long || note.code.result == Type::Ulong)
			return is_signed ? static_cast<std::uint64_t>(widened(a)) : a;
		return a & 0xffffffffu;
	default:
		return is_signed ? compared(note.code.kind, widened(a) < widened(b), a == b, widened(a) > widened(b))
		                 : compared(note.code.kind, a<b, a == b, a> b);
	}
}

bool same_value(std::uint64_t a, std::uint64_t b)
{
	// A NaN's sign and payload are the device's own.
	return a == b || (is_nan(a) && is_nan(b));
}

bool same_operands(const TraceNote& a, const TraceNote& b)
{
	return same_value(a.operands[0], b.operands[0]) && same_value(a.operands[1], b.operands[1]) &&
	       same_value(a.operands[2], b.operands[2]);
}

bool same_kind(const TraceNote& a, const TraceNote& b)
{
	// A value without a note of its own in one text may be an operation's in the other: the line tells then.
	return a.code.kind == b.code.kind && a.code.operand == b.code.operand && a.code.result == b.code.result;
}

bool same_line(const TraceNote& a, const TraceNote& b)
{
	return a.code.file == b.code.file && a.code.line == b.code.line;
}

// The notes of the line of notes[at], as far as they follow each other.
std::vector<TraceNote> line_of(const std::vector<TraceNote>& notes, std::size_t at, const TraceNote& line)
{
	std::size_t begin = at, end = at;
	while (begin > 0 && same_line(notes[begin - 1], line) && notes[begin - 1].code.number < notes[begin].code.number)
		--begin;
	while (end < notes.size() && same_line(notes[end], line) &&
	       (end == at || notes[end].code.number > notes[end - 1].code.number))
		++end;
	return {notes.begin() + static_cast<std::ptrdiff_t>(begin), notes.begin() + static_cast<std::ptrdiff_t>(end)};
}

// Where the contract leaves the result to the device (kernels/math.h).
bool is_open(const TraceNote& note)
{
	const float a = std::fabs(as_float(note.operands[0]));
	if (note.code.kind == TraceKind::Reciprocal)
		return !(a >= 0x1p-100f && a <= 0x1p+100f);
	return note.code.kind == TraceKind::Root && !(as_float(note.operands[0]) > RT_MIN_SQUARE);
}

} // namespace

std::optional<std::uint64_t> correct_result(const TraceNote& note)
{
	switch (note.code.kind) {
	case TraceKind::Value:
	case TraceKind::Load:
	case TraceKind::Call:
	case TraceKind::MoreArguments:
		return std::nullopt;
	case TraceKind::Select:
		return note.operands[1];
	default:
		return note.code.operand == Type::Real ? real_result(note) : integer_result(note);
	}
}

void TracePosition::see(const TraceNote& note)
{
	const TraceSite* site = trace_site(note.code);
	if (!site)
		return;
	const auto frame = std::find_if(frames_.rbegin(), frames_.rend(),
	                                [&](const Frame& candidate) { return candidate.function == site->function; });
	if (frame == frames_.rend())
		frames_.push_back({site->function, {}});
	else
		frames_.erase(frame.base(), frames_.end());
	if (note.code.kind != TraceKind::Call)
		return;
	frames_.push_back({site->target, fmt::format("{}, {}:{}", site->function, site->file, site->code.line)});
	if (site->target == "rt_path_start") {
		bounce_ = 0;
		++starts_;
	}
	if (site->target == "rt_path_scatter")
		++bounce_;
}

std::vector<std::string> TracePosition::stack() const
{
	std::vector<std::string> result;
	for (auto frame = frames_.rbegin(); frame != frames_.rend(); ++frame)
		if (!frame->called_from.empty())
			result.push_back(fmt::format("{} in {}", frame->function, frame->called_from));
	return result;
}

bool TraceComparison::excused(const TraceNote& judged, const TraceNote& against)
{
	const auto known = [this](std::uint64_t mine, std::uint64_t theirs) {
		return std::find(open_.begin(), open_.end(), std::make_pair(mine, theirs)) != open_.end();
	};
	bool open = is_open(judged) && is_open(against);
	for (std::size_t i = 0; i < 3; ++i) {
		if (same_value(judged.operands[i], against.operands[i]))
			continue;
		if (!known(judged.operands[i], against.operands[i]))
			return false;
		open = true;
	}
	if (!open)
		return false;
	if (!same_value(judged.result, against.result))
		open_.emplace_back(judged.result, against.result);
	return true;
}

bool TraceComparison::compare(const Trace& judged, const Trace& against)
{
	const std::size_t count = std::max(judged.notes.size(), against.notes.size());
	for (std::size_t i = 0; i < count && !difference_; ++i) {
		if (i >= judged.notes.size() || i >= against.notes.size()) {
			found(judged, against, i);
			break;
		}
		const TraceNote &mine = judged.notes[i], &theirs = against.notes[i];
		position_.see(theirs);
		// A place that differs alone is a matter of the text: a line more or less above.
		const bool same =
		    same_kind(mine, theirs) &&
		    ((same_operands(mine, theirs) && same_value(mine.result, theirs.result)) || excused(mine, theirs));
		if (!same)
			found(judged, against, i);
		else
			++compared_;
	}
	return !difference_;
}

void TraceComparison::found(const Trace& judged, const Trace& against, std::size_t at)
{
	TraceDifference difference;
	difference.index = against.first_note + at;
	difference.sample = position_.sample();
	difference.bounce = position_.bounce();
	difference.stack = position_.stack();
	difference.kind = Difference::Operation;
	if (at < against.notes.size())
		difference.expected = against.notes[at];
	else if (at > 0)
		difference.expected = against.notes[at - 1];
	if (at < judged.notes.size())
		difference.got = judged.notes[at];
	const bool both = at < against.notes.size() && at < judged.notes.size();
	if (both && at > 0 && !same_line(difference.expected, difference.got) &&
	    same_line(judged.notes[at - 1], difference.got) && same_line(against.notes[at - 1], difference.got)) {
		// One operation more on a line that the other trace has left: what that line computed is changed.
		difference.index -= 1;
		difference.expected = against.notes[at - 1];
		difference.expected_line = line_of(against.notes, at - 1, difference.expected);
		difference.got_line = line_of(judged.notes, at, difference.expected);
	} else if (both) {
		difference.expected_line = line_of(against.notes, at, difference.expected);
		difference.got_line = line_of(judged.notes, at, difference.expected);
		// With the same operations on the line, the first that differs is the one; otherwise the first of the
		// contract's that the other does not have at all.
		bool same_operations = difference.expected_line.size() == difference.got_line.size();
		for (std::size_t i = 0; same_operations && i < difference.expected_line.size(); ++i)
			same_operations = same_kind(difference.expected_line[i], difference.got_line[i]);
		if (same_operations || same_kind(difference.expected, difference.got)) {
			if (same_kind(difference.expected, difference.got))
				difference.kind =
				    same_operands(difference.expected, difference.got) ? Difference::Result : Difference::Operands;
		}
		if (!same_operations) {
			difference.kind = Difference::Operation;
			const auto there = [&](const TraceNote& note) {
				return std::any_of(difference.got_line.begin(), difference.got_line.end(), [&](const TraceNote& other) {
					return same_kind(note, other) && same_operands(note, other) && note.result == other.result;
				});
			};
			const auto missing = std::find_if(difference.expected_line.begin(), difference.expected_line.end(),
			                                  [&](const TraceNote& note) { return !there(note); });
			if (missing != difference.expected_line.end())
				difference.expected = *missing;
		}
	}
	difference.correct = correct_result(difference.expected);
	difference_ = std::move(difference);
}

} // namespace rt
