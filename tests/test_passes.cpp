// tools/passes.h: a render that is cut into passes is the straight one, and pays once for what its scene takes.
#include "tests/catch.h"
#include "tests/devices.h"

#include "tools/passes.h"

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <string>
#include <vector>

namespace {

using namespace rt;

constexpr std::uint32_t samples = 5;

PackedScene cloud()
{
	Result<SceneFile> file = open_scene("cloud-1000");
	REQUIRE(file);
	RenderSettings settings = file->base.render;
	settings.width = 40;
	settings.height = 30;
	settings.samples = samples;
	Result<PackedScene> packed = pack_scene(file->base, settings, {0, 0, settings.width, settings.height});
	REQUIRE(packed);
	return std::move(packed).value();
}

// Every pass of one sample.
PassOptions one_by_one()
{
	PassOptions options;
	options.samples = samples;
	options.resumable = true;
	options.checkpoint_seconds = 0;
	return options;
}

PassResult run(const PackedScene& packed, PassOptions options)
{
	Result<PassResult> result = render_in_passes(packed, {reference_device().device}, std::move(options));
	REQUIRE(result);
	return std::move(result).value();
}

} // namespace

TEST_CASE("passes share one tree, one program and one film")
{
	const PackedScene packed = cloud();
	PassOptions options = one_by_one();
	std::vector<std::string> done;
	options.session.status = [&done](const std::string& text) { done.push_back(text); };
	std::vector<std::string> films;
	options.checkpoint = [&films](const Film& film) {
		CHECK(film.is_even());
		films.push_back(film.hash().hex());
		return success();
	};
	const PassResult result = run(packed, std::move(options));

	REQUIRE(done.size() == 2);
	CHECK(done[0] == "building a tree of 1000 spheres");
	CHECK(done[1].find("compiling") == 0);
	REQUIRE(films.size() == samples);
	for (std::uint32_t taken = 1; taken <= samples; ++taken)
		CHECK(films[taken - 1] == render(packed, reference_device(), {}, taken).hash().hex());
	CHECK(result.film.hash().hex() == films.back());
	CHECK(result.samples == result.film.pixels() * samples);
	CHECK(result.segments == result.film.segments);
	REQUIRE(result.devices.size() == 1);
	CHECK(result.devices[0].samples == result.samples);
	CHECK_FALSE(result.interrupted);
	CHECK_FALSE(result.even);
}

TEST_CASE("passes go on from a film, and a stop leaves what can be gone on from")
{
	const PackedScene packed = cloud();
	const Film straight = render(packed, reference_device(), {}, samples);
	for (const std::uint32_t before : {0u, 2u, samples}) {
		PassOptions options = one_by_one();
		if (before > 0)
			options.start = render(packed, reference_device(), {}, before);
		std::uint64_t least = ~0ull, most = 0;
		options.progress = [&](const Progress& progress, std::uint64_t had) {
			CHECK(had == straight.pixels() * before);
			least = std::min(least, progress.samples_done);
			most = std::max(most, progress.samples_done);
			CHECK(progress.samples_total == straight.pixels() * samples);
		};
		const PassResult result = run(packed, std::move(options));
		CHECK(result.film.hash().hex() == straight.hash().hex());
		CHECK(result.samples == straight.pixels() * (samples - before));
		if (before < samples) {
			CHECK(least >= straight.pixels() * before);
			CHECK(most == straight.pixels() * samples);
		}
	}

	// Stopped in its third pass: the first two are whole.
	std::atomic<bool> stop = false;
	PassOptions options = one_by_one();
	options.session.rows_per_launch = 1;
	options.session.stop = &stop;
	unsigned checkpoints = 0;
	options.checkpoint = [&](const Film&) {
		checkpoints += 1;
		return success();
	};
	options.session.snapshot_wanted = [&] {
		stop = checkpoints == 2;
		return false;
	};
	const PassResult stopped = run(packed, std::move(options));
	CHECK(stopped.interrupted);
	CHECK_FALSE(stopped.film.is_even());
	CHECK(stopped.film.min_samples() == 2);
	CHECK(stopped.film.max_samples() == 3);
	REQUIRE(stopped.even);
	CHECK(stopped.even->hash().hex() == render(packed, reference_device(), {}, 2).hash().hex());
	CHECK(checkpoints == 3); // the last of the even film
}

TEST_CASE("a test that runs while a session opens is heard before anything is launched")
{
	const PackedScene packed = cloud();
	const std::string straight = render(packed, reference_device(), {}, samples).hash().hex();
	for (const TestDevice& device : test_devices())
		for (const bool needed : {false, true}) {
			PassOptions options = one_by_one();
			options.session.software_roots = device.needs_software_roots;
			std::vector<std::string> done;
			options.session.status = [&done](const std::string& text) { done.push_back(text.substr(0, 9)); };
			options.session.late_software_roots = [&] {
				done.push_back("heard");
				return Result<bool>(needed);
			};
			options.progress = [&done](const Progress&, std::uint64_t) { done.push_back("progress"); };
			Result<PassResult> result = render_in_passes(packed, {device.device}, std::move(options));
			INFO(device.name << ", needed " << needed);
			REQUIRE(result);
			CHECK(result->film.hash().hex() == straight);
			CHECK(result->devices[0].native_roots == !(needed || device.needs_software_roots));
			CHECK(result->devices[0].bvh);
			// Built again only where the first program was the wrong one.
			std::vector<std::string> expected = {"building ", "compiling", "heard"};
			if (needed && !device.needs_software_roots)
				expected.push_back("compiling");
			REQUIRE(done.size() > expected.size());
			CHECK(std::vector<std::string>(done.begin(), done.begin() + std::ptrdiff_t(expected.size())) == expected);
			CHECK(done[expected.size()] == "progress");
		}

	PassOptions options = one_by_one();
	options.session.late_software_roots = [] { return Result<bool>(Error{ErrorKind::SelfTest, "wrong", {}, {}, {}}); };
	options.progress = [](const Progress&, std::uint64_t) { FAIL("rendered all the same"); };
	const Result<PassResult> refused = render_in_passes(packed, {reference_device().device}, std::move(options));
	REQUIRE_FALSE(refused);
	CHECK(refused.error().kind == ErrorKind::SelfTest);
}
