// Copies through staging memory, with a driver that copies as late as it may: at the next wait.
#include "backends/staging.h"
#include "tests/catch.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <random>
#include <vector>

using rt::Error;
using rt::ErrorKind;
using rt::Status;

namespace {

// A copy that was begun and not awaited may happen at any time: at the earliest or at the latest, both must do.
class Driver {
public:
	explicit Driver(bool late) : late_(late) {}

	Status start(void* target, const void* source, std::size_t bytes)
	{
		pending_.push_back({target, source, bytes});
		most_pending = std::max(most_pending, pending_.size());
		if (!late_)
			finish();
		return rt::success();
	}
	Status wait()
	{
		finish();
		return ++waits == fails_at ? Status(Error{ErrorKind::Failure, "the driver is gone", {}, {}, {}})
		                           : rt::success();
	}

	std::size_t most_pending = 0;
	int waits = 0, fails_at = 0;

private:
	struct Copy {
		void* target;
		const void* source;
		std::size_t bytes;
	};
	void finish()
	{
		for (const Copy& copy : pending_)
			std::memcpy(copy.target, copy.source, copy.bytes);
		pending_.clear();
	}

	bool late_;
	std::vector<Copy> pending_;
};

std::vector<std::uint8_t> noise(std::size_t bytes)
{
	std::mt19937 random(7);
	std::vector<std::uint8_t> values(bytes);
	for (std::uint8_t& value : values)
		value = static_cast<std::uint8_t>(random());
	return values;
}

const std::size_t sizes[] = {1,
                             rt::staging_bytes - 1,
                             rt::staging_bytes,
                             rt::staging_bytes + 1,
                             2 * rt::staging_bytes,
                             5 * rt::staging_bytes + 12345};

} // namespace

TEST_CASE("what is read through staging memory is what the device holds, in order")
{
	for (const std::size_t size : sizes)
		for (const bool late : {false, true}) {
			INFO(size << (late ? " late" : " early"));
			const std::vector<std::uint8_t> device = noise(size);
			std::vector<std::uint8_t> staging(2 * rt::staging_bytes), host(size);
			Driver driver(late);
			std::size_t next = 0;
			const Status done = rt::read_through_staging(
			    staging.data(), size,
			    [&](void* target, std::size_t first, std::size_t count) {
				    return driver.start(target, device.data() + first, count);
			    },
			    [&] { return driver.wait(); },
			    [&](const void* piece, std::size_t first, std::size_t bytes) {
				    CHECK(first == next);
				    CHECK(first % 64 == 0);
				    next = first + bytes;
				    rt::copy_to(host.data())(piece, first, bytes);
			    });
			REQUIRE(done);
			CHECK(next == size);
			CHECK(host == device);
		}
}

TEST_CASE("what is written through staging memory arrives")
{
	for (const std::size_t size : sizes)
		for (const bool late : {false, true}) {
			INFO(size << (late ? " late" : " early"));
			const std::vector<std::uint8_t> host = noise(size);
			std::vector<std::uint8_t> staging(2 * rt::staging_bytes), device(size);
			Driver driver(late);
			const auto start = [&](const void* source, std::size_t first, std::size_t count) {
				return driver.start(device.data() + first, source, count);
			};
			REQUIRE(rt::write_through_staging(staging.data(), host.data(), size, start, [&] { return driver.wait(); }));
			CHECK(device == host);
			CHECK(driver.most_pending == 1);
		}
}

TEST_CASE("a driver's failure ends a staged copy")
{
	const std::vector<std::uint8_t> host = noise(4 * rt::staging_bytes);
	std::vector<std::uint8_t> staging(2 * rt::staging_bytes), device(host.size());
	Driver driver(true);
	driver.fails_at = 2;
	const auto start = [&](const void* source, std::size_t first, std::size_t count) {
		return driver.start(device.data() + first, source, count);
	};
	CHECK_FALSE(
	    rt::write_through_staging(staging.data(), host.data(), host.size(), start, [&] { return driver.wait(); }));
	CHECK(driver.waits == 2);
}
