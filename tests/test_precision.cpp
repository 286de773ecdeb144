// The rungs beside the exact one: double is right to its own digits and the same on every device with fp64, fast is
// near, and neither touches the exact one.
#include "tests/catch.h"
#include "tests/devices.h"
#include "tests/double_kernels.h"
#include "tests/statistics.h"

#include "common/rt_contract.h"
#include "kernels/rng.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <fmt/format.h>
#include <memory>
#include <random>

using namespace rt;

namespace {

constexpr long double two_pi = 6.283185307179586476925286766559L;

bool has_double(const TestDevice& device) { return device.device->info().reports_fp64; }

SessionOptions of(Precision precision, bool specialise = true)
{
	SessionOptions options;
	options.precision = precision;
	options.specialise = specialise;
	return options;
}

Film reference_film(const PackedScene& packed, Precision precision, std::uint32_t samples)
{
	return render(packed, reference_device(), of(precision), samples);
}

} // namespace

// ---- functions ----

TEST_CASE("double rung: sine and cosine of turns are right to 1.6e-16")
{
	double worst = 0;
	const auto check = [&worst](double u) {
		const DoubleSincos result = double_sincos_turns(u);
		const long double angle = two_pi * static_cast<long double>(u);
		worst = std::max(worst, static_cast<double>(std::fabs(std::sin(angle) - result.sine)));
		worst = std::max(worst, static_cast<double>(std::fabs(std::cos(angle) - result.cosine)));
	};
	for (std::uint32_t k = 0; k < 1u << 24; k += 17) // what the random numbers are
		check(k * 0x1p-24);
	std::mt19937_64 engine(1);
	std::uniform_real_distribution<double> uniform(0, 1);
	for (int i = 0; i < 1000000; ++i)
		check(uniform(engine));
	INFO("largest error " << worst);
	CHECK(worst < 1.6e-16);
	CHECK(worst > 1e-17); // long double tells the difference
	// Quarters are exact.
	CHECK(double_sincos_turns(0.25).sine == 1);
	CHECK(double_sincos_turns(0.25).cosine == 0);
	CHECK(double_sincos_turns(0.5).cosine == -1);
	CHECK(double_sincos_turns(1).sine == 0);
}

TEST_CASE("double rung: atan2 in turns is right to 7e-17")
{
	double worst = 0;
	const auto check = [&worst](double y, double x) {
		const long double truth = std::atan2(static_cast<long double>(y), static_cast<long double>(x)) / two_pi;
		worst = std::max(worst, static_cast<double>(std::fabs(truth - double_atan2_turns(y, x))));
	};
	std::mt19937_64 engine(2);
	std::uniform_real_distribution<double> uniform(-1, 1), exponent(-40, 40);
	for (int i = 0; i < 1000000; ++i) {
		check(uniform(engine), uniform(engine));
		check(std::ldexp(uniform(engine), static_cast<int>(exponent(engine))), uniform(engine));
	}
	for (const double x : {-1.0, 1.0, 0.0})
		for (const double y : {-1.0, 1.0, 0.0})
			if (x < 0 || y != 0) // atan2(0, x > 0) is 0, checked below
				check(y, x);
	INFO("largest error " << worst);
	CHECK(worst < 7e-17);
	CHECK(worst > 1e-17);
	CHECK(double_atan2_turns(0, 0) == 0);
	CHECK(double_atan2_turns(0, 3) == 0);
}

TEST_CASE("double rung: roots, reciprocals and the film's integers are correctly rounded")
{
	std::mt19937_64 engine(3);
	std::uniform_real_distribution<double> mantissa(1, 2), exponent(-98, 98);
	for (int i = 0; i < 200000; ++i) {
		const double x = std::ldexp(mantissa(engine), static_cast<int>(exponent(engine)));
		if (double_sqrt(x) != std::sqrt(x) || double_rcp(x) != 1 / x)
			FAIL_CHECK("of " << x);
	}
	CHECK(double_sqrt(-1) == 0);
	CHECK(double_sqrt(std::nan("")) == 0);
	std::uniform_real_distribution<double> radiance(0, 1);
	for (int i = 0; i < 200000; ++i) {
		const double v = std::ldexp(radiance(engine), -(i % 41));
		if (double_film_integer(v) != std::llrint(v * 0x1p40))
			FAIL_CHECK("of " << v);
	}
	CHECK(double_film_integer(1) == std::int64_t(1) << 40);
	CHECK(double_film_integer(0x1p-41) == 0); // half to even
	CHECK(double_film_integer(0x3p-41) == 2);
}

