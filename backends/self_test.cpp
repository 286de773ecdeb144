#include "backends/self_test.h"

#include "backends/kernel_text.h"
#include "backends/program_cache.h"
#include "backends/stress_tile.h"
#include "common/rt_contract.h"
#include "common/rt_layout.h"
#include "support/float_environment.h"
#include "support/hash.h"
#include "version.h"

// The host's own compilation of the kernels' functions: what the composed ones (sincos, atan2, random, film) should
// give.
namespace {
thread_local unsigned rt_host_global_id = 0;
}
#include "kernels/probe.cl"

#include <chrono>
#include <cmath>
#include <cstddef>
#include <fmt/format.h>

namespace rt {
namespace {

using Words = std::vector<std::uint32_t>;

// ---- operands: special bit patterns in all combinations, then random ones ----

class Generator { // a fixed sequence, so that a failure can be repeated
public:
	std::uint32_t next()
	{
		state_ = state_ * 6364136223846793005u + 1442695040888963407u;
		return static_cast<std::uint32_t>(state_ >> 32);
	}
	// A float of random sign and mantissa whose exponent lies in [low, high].
	std::uint32_t number(int low, int high)
	{
		const std::uint32_t exponent =
		    127u + static_cast<std::uint32_t>(low) + next() % static_cast<std::uint32_t>(high - low + 1);
		return (next() & 0x807fffffu) | (exponent << 23);
	}

private:
	std::uint64_t state_ = 0x9e3779b97f4a7c15u;
};

constexpr std::uint32_t count = 1u << 14;

struct Operands {
	Words a, b, c;
	void add(std::uint32_t x, std::uint32_t y, std::uint32_t z)
	{
		a.push_back(x);
		b.push_back(y);
		c.push_back(z);
	}
	std::size_t size() const { return a.size(); }
};

enum class Domain { Ordinary, Positive, Turns, Integers, Special, Subnormal, SubnormalPairs, Radiance, SmallIntegers };

Operands make_operands(Domain domain)
{
	// Mantissas where rounding goes wrong first: all ones, all zeros, one bit, the middle.
	static const std::uint32_t mantissas[] = {0x000000, 0x000001, 0x7fffff, 0x7ffffe,
	                                          0x400000, 0x3fffff, 0x400001, 0x2aaaaa};
	static const std::uint32_t specials[] = {0x00000000, 0x80000000, 0x3f800000, 0xbf800000, 0x7f800000, 0xff800000,
	                                         0x7fc00000, 0x00800000, 0x7f7fffff, 0x4b000000, 0x33800000};
	static const std::uint32_t subnormals[] = {0x00000000, 0x80000000, 0x00000001, 0x80000001, 0x007fffff, 0x00800000};
	Operands operands;
	Generator random;
	if (domain == Domain::Special) {
		for (const std::uint32_t x : specials)
			for (const std::uint32_t y : specials)
				operands.add(x, y, 0);
		return operands;
	}
	if (domain == Domain::SubnormalPairs) {
		for (const std::uint32_t x : subnormals)
			for (const std::uint32_t y : subnormals)
				operands.add(x, y, 0);
		return operands;
	}
	if (domain == Domain::Ordinary || domain == Domain::Positive) {
		for (const std::uint32_t x : mantissas)
			for (const std::uint32_t y : mantissas)
				for (const std::uint32_t z : mantissas)
					operands.add(x | 0x3f800000u, y | 0x3f800000u, z | 0xbf800000u);
		// Where a fused and an unfused a b + c differ: a = b = 1 + 2^-12, c = -(1 + 2^-11).
		operands.add(0x3f800800u, 0x3f800800u, 0xbf801000u);
	}
	while (operands.size() < count) {
		switch (domain) {
		case Domain::Ordinary:
			operands.add(random.number(-60, 60), random.number(-30, 30), random.number(-60, 60));
			break;
		case Domain::Positive:
			operands.add(random.number(-99, 60) & 0x7fffffffu, random.number(-30, 30), 0);
			break;
		case Domain::Turns:
			operands.add(rt_bits(static_cast<float>(random.next() >> 8) * 0x1p-24f), 0, 0);
			break;
		case Domain::Subnormal: // products and sums that are subnormal
			operands.add(random.number(-80, -70), random.number(-65, -58), random.number(-126, -120));
			break;
		case Domain::Radiance:
			operands.add(random.number(-60, 0) & 0x7fffffffu, 0, 0);
			break;
		case Domain::SmallIntegers:
			operands.add(random.number(0, 30), random.next(), random.next());
			break;
		case Domain::Integers:
		case Domain::Special:
		case Domain::SubnormalPairs:
			operands.add(random.next(), random.next(), random.next());
			break;
		}
	}
	return operands;
}

// ---- what the contract says ----

struct Answer {
	std::uint32_t first = 0, second = 0;
};

float as_float(std::uint32_t bits) { return rt_from_bits(bits); }

Answer answer_float(float value) { return {rt_bits(value), 0}; }

Answer answer_long(std::uint64_t value)
{
	return {static_cast<std::uint32_t>(value), static_cast<std::uint32_t>(value >> 32)};
}

// The basic operations from the host's IEEE arithmetic, the composed ones from the host's compilation of the kernels.
Answer expected(std::uint32_t operation, std::uint32_t a, std::uint32_t b, std::uint32_t c)
{
	const float x = as_float(a), y = as_float(b), z = as_float(c);
	switch (operation) {
	case RT_PROBE_ADD:
		return answer_float(x + y);
	case RT_PROBE_SUBTRACT:
		return answer_float(x - y);
	case RT_PROBE_MULTIPLY:
		return answer_float(x * y);
	case RT_PROBE_FMA:
		return answer_float(std::fma(x, y, z));
	case RT_PROBE_ROOT:
		return answer_float(x > RT_MIN_SQUARE ? std::sqrt(x) : 0.0f);
	case RT_PROBE_RECIPROCAL:
		return answer_float(1.0f / x);
	case RT_PROBE_COMPARE:
		return {(x < y ? 1u : 0u) | (x <= y ? 2u : 0u) | (x > y ? 4u : 0u) | (x >= y ? 8u : 0u) | (x == y ? 16u : 0u),
		        rt_bits(x < y ? x : y) == b ? 1u : 0u};
	case RT_PROBE_TO_FLOAT:
		return answer_float(static_cast<float>(static_cast<std::int32_t>(a & 0x7fffffffu)));
	case RT_PROBE_TO_INT:
		return {static_cast<std::uint32_t>(static_cast<std::int32_t>(x)), 0};
	case RT_PROBE_SHIFT:
		return {a >> (b & 31u), a << (b & 31u)};
	case RT_PROBE_INTEGER:
		return {a * b + c, a ^ (b - c)};
	case RT_PROBE_LONG_ADD:
	case RT_PROBE_LONG_MULTIPLY:
		return answer_long(rt_probe_long(operation, a, b, c));
	case RT_PROBE_SINCOS: {
		float sine, cosine;
		rt_sincos_turns(x, &sine, &cosine);
		return {rt_bits(sine), rt_bits(cosine)};
	}
	case RT_PROBE_ATAN2:
		return answer_float(rt_atan2_turns(x, y));
	case RT_PROBE_RANDOM: {
		const rt_random4 u = rt_random(RT_PROBE_SEED, a, b, c);
		return {rt_bits(u.a), rt_bits(u.d)};
	}
	case RT_PROBE_SOBOL: {
		const rt_random4 u = rt_sobol(RT_PROBE_SEED, a, b, c);
		return {rt_bits(u.a) ^ rt_bits(u.c), rt_bits(u.b) ^ rt_bits(u.d)};
	}
	case RT_PROBE_FILM: // round-half-even(x 2^40): llrint of an exact double product, in the contract's environment
		return answer_long(static_cast<std::uint64_t>(std::llrint(static_cast<double>(x) * 0x1p40)));
	default:
		return {};
	}
}

struct Question {
	const char* group;
	const char* name;
	std::uint32_t operation;
	Domain domain;
	bool required;
};

// The groups, as a row of a table names them.
constexpr const char* floats = "+ - * fma sqrt reciprocal";
constexpr const char* comparisons = "< <= == min, of NaN and zeros";
constexpr const char* conversions = "int to float, float to int";
constexpr const char* integers = "shifts, 32-bit integers";
constexpr const char* longs = "64-bit + and *";
constexpr const char* functions = "sincos atan2 random Sobol film";
constexpr const char* subnormals = "subnormals: * < fma";

constexpr Question questions[] = {
    {floats, "addition", RT_PROBE_ADD, Domain::Ordinary, true},
    {floats, "subtraction", RT_PROBE_SUBTRACT, Domain::Ordinary, true},
    {floats, "multiplication", RT_PROBE_MULTIPLY, Domain::Ordinary, true},
    {floats, "fma", RT_PROBE_FMA, Domain::Ordinary, true},
    {floats, "square root", RT_PROBE_ROOT, Domain::Positive, true},
    {floats, "reciprocal", RT_PROBE_RECIPROCAL, Domain::Ordinary, true},
    {comparisons, "comparison and minimum, with NaN and zeros", RT_PROBE_COMPARE, Domain::Special, true},
    {conversions, "int to float", RT_PROBE_TO_FLOAT, Domain::Integers, true},
    {conversions, "float to int", RT_PROBE_TO_INT, Domain::SmallIntegers, true},
    {integers, "shifts", RT_PROBE_SHIFT, Domain::Integers, true},
    {integers, "32-bit integers", RT_PROBE_INTEGER, Domain::Integers, true},
    {longs, "64-bit addition", RT_PROBE_LONG_ADD, Domain::Integers, true},
    {longs, "64-bit multiplication", RT_PROBE_LONG_MULTIPLY, Domain::Integers, true},
    {functions, "sine and cosine", RT_PROBE_SINCOS, Domain::Turns, true},
    {functions, "atan2", RT_PROBE_ATAN2, Domain::Ordinary, true},
    {functions, "random numbers", RT_PROBE_RANDOM, Domain::Integers, true},
    {functions, "Sobol points", RT_PROBE_SOBOL, Domain::Integers, true},
    {functions, "radiance to integer", RT_PROBE_FILM, Domain::Radiance, true},
    // Rule 5 keeps ordinary scenes away from subnormals, so a device that flushes them is told of and not refused.
    {subnormals, "subnormal products", RT_PROBE_MULTIPLY, Domain::Subnormal, false},
    {subnormals, "subnormal comparison", RT_PROBE_COMPARE, Domain::SubnormalPairs, false},
    {subnormals, "subnormal fma", RT_PROBE_FMA, Domain::Subnormal, false},
};

bool is_root(std::uint32_t operation) { return operation == RT_PROBE_ROOT || operation == RT_PROBE_RECIPROCAL; }

// ---- asking the device ----

Result<BufferHandle> upload(Device& device, const Words& words)
{
	RT_TRY_ASSIGN(BufferHandle buffer, device.alloc(words.size() * sizeof(std::uint32_t)));
	RT_TRY(device.write(buffer, 0, words.data(), words.size() * sizeof(std::uint32_t)));
	return buffer;
}

Result<SelfTestItem> ask(Device& device, const ProgramHandle& program, const Question& question)
{
	const Operands operands = make_operands(question.domain);
	const auto items = static_cast<std::uint32_t>(operands.size());
	RT_TRY_ASSIGN(BufferHandle a, upload(device, operands.a));
	RT_TRY_ASSIGN(BufferHandle b, upload(device, operands.b));
	RT_TRY_ASSIGN(BufferHandle c, upload(device, operands.c));
	// Guarded: a device that does not write an answer leaves the pattern.
	Words answers(std::size_t(items) * 2, 0xdeadbeefu);
	RT_TRY_ASSIGN(BufferHandle out, upload(device, answers));
	RT_TRY(device.launch(program, "rt_probe", items, {a, b, c, out, question.operation, items}));
	RT_TRY(device.wait());
	RT_TRY(device.read(out, 0, answers.data(), answers.size() * sizeof(std::uint32_t)));

	SelfTestItem item{question.name, question.group, true, question.required, {}};
	std::size_t wrong = 0;
	for (std::size_t i = 0; i < items; ++i) {
		const Answer want = expected(question.operation, operands.a[i], operands.b[i], operands.c[i]);
		if (want.first == answers[2 * i] && want.second == answers[2 * i + 1])
			continue;
		if (wrong++ == 0)
			item.detail = fmt::format("of {:08x} {:08x} {:08x} gave {:08x} {:08x}, the contract says {:08x} {:08x}",
			                          operands.a[i], operands.b[i], operands.c[i], answers[2 * i], answers[2 * i + 1],
			                          want.first, want.second);
	}
	if (wrong) {
		item.passed = false;
		item.detail += fmt::format(" ({} of {} wrong)", wrong, items);
	}
	return item;
}

struct LayoutEntry {
	const char* name;
	std::uint32_t value;
};

const LayoutEntry layout[] = {
#define RT_LAYOUT_SIZE(type) {"size of " #type, std::uint32_t(sizeof(type))},
#define RT_LAYOUT_OFFSET(type, member) {"offset of " #type "." #member, std::uint32_t(offsetof(type, member))},
    RT_LAYOUT_LIST(RT_LAYOUT_SIZE, RT_LAYOUT_OFFSET)
#undef RT_LAYOUT_SIZE
#undef RT_LAYOUT_OFFSET
};
constexpr std::size_t layout_count = sizeof layout / sizeof layout[0];

Result<SelfTestItem> ask_layout(Device& device, const ProgramHandle& program)
{
	RT_TRY_ASSIGN(BufferHandle memory, device.alloc(sizeof(rt_scene)));
	Words answers(layout_count, 0xdeadbeefu);
	RT_TRY_ASSIGN(BufferHandle out, upload(device, answers));
	RT_TRY(device.launch(program, "rt_probe_layout", 1, {memory, out}));
	RT_TRY(device.wait());
	RT_TRY(device.read(out, 0, answers.data(), answers.size() * sizeof(std::uint32_t)));
	SelfTestItem item{"layout of the shared structs", "layout of structs", true, true, {}};
	for (std::size_t i = 0; i < layout_count && item.passed; ++i)
		if (answers[i] != layout[i].value) {
			item.passed = false;
			item.detail =
			    fmt::format("{} is {} on the device and {} on the host", layout[i].name, answers[i], layout[i].value);
		}
	return item;
}

Result<SelfTestItem> ask_stress_tile(Device& device, const ProgramHandle& program, Precision precision,
                                     bool through_tree)
{
	const std::uint32_t lanes = lanes_for(device.info(), precision);
	RT_TRY_ASSIGN(const Hash128 hash, render_stress_tile(device, program, lanes, through_tree));
	const char* const wanted = precision == Precision::Double ? stress_tile_double_hash : stress_tile_hash;
	SelfTestItem item{through_tree ? "stress tile through a tree" : "stress tile",
	                  "an image of 32x32",
	                  hash.hex() == wanted,
	                  true,
	                  {}};
	if (!item.passed)
		item.detail = fmt::format("hash {}, the contract says {}", hash.hex(), wanted);
	return item;
}

Result<SelfTestReport> run_double(const DeviceHandle& device)
{
	RT_TRY(check_precision(device->info(), Precision::Double));
	ProgramSpec spec;
	spec.root = "kernels/render.cl";
	spec.entries = {"rt_render"};
	spec.defines = {{"RT_LANES", "1"}};
	set_precision(spec, Precision::Double);
	Result<ProgramHandle> program = device->build(spec);
	if (!program) {
		// The compiler is there and works, so it is fp64 that it lacks.
		Error error = program.error();
		if (error.kind == ErrorKind::Build && !error.log.empty()) {
			error.kind = ErrorKind::NoDevice;
			error.message = "the device says that it has double precision, and its compiler refuses it";
			error.where = device->info().name;
			error.cure = "choose another device (`rt devices` lists them); --backend reference always has it";
		}
		return error;
	}
	SelfTestReport report;
	report.passed = true;
	for (const bool through_tree : {false, true}) {
		RT_TRY_ASSIGN(SelfTestItem tile, ask_stress_tile(*device, *program, Precision::Double, through_tree));
		report.passed = report.passed && tile.passed;
		report.items.push_back(std::move(tile));
	}
	return report;
}

ProgramSpec probe_program(const DeviceInfo& info, bool software_roots)
{
	ProgramSpec spec;
	spec.root = "kernels/probe.cl";
	spec.entries = {"rt_probe", "rt_probe_layout", "rt_render"};
	spec.defines = {{"RT_LANES", fmt::format("{}", info.native_lanes)},
	                {"RT_DEF_NATIVE_ROOTS", software_roots ? "0" : "1"}};
	// Compilers for one lane, a GPU's, copy every function to where it is called, and take a third less for what the
	// tile and the questions need. For lanes nothing is gained, and for 16 much is lost (docs/performance.md, Steps).
	if (info.native_lanes == 1)
		spec.defines.emplace_back("RT_FEATURES", fmt::format("{:#x}u", stress_tile_features | RT_FEATURE_SOBOL));
	return spec;
}

Result<SelfTestReport> run(const DeviceHandle& device, bool software_roots)
{
	RT_TRY_ASSIGN(const ProgramHandle program, device->build(probe_program(device->info(), software_roots)));

	SelfTestReport report;
	report.needs_software_roots = software_roots;
	RT_TRY_ASSIGN(SelfTestItem layout_item, ask_layout(*device, program));
	report.items.push_back(std::move(layout_item));
	for (const Question& question : questions) {
		RT_TRY_ASSIGN(SelfTestItem item, ask(*device, program, question));
		report.items.push_back(std::move(item));
	}
	for (const bool through_tree : {false, true}) {
		RT_TRY_ASSIGN(SelfTestItem tile, ask_stress_tile(*device, program, Precision::Exact, through_tree));
		report.items.push_back(std::move(tile));
	}
	report.passed = true;
	for (const SelfTestItem& item : report.items)
		report.passed = report.passed && (item.passed || !item.required);
	return report;
}

// Is a root the first thing that is wrong? Then everything after it may be wrong only because of it.
bool roots_at_fault(const SelfTestReport& report)
{
	for (const SelfTestItem& item : report.items)
		if (item.required && !item.passed)
			for (const Question& question : questions)
				if (item.name == question.name)
					return is_root(question.operation);
	return false;
}

// ---- remembering ----

CacheKey cache_key(const DeviceInfo& info, Precision precision)
{
	return {info.backend,
	        info.platform,
	        info.name,
	        info.driver,
	        info.compiler,
	        fmt::format("lanes {} {}", info.native_lanes, cache_environment()),
	        fmt::format("self-test{}, contract {}, kernels {}, rt {} {}",
	                    precision == Precision::Double ? " in double" : "", RT_CONTRACT_VERSION, kernel_hash(),
	                    RT_VERSION, RT_REVISION)};
}

// Only a pass is remembered, as one byte: whether software roots are needed. A failure is tested again, and explained
// again, every time.
void remember(const DeviceInfo& info, Precision precision, const SelfTestReport& report)
{
	if (report.passed)
		cache_store(cache_key(info, precision), {static_cast<std::uint8_t>(report.needs_software_roots ? 1 : 0)});
}

} // namespace

std::string SelfTestReport::first_failure() const
{
	for (const SelfTestItem& item : items)
		if (item.required && !item.passed)
			return item.name + ": " + item.detail;
	return {};
}

Result<SelfTestItem> test_layout(const DeviceHandle& device)
{
	RT_TRY_ASSIGN(const ProgramHandle program, device->build(probe_program(device->info(), false)));
	return ask_layout(*device, program);
}

std::optional<SelfTestReport> remembered_self_test(const DeviceInfo& info, Precision precision)
{
	const auto known = cache_load(cache_key(info, precision));
	if (!known || known->size() != 1)
		return std::nullopt;
	SelfTestReport report;
	report.needs_software_roots = (*known)[0] != 0;
	report.passed = report.from_cache = true;
	return report;
}

Result<SelfTestReport> self_test(const DeviceHandle& device, bool use_cache, Precision precision)
{
	const ContractFloatEnvironment environment;
	const auto start = std::chrono::steady_clock::now();
	if (use_cache)
		if (std::optional<SelfTestReport> known = remembered_self_test(device->info(), precision))
			return std::move(*known);
	const bool in_double = precision == Precision::Double;
	RT_TRY_ASSIGN(SelfTestReport report, in_double ? run_double(device) : run(device, false));
	if (!in_double && !report.passed && roots_at_fault(report)) {
		RT_TRY_ASSIGN(SelfTestReport again, run(device, true));
		// If that does not help, the first report names the culprit.
		if (again.passed) {
			again.native_roots_failure = report.first_failure();
			report = std::move(again);
		}
	}
	report.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
	remember(device->info(), precision, report);
	return report;
}

Error failed_self_test(const DeviceInfo& info, const SelfTestReport& report, const std::string& and_then)
{
	return Error{ErrorKind::SelfTest,
	             fmt::format("{} does not keep the numeric contract: {}", info.name, report.first_failure()),
	             fmt::format("self-test of {}, driver {}", describe(info), info.driver),
	             "take another device (`rt devices` lists them) or another driver; --force-unverified " + and_then,
	             {}};
}

} // namespace rt
