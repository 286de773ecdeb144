#include "tests/faulty_device.h"

#include <map>
#include <utility>

namespace rt {
namespace {

class FaultyDevice final : public Device {
public:
	FaultyDevice(DeviceHandle device, Fault fault) : device_(std::move(device)), fault_(std::move(fault))
	{
		info_ = device_->info();
		info_.name += " with a fault: " + fault_.name;
		if (fault_.native_lanes)
			info_.native_lanes = fault_.native_lanes;
	}

	Result<ProgramHandle> build(const ProgramSpec& spec) override
	{
		if (fault_.stale_program)
			if (const auto first = programs_.find(spec.root); first != programs_.end())
				return first->second;
		ProgramSpec faulty = spec;
		if (fault_.only_root.empty() || fault_.only_root == spec.root) {
			faulty.edits.insert(faulty.edits.end(), fault_.edits.begin(), fault_.edits.end());
			if (fault_.allow_contraction)
				faulty.defines.emplace_back("RT_DEF_CONTRACT", "1");
		}
		RT_TRY_ASSIGN(ProgramHandle program, device_->build(faulty));
		programs_.emplace(spec.root, program);
		return program;
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
		RT_TRY(device_->read(buffer, offset, data, bytes));
		if (fault_.tamper)
			fault_.tamper(offset, static_cast<unsigned char*>(data), bytes);
		return success();
	}

	Status wait() override { return device_->wait(); }

private:
	DeviceHandle device_;
	Fault fault_;
	std::map<std::string, ProgramHandle> programs_; // the first of each root
};

} // namespace

DeviceHandle make_faulty(const DeviceHandle& device, Fault fault)
{
	return std::make_shared<FaultyDevice>(device, std::move(fault));
}

} // namespace rt