// ---- whole images in double ----

TEST_CASE("double rung: every device with fp64 makes the same film, specialised or not")
{
	for (const TestScene& scene : test_scenes()) {
		const PackedScene packed = pack_test_scene(scene);
		const Film expected = reference_film(packed, Precision::Double, scene.samples);
		CHECK(expected.rejected == 0);
		for (const TestDevice& device : test_devices()) {
			if (!has_double(device)) {
				WARN("skipped: " << device.name << " has no fp64");
				continue;
			}
			for (const bool specialise : {true, false}) {
				INFO(scene.name << ", " << device.name << (specialise ? ", specialised" : ", generic"));
				const Film film = render(packed, device, of(Precision::Double, specialise), scene.samples);
				CHECK(film.hash().hex() == expected.hash().hex());
				CHECK(film.segments == expected.segments);
			}
		}
		// A tree leaves out work, never a hit.
		SessionOptions listed = of(Precision::Double);
		listed.bvh = Acceleration::Never;
		CHECK(render(packed, reference_device(), listed, scene.samples).hash().hex() == expected.hash().hex());
		// The control: an exact film is another one, except where nothing rounds.
		const bool rounds = scene.name != "closed" && scene.name != "furnace";
		CHECK((reference_film(packed, Precision::Exact, scene.samples).hash() == expected.hash()) != rounds);
	}
}

TEST_CASE("double rung: inside a glowing sphere radiance is exactly 1 - 2^-depth")
{
	const TestScene scene{"closed", 17, 13, 4, 1};
	for (const std::uint32_t depth : {1u, 5u, 23u, 36u}) {
		INFO("depth " << depth);
		PackedScene packed = pack_test_scene(scene);
		packed.scene.max_depth = depth;
		const Film film = reference_film(packed, Precision::Double, scene.samples);
		const std::int64_t one = std::int64_t(1) << film.exponent();
		const std::int64_t sum = scene.samples * (one - (one >> depth));
		CHECK(std::all_of(film.sums().begin(), film.sums().end(), [sum](std::int64_t s) { return s == sum; }));
	}
}

TEST_CASE("double rung: where nothing absorbs, every sample is exactly 1")
{
	const TestScene scene{"furnace", 33, 22, 8, 1};
	PackedScene packed = pack_test_scene(scene);
	packed.scene.max_depth = 2000;
	const Film film = reference_film(packed, Precision::Double, scene.samples);
	const std::int64_t sum = std::int64_t(scene.samples) << film.exponent();
	CHECK(std::all_of(film.sums().begin(), film.sums().end(), [sum](std::int64_t s) { return s == sum; }));
}

namespace {

// An independent path tracer for perfect mirrors under a sky, in long double and by the textbook: the quadratic
// formula, point minus centre, d - 2 (d . n) n. It takes the renderer's random numbers for the place in a pixel and
// reads the packed scene, so its sums may be compared integer by integer.
class MirrorTracer {
public:
	using Vector = std::array<long double, 3>;

	explicit MirrorTracer(const PackedScene& packed) : packed_(packed) {}

