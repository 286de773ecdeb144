#include "tools/bench_sweep.h"

#include "tools/bench_threads.h"
#include "tools/report.h"

#include "render/scene_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

namespace rt {

namespace {

struct Plan {
	double x = 0;
	std::string scene;
	RenderOptions options;
	unsigned threads = 0; // 0: those of this process
};

// 1, 2, 4, ... and `last` itself.
std::vector<std::uint32_t> doublings(std::uint32_t last)
{
	std::vector<std::uint32_t> values;
	for (std::uint64_t value = 1; value < last; value *= 2)
		values.push_back(static_cast<std::uint32_t>(value));
	values.push_back(last);
	return values;
}

constexpr std::uint64_t most_spheres = 10000000;
// Areas half as large each.
constexpr int image_sizes = 7;

Result<std::vector<Plan>> plan(const BenchOptions& bench)
{
	std::vector<Plan> plans;
	RT_TRY_ASSIGN(const SceneFile file, open_scene(bench.render.scene));
	const RenderSettings settings = bench.render.settings_over(file.base.render);
	const auto add = [&](double x, const std::string& scene) -> Plan& {
		plans.push_back({x, scene, bench.render, 0});
		return plans.back();
	};
	switch (bench.sweep) {
	case Sweep::Pixels:
		for (int halvings = image_sizes - 1; halvings >= 0; --halvings) {
			const double scale = std::pow(2.0, -0.5 * halvings);
			const auto side = [scale](std::uint32_t full) {
				return std::max(1u, static_cast<std::uint32_t>(std::lround(full * scale)));
			};
			const std::uint32_t width = side(settings.width), height = side(settings.height);
			Plan& point = add(static_cast<double>(width) * height, bench.render.scene);
			point.options.width = width;
			point.options.height = height;
		}
		break;
	case Sweep::Samples:
		for (const std::uint32_t samples : doublings(settings.samples))
			add(samples, bench.render.scene).options.samples = samples;
		break;
	case Sweep::Depth:
		for (const std::uint32_t depth : doublings(settings.max_depth))
			add(depth, bench.render.scene).options.max_depth = depth;
		break;
	case Sweep::Spheres:
		for (std::uint64_t spheres = 10; spheres <= most_spheres; spheres *= 10)
			add(static_cast<double>(spheres), fmt::format("cloud-{}", spheres));
		break;
	case Sweep::Threads:
		for (const std::uint32_t threads : doublings(processors_allowed()))
			add(threads, bench.render.scene).threads = threads;
		break;
	case Sweep::None:
		break;
	}
	return plans;
}

// What the next point will take: in proportion after the first point, then as time grew between the last two, but
// neither slower than a square root nor faster than a square: others can hold up a short measurement.
double predicted_seconds(const std::vector<SweepPoint>& points, double x)
{
	if (points.empty())
		return 0;
	const SweepPoint& last = points.back();
	double exponent = 1;
	if (points.size() > 1)
		exponent = std::clamp(fitted_exponent(points, points.size() - 2).value_or(1), 0.5, 2.0);
	return last.seconds() * std::pow(x / last.x, exponent);
}

} // namespace

std::optional<double> fitted_exponent(const std::vector<SweepPoint>& points, std::size_t first)
{
	double n = 0, sum_x = 0, sum_y = 0, sum_xx = 0, sum_xy = 0;
	for (std::size_t i = first; i < points.size(); ++i) {
		if (!(points[i].x > 0) || !(points[i].seconds() > 0))
			continue;
		const double x = std::log(points[i].x), y = std::log(points[i].seconds());
		n += 1;
		sum_x += x;
		sum_y += y;
		sum_xx = std::fma(x, x, sum_xx);
		sum_xy = std::fma(x, y, sum_xy);
	}
	const double spread = std::fma(n, sum_xx, -(sum_x * sum_x));
	if (n < 2 || !(spread > 0))
		return std::nullopt;
	return std::fma(n, sum_xy, -(sum_x * sum_y)) / spread;
}

Result<SweepResult> run_sweep(const BenchOptions& options, const BenchDevice& device,
                              const std::function<void(const std::string&)>& status)
{
	SweepResult sweep;
	sweep.of = sweep_name(options.sweep);
	const DeviceKind kind = device.handle->info().kind;
	if (options.sweep == Sweep::Threads && kind != DeviceKind::Cpu && kind != DeviceKind::Host)
		return Error{ErrorKind::Usage, fmt::format("{} has no threads to vary", device.handle->info().name),
		             "--sweep threads", "choose a processor: --backend reference, or an OpenCL device of kind CPU", ""};
	RT_TRY_ASSIGN(const std::vector<Plan> plans, plan(options));
	for (const Plan& point : plans) {
		const double expected = options.sweep == Sweep::Threads ? 0 : predicted_seconds(sweep.points, point.x);
		if (expected > options.limit_seconds) {
			sweep.left_out =
			    fmt::format("{} {} and more would take {} a render, and --limit is {} s", format_quantity(point.x),
			                sweep.of, format_seconds(expected), options.limit_seconds);
			break;
		}
		Result<BenchRun> run =
		    point.threads ? bench_with_threads(point.scene, point.options, options.repeats, point.threads, status)
		                  : bench_scene(point.scene, point.options, device, options.repeats, status);
		if (!run && run.error().kind == ErrorKind::Memory && !sweep.points.empty()) {
			sweep.left_out = fmt::format("{} {}: {}", format_quantity(point.x), sweep.of, run.error().message);
			break;
		}
		if (!run)
			return run.error();
		sweep.points.push_back({point.x, std::move(run).value()});
	}
	sweep.exponent = fitted_exponent(sweep.points, 0);
	sweep.upper_exponent = fitted_exponent(sweep.points, sweep.points.size() / 2);
	return sweep;
}

} // namespace rt
