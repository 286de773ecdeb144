#include "verify/exhaustive.h"

#include "common/rt_contract.h"
#include "support/float_environment.h"
#include "support/thread_pool.h"

// The host's own compilation: operands, hashes, and the functions whose bits are ours.
namespace {
thread_local unsigned rt_host_global_id = 0;
}
#include "kernels/exhaust.cl"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <mutex>
#include <random>

namespace rt {
namespace {

constexpr std::uint32_t block_length = 256;
constexpr std::uint32_t chunk_inputs = 1u << 26; // 2^18 blocks: enough threads for a large GPU
constexpr std::uint32_t rays_a_lane = 64;
constexpr std::uint32_t chunk_ray_lanes = 1u << 18;
constexpr std::uint32_t sphere_count = 1u << 16;
constexpr std::uint64_t max_failures = 1u << 16; // told one by one; more need no counting

const std::vector<ExhaustiveFunction> functions = {
    {"root", "all 2^32 floats but infinity", ExhaustiveKind::Device, RT_EXHAUST_ROOT, 1ull << 32, false, true},
    {"reciprocal", "all floats of size 2^-100 to 2^100", ExhaustiveKind::Device, RT_EXHAUST_RECIPROCAL, 1ull << 32,
     false, true},
    {"quotient", "pairs for a (1 / b), one divisor in four all ones", ExhaustiveKind::Device, RT_EXHAUST_QUOTIENT,
     1ull << 30, true, true},
    {"add", "pairs for a + b", ExhaustiveKind::Device, RT_EXHAUST_ADD, 1ull << 30, true, false},
    {"multiply", "pairs for a b", ExhaustiveKind::Device, RT_EXHAUST_MULTIPLY, 1ull << 30, true, false},
    {"fma", "triples for a b + c, c near -a b or a b", ExhaustiveKind::Device, RT_EXHAUST_FMA, 1ull << 30, true, false},
    {"sincos", "all u = k 2^-24 in [0, 1]", ExhaustiveKind::Device, RT_EXHAUST_SINCOS, (1ull << 24) + 1, false, false},
    {"atan2", "pairs, axes and diagonals among them", ExhaustiveKind::Device, RT_EXHAUST_ATAN2, 1ull << 26, true, true},
    {"asin", "heights of normals, poles and equator among them", ExhaustiveKind::Device, RT_EXHAUST_ASIN, 1ull << 26,
     true, true},
    {"film", "all floats in [0, 2] to integers of 2^-40", ExhaustiveKind::Device, RT_EXHAUST_FILM, (1ull << 30) + 1,
     false, false},
    {"to-int", "all floats with |x| < 2^31", ExhaustiveKind::Device, RT_EXHAUST_TO_INT, 2ull * 0x4f000000u, false,
     false},
    {"to-float", "all 2^32 integers", ExhaustiveKind::Device, RT_EXHAUST_TO_FLOAT, 1ull << 32, false, false},
    {"cell", "all floats, each among 1 to 2^20 cells of a texture", ExhaustiveKind::Device, RT_EXHAUST_CELL, 1ull << 32,
     false, false},
    {"roulette", "throughputs in [2^-60, 1) and random numbers", ExhaustiveKind::Device, RT_EXHAUST_ROULETTE,
     1ull << 28, true, true},
    {"random", "keys of the independent sampler", ExhaustiveKind::Device, RT_EXHAUST_RANDOM, 1ull << 30, true, false},
    {"sobol", "keys of the sampler sobol", ExhaustiveKind::Device, RT_EXHAUST_SOBOL, 1ull << 28, true, false},
    {"display", "all floats in [0, 2] to 8 bits by each transfer", ExhaustiveKind::Display, 0, (1ull << 30) + 1, false,
     false},
    {"seeds", "all mantissas, seeds up to 4 floats off", ExhaustiveKind::Seeds, 0, 9ull * 3 << 23, false, false},
    {"rehit", "rays that leave spheres of radius 2^-27 to 2^27", ExhaustiveKind::Rays, 0, 1000000000, true, true},
};

// ---- answers ----

struct Words {
	std::uint32_t first = 0, second = 0;
};

struct Totals {
	std::uint64_t tried = 0;
	double max_ulp = -1, max_error = -1;
	void join(const Totals& other)
	{
		tried += other.tried;
		max_ulp = std::max(max_ulp, other.max_ulp);
		max_error = std::max(max_error, other.max_error);
	}
	// The distance of ours from the truth, in units of the last digit that a float at the truth has.
	void measure(float ours, double truth)
	{
		const double error = std::fabs(static_cast<double>(ours) - truth);
		int exponent = 0;
		std::frexp(truth, &exponent);
		max_error = std::max(max_error, error);
		if (error > 0)
			max_ulp = std::max(max_ulp, std::ldexp(error, 24 - std::max(exponent, -125)));
	}
};

constexpr double tau = 6.283185307179586;

double number(std::uint32_t bits) { return static_cast<double>(rt_from_bits(bits)); }
Words narrow(double x) { return {rt_bits(static_cast<float>(x)), 0}; }

// sin and cos of f quarter turns past the quadrant, in double.
void sincos_turns(double u, double& sine, double& cosine)
{
	const double quadrant = std::floor(4 * u + 0.5), angle = (4 * u - quadrant) * (tau / 4);
	const double s = std::sin(angle), c = std::cos(angle);
	switch (static_cast<int>(quadrant) & 3) {
	case 0:
		sine = s, cosine = c;
		break;
	case 1:
		sine = c, cosine = -s;
		break;
	case 2:
		sine = -s, cosine = -c;
		break;
	default:
		sine = -c, cosine = s;
	}
}

// a b + c rounded once: the product is exact, its sum with c is rounded to odd.
Words fma_by_double(double a, double b, double c)
{
	const double product = a * b, sum = product + c;
	const double part = sum - product;
	const double error = (product - (sum - part)) + (c - part); // Knuth's two-sum: exact
	std::uint64_t bits;
	std::memcpy(&bits, &sum, sizeof bits);
	if (error != 0 && (bits & 1u) == 0)
		bits += (error > 0) == (sum > 0) ? 1u : ~std::uint64_t(0);
	double odd;
	std::memcpy(&odd, &bits, sizeof odd);
	return narrow(odd);
}

template <std::uint32_t operation>
Words answer(const rt_operands& o, Totals& totals)
{
	if constexpr (operation == RT_EXHAUST_ROOT)
		return number(o.a) > static_cast<double>(RT_MIN_SQUARE) ? narrow(std::sqrt(number(o.a))) : Words{};
	else if constexpr (operation == RT_EXHAUST_RECIPROCAL)
		return narrow(1 / number(o.a));
	else if constexpr (operation == RT_EXHAUST_QUOTIENT)
		return narrow(number(o.a) * static_cast<double>(static_cast<float>(1 / number(o.b))));
	else if constexpr (operation == RT_EXHAUST_ADD)
		return narrow(number(o.a) + number(o.b));
	else if constexpr (operation == RT_EXHAUST_MULTIPLY)
		return narrow(number(o.a) * number(o.b));
	else if constexpr (operation == RT_EXHAUST_FMA)
		return fma_by_double(number(o.a), number(o.b), number(o.c));
	else if constexpr (operation == RT_EXHAUST_SINCOS) {
		float ours[2];
		double truth[2];
		rt_sincos_turns(rt_from_bits(o.a), &ours[0], &ours[1]);
		sincos_turns(number(o.a), truth[0], truth[1]);
		totals.measure(ours[0], truth[0]);
		totals.measure(ours[1], truth[1]);
		return {rt_bits(ours[0]), rt_bits(ours[1])};
	} else if constexpr (operation == RT_EXHAUST_ATAN2) {
		const float ours = rt_atan2_turns(rt_from_bits(o.a), rt_from_bits(o.b));
		// Zeros have no sign here: an angle of half a turn is +1/2 unless y < 0.
		totals.measure(ours, std::atan2(number(o.a) == 0 ? 0.0 : number(o.a), number(o.b)) / tau);
		return {rt_bits(ours), 0};
	} else if constexpr (operation == RT_EXHAUST_ASIN) {
		const rt_float b = rt_from_bits(o.b), c = rt_from_bits(o.c);
		const rt_float ours = rt_atan2_turns(rt_from_bits(o.a), rt_sqrt(rt_fma(b, b, c * c)));
		totals.measure(ours, std::atan2(number(o.a), std::hypot(number(o.b), number(o.c))) / tau);
		return {rt_bits(ours), 0};
	} else if constexpr (operation == RT_EXHAUST_FILM) {
		const auto sum = static_cast<std::uint64_t>(std::llrint(number(o.a) * 0x1p40));
		return {static_cast<std::uint32_t>(sum), static_cast<std::uint32_t>(sum >> 32)};
	} else if constexpr (operation == RT_EXHAUST_TO_INT) {
		// By the digits: a mantissa of 24 bits, shifted.
		const int shift = static_cast<int>((o.a >> 23) & 255u) - 150;
		const std::uint64_t mantissa = (o.a & 0x7fffffu) | 0x800000u;
		const std::uint64_t size = shift >= 0 ? mantissa << shift : shift > -24 ? mantissa >> -shift : 0;
		return {static_cast<std::uint32_t>((o.a >> 31) != 0 ? 0 - size : size), 0};
	} else if constexpr (operation == RT_EXHAUST_CELL) {
		// No number and what is below 0 is in the first cell, what lies beyond in the last.
		const double x = number(o.a), last = number(o.b) - 1;
		return {x > 0 ? static_cast<std::uint32_t>(std::min(x, last)) : 0u, 0};
	} else if constexpr (operation == RT_EXHAUST_ROULETTE) {
		// The probability in units of 2^-24; the weight times the throughput never exceeds 1.
		const double q = (std::floor(number(o.a) * 0x1p24) + 1) * 0x1p-24;
		const rt_random4 u = rt_random(0x51ab1e5u, o.b, o.c, (o.c >> 26) | RT_ROULETTE_BLOCK);
		const double weight = static_cast<double>(u.a) < q ? number(narrow(1 / q).first) : 0;
		return {narrow(weight).first, narrow(std::min(weight * number(o.a), 1.0)).first};
	} else if constexpr (operation == RT_EXHAUST_RANDOM || operation == RT_EXHAUST_SOBOL) {
		const std::uint32_t seed = rt_exhaust_shuffle(o.c ^ 0x3c6ef372u);
		const rt_random4 u =
		    operation == RT_EXHAUST_SOBOL ? rt_sobol(seed, o.a, o.b, o.c) : rt_random(seed, o.a, o.b, o.c);
		const bool last = (o.c & 1u) != 0;
		return {rt_bits(last ? u.c : u.a), rt_bits(last ? u.d : u.b)};
	} else // RT_EXHAUST_TO_FLOAT
		return narrow(static_cast<double>(static_cast<std::int32_t>(o.a)));
}

using AnswerFunction = Words (*)(std::uint32_t input, Totals& totals);

template <std::uint32_t operation>
Words answer_input(std::uint32_t input, Totals& totals)
{
	const rt_operands o = rt_exhaust_operands(operation, input);
	if (!o.used)
		return {};
	++totals.tried;
	return answer<operation>(o, totals);
}

struct Piece { // inputs first + stride i, i < count, of a launch
	std::uint32_t first, stride, count;
	std::uint32_t blocks() const { return (count + block_length - 1) / block_length; }
};

// The hashes that the device's blocks should have.
template <std::uint32_t operation>
void answer_blocks(const Piece& piece, std::vector<std::uint32_t>& hashes, Totals& totals)
{
	std::mutex mutex;
	parallel_for(piece.blocks(), 64, [&](std::uint64_t begin, std::uint64_t end) {
		Totals own;
		for (std::uint64_t block = begin; block < end; ++block) {
			const auto from = static_cast<std::uint32_t>(block) * block_length;
			const std::uint32_t to = std::min(from + block_length, piece.count);
			std::uint32_t hash = 0;
			for (std::uint32_t i = from; i < to; ++i) {
				const Words words = answer_input<operation>(piece.first + i * piece.stride, own);
				hash = rt_probe_mix(rt_probe_mix(hash, words.first), words.second);
			}
			hashes[block] = hash;
		}
		const std::lock_guard lock(mutex);
		totals.join(own);
	});
}

struct Answers {
	void (*blocks)(const Piece& piece, std::vector<std::uint32_t>& hashes, Totals& totals);
	AnswerFunction one;
};

template <std::uint32_t operation>
constexpr Answers answers_of()
{
	return {answer_blocks<operation>, answer_input<operation>};
}

constexpr Answers answers[] = {
    answers_of<RT_EXHAUST_ROOT>(),   answers_of<RT_EXHAUST_RECIPROCAL>(), answers_of<RT_EXHAUST_QUOTIENT>(),
    answers_of<RT_EXHAUST_ADD>(),    answers_of<RT_EXHAUST_MULTIPLY>(),   answers_of<RT_EXHAUST_FMA>(),
    answers_of<RT_EXHAUST_SINCOS>(), answers_of<RT_EXHAUST_ATAN2>(),      answers_of<RT_EXHAUST_FILM>(),
    answers_of<RT_EXHAUST_TO_INT>(), answers_of<RT_EXHAUST_TO_FLOAT>(),   answers_of<RT_EXHAUST_ASIN>(),
    answers_of<RT_EXHAUST_CELL>(),   answers_of<RT_EXHAUST_ROULETTE>(),   answers_of<RT_EXHAUST_RANDOM>(),
    answers_of<RT_EXHAUST_SOBOL>(),
};

// What it means where a counter of rays is not 0.
constexpr const char* ray_faults[RT_EXHAUST_COUNTERS] = {nullptr,
                                                         nullptr,
                                                         "the sphere that was left outward is met again",
                                                         nullptr,
                                                         "the far end of the chord is missed",
                                                         nullptr,
                                                         "a normal or a direction is no unit vector",
                                                         nullptr};

std::uint64_t items_of(std::uint64_t lanes_wanted, std::uint32_t lanes) { return (lanes_wanted + lanes - 1) / lanes; }

// Radii over 16 decades, distances from inside to 2^23 radii, within rule 5's lengths.
std::vector<rt_sphere> make_spheres()
{
	std::mt19937 random(10);
	const auto uniform = [&] { return static_cast<double>(random()) * 0x1p-32; };
	std::vector<rt_sphere> spheres(sphere_count);
	for (rt_sphere& sphere : spheres) {
		const double exponent = 54 * uniform() - 27;
		const double distance = std::exp2(exponent + std::min(25 * uniform() - 2, 29 - exponent));
		const double z = 2 * uniform() - 1, turn = tau * uniform(), ring = std::sqrt(1 - z * z);
		sphere = {static_cast<float>(distance * ring * std::cos(turn)),
		          static_cast<float>(distance * ring * std::sin(turn)), static_cast<float>(distance * z),
		          static_cast<float>(std::exp2(exponent))};
	}
	return spheres;
}

} // namespace

const std::vector<ExhaustiveFunction>& exhaustive_functions() { return functions; }

const ExhaustiveFunction* find_exhaustive(const std::string& name)
{
	for (const ExhaustiveFunction& function : functions)
		if (name == function.name)
			return &function;
	return nullptr;
}

ExhaustiveResult ExhaustiveRun::begin(const ExhaustiveFunction& function, std::uint64_t stride, std::uint64_t count,
                                      bool software_roots)
{
	ExhaustiveResult result;
	result.name = function.name;
	result.software_roots = software_roots;
	result.stride = stride;
	const std::uint64_t inputs = function.samples && count != 0 ? count : function.inputs;
	result.total = (inputs + stride - 1) / stride;
	return result;
}

Status ExhaustiveRun::advance(const ExhaustiveFunction& function, ExhaustiveResult& result)
{
	const ContractFloatEnvironment environment;
	const auto start = std::chrono::steady_clock::now();
	switch (function.kind) {
	case ExhaustiveKind::Device:
		RT_TRY(advance_device(function, result));
		break;
	case ExhaustiveKind::Rays:
		RT_TRY(advance_rays(result));
		break;
	case ExhaustiveKind::Display:
		advance_display(result);
		break;
	case ExhaustiveKind::Seeds:
		advance_seeds(result);
		break;
	}
	result.seconds += std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
	return success();
}

Result<ProgramHandle> ExhaustiveRun::program(bool software_roots)
{
	ProgramHandle& known = programs_[software_roots ? 1 : 0];
	if (!known) {
		ProgramSpec spec;
		spec.root = "kernels/exhaust.cl";
		spec.entries = {"rt_exhaust", "rt_exhaust_rays"};
		spec.defines = {{"RT_LANES", fmt::format("{}", device_->info().native_lanes)},
		                {"RT_DEF_NATIVE_ROOTS", software_roots ? "0" : "1"}};
		RT_TRY_ASSIGN(known, device_->build(spec));
	}
	return known;
}

Status ExhaustiveRun::advance_device(const ExhaustiveFunction& function, ExhaustiveResult& result)
{
	RT_TRY_ASSIGN(const ProgramHandle ours, program(result.software_roots));
	const Piece piece = {static_cast<std::uint32_t>(result.done * result.stride),
	                     static_cast<std::uint32_t>(result.stride),
	                     static_cast<std::uint32_t>(std::min<std::uint64_t>(chunk_inputs, result.total - result.done))};
	std::vector<std::uint32_t> got(std::size_t(piece.blocks()) * 2, 0xdeadbeefu);
	const std::size_t bytes = got.size() * sizeof got[0];
	RT_TRY_ASSIGN(const BufferHandle out, device_->alloc(bytes));
	RT_TRY(device_->write(out, 0, got.data(), bytes)); // what a device leaves unwritten is wrong
	RT_TRY(device_->launch(ours, "rt_exhaust", items_of(piece.blocks(), device_->info().native_lanes),
	                       {out, function.operation, piece.first, piece.stride, piece.count, block_length}));
	// Meanwhile, where the device is not this processor.
	std::vector<std::uint32_t> hashes(piece.blocks());
	Totals totals;
	answers[function.operation].blocks(piece, hashes, totals);
	RT_TRY(device_->wait());
	RT_TRY(device_->read(out, 0, got.data(), bytes));

	result.tried += totals.tried;
	result.max_ulp = std::max(result.max_ulp, totals.max_ulp);
	result.max_error = std::max(result.max_error, totals.max_error);
	result.done += piece.count;
	for (std::uint32_t block = 0; block < piece.blocks(); ++block) {
		if (got[2 * std::size_t(block)] == hashes[block] && got[2 * std::size_t(block) + 1] == 0)
			continue;
		const std::uint32_t from = block * block_length;
		RT_TRY(tell_block(function, result, piece.first + from * piece.stride,
		                  std::min(block_length, piece.count - from)));
		if (result.failures >= max_failures) {
			result.note = fmt::format("given up after {} failures", result.failures);
			result.total = result.done;
			break;
		}
	}
	return success();
}

// Every result of a block whose hash is wrong.
Status ExhaustiveRun::tell_block(const ExhaustiveFunction& function, ExhaustiveResult& result, std::uint32_t first,
                                 std::uint32_t count)
{
	RT_TRY_ASSIGN(const ProgramHandle ours, program(result.software_roots));
	std::vector<std::uint32_t> got(std::size_t(count) * 2, 0xdeadbeefu);
	const std::size_t bytes = got.size() * sizeof got[0];
	RT_TRY_ASSIGN(const BufferHandle out, device_->alloc(bytes));
	RT_TRY(device_->write(out, 0, got.data(), bytes));
	const auto stride = static_cast<std::uint32_t>(result.stride);
	RT_TRY(device_->launch(ours, "rt_exhaust", items_of(count, device_->info().native_lanes),
	                       {out, function.operation, first, stride, count, 1u}));
	RT_TRY(device_->wait());
	RT_TRY(device_->read(out, 0, got.data(), bytes));
	std::uint64_t wrong = 0;
	for (std::uint32_t i = 0; i < count; ++i) {
		const std::uint32_t input = first + i * stride;
		Totals unused;
		const Words want = answers[function.operation].one(input, unused);
		const Words found = {got[2 * std::size_t(i)], got[2 * std::size_t(i) + 1]};
		if (found.first == want.first && found.second == want.second)
			continue;
		++wrong;
		if (result.first_failure.empty()) {
			const rt_operands o = rt_exhaust_operands(function.operation, input);
			result.first_failure =
			    fmt::format("of {:08x} {:08x} {:08x} gave {:08x} {:08x}, the contract says {:08x} {:08x}", o.a, o.b,
			                o.c, found.first, found.second, want.first, want.second);
		}
	}
	if (wrong == 0) {
		wrong = 1;
		if (result.first_failure.empty())
			result.first_failure = fmt::format("the hash of the {} inputs from number {:#x} on is wrong, and no result "
			                                   "is: the device computes now this, now that",
			                                   count, first);
	}
	result.failures += wrong;
	return success();
}

Status ExhaustiveRun::advance_rays(ExhaustiveResult& result)
{
	RT_TRY_ASSIGN(const ProgramHandle ours, program(result.software_roots));
	if (!spheres_) {
		const std::vector<rt_sphere> spheres = make_spheres();
		const std::uint32_t id = 0;
		RT_TRY_ASSIGN(spheres_, device_->alloc(spheres.size() * sizeof spheres[0]));
		RT_TRY(device_->write(spheres_, 0, spheres.data(), spheres.size() * sizeof spheres[0]));
		RT_TRY_ASSIGN(sphere_ids_, device_->alloc(sizeof id));
		RT_TRY(device_->write(sphere_ids_, 0, &id, sizeof id));
	}
	const std::uint64_t rays = result.total - result.done;
	const auto lanes =
	    static_cast<std::uint32_t>(std::min<std::uint64_t>(chunk_ray_lanes, (rays + rays_a_lane - 1) / rays_a_lane));
	const auto first = static_cast<std::uint32_t>(result.done / rays_a_lane);
	std::vector<std::uint32_t> counts(std::size_t(lanes) * RT_EXHAUST_COUNTERS, 0xdeadbeefu);
	const std::size_t bytes = counts.size() * sizeof counts[0];
	RT_TRY_ASSIGN(const BufferHandle out, device_->alloc(bytes));
	RT_TRY(device_->write(out, 0, counts.data(), bytes));
	RT_TRY(device_->launch(ours, "rt_exhaust_rays", items_of(lanes, device_->info().native_lanes),
	                       {spheres_, sphere_ids_, out, first, sphere_count, lanes, rays_a_lane}));
	RT_TRY(device_->wait());
	RT_TRY(device_->read(out, 0, counts.data(), bytes));
	std::uint64_t sums[RT_EXHAUST_COUNTERS] = {};
	for (std::size_t i = 0; i < counts.size(); ++i) {
		const char* const fault = ray_faults[i % RT_EXHAUST_COUNTERS];
		if (fault && counts[i] != 0 && result.first_failure.empty())
			result.first_failure =
			    fmt::format("{} of the rays of lane {}: {}", counts[i], first + i / RT_EXHAUST_COUNTERS, fault);
		sums[i % RT_EXHAUST_COUNTERS] += counts[i];
	}
	result.done += std::uint64_t(lanes) * rays_a_lane;
	result.total = std::max(result.total, result.done); // the last lanes take all their rays
	result.tried += sums[RT_EXHAUST_OUTWARD] + sums[RT_EXHAUST_INWARD];
	result.failures += sums[RT_EXHAUST_REHITS] + sums[RT_EXHAUST_CHORD_FAULTS] + sums[RT_EXHAUST_LENGTH_FAULTS];
	result.bits += sums[RT_EXHAUST_BITS];
	result.controls += sums[RT_EXHAUST_BOOK_REHITS];
	result.outward += sums[RT_EXHAUST_OUTWARD];
	return success();
}

} // namespace rt
