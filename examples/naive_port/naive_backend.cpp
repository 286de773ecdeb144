#include "examples/naive_port/naive_backend.h"

#include "backends/opencl/opencl_backend.h"
#include "examples/naive_port/naive_kernels.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>
#include <sstream>
#include <utility>

namespace rt {
namespace {

constexpr const char* backend_name = "naive";

// The habits that RT_NAIVE leaves.
Result<std::vector<NaiveHabit>> chosen_habits()
{
	const char* const variable = std::getenv("RT_NAIVE");
	if (!variable)
		return naive_habits();
	std::vector<NaiveHabit> chosen;
	std::istringstream words(variable);
	for (std::string word; std::getline(words, word, ',');) {
		if (word == "none")
			continue;
		const auto habit = std::find_if(naive_habits().begin(), naive_habits().end(),
		                                [&word](const NaiveHabit& one) { return one.name == word; });
		if (habit == naive_habits().end())
			return Error{ErrorKind::Usage,
			             fmt::format("RT_NAIVE names '{}', which is no habit of the naive port", word),
			             {},
			             "name any of dot, native, quadratic, sums, with commas, or none",
			             {}};
		chosen.push_back(*habit);
	}
	return chosen;
}

std::string names(const std::vector<NaiveHabit>& habits)
{
	std::string text;
	for (const NaiveHabit& habit : habits)
		text += (text.empty() ? "" : ", ") + habit.name;
	return text.empty() ? "none" : text;
}

class NaiveDevice final : public Device {
public:
	NaiveDevice(DeviceHandle device, DeviceInfo info, std::vector<NaiveHabit> habits)
	    : device_(std::move(device)), habits_(std::move(habits))
	{
		info_ = std::move(info);
	}

	Result<ProgramHandle> build(const ProgramSpec& spec) override
	{
		if (spec.root == "kernels/peak.cl") // measures speed alone, and has none of the places that habits change
			return device_->build(spec);
		ProgramSpec naive = spec;
		for (const NaiveHabit& habit : habits_) {
			naive.edits.insert(naive.edits.end(), habit.edits.begin(), habit.edits.end());
			if (habit.lets_compiler_fuse)
				naive.defines.emplace_back("RT_DEF_CONTRACT", "1");
		}
		return device_->build(naive);
	}

	Status launch(const ProgramHandle& program, const std::string& entry, std::uint64_t items,
	              const std::vector<Argument>& arguments, std::uint32_t group_size) override
	{
		return device_->launch(program, entry, items, arguments, group_size);
	}

	Result<BufferHandle> alloc(std::size_t bytes) override { return device_->alloc(bytes); }

	Status write(const BufferHandle& buffer, std::size_t offset, const void* data, std::size_t bytes) override
	{
		return device_->write(buffer, offset, data, bytes);
	}

	Status read(const BufferHandle& buffer, std::size_t offset, void* data, std::size_t bytes) override
	{
		return device_->read(buffer, offset, data, bytes);
	}

	Status wait() override { return device_->wait(); }

private:
	DeviceHandle device_;
	std::vector<NaiveHabit> habits_;
};

class NaiveBackend final : public Backend {
public:
	const char* name() const override { return backend_name; }

	Enumeration enumerate() override
	{
		Enumeration found;
		const Result<std::vector<NaiveHabit>> habits = chosen_habits();
		if (!habits) {
			found.absences.push_back({backend_name, habits.error().message, habits.error().cure});
			return found;
		}
		for (const DeviceInfo& info : opencl_backend().enumerate().devices)
			found.devices.push_back(as_naive(info, *habits));
		if (found.devices.empty())
			found.absences.push_back({backend_name, "the naive port runs on OpenCL, which has no device here",
			                          "see what is said of the opencl backend"});
		return found;
	}

	Result<DeviceHandle> open(const DeviceInfo& info) override
	{
		RT_TRY_ASSIGN(std::vector<NaiveHabit> habits, chosen_habits());
		RT_TRY_ASSIGN(DeviceHandle device, opencl_backend().open(info));
		return DeviceHandle(std::make_shared<NaiveDevice>(std::move(device), info, std::move(habits)));
	}

private:
	// Habits stand with the driver, by which self-tests are remembered: each choice of them is another candidate.
	static DeviceInfo as_naive(DeviceInfo info, const std::vector<NaiveHabit>& habits)
	{
		info.backend = backend_name;
		info.driver += fmt::format(", naive port: {}", names(habits));
		info.id = fmt::format("{}:{}", backend_name, info.id);
		info.reports_fp64 = false; // it has no double rung
		return info;
	}
};

} // namespace

Backend& naive_backend()
{
	static NaiveBackend backend;
	return backend;
}

} // namespace rt