	std::array<std::int64_t, 3> sample(std::uint32_t x, std::uint32_t y, std::uint32_t number) const
	{
		const rt_scene& s = packed_.scene;
		const rt_random4 u = rt_random(s.seed, y * s.width + x, number, 0);
		const long double px = static_cast<long double>(x) + u.a, py = static_cast<long double>(y) + u.b;
		Vector origin{0, 0, 0};
		Vector direction{s.corner_x + px * s.step_x_x + py * s.step_y_x, s.corner_y + px * s.step_x_y + py * s.step_y_y,
		                 s.corner_z + px * s.step_x_z + py * s.step_y_z};
		Vector weight{1, 1, 1};
		normalise(direction);
		for (std::uint32_t depth = 0; depth < s.max_depth; ++depth) {
			long double nearest = HUGE_VALL;
			std::size_t hit = 0;
			for (std::size_t i = 0; i < packed_.spheres.size(); ++i)
				if (const long double t = distance(packed_.spheres[i], origin, direction); t > 1e-9L && t < nearest) {
					nearest = t;
					hit = i;
				}
			if (nearest == HUGE_VALL)
				return rounded(weight, direction);
			const rt_sphere& sphere = packed_.spheres[hit];
			const Vector center{sphere.cx, sphere.cy, sphere.cz};
			Vector normal;
			for (std::size_t k = 0; k < 3; ++k) {
				origin[k] += nearest * direction[k];
				normal[k] = (origin[k] - center[k]) / sphere.radius;
			}
			const long double projection = dot(direction, normal);
			for (std::size_t k = 0; k < 3; ++k)
				direction[k] -= 2 * projection * normal[k];
			normalise(direction);
			const rt_material& material = packed_.materials[packed_.sphere_materials[hit]];
			weight = {weight[0] * material.albedo_r, weight[1] * material.albedo_g, weight[2] * material.albedo_b};
		}
		return {0, 0, 0};
	}

private:
	static long double dot(const Vector& a, const Vector& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
	static void normalise(Vector& v)
	{
		const long double length = std::sqrt(dot(v, v));
		for (long double& component : v)
			component /= length;
	}
	static long double distance(const rt_sphere& sphere, const Vector& origin, const Vector& direction)
	{
		const Vector away{origin[0] - sphere.cx, origin[1] - sphere.cy, origin[2] - sphere.cz};
		const long double half_b = dot(away, direction);
		const long double c = dot(away, away) - static_cast<long double>(sphere.radius) * sphere.radius;
		const long double discriminant = half_b * half_b - c;
		return discriminant < 0 ? -1 : -half_b - std::sqrt(discriminant);
	}
	std::array<std::int64_t, 3> rounded(const Vector& weight, const Vector& direction) const
	{
		const rt_scene& s = packed_.scene;
		const long double height = (direction[1] + 1) / 2;
		const Vector sky{s.sky_bottom_r + height * s.sky_delta_r, s.sky_bottom_g + height * s.sky_delta_g,
		                 s.sky_bottom_b + height * s.sky_delta_b};
		std::array<std::int64_t, 3> result{};
		for (std::size_t k = 0; k < 3; ++k)
			result[k] = std::llrint(weight[k] * sky[k] * s.film_scale);
		return result;
	}

	const PackedScene& packed_;
};

// Mirrors on a mirror ground; a wide one, and one small enough to be none.
PackedScene pack_mirrors(double ground)
{
	Scene scene;
	scene.camera.from = {0.25, 1.25, -5}; // so that the ground is where the file says, unrounded
	scene.camera.at = {0, 0.6, 0};
	scene.camera.vfov = 50;
	scene.sky.kind = Sky::Kind::Gradient;
	scene.sky.bottom = {0.9, 0.7, 0.3};
	scene.sky.top = {0.2, 0.5, 1};
	for (const double albedo : {0.5, 0.9, 0.7}) {
		Material material;
		material.kind = Material::Kind::Metal;
		material.albedo = {albedo, albedo / 2, 1 - albedo / 3};
		material.fuzz = 0;
		scene.materials.push_back(material);
	}
	scene.spheres = {{{0, -ground, 0}, ground, 0}, {{-1.1, 0.9, 0.2}, 0.8, 1}, {{1.0, 0.7, -0.3}, 0.6, 2}};
	RenderSettings settings;
	settings.width = 40;
	settings.height = 30;
	settings.max_depth = 3;
	settings.seed = 11;
	const Result<PackedScene> packed = pack_scene(scene, settings, {0, 0, 40, 30});
	REQUIRE(packed);
	return *packed;
}

// Sorted absolute differences of a film's sums from the tracer's, in units of the film's last place a sample.
std::vector<double> differences_from(const MirrorTracer& tracer, const Film& film, std::uint32_t samples)
{
	std::vector<double> differences;
	for (std::uint32_t y = 0; y < film.window().height; ++y)
		for (std::uint32_t x = 0; x < film.window().width; ++x) {
			std::array<std::int64_t, 3> sum{};
			for (std::uint32_t n = 0; n < samples; ++n) {
				const std::array<std::int64_t, 3> one = tracer.sample(x, y, n);
				for (std::size_t k = 0; k < 3; ++k)
					sum[k] += one[k];
			}
			for (std::size_t k = 0; k < 3; ++k) {
				const std::size_t i = 3 * (std::size_t(y) * film.window().width + x) + k;
				differences.push_back(std::fabs(static_cast<double>(film.sums()[i] - sum[k])) / samples);
			}
		}
	std::sort(differences.begin(), differences.end());
	return differences;
}

} // namespace

TEST_CASE("double rung: mirrors agree with a textbook tracer in long double, sample by sample")
{
	constexpr std::uint32_t samples = 4;
	for (const double ground : {10.0, 1000.0}) {
		const PackedScene packed = pack_mirrors(ground);
		REQUIRE(packed.wide.empty() == (ground == 10.0));
		const MirrorTracer tracer(packed);
		const std::vector<double> of_double =
		    differences_from(tracer, reference_film(packed, Precision::Double, samples), samples);
		const std::vector<double> of_exact =
		    differences_from(tracer, reference_film(packed, Precision::Exact, samples), samples);
		const std::size_t middle = of_double.size() / 2;
		INFO("ground " << ground << ": in units of 2^-" << packed.film_exponent << ", double: median "
		               << of_double[middle] << ", largest " << of_double.back() << "; exact: median "
		               << of_exact[middle] << ", largest " << of_exact.back());
		CHECK(of_double[middle] == 0);
		CHECK(of_double.back() <= 4);   // at a silhouette an error of a last place grows
		CHECK(of_exact[middle] > 1000); // the control: float32 has 2^17 times coarser digits
	}
}

// ---- the rungs against each other ----

namespace {

struct Comparison {
	double bias = 0; // largest of the channels: |mean difference| over the mean
	double z = 0;    // of the same channel: over its standard error
	double rmse = 0; // over the root mean square
};

// The rungs take the same random numbers, so differences are taken pixel by pixel.
Comparison compare(const Film& film, const Film& base)
{
	Comparison result;
	double squares = 0, power = 0;
	const double count = static_cast<double>(film.pixels());
	for (std::size_t channel = 0; channel < 3; ++channel) {
		double mean = 0, square = 0, brightness = 0;
		for (std::size_t i = channel; i < film.sums().size(); i += 3) {
			const double value = static_cast<double>(base.sums()[i]);
			const double difference = static_cast<double>(film.sums()[i] - base.sums()[i]);
			mean += difference / count;
			square += difference * difference / count;
			brightness += value / count;
			power += value * value;
			squares += difference * difference;
		}
		const double bias = brightness > 0 ? std::fabs(mean) / brightness : 0;
		if (bias > result.bias) {
			result.bias = bias;
			result.z = std::fabs(mean) / std::sqrt(std::max(square - mean * mean, 1e-300) / count);
		}
	}
	result.rmse = std::sqrt(squares / power);
	return result;
}

// Rounding alone is a bias of some 1e-9, so z says nothing below that; above, chance must explain it. 4.5 sigma in
// three channels: 2e-5 if the random numbers were drawn anew.
bool is_unbiased(const Comparison& comparison) { return comparison.bias < 1e-7 || comparison.z < 4.5; }

// Larger than test_scenes(), so that a bias shows.
std::vector<TestScene> larger_scenes()
{
	return {{"three-spheres", 96, 64, 8, 1}, {"floating", 80, 60, 6, 3}, {"cornell", 60, 46, 8, 6}};
}

} // namespace

TEST_CASE("exact agrees with double: no bias, and what scatters is little")
{
	for (const TestScene& scene : larger_scenes()) {
		const PackedScene packed = pack_test_scene(scene);
		const Film truth = reference_film(packed, Precision::Double, scene.samples);
		const Comparison comparison = compare(reference_film(packed, Precision::Exact, scene.samples), truth);
		INFO(scene.name << ": bias " << comparison.bias << ", z " << comparison.z << ", rmse " << comparison.rmse);
		CHECK(is_unbiased(comparison));
		CHECK(comparison.bias < 1e-4);
		CHECK(comparison.rmse < 0.02);

		// The control: albedos a hundredth of a percent too bright.
		PackedScene wrong = packed;
		for (rt_material& material : wrong.materials)
			for (float* albedo : {&material.albedo_r, &material.albedo_g, &material.albedo_b})
				*albedo *= 1.0001f;
		for (rt_texture& texture : wrong.textures)
			for (float* albedo : {&texture.even_r, &texture.even_g, &texture.even_b})
				*albedo *= 1.0001f;
		const Comparison biased = compare(reference_film(wrong, Precision::Exact, scene.samples), truth);
		INFO("brightened: bias " << biased.bias << ", z " << biased.z);
		CHECK(biased.bias > 1e-5);
		CHECK_FALSE(is_unbiased(biased));
	}
}

TEST_CASE("fast is near exact on every device, and is not exact")
{
	for (const TestDevice& device : test_devices()) {
		bool differs = false;
		for (const TestScene& scene : larger_scenes()) {
			const PackedScene packed = pack_test_scene(scene);
			const Film exact = render(packed, device, of(Precision::Exact), scene.samples);
			const Film fast = render(packed, device, of(Precision::Fast), scene.samples);
			const Comparison comparison = compare(fast, exact);
			INFO(device.name << ", " << scene.name << ": bias " << comparison.bias << ", z " << comparison.z
			                 << ", rmse " << comparison.rmse);
			CHECK(fast.rejected == 0);
			// Approximations to 2^-22 may bias a thing that float32 does not; a picture shows none of it.
			CHECK(comparison.bias < 1e-4);
			CHECK(comparison.rmse < 0.02);
			differs = differs || fast.hash() != exact.hash();

			// The controls: another seed scatters much more, and a brighter sky is a bias.
			PackedScene other = packed;
			other.scene.seed += 1;
			CHECK(compare(render(other, device, of(Precision::Exact), scene.samples), exact).rmse > 0.05);
			other = packed;
			for (rt_material& material : other.materials)
				for (float* light : {&material.albedo_r, &material.albedo_g, &material.albedo_b, &material.emission_r,
				                     &material.emission_g, &material.emission_b})
					*light *= 0.999f;
			CHECK(compare(render(other, device, of(Precision::Fast), scene.samples), exact).bias > 1e-4);
		}
		INFO(device.name);
		CHECK(differs);
	}
}

TEST_CASE("fast: a part of it can be measured alone, and none of it is the exact film")
{
	const TestScene scene = test_scenes().front();
	const PackedScene packed = pack_test_scene(scene);
	const Film exact = reference_film(packed, Precision::Exact, scene.samples);
	for (const TestDevice& device : test_devices()) {
		INFO(device.name);
		SessionOptions options = of(Precision::Fast);
		options.fast_parts = 0;
		options.samples = scene.samples;
		const Result<SessionResult> result = render_scene(packed, {device.device}, options);
		if (device.is_reference()) { // compiled beforehand, as a whole
			REQUIRE_FALSE(result);
			CHECK(result.error().kind == ErrorKind::Build);
			continue;
		}
		REQUIRE(result);
		CHECK(result->film.hash().hex() == exact.hash().hex());
	}
}

// ---- devices that cannot ----

namespace {

// A device that fails in one way: its compiler refuses double, or an image read back has a bit flipped.
class FaultyDevice final : public Device {
public:
	FaultyDevice(DeviceHandle honest, bool refuses, bool flips)
	    : honest_(std::move(honest)), refuses_(refuses), flips_(flips)
	{
		info_ = honest_->info();
	}
	Result<ProgramHandle> build(const ProgramSpec& spec) override
	{
		if (refuses_ && integer_define(spec, "RT_PRECISION", 0) == RT_PRECISION_DOUBLE)
			return Error{ErrorKind::Build, "clBuildProgram failed", "", "", "error: use of type 'double'"};
		return honest_->build(spec);
	}
	Status launch(const ProgramHandle& program, const std::string& entry, std::uint64_t items,
	              const std::vector<Argument>& arguments, std::uint32_t group_size) override
	{
		return honest_->launch(program, entry, items, arguments, group_size);
	}
	Result<BufferHandle> alloc(std::size_t bytes) override { return honest_->alloc(bytes); }
	Status write(const BufferHandle& buffer, std::size_t offset, const void* data, std::size_t bytes) override
	{
		return honest_->write(buffer, offset, data, bytes);
	}
	Status read(const BufferHandle& buffer, std::size_t offset, void* data, std::size_t bytes) override
	{
		Status status = honest_->read(buffer, offset, data, bytes);
		if (flips_)
			*static_cast<unsigned char*>(data) ^= 1;
		return status;
	}
	Status wait() override { return honest_->wait(); }

private:
	DeviceHandle honest_;
	bool refuses_, flips_;
};

} // namespace

TEST_CASE("double rung: the self-test passes where there is fp64, and finds a flipped bit")
{
	for (const TestDevice& device : test_devices()) {
		if (!has_double(device))
			continue;
		const Result<SelfTestReport> report = self_test(device.device, false, Precision::Double);
		REQUIRE(report);
		INFO(device.name << ": " << report->first_failure());
		CHECK(report->passed);
	}
	const auto flipping = std::make_shared<FaultyDevice>(reference_device().device, false, true);
	const Result<SelfTestReport> report = self_test(flipping, false, Precision::Double);
	REQUIRE(report);
	CHECK_FALSE(report->passed);
	CHECK(report->first_failure().rfind("stress tile", 0) == 0);
}

TEST_CASE("double rung: a device without fp64 says so, whether it knows or its compiler finds out")
{
	const auto refusing = std::make_shared<FaultyDevice>(reference_device().device, true, false);
	const Result<SelfTestReport> refused = self_test(refusing, false, Precision::Double);
	REQUIRE_FALSE(refused);
	CHECK(refused.error().kind == ErrorKind::NoDevice);
	CHECK(refused.error().log.find("double") != std::string::npos);

	Enumeration found;
	DeviceInfo gpu;
	gpu.backend = "opencl";
	gpu.name = "a GPU of no doubles";
	gpu.kind = DeviceKind::Gpu;
	found.devices = {gpu, reference_device().device->info()};
	DeviceRequest request;
	CHECK(select_devices(request, found)->front().name == gpu.name);
	request.precision = Precision::Double;
	CHECK(select_devices(request, found)->front().backend == "reference"); // passed over
	request.device = "no doubles";
	const auto named = select_devices(request, found);
	REQUIRE_FALSE(named);
	CHECK(named.error().kind == ErrorKind::NoDevice);
	CHECK(named.error().message.find("fp64") != std::string::npos);
	CHECK(named.error().cure.find("reference") != std::string::npos);
	request.device.clear();
	request.backend = "opencl";
	CHECK(select_devices(request, found).error().kind == ErrorKind::NoDevice);
}

TEST_CASE("the programs shipped compiled are exact, and an exact program's text knows no rungs")
{
	const PackedScene packed = pack_test_scene(test_scenes().front());
	const DeviceInfo& info = reference_device().device->info();
	const auto defines = [&](Precision precision) {
		std::string names;
		for (const auto& [name, value] : render_program(packed, info, of(precision)).defines)
			names += name + "=" + value + " ";
		return names;
	};
	CHECK(defines(Precision::Exact).find("PRECISION") == std::string::npos);
	CHECK(defines(Precision::Fast).find("RT_PRECISION=1") != std::string::npos);
	CHECK(defines(Precision::Double).find("RT_PRECISION=2") != std::string::npos);
	CHECK(defines(Precision::Double).find("RT_LANES=1 ") != std::string::npos);
}
